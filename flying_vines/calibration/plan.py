"""What a calibration does, as data: stages with their movements, the time and the air that they take."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import ceil
from typing import TYPE_CHECKING

from flying_vines.calibration.derived import derived
from flying_vines.config.config import Config
from flying_vines.supply import nominal
from flying_vines.vine.motion import Motion
from flying_vines.vine.motion import plan as motion
from flying_vines.vine.profile import HoldFor, PressureProfile, Ramp, Segment, Step, flatten

if TYPE_CHECKING:
    from flying_vines.identification.bend_curve import Pairs

STAGES = ("empty", "zero", "bottle_leak", "vessel", "levels", "vine_leak", "valve", "angle")
"""In their order."""
SETTLE_S = 1.0
ZERO_S = 5.0
EMPTY_S = 3.0
BOTTLE_LEAK_S = 30.0
VINE_LEAK_S = 30.0
LEVELS = 3
ROUNDS, ROUNDS_AGAIN = 3, 2
"""Of the staircase, at first and each time that it is not sure enough."""
LEVELS_AGAIN, VALVE_AGAIN = 3, 1
"""So often at most more is done, until what is measured is sure enough."""
STEP_S = 0.5
"""From one level to the next."""
RATES_KPA_PER_S = (4.0, 60.0, 15.0, 60.0, 30.0)
"""Of inflations: the slow ones tell where the valve starts, the quick ones what it passes."""
LOW_SHARE = 0.25
"""Of the top: a vine that has so much is full, and its pressure tells its air."""
ANGLES = 6
"""Steps up, and as many down."""
ANSWER_S = 60.0
"""So long the vine is held while nobody answers."""
ANGLE_S = 8.0
"""Until somebody has read one and typed it."""
HELD_S = 2.5
HELD_S_PER_L = 5.0
SETTLED_SHARE = 0.65
"""Of a hold, after which gas that was compressed has cooled; a larger vine takes longer."""
MOST_HELD_S = 10.0


@dataclass(frozen=True)
class CalibrationRequest:
    """What the person wants."""

    only: tuple[str, ...] = ()
    """Names of stages; none means all that apply."""
    bottle_empty: bool = False
    bottle_volume_L: float | None = None
    vessel_L: float | None = None
    angles: Pairs | None = None
    eye: bool = True
    """Whether somebody answers which angle is seen."""
    telemetry_Hz: int = 1000
    """That the board will send."""


@dataclass(frozen=True)
class Movement:
    """A profile of the derived configuration; the vine is vented after it. Air in kPa of the bottle."""

    profile: str
    seconds: float
    air_kPa: float


@dataclass(frozen=True)
class Stage:
    """One step of the calibration. Air in kPa of the bottle, as believed."""

    name: str
    title: str
    does: str
    seconds: float
    air_kPa: float = 0.0
    rest_s: float = 0.0
    """Vented, at first."""
    movements: tuple[Movement, ...] = ()
    again: tuple[Movement, ...] = ()
    """Where it is not sure enough after them, up to `most_again` times."""
    most_again: int = 0
    levels_kPa: tuple[float, ...] = ()
    """At which somebody looks."""


@dataclass(frozen=True)
class CalibrationPlan:
    """All of it. `config` is the derived profile, `believed` the user's own."""

    stages: tuple[Stage, ...]
    config: Config
    believed: Config
    wish: CalibrationRequest
    hold_s: float
    top_kPa: float

    @property
    def seconds(self) -> float:
        return sum(stage.seconds for stage in self.stages)

    @property
    def air_kPa(self) -> float:
        return sum(stage.air_kPa for stage in self.stages)

    @property
    def most_seconds(self) -> float:
        """Where every movement has to be repeated."""
        return self.seconds + sum(
            stage.most_again * sum(move.seconds + self.vented_s for move in stage.again)
            for stage in self.stages
        )

    @property
    def most_air_kPa(self) -> float:
        return self.air_kPa + sum(
            stage.most_again * sum(move.air_kPa for move in stage.again) for stage in self.stages
        )

    @property
    def vented_s(self) -> float:
        """Vented, after each movement."""
        return self.hold_s

    @property
    def settling_s(self) -> float:
        """After which a reading of a vine that was inflated tells its air."""
        return SETTLED_SHARE * self.hold_s

    def summary(self) -> str:
        """What it takes, for people."""
        least, most = ceil(self.seconds / 60.0), ceil(self.most_seconds / 60.0)
        minutes = f"{least} min" if least == most else f"{least} to {most} min"
        air = f"{self.air_kPa:.0f}"
        if self.most_air_kPa > 1.2 * self.air_kPa:
            air += f" to {self.most_air_kPa:.0f}"
        return f"takes {minutes} and about {air} kPa of the bottle"


