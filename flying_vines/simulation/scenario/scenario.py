"""Scenario files: kinds of run, and checks. EVP: inflation valve. DVP: the Venturi's supply valve."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from flying_vines.files.toml_text import OneLineError, converted, read_text
from flying_vines.vine.curve import BendCurve
from flying_vines.vine.motion import Motion, plan
from flying_vines.vine.profile import MAX_PIECES, HoldFor, Ramp, Step
from flying_vines.vine.profile import Sine as Swing

_EXAMPLES = resources.files("flying_vines.simulation.scenario") / "examples"
LONGEST_S = 3600.0
MOST_KPA = 150.0
"""Maximum setpoint, gauge: the control volume's sensor range minus a margin for overshoot."""
FIRMWARE_HZ = 1000
_NO_CURVE = BendCurve(((0.0, 0.0), (1.0, 0.0)))
"""A bend curve that is never used, because profiles in scenarios are in kPa."""

RunName = Annotated[
    str, Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,39}\Z", description="of 1 to 40 letters, digits, - and _")
]
Pressure = Annotated[float, Meta(ge=0, le=MOST_KPA)]
OpeningFraction = Annotated[float, Meta(ge=0, le=1)]
Duration = Annotated[float, Meta(gt=0, le=LONGEST_S)]
Frequency = Annotated[float, Meta(gt=0, le=FIRMWARE_HZ / 2)]
Times = Annotated[int, Meta(ge=1, le=1000)]


class Common(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="kind",
    omit_defaults=True,
):
    """Keys of all kinds of run. A run starts at rest, with the control volume at ambient pressure."""

    name: RunName | None = None
    """Part of the file's name; default: the kind."""
    reservoir_kPa: Annotated[float, Meta(ge=1, le=900)] = 690.0
    """Gauge, at the start."""
    sample_rate_Hz: Annotated[int, Meta(ge=10, le=FIRMWARE_HZ)] = 50

    def __post_init__(self) -> None:
        if FIRMWARE_HZ % self.sample_rate_Hz:
            raise ValueError(
                f"sample_rate_Hz: {self.sample_rate_Hz} does not divide the firmware's {FIRMWARE_HZ} Hz"
            )
        self.check()

    def check(self) -> None:
        """Raises `ValueError` if keys contradict each other."""
        if not self.length_s <= LONGEST_S:
            raise ValueError(f"a run of {self.length_s:g} s is longer than {LONGEST_S:.0f} s")

    @property
    def label(self) -> str:
        return self.name or str(self.__struct_config__.tag)

    @property
    def needs_cv(self) -> bool:
        return True

    @property
    def length_s(self) -> float:
        raise NotImplementedError


class _Lasting(Common, frozen=True, kw_only=True):
    duration_s: Duration

    @property
    def length_s(self) -> float:
        return self.duration_s


class StepsRun(Common, tag="steps", frozen=True, kw_only=True):
    """Pressure steps, each held for its time."""

    pressures_kPa: Annotated[tuple[Pressure, ...], Meta(min_length=1, max_length=1000)]
    hold_s: Duration | tuple[Duration, ...]
    """One time for all, or one per pressure."""

    @property
    def holds_s(self) -> tuple[float, ...]:
        if isinstance(self.hold_s, tuple):
            return self.hold_s
        return (self.hold_s,) * len(self.pressures_kPa)

    @property
    def length_s(self) -> float:
        return sum(self.holds_s)

    def check(self) -> None:
        if len(self.holds_s) != len(self.pressures_kPa):
            count = len(self.pressures_kPa)
            raise ValueError(
                f"hold_s: {len(self.holds_s)} times for {count} pressures; give one time, or one per pressure"
            )
        super().check()


class _Swinging(_Lasting, frozen=True, kw_only=True):
    low_kPa: Pressure = 0.0
    high_kPa: Pressure

    @property
    def fastest_Hz(self) -> float:
        raise NotImplementedError

    def check(self) -> None:
        if not self.low_kPa < self.high_kPa:
            raise ValueError("high_kPa: must be above low_kPa")
        if self.fastest_Hz > self.sample_rate_Hz / 2:
            raise ValueError(
                f"sample_rate_Hz: {self.sample_rate_Hz} samples a second cannot show {self.fastest_Hz:g} Hz"
            )
        super().check()


class SineRun(_Swinging, tag="sine", frozen=True, kw_only=True):
    """A sine that starts at its low end."""

    frequency_Hz: Frequency

    @property
    def fastest_Hz(self) -> float:
        return self.frequency_Hz


class ChirpRun(_Swinging, tag="chirp", frozen=True, kw_only=True):
    """A sine whose frequency changes from `from_Hz` to `to_Hz`, evenly in octaves (log) or hertz (linear)."""

    from_Hz: Frequency
    to_Hz: Frequency
    sweep: Literal["log", "linear"] = "log"

    @property
    def fastest_Hz(self) -> float:
        return max(self.from_Hz, self.to_Hz)


