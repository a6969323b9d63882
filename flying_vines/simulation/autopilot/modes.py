"""Flight modes: their names here, and how HEARTBEAT shows them."""

from __future__ import annotations

from dataclasses import dataclass

from flying_vines.vehicle.mission.storage import AutopilotKind

ARMED_FLAG = 128


@dataclass(frozen=True, slots=True)
class FlightMode:
    """A flight mode as HEARTBEAT shows it; `base` is base_mode while disarmed."""

    name: str
    custom: int
    base: int


_ARDUPILOT = {
    mode.name: mode
    for mode in (
        FlightMode("STABILIZE", 0, 81),
        FlightMode("AUTO", 3, 89),
        FlightMode("GUIDED", 4, 89),
        FlightMode("LOITER", 5, 89),
        FlightMode("RTL", 6, 89),
        FlightMode("LAND", 9, 81),
    )
}

_PX4 = {
    mode.name: mode
    for mode in (
        FlightMode("POSCTL", 3 << 16, 81),
        FlightMode("STABILIZE", 7 << 16, 81),
        FlightMode("TAKEOFF", 4 << 16 | 2 << 24, 29),
        FlightMode("HOLD", 4 << 16 | 3 << 24, 29),
        FlightMode("MISSION", 4 << 16 | 4 << 24, 29),
        FlightMode("RTL", 4 << 16 | 5 << 24, 29),
        FlightMode("LAND", 4 << 16 | 6 << 24, 29),
    )
}

_PX4_ALIASES = {"AUTO": "MISSION", "GUIDED": "HOLD", "LOITER": "HOLD"}


def modes_of(kind: AutopilotKind) -> dict[str, FlightMode]:
    """The simulated modes of the autopilot, by name."""
    return dict(_ARDUPILOT if kind == "ardupilot" else _PX4)


def mode_named(kind: AutopilotKind, name: str) -> FlightMode:
    """The mode of this name. AUTO, GUIDED and LOITER also name modes of PX4. Raises `ValueError`."""
    modes = modes_of(kind)
    key = name.upper()
    if kind == "px4":
        key = _PX4_ALIASES.get(key, key)
    if key not in modes:
        raise ValueError(f"the simulated {kind} has no mode {name!r}; it has {', '.join(modes)}")
    return modes[key]


def mode_numbered(kind: AutopilotKind, custom: int) -> FlightMode | None:
    """The mode with this custom_mode number, or None."""
    return next((mode for mode in modes_of(kind).values() if mode.custom == custom), None)


def mission_mode(kind: AutopilotKind) -> FlightMode:
    """The mode that flies the mission."""
    return mode_named(kind, "AUTO")
