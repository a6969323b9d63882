"""Who may change what we do: our autopilot and ground stations. This is the only place that decides it.

Everybody may read, and everybody may let air out of the vine.

A ground station is recognised by the type in its HEARTBEAT. Scripts send no HEARTBEAT, and some autopilots do
not forward it to a companion. So a sender without a HEARTBEAT is recognised by its ids. Ids and types can be
forged; only signing proves the sender.

QGroundControl reads an ArduPilot's parameters as a file. Then it requests no parameters of other components,
but it accepts parameters that it did not request. So each station gets ours once, after it has had time to
read the autopilot's.
"""

from __future__ import annotations

from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.state import VehicleState

SETTLED_S = 7.0
GONE_S = 60.0
MAX_SENDERS = 256
STATION_SYSTEMS = range(240, 256)
"""Vehicles have system ids from 1 up, ground stations from 255 down. mavsdk uses 245."""
STATION_COMPONENTS = (
    mavlink.MAV_COMP_ID_ALL,  # pymavlink's default
    mavlink.MAV_COMP_ID_MISSIONPLANNER,  # QGroundControl, Mission Planner, mavsdk
    230,  # MAVProxy
)


class Sender(NamedTuple):
    """The sender of one message, and what it is to us. The kinds exclude each other."""

    system_id: int
    component_id: int
    is_autopilot: bool = False
    """It is the autopilot that we serve."""
    is_station: bool = False
    """It is a ground station: a person decides."""

    @property
    def name(self) -> str:
        return f"{self.system_id}/{self.component_id}"

    @property
    def refusal(self) -> str:
        """Why the sender may change nothing; empty if it may."""
        return "" if self.is_autopilot or self.is_station else f"{self.name} is not a ground station"


class Senders:
    """All times are seconds of one clock."""

    def __init__(self) -> None:
        self._type_of: dict[tuple[int, int], int] = {}
        """MAV_TYPE of each sender's latest heartbeat."""
        self._received_at: dict[int, float] = {}
        self._show_at: dict[int, float] = {}

    def handle(self, t: float, heartbeat: MavlinkMessage, show: bool) -> None:
        """Take in a heartbeat that is not the autopilot's. `show`: send our parameters to a new station."""
        sender = _ids(heartbeat)
        self._type_of.pop(sender, None)
        self._type_of[sender] = heartbeat.type
        if len(self._type_of) > MAX_SENDERS:
            del self._type_of[next(iter(self._type_of))]
        if not show or heartbeat.type != mavlink.MAV_TYPE_GCS:
            return
        system_id = heartbeat.get_srcSystem()
        if t - self._received_at.get(system_id, float("-inf")) > GONE_S:
            self._show_at[system_id] = t + SETTLED_S
        self._received_at[system_id] = t

    def of(self, message: MavlinkMessage, vehicle: VehicleState) -> Sender:
        """The sender of a message."""
        sender = _ids(message)
        if vehicle.is_ours(message):
            return Sender(*sender, is_autopilot=True)
        return Sender(*sender, is_station=sender[0] != vehicle.system_id and self._is_station(sender))

    def _is_station(self, sender: tuple[int, int]) -> bool:
        if sender in self._type_of:
            return sender[0] != 0 and self._type_of[sender] == mavlink.MAV_TYPE_GCS
        return sender[0] in STATION_SYSTEMS and sender[1] in STATION_COMPONENTS

    def due(self, t: float) -> bool:
        """True, once for each station, if it needs our parameters now."""
        waiting = [system_id for system_id, show_at in self._show_at.items() if t >= show_at]
        for system_id in waiting:
            del self._show_at[system_id]
        return bool(waiting)


def _ids(message: MavlinkMessage) -> tuple[int, int]:
    return message.get_srcSystem(), message.get_srcComponent()
