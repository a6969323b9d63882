"""The autopilots that we know. To add one: a subclass of `Autopilot` in its own module, and its row here."""

from __future__ import annotations

from flying_vines.vehicle.autopilots.ardupilot import ArduPilot
from flying_vines.vehicle.autopilots.autopilot import Autopilot
from flying_vines.vehicle.autopilots.px4 import Px4
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.mission.storage import AutopilotKind

AUTOPILOTS: dict[AutopilotKind, Autopilot] = {"ardupilot": ArduPilot(), "px4": Px4()}
OTHER = Autopilot()

_OF_HEARTBEAT = {autopilot.mav_autopilot: autopilot for autopilot in AUTOPILOTS.values()}


def of_heartbeat(mav_autopilot: int) -> Autopilot:
    """The autopilot that a HEARTBEAT names (MAV_AUTOPILOT)."""
    return _OF_HEARTBEAT.get(mav_autopilot, OTHER)


def of_name(kind: str) -> Autopilot:
    """The autopilot of this name."""
    return next((autopilot for autopilot in AUTOPILOTS.values() if autopilot.kind == kind), OTHER)


def store(kind: AutopilotKind, item: MissionItem) -> MissionItem:
    """The item as this autopilot would give it back; MissionRefused if it would not take it."""
    return AUTOPILOTS[kind].store(item)