class PrbsRun(_Lasting, tag="prbs", frozen=True, kw_only=True):
    """Random levels, each held for a random time. The seed determines levels and times.

    The regulator follows `levels_kPa`. `levels_opening` are openings of the EVP without regulation. A share
    `vent_share` of them are vents instead, with the DVP shut, half or fully open. From `most_kPa` on the EVP
    stays shut.
    """

    levels_kPa: tuple[Pressure, ...] = ()
    levels_opening: tuple[OpeningFraction, ...] = ()
    min_hold_s: Duration = 0.1
    max_hold_s: Duration = 0.8
    vent_share: OpeningFraction = 0.3
    most_kPa: Pressure = 60.0

    def check(self) -> None:
        if bool(self.levels_kPa) == bool(self.levels_opening):
            raise ValueError("give either levels_kPa or levels_opening")
        if len(set(self.levels_kPa or self.levels_opening)) < 2:
            raise ValueError(f"levels_{'kPa' if self.levels_kPa else 'opening'}: give at least two levels")
        if self.min_hold_s > self.max_hold_s:
            raise ValueError("max_hold_s: must not be below min_hold_s")
        if self.min_hold_s * self.sample_rate_Hz < 1.0 - 1e-9:
            raise ValueError("min_hold_s: is shorter than a sample")
        super().check()


class DischargeRun(_Lasting, tag="discharge", frozen=True, kw_only=True):
    """One valve stays open without regulation. The solenoid is open if this valve is the EVP."""

    valve: Literal["evp", "dvp"] = "evp"
    opening: Annotated[float, Meta(gt=0, le=1)] = 1.0

    @property
    def needs_cv(self) -> bool:
        return False


class BendsRun(Common, tag="bends", frozen=True, kw_only=True):
    """Cycles of inflation, hold, deflation and rest."""

    cycles: Times
    bend_kPa: Pressure = 20.7
    hold_s: Duration = 1.25
    rest_s: Duration = 1.25

    @property
    def length_s(self) -> float:
        return self.cycles * (self.hold_s + self.rest_s)


class Valves(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Openings for a time, or until the control volume reaches `until_kPa`, whichever is first."""

    for_s: Duration
    evp: OpeningFraction = 0.0
    dvp: OpeningFraction = 0.0
    solenoid: bool = False
    until_kPa: Pressure | None = None


class OpeningsRun(Common, tag="openings", frozen=True, kw_only=True):
    """Valve openings over time, without regulation.

    If entries end early because of `until_kPa`, the last entry holds until the planned end of the run.
    """

    valves: Annotated[tuple[Valves, ...], Meta(min_length=1, max_length=10_000)]

    @property
    def needs_cv(self) -> bool:
        return any(valves.until_kPa is not None for valves in self.valves)

    @property
    def length_s(self) -> float:
        return sum(valves.for_s for valves in self.valves)


ScenarioSegment = Step | Ramp | HoldFor | Swing


class ProfileRun(Common, tag="profile", frozen=True, kw_only=True):
    """A pressure profile of segments as in the configuration's profiles, in kPa."""

    segments: Annotated[tuple[ScenarioSegment, ...], Meta(min_length=1, max_length=1000)]
    repeat: Times = 1
    rate_kPa_per_s: Annotated[float, Meta(gt=0, le=2000)] = 60.0
    settle_s: Annotated[float, Meta(ge=0, le=LONGEST_S)] = 0.0
    """Hold time of the last value."""

    @property
    def length_s(self) -> float:
        return self.motion().duration_s + self.settle_s

    def motion(self) -> Motion:
        """The planned motion of the profile, from rest."""
        return plan(self.segments * self.repeat, _NO_CURVE, 0.0, self.rate_kPa_per_s, MOST_KPA)

    def check(self) -> None:
        if len(self.segments) * self.repeat > MAX_PIECES:
            raise ValueError(f"repeat: makes a profile of more than {MAX_PIECES} segments")
        for index, segment in enumerate(self.segments):
            for key in ("to", "from"):
                if getattr(segment, f"{key}_deg", None) is not None:
                    raise ValueError(f"segments[{index}].{key}_deg: a scenario has no bend curve; give kPa")
                kPa = getattr(segment, f"{key}_kPa", None)
                if kPa is not None and not 0.0 <= kPa <= MOST_KPA:
                    raise ValueError(f"segments[{index}].{key}_kPa: {kPa:g} is outside 0…{MOST_KPA:g} kPa")
        super().check()


RunKind = StepsRun | SineRun | ChirpRun | PrbsRun | DischargeRun | BendsRun | OpeningsRun | ProfileRun


class ScenarioError(OneLineError, ValueError):
    """A scenario is invalid; the text is one line, `file: key: reason`."""


class Scenario(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Runs in order; each starts at rest."""

    runs: Annotated[tuple[RunKind, ...], Meta(min_length=1, max_length=20)]
    name: Annotated[str, Meta(max_length=100)] = ""
    """The picture's title."""


def examples() -> tuple[str, ...]:
    """The names of the built-in scenarios."""
    names = (entry.name for entry in _EXAMPLES.iterdir())
    return tuple(sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml")))


def load_scenario(source: Path | str) -> Scenario:
    """The scenario in a TOML file, or the built-in one of this name. Raises `ScenarioError`."""
    path = Path(source)
    if not path.exists() and str(source) in examples():
        return parse_scenario((_EXAMPLES / f"{source}.toml").read_text(encoding="utf-8"), str(source))
    absent = f" and no such example; the examples are {', '.join(examples())}"
    return parse_scenario(read_text(path, ScenarioError, absent), str(path))


def parse_scenario(text: str, source: str) -> Scenario:
    """Check a scenario's text. Errors name the text by `source`."""
    scenario: Scenario = converted(text, source, Scenario, ScenarioError)
    return scenario
