"""Intents: requests of people, the mission and installed packages, before safety judges them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

CommandName = Literal[
    "vent",
    "hold",
    "profile",
    "bend",
    "pressure",
    "clear_faults",
    "arm",
    "disarm",
    "start_bench",
    "stop_bench",
]
"""The name of an intent in requests that do not come over MAVLink."""

Asker = Literal["page", "broker", "calibration"]
"""The source of a request that does not come over MAVLink."""

ACTS_WITHIN_S = 1.0
"""A request older than this may only deflate the vine."""


@dataclass(frozen=True, slots=True)
class StartProfile:
    """Run the named profile of the configuration."""

    name: str

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class BendTo:
    """Bend to an angle and stay there."""

    angle_deg: float

    def __str__(self) -> str:
        return f"bend {self.angle_deg:g}°"


@dataclass(frozen=True, slots=True)
class SetPressure:
    """Go to a pressure (gauge) and hold it."""

    target_kPa: float

    def __str__(self) -> str:
        return f"{self.target_kPa:g} kPa"


@dataclass(frozen=True, slots=True)
class Hold:
    """Stay at the present pressure."""

    def __str__(self) -> str:
        return "hold"


@dataclass(frozen=True, slots=True)
class VentVine:
    """Vent the vine now. Always allowed."""

    def __str__(self) -> str:
        return "vent"


@dataclass(frozen=True, slots=True)
class ClearLatchedFaults:
    """A person clears latched faults."""

    def __str__(self) -> str:
        return "clear faults"


@dataclass(frozen=True, slots=True)
class ArmPneumatics:
    """A person allows the vine to bend."""

    def __str__(self) -> str:
        return "arm the pneumatics"


@dataclass(frozen=True, slots=True)
class DisarmPneumatics:
    """Vent the vine. It cannot bend until a person arms the pneumatics."""

    def __str__(self) -> str:
        return "disarm the pneumatics"


@dataclass(frozen=True, slots=True)
class StartBench:
    """Allow the vine to bend on the ground, without an armed vehicle."""

    def __str__(self) -> str:
        return "bench mode"


@dataclass(frozen=True, slots=True)
class StopBench:
    """End bench mode and vent."""

    def __str__(self) -> str:
        return "leave bench mode"


Intent = (
    StartProfile
    | BendTo
    | SetPressure
    | Hold
    | VentVine
    | ClearLatchedFaults
    | ArmPneumatics
    | DisarmPneumatics
    | StartBench
    | StopBench
)

COMMAND_OF: dict[type[Intent], CommandName] = {
    VentVine: "vent",
    Hold: "hold",
    StartProfile: "profile",
    BendTo: "bend",
    SetPressure: "pressure",
    ClearLatchedFaults: "clear_faults",
    ArmPneumatics: "arm",
    DisarmPneumatics: "disarm",
    StartBench: "start_bench",
    StopBench: "stop_bench",
}

_NAMES: dict[type, str] = {VentVine: "Vent", ClearLatchedFaults: "ClearFaults"}


def name_of(kind: type[Intent]) -> str:
    """The name of a kind of intent in flight logs."""
    return _NAMES.get(kind, kind.__name__)
