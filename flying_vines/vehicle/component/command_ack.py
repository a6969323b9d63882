"""COMMAND_ACK, the answer to the sender of a command."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.codec import MavlinkMessage


def acknowledgement(command: MavlinkMessage, result: int, percent: int = 0) -> MavlinkMessage:
    """The answer to a COMMAND_LONG or COMMAND_INT.

    Args:
        command: the command.
        result: MAV_RESULT.
        percent: progress, for the result IN_PROGRESS.
    """
    return mavlink.MAVLink_command_ack_message(
        command.command, result, percent, 0, command.get_srcSystem(), command.get_srcComponent()
    )
