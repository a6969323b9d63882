"""What the robot wants of its air: one TOML profile, by default the paper's demonstration."""

from __future__ import annotations

import math
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from flying_vines.config.config import ConfigError
from flying_vines.config.toml_text import read_text
from flying_vines.physics import paper
from flying_vines.physics.constants import STANDARD_PRESSURE_KPA
from flying_vines.studies.design.reading import decode

# The bounds keep every result finite.
PositiveNumeral = Annotated[float, Meta(ge=1e-6, le=1e6)]
NotNegativeNumber = Annotated[float, Meta(ge=0, le=1e6)]


class PartNames(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The choice of parts to evaluate, by the names of their files; by default the paper's prototype.

    An empty `venturi` is a phloSAR that vents passively: it has no DVP either.
    """

    evp: str = "clippard-evp"
    dvp: str = "clippard-dvp"
    venturi: str = "coval-vr09f14"
    solenoid: str = "huamei-solenoid"
    reservoir: str = "pet-2.0"
    reservoirs: Annotated[int, Meta(ge=1, le=10)] = 1


class Robot(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A pneumatic soft robot as the design guide needs to know it (paper, Sec. VI).

    `frequency_Hz` or `inflation_rate_kPa_per_s` says how fast it is to be: one of them.
    `peak_to_peak_kPa` is the swing of a cycle, by default from 0 to `pressure_kPa`; the paper calls it A.
    """

    name: str
    cv_volume_L: PositiveNumeral
    pressure_kPa: PositiveNumeral
    payload_kg: PositiveNumeral
    cv_kind: Literal["rigid", "pouch"] = "rigid"
    frequency_Hz: PositiveNumeral | None = None
    wave: Literal["triangle", "sine"] = "triangle"
    inflation_rate_kPa_per_s: PositiveNumeral | None = None
    deflation_rate_kPa_per_s: PositiveNumeral | None = None
    peak_to_peak_kPa: PositiveNumeral | None = None
    least_cycles: NotNegativeNumber = 0.0
    fill_kPa: PositiveNumeral = 690.0
    other_mass_kg: NotNegativeNumber = 0.0
    ambient_kPa: Annotated[float, Meta(ge=20, le=120)] = STANDARD_PRESSURE_KPA
    parts: PartNames = PartNames()

    def __post_init__(self) -> None:
        for key in self.__struct_fields__:
            value = getattr(self, key)
            if isinstance(value, float) and not math.isfinite(value):
                raise ValueError(f"{key} is not a finite number")
        if (self.frequency_Hz is None) == (self.inflation_rate_kPa_per_s is None):
            raise ValueError("give either frequency_Hz or inflation_rate_kPa_per_s")
        if self.swing_kPa > self.pressure_kPa:
            raise ValueError("peak_to_peak_kPa is above pressure_kPa")
        if self.cv_kind == "pouch" and self.swing_kPa != self.pressure_kPa:
            raise ValueError("a pouch lies flat at first: peak_to_peak_kPa must be pressure_kPa")

    @property
    def swing_kPa(self) -> float:
        """ΔP_cv of one cycle, kPa."""
        return self.pressure_kPa if self.peak_to_peak_kPa is None else self.peak_to_peak_kPa

    @property
    def wanted_inflation_kPa_per_s(self) -> float:
        """The wanted dP_cv/dt, kPa/s: as said, or what the wave needs (paper, Eq. 5)."""
        if self.inflation_rate_kPa_per_s is not None:
            return self.inflation_rate_kPa_per_s
        assert self.frequency_Hz is not None
        if self.wave == "sine":
            return paper.sine_peak_rate_kPa_per_s(self.frequency_Hz, self.swing_kPa / 2.0)
        return paper.triangle_rate_kPa_per_s(self.frequency_Hz, self.swing_kPa)

    @property
    def wanted_deflation_kPa_per_s(self) -> float:
        """As fast down as up, unless the profile says otherwise, kPa/s."""
        return self.deflation_rate_kPa_per_s or self.wanted_inflation_kPa_per_s

    @property
    def cycle_rate_Hz(self) -> float:
        """Cycles per second when they follow each other without a pause."""
        if self.frequency_Hz is not None:
            return self.frequency_Hz
        up, down = self.wanted_inflation_kPa_per_s, self.wanted_deflation_kPa_per_s
        return 1.0 / (self.swing_kPa / up + self.swing_kPa / down)

    @property
    def rigid_fill_SL(self) -> float:
        """The air that Eq. 8 counts for one inflation, standard litres."""
        return paper.rigid_fill_SL(self.swing_kPa, self.cv_volume_L)

    @property
    def pouch_fill_SL(self) -> float:
        """The air that one inflation takes if the control volume lies flat before it, standard litres."""
        return paper.pouch_fill_SL(self.pressure_kPa, self.cv_volume_L, self.ambient_kPa)

    @property
    def fill_SL(self) -> float:
        """The air that one inflation takes, for the kind of control volume that it is, standard litres."""
        return self.pouch_fill_SL if self.cv_kind == "pouch" else self.rigid_fill_SL


def example_text() -> str:
    """The commented profile of the paper's demonstration."""
    file = resources.files("flying_vines.studies.design").joinpath("examples/vine.toml")
    return file.read_text(encoding="utf-8")


def demonstration() -> Robot:
    """The robot of the paper's Sec. VII."""
    return parse(example_text(), "examples/vine.toml")


def load(path: Path) -> Robot:
    """Read and check a profile; `ConfigError` says in one line which file, line and key is wrong."""
    return parse(read_text(path, ConfigError), str(path))


def parse(text: str, source: str) -> Robot:
    """Check the text of a profile; `source` is what errors call it."""
    known = [*Robot.__struct_fields__, *PartNames.__struct_fields__]
    robot: Any = decode(text, source, Robot, known)
    if not isinstance(robot, Robot):
        raise ConfigError(f"{source}: not a robot's profile")
    return robot
