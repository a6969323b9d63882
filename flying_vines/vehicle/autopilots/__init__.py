"""The known autopilots. To add one: a subclass of `Autopilot` in its own module, and its row here."""

from __future__ import annotations

from flying_vines.vehicle.autopilots.ardupilot import ArduPilot
from flying_vines.vehicle.autopilots.autopilot import Autopilot
from flying_vines.vehicle.autopilots.px4 import Px4
from flying_vines.vehicle.mission.item import AutopilotKind

AUTOPILOTS: dict[AutopilotKind, Autopilot] = {"ardupilot": ArduPilot(), "px4": Px4()}
OTHER = Autopilot()

_OF_HEARTBEAT = {autopilot.mav_autopilot: autopilot for autopilot in AUTOPILOTS.values()}


def of_heartbeat(mav_autopilot: int) -> Autopilot:
    """The autopilot for the MAV_AUTOPILOT of a HEARTBEAT."""
    return _OF_HEARTBEAT.get(mav_autopilot, OTHER)


_OF_NAME = {autopilot.kind: autopilot for autopilot in AUTOPILOTS.values()}


def of_name(kind: str) -> Autopilot:
    return _OF_NAME.get(kind, OTHER)
