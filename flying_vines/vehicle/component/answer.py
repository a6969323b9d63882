"""COMMAND_ACK, the answer to the sender of a command."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.codec import Message


def acknowledgement(command: Message, result: int, percent: int = 0) -> Message:
    """The answer to a COMMAND_LONG or COMMAND_INT.

    Args:
        command: the command.
        result: MAV_RESULT.
        percent: how much of it is done, where the result is IN_PROGRESS.
    """
    return mavlink.MAVLink_command_ack_message(
        command.command, result, percent, 0, command.get_srcSystem(), command.get_srcComponent()
    )
