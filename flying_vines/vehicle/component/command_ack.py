"""COMMAND_ACK, the answer to the sender of a command."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.codec import MavlinkMessage


class AirOutAck(mavlink.MAVLink_command_ack_message):  # type: ignore[misc]
    """COMMAND_ACK for a command that let air out. It is dropped only if all waiting answers are such ones, or
    if its sender is the busiest."""


def acknowledgement(
    command: MavlinkMessage, result: int, percent: int = 0, lets_air_out: bool = False
) -> MavlinkMessage:
    """The answer to a COMMAND_LONG or COMMAND_INT.

    Args:
        command: the command.
        result: MAV_RESULT.
        percent: progress, for the result IN_PROGRESS.
        lets_air_out: the command let air out.
    """
    kind = AirOutAck if lets_air_out else mavlink.MAVLink_command_ack_message
    return kind(command.command, result, percent, 0, command.get_srcSystem(), command.get_srcComponent())