def plan(config: Config, wish: CalibrationRequest) -> CalibrationPlan:
    """What is to be done, with the profile for it. ValueError, a sentence, where the wish cannot be met."""
    _check(wish)
    top_kPa = config.limits.max_kPa
    hold_s = _hold_s(config.pneumatics.cv_volume_L)
    most_kPa_per_s = config.limits.max_rate_kPa_per_s
    low_kPa = LOW_SHARE * top_kPa
    profiles = {
        "calibrate-levels": _profile(_staircase(top_kPa, hold_s)),
        "calibrate-vine-leak": _profile((Ramp(to_kPa=top_kPa, over_s=1.0), HoldFor(for_s=VINE_LEAK_S))),
        # Down at once, so that the Venturi helps where it does.
        "calibrate-venturi": _profile((*_to(top_kPa, 1.0, hold_s), Step(to_kPa=0.0), HoldFor(for_s=hold_s))),
    }
    for rate in set(RATES_KPA_PER_S):
        over_s = (top_kPa - low_kPa) / min(rate, most_kPa_per_s)
        ramp = (*_to(low_kPa, STEP_S, hold_s), *_to(top_kPa, over_s, hold_s))
        profiles[_valve_profile(rate)] = _profile(ramp)
    if wish.vessel_L is not None:
        profiles["calibrate-vessel"] = _profile(_staircase(top_kPa, _hold_s(wish.vessel_L)))
    moves = {name: _motion(config, profiles, name) for name in profiles}
    longest_s = max(*(move.duration_s for move in moves.values()), ANSWER_S)
    stages = tuple(_stages(config, wish, moves, hold_s))
    changed = derived(config, profiles, longest_s, wish.vessel_L or 0.0)
    return CalibrationPlan(stages, changed, config, wish, hold_s, top_kPa)


def _check(wish: CalibrationRequest) -> None:
    for name in wish.only:
        if name not in STAGES:
            near = difflib.get_close_matches(name, STAGES, n=1)
            did = f"; did you mean '{near[0]}'?" if near else f": give some of {', '.join(STAGES)}"
            raise ValueError(f"there is no stage '{name}'{did}")
    for what, litres in (("bottle", wish.bottle_volume_L), ("vessel", wish.vessel_L)):
        if litres is not None and not 0.01 <= litres <= 50.0:
            raise ValueError(f"a {what} of {litres:g} L: give its volume in litres, 0.01 to 50")
    if wish.bottle_volume_L is not None and wish.vessel_L is not None:
        raise ValueError("give the bottle's volume or a vessel's, not both")
    if "vessel" in wish.only and wish.vessel_L is None:
        raise ValueError("the stage 'vessel' needs the vessel's volume")
    if "empty" in wish.only and not wish.bottle_empty:
        raise ValueError("the stage 'empty' needs a bottle that is empty and open")
    if "angle" in wish.only and wish.angles is None and not wish.eye:
        raise ValueError("the stage 'angle' needs somebody who answers, or pairs measured before")


def _hold_s(litres: float) -> float:
    """So long a level is held."""
    return min(MOST_HELD_S, HELD_S + HELD_S_PER_L * litres)


def _profile(segments: Iterable[Segment]) -> PressureProfile:
    return PressureProfile(tuple(segments))


def _valve_profile(rate_kPa_per_s: float) -> str:
    return f"calibrate-valve-{rate_kPa_per_s:g}"


def _to(kPa: float, over_s: float, hold_s: float) -> tuple[Segment, Segment]:
    return Ramp(to_kPa=kPa, over_s=over_s), HoldFor(for_s=hold_s)


