"""The requirements of a robot: one TOML file, by default the paper's demonstration."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from flying_vines.config.config import ConfigError
from flying_vines.files.toml_text import converted, read_text
from flying_vines.physics import paper
from flying_vines.physics.gas import STANDARD_PRESSURE_KPA

# The bounds keep every result finite.
PositiveFloat = Annotated[float, Meta(ge=1e-6, le=1e6)]
NotNegativeFloat = Annotated[float, Meta(ge=0, le=1e6)]


class PartNames(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The parts to evaluate, by file name; default: the paper's prototype.

    With an empty `venturi` the phloSAR vents passively and has no DVP (the Venturi's supply valve).
    """

    evp: str = "clippard-evp"
    dvp: str = "clippard-dvp"
    venturi: str = "coval-vr09f14"
    solenoid: str = "huamei-solenoid"
    reservoir: str = "pet-2.0"
    reservoirs: Annotated[int, Meta(ge=1, le=10)] = 1


class Robot(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A pneumatic soft robot for the design guide (paper, Sec. VI). Pressures are gauge.

    Its speed is given by either `frequency_Hz` or `inflation_rate_kPa_per_s`. `peak_to_peak_kPa` is the swing
    of a cycle, by default from 0 to `pressure_kPa`; the paper calls it A.
    """

    name: str
    cv_volume_L: PositiveFloat
    pressure_kPa: PositiveFloat
    payload_kg: PositiveFloat
    cv_kind: Literal["rigid", "pouch"] = "rigid"
    frequency_Hz: PositiveFloat | None = None
    wave: Literal["triangle", "sine"] = "triangle"
    inflation_rate_kPa_per_s: PositiveFloat | None = None
    deflation_rate_kPa_per_s: PositiveFloat | None = None
    peak_to_peak_kPa: PositiveFloat | None = None
    least_cycles: NotNegativeFloat = 0.0
    fill_kPa: PositiveFloat = 690.0
    other_mass_kg: NotNegativeFloat = 0.0
    ambient_kPa: Annotated[float, Meta(ge=20, le=120)] = STANDARD_PRESSURE_KPA
    parts: PartNames = PartNames()

    def __post_init__(self) -> None:
        if (self.frequency_Hz is None) == (self.inflation_rate_kPa_per_s is None):
            raise ValueError("give either frequency_Hz or inflation_rate_kPa_per_s")
        if self.swing_kPa > self.pressure_kPa:
            raise ValueError("peak_to_peak_kPa is above pressure_kPa")
        if self.cv_kind == "pouch" and self.swing_kPa != self.pressure_kPa:
            raise ValueError("a pouch is flat at first: peak_to_peak_kPa must be pressure_kPa")

    @property
    def swing_kPa(self) -> float:
        """ΔP_cv of one cycle, kPa."""
        return self.pressure_kPa if self.peak_to_peak_kPa is None else self.peak_to_peak_kPa

    @property
    def wanted_inflation_kPa_per_s(self) -> float:
        """The wanted dP_cv/dt, kPa/s: as given, or as the wave needs it (paper, Eq. 5)."""
        if self.inflation_rate_kPa_per_s is not None:
            return self.inflation_rate_kPa_per_s
        assert self.frequency_Hz is not None
        if self.wave == "sine":
            return paper.sine_peak_rate_kPa_per_s(self.frequency_Hz, self.swing_kPa / 2.0)
        return paper.triangle_rate_kPa_per_s(self.frequency_Hz, self.swing_kPa)

    @property
    def wanted_deflation_kPa_per_s(self) -> float:
        """The wanted deflation rate, kPa/s; default: the inflation rate."""
        return self.deflation_rate_kPa_per_s or self.wanted_inflation_kPa_per_s

    @property
    def cycle_rate_Hz(self) -> float:
        """Cycles per second without pauses."""
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
        """The air for one inflation of a pouch that is flat before it, standard litres."""
        return paper.pouch_fill_SL(self.pressure_kPa, self.cv_volume_L, self.ambient_kPa)

    @property
    def fill_SL(self) -> float:
        """The air for one inflation of this control volume, standard litres."""
        return self.pouch_fill_SL if self.cv_kind == "pouch" else self.rigid_fill_SL


def example_text() -> str:
    """The commented robot file of the paper's demonstration."""
    file = resources.files("flying_vines.studies.design").joinpath("examples/vine.toml")
    return file.read_text(encoding="utf-8")


def demonstration() -> Robot:
    """The robot of the paper's Sec. VII."""
    return parse(example_text(), "examples/vine.toml")


def load(path: Path) -> Robot:
    """The robot in a robot file. Raises `ConfigError` with one line that names file, line and key."""
    return parse(read_text(path, ConfigError), str(path))


def parse(text: str, source: str) -> Robot:
    """The robot in the text of a robot file; `source` is its name in errors. Raises `ConfigError`."""
    robot: Robot = converted(text, source, Robot, ConfigError)
    return robot
