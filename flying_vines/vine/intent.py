"""What the pilot or the mission wants, before safety has looked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Command = Literal[
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
"""What a person who does not ask over MAVLink calls an intent."""

Asker = Literal["page", "broker", "calibration"]
"""By what way a person asks who does not ask over MAVLink."""

ACTS_WITHIN_S = 1.0
"""A request of page or broker that is older only lets air out: that is never late."""


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
    """Stay where the vine is."""

    def __str__(self) -> str:
        return "hold"


@dataclass(frozen=True, slots=True)
class Vent:
    """Let the air out, now: always allowed."""

    def __str__(self) -> str:
        return "vent"


@dataclass(frozen=True, slots=True)
class ClearFaults:
    """A person says that latched faults have been seen to."""

    def __str__(self) -> str:
        return "clear faults"


@dataclass(frozen=True, slots=True)
class ArmPneumatics:
    """A person says that the vine may bend."""

    def __str__(self) -> str:
        return "arm the pneumatics"


@dataclass(frozen=True, slots=True)
class DisarmPneumatics:
    """Let the air out, and bend for nobody until a person arms."""

    def __str__(self) -> str:
        return "disarm the pneumatics"


@dataclass(frozen=True, slots=True)
class StartBench:
    """Let the vine be tried on the ground, without an armed vehicle."""

    def __str__(self) -> str:
        return "bench mode"


@dataclass(frozen=True, slots=True)
class StopBench:
    """No longer on the bench."""

    def __str__(self) -> str:
        return "leave bench mode"


Intent = (
    StartProfile
    | BendTo
    | SetPressure
    | Hold
    | Vent
    | ClearFaults
    | ArmPneumatics
    | DisarmPneumatics
    | StartBench
    | StopBench
)

COMMAND_OF: dict[type[Intent], Command] = {
    Vent: "vent",
    Hold: "hold",
    StartProfile: "profile",
    BendTo: "bend",
    SetPressure: "pressure",
    ClearFaults: "clear_faults",
    ArmPneumatics: "arm",
    DisarmPneumatics: "disarm",
    StartBench: "start_bench",
    StopBench: "stop_bench",
}