def _staircase(top_kPa: float, hold_s: float) -> Iterator[Segment]:
    """Up in steps, each held."""
    for level in range(1, LEVELS + 1):
        yield from _to(top_kPa * level / LEVELS, STEP_S, hold_s)


def _motion(config: Config, profiles: dict[str, PressureProfile], name: str) -> Motion:
    rate = config.limits.max_rate_kPa_per_s
    segments = tuple(flatten(profiles, name))
    return motion(segments, config.vine.bend_curve(), 0.0, rate, config.limits.max_kPa)


def _stages(
    config: Config, wish: CalibrationRequest, moves: dict[str, Motion], hold_s: float
) -> Iterator[Stage]:
    belief = nominal(config.pneumatics)

    def wanted(name: str) -> bool:
        return not wish.only or name in wish.only

    def movement(profile: str, vine: float = 1.0) -> Movement:
        """`vine`: how much larger what is filled is."""
        move = moves[profile]
        air_kPa = vine * belief.rise.mean * move.rise_kPa + belief.flat.mean
        return Movement(profile, move.duration_s, air_kPa)

    def moving(
        name: str,
        title: str,
        does: str,
        movements: Sequence[Movement],
        again: Sequence[Movement] = (),
        most_again: int = 0,
        rest_s: float = 0.0,
    ) -> Stage:
        seconds = rest_s + sum(move.seconds + hold_s for move in movements)
        air_kPa = sum(move.air_kPa for move in movements)
        return Stage(name, title, does, seconds, air_kPa, rest_s, tuple(movements), tuple(again), most_again)

    if wish.bottle_empty and wanted("empty"):
        does = "read the bottle's sensor while it is empty and open; then you fill it"
        yield Stage("empty", "Bottle's zero", does, EMPTY_S, rest_s=EMPTY_S)
    # Without it no pressure of the vine means anything.
    yield Stage("zero", "Zero", "read the vented vine's sensor", SETTLE_S + ZERO_S, rest_s=SETTLE_S + ZERO_S)
    if wanted("bottle_leak"):
        does = "watch the bottle while nothing takes air"
        yield Stage("bottle_leak", "Bottle's leak", does, BOTTLE_LEAK_S, rest_s=BOTTLE_LEAK_S)
    if wish.vessel_L is not None and wanted("vessel"):
        does = f"fill a vessel of {wish.vessel_L:g} L in place of the vine: the bottle's volume"
        vessel = movement("calibrate-vessel", wish.vessel_L / config.pneumatics.cv_volume_L)
        yield moving("vessel", "Bottle's volume", does, [vessel] * ROUNDS, rest_s=SETTLE_S + ZERO_S)
    if wanted("levels"):
        does = "up a staircase, again and again: the air that each pressure takes"
        step = movement("calibrate-levels")
        yield moving("levels", "Vine's volume", does, [step] * ROUNDS, [step] * ROUNDS_AGAIN, LEVELS_AGAIN)
    if wanted("vine_leak"):
        does = f"hold the vine at {config.limits.max_kPa:g} kPa: what holding takes"
        yield moving("vine_leak", "Vine's leak", does, [movement("calibrate-vine-leak")])
    if wanted("valve"):
        does = "inflate at several rates: where the valve starts and what it passes"
        ramps = [movement(_valve_profile(rate)) for rate in RATES_KPA_PER_S]
        down = movement("calibrate-venturi")
        yield moving("valve", "Valves", does, [*ramps, down], ramps[:3], VALVE_AGAIN)
    if wanted("angle") and (wish.eye or wish.angles is not None):
        yield _angle(config, wish, belief.rise.mean, hold_s)


def _angle(config: Config, wish: CalibrationRequest, kPa_per_kPa: float, hold_s: float) -> Stage:
    if wish.angles is not None:
        return Stage("angle", "Bend", "fit the angles that were measured before", 0.0)
    top_kPa = config.limits.max_kPa
    up = [top_kPa * step / ANGLES for step in range(ANGLES + 1)]
    levels = (*up, *reversed(up[:-1]))
    seconds = len(levels) * (hold_s + ANGLE_S)
    does = "up and down in steps: you say which angle you see"
    return Stage("angle", "Bend", does, seconds, 2.0 * kPa_per_kPa * top_kPa, levels_kPa=levels)
