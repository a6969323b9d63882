"""The plan of a calibration as data: its stages and movements, and the time and air that they take."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import ceil
from typing import TYPE_CHECKING

from msgspec.structs import replace

from flying_vines.config.config import Config
from flying_vines.supply import nominal
from flying_vines.vine.motion import Motion
from flying_vines.vine.motion import plan as motion
from flying_vines.vine.profile import HoldFor, PressureProfile, Ramp, Segment, Step, flatten

if TYPE_CHECKING:
    from flying_vines.identification.bend_curve import Pairs

STAGES = ("empty", "zero", "reservoir_leak", "vessel", "levels", "vine_leak", "valve", "angle")
"""In the order in which they run."""
SETTLE_S = 1.0
ZERO_S = 5.0
EMPTY_S = 3.0
RESERVOIR_LEAK_S = 30.0
VINE_LEAK_S = 30.0
LEVELS = 3
# The pressure rises in steps ROUNDS times. A stage repeats its movements until its result is precise enough,
# at most LEVELS_AGAIN or VALVE_AGAIN times.
ROUNDS, ROUNDS_AGAIN = 3, 2
LEVELS_AGAIN, VALVE_AGAIN = 3, 1
RAMP_S = 0.5
"""Time of a rise from one level to the next."""
RATES_KPA_PER_S = (4.0, 60.0, 15.0, 60.0, 30.0)
"""Rates of inflation. Slow inflations measure where the valve starts to open, fast ones its gain."""
LOW_SHARE = 0.25
"""Share of the top pressure at which a pouch (the bending chamber of the vine) is full."""
ANGLES = 6
"""Steps up, and as many down."""
ANSWER_S = 60.0
"""Time for an answer before the vine is vented."""
ANGLE_S = 8.0
"""Usual time to read and type an angle."""
HOLD_S = 2.5
HOLD_S_PER_L = 5.0
MAX_HOLD_S = 10.0
SETTLED_SHARE = 0.65
"""Share of a hold after which compressed gas has cooled; the hold grows with the vine's volume."""
VOLUME_FACTOR = 4.0
"""The vine's volume may be larger or smaller than assumed by this factor."""
MAX_VOLUME_FACTOR = 10.0
BENT_MARGIN_S = 30.0
"""Added to the longest movement for `max_bent_s`."""


@dataclass(frozen=True)
class CalibrationRequest:
    """What the user wants to calibrate."""

    only: tuple[str, ...] = ()
    """Names of stages; empty: all that apply."""
    reservoir_empty: bool = False
    reservoir_volume_L: float | None = None
    vessel_L: float | None = None
    angles: Pairs | None = None
    asks_angles: bool = True
    """True if somebody sees the vine and answers questions."""


@dataclass(frozen=True)
class Movement:
    """Runs a profile of `CalibrationPlan.config`, then vents the vine.

    `air_kPa`: expected fall of the reservoir's pressure.
    """

    profile: str
    seconds: float
    air_kPa: float


@dataclass(frozen=True)
class Stage:
    """One stage of the calibration. `air_kPa`: expected fall of the reservoir's pressure."""

    name: str
    title: str
    does: str
    seconds: float
    air_kPa: float = 0.0
    rest_s: float = 0.0
    """Vented time before the first movement."""
    movements: tuple[Movement, ...] = ()
    again: tuple[Movement, ...] = ()
    """Repeated up to `max_repeats` times until the result is precise enough."""
    max_repeats: int = 0
    levels_kPa: tuple[float, ...] = ()
    """Pressures at which the person is asked for the angle."""


@dataclass(frozen=True)
class CalibrationPlan:
    """`config`: the user's configuration with the calibration's movements; `user_config`: without them."""

    stages: tuple[Stage, ...]
    config: Config
    user_config: Config
    request: CalibrationRequest
    hold_s: float
    """Time at each level, and vented time after each movement."""
    top_kPa: float

    @property
    def seconds(self) -> float:
        return sum(stage.seconds for stage in self.stages)

    @property
    def air_kPa(self) -> float:
        return sum(stage.air_kPa for stage in self.stages)

    @property
    def max_seconds(self) -> float:
        """The time if every stage is repeated as often as possible."""
        return self.seconds + sum(
            stage.max_repeats * sum(move.seconds + self.hold_s for move in stage.again)
            for stage in self.stages
        )

    @property
    def max_air_kPa(self) -> float:
        return self.air_kPa + sum(
            stage.max_repeats * sum(move.air_kPa for move in stage.again) for stage in self.stages
        )

    def settling_s(self, stage: str) -> float:
        """Time after an inflation until the pressure shows how much air is in the vine, or in the vessel."""
        litres = self.request.vessel_L if stage == "vessel" else None
        return SETTLED_SHARE * (self.hold_s if litres is None else _hold_s(litres))

    def summary(self) -> str:
        """Time and air, as text."""
        usual, longest = ceil(self.seconds / 60.0), ceil(self.max_seconds / 60.0)
        minutes = f"{usual} min" if usual == longest else f"{usual} to {longest} min"
        air = f"{self.air_kPa:.0f}"
        if self.max_air_kPa > 1.2 * self.air_kPa:
            air += f" to {self.max_air_kPa:.0f}"
        return f"takes {minutes} and about {air} kPa of the reservoir"


def plan(config: Config, request: CalibrationRequest) -> CalibrationPlan:
    """Raises ValueError, one sentence, if the request cannot be met."""
    _check(request)
    top_kPa = config.limits.max_kPa
    hold_s = _hold_s(config.pneumatics.cv_volume_L)
    max_kPa_per_s = config.limits.max_rate_kPa_per_s
    low_kPa = LOW_SHARE * top_kPa
    profiles = {
        "calibrate-levels": _profile(_staircase(top_kPa, hold_s)),
        "calibrate-vine-leak": _profile((Ramp(to_kPa=top_kPa, over_s=1.0), HoldFor(for_s=VINE_LEAK_S))),
        # A step down makes the firmware use the Venturi.
        "calibrate-venturi": _profile((*_to(top_kPa, 1.0, hold_s), Step(to_kPa=0.0), HoldFor(for_s=hold_s))),
    }
    for rate in set(RATES_KPA_PER_S):
        over_s = (top_kPa - low_kPa) / min(rate, max_kPa_per_s)
        ramp = (*_to(low_kPa, RAMP_S, hold_s), *_to(top_kPa, over_s, hold_s))
        profiles[_valve_profile(rate)] = _profile(ramp)
    if request.vessel_L is not None:
        profiles["calibrate-vessel"] = _profile(_staircase(top_kPa, _hold_s(request.vessel_L)))
    moves = {name: _motion(config, profiles, name) for name in profiles}
    longest_s = max(*(move.duration_s for move in moves.values()), ANSWER_S)
    stages = tuple(_stages(config, request, moves, hold_s))
    changed = _derived(config, profiles, longest_s, request.vessel_L or 0.0)
    return CalibrationPlan(stages, changed, config, request, hold_s, top_kPa)


def _derived(
    config: Config, profiles: Mapping[str, PressureProfile], longest_s: float, vessel_L: float = 0.0
) -> Config:
    """The configuration for the calibration: the user's with these movements.

    Limits (except a longer `max_bent_s`), losses and interlocks are the user's. Volume and leak of the vine
    are still unknown, so physics checks of the volume accept a factor of `VOLUME_FACTOR` or more, and
    `vine_leak` only warns. All other checks act as in flight.
    """
    checks = config.checks
    cv_L = config.pneumatics.cv_volume_L
    factor = max(checks.volume_factor, VOLUME_FACTOR, 2.0 * vessel_L / cv_L)
    return replace(
        config,
        profiles={**config.profiles, **profiles},
        limits=replace(config.limits, max_bent_s=max(config.limits.max_bent_s, longest_s + BENT_MARGIN_S)),
        checks=replace(checks, volume_factor=min(factor, MAX_VOLUME_FACTOR), vine_leak="warn"),
    )


def _check(request: CalibrationRequest) -> None:
    for name in request.only:
        if name not in STAGES:
            near = difflib.get_close_matches(name, STAGES, n=1)
            did = f"; did you mean '{near[0]}'?" if near else f": give some of {', '.join(STAGES)}"
            raise ValueError(f"there is no stage '{name}'{did}")
    for what, litres in (("reservoir", request.reservoir_volume_L), ("vessel", request.vessel_L)):
        if litres is not None and not 0.01 <= litres <= 50.0:
            raise ValueError(f"a {what} of {litres:g} L: give its volume in litres, 0.01 to 50")
    if request.reservoir_volume_L is not None and request.vessel_L is not None:
        raise ValueError("give the reservoir's volume or a vessel's, not both")
    if "vessel" in request.only and request.vessel_L is None:
        raise ValueError("the stage 'vessel' needs the vessel's volume (--vessel-L)")
    if "empty" in request.only and not request.reservoir_empty:
        raise ValueError("the stage 'empty' needs an empty, open reservoir (--reservoir-empty)")
    if "angle" in request.only and request.angles is None and not request.asks_angles:
        raise ValueError("the stage 'angle' needs a person who answers, or earlier pairs (--angles)")


def _hold_s(litres: float) -> float:
    """Time for which a level is held."""
    return min(MAX_HOLD_S, HOLD_S + HOLD_S_PER_L * litres)


def _profile(segments: Iterable[Segment]) -> PressureProfile:
    return PressureProfile(tuple(segments))


def _valve_profile(rate_kPa_per_s: float) -> str:
    return f"calibrate-valve-{rate_kPa_per_s:g}"


def _to(kPa: float, over_s: float, hold_s: float) -> tuple[Segment, Segment]:
    return Ramp(to_kPa=kPa, over_s=over_s), HoldFor(for_s=hold_s)


def _staircase(top_kPa: float, hold_s: float) -> Iterator[Segment]:
    """Rises in steps, and holds each step."""
    for level in range(1, LEVELS + 1):
        yield from _to(top_kPa * level / LEVELS, RAMP_S, hold_s)


def _motion(config: Config, profiles: dict[str, PressureProfile], name: str) -> Motion:
    rate = config.limits.max_rate_kPa_per_s
    segments = tuple(flatten(profiles, name))
    return motion(segments, config.vine.bend_curve(), 0.0, rate, config.limits.max_kPa)


def _stages(
    config: Config, request: CalibrationRequest, moves: dict[str, Motion], hold_s: float
) -> Iterator[Stage]:
    prior = nominal(config.pneumatics)

    def wanted(name: str) -> bool:
        return not request.only or name in request.only

    def movement(profile: str, volume: float = 1.0) -> Movement:
        """`volume`: volume that is filled, relative to that of the vine."""
        move = moves[profile]
        air_kPa = volume * prior.rise.mean * move.rise_kPa + prior.flat.mean
        return Movement(profile, move.duration_s, air_kPa)

    def moving(
        name: str,
        title: str,
        does: str,
        movements: Sequence[Movement],
        again: Sequence[Movement] = (),
        max_repeats: int = 0,
        rest_s: float = 0.0,
    ) -> Stage:
        seconds = rest_s + sum(move.seconds + hold_s for move in movements)
        air_kPa = sum(move.air_kPa for move in movements)
        return Stage(name, title, does, seconds, air_kPa, rest_s, tuple(movements), tuple(again), max_repeats)

    if request.reservoir_empty and wanted("empty"):
        does = "read the reservoir's sensor while it is empty and open; then you fill it"
        yield Stage("empty", "Reservoir's zero", does, EMPTY_S, rest_s=EMPTY_S)
    # All later stages need the zero.
    yield Stage("zero", "Zero", "read the vented vine's sensor", SETTLE_S + ZERO_S, rest_s=SETTLE_S + ZERO_S)
    if wanted("reservoir_leak"):
        does = "watch the reservoir while no air is used"
        yield Stage("reservoir_leak", "Reservoir's leak", does, RESERVOIR_LEAK_S, rest_s=RESERVOIR_LEAK_S)
    if request.vessel_L is not None and wanted("vessel"):
        does = f"fill a vessel of {request.vessel_L:g} L in place of the vine: the reservoir's volume"
        vessel = movement("calibrate-vessel", request.vessel_L / config.pneumatics.cv_volume_L)
        yield moving("vessel", "Reservoir's volume", does, [vessel] * ROUNDS, rest_s=SETTLE_S + ZERO_S)
    if wanted("levels"):
        does = "raise the pressure in steps: air for each pressure"
        step = movement("calibrate-levels")
        yield moving("levels", "Vine's volume", does, [step] * ROUNDS, [step] * ROUNDS_AGAIN, LEVELS_AGAIN)
    if wanted("vine_leak"):
        does = f"hold the vine at {config.limits.max_kPa:g} kPa: air that leaks"
        yield moving("vine_leak", "Vine's leak", does, [movement("calibrate-vine-leak")])
    if wanted("valve"):
        does = "inflate at several rates: start and flow of the valve"
        ramps = [movement(_valve_profile(rate)) for rate in RATES_KPA_PER_S]
        down = movement("calibrate-venturi")
        yield moving("valve", "Valves", does, [*ramps, down], ramps[:3], VALVE_AGAIN)
    if wanted("angle") and (request.asks_angles or request.angles is not None):
        yield _angle(config, request, prior.rise.mean, hold_s)


def _angle(config: Config, request: CalibrationRequest, kPa_per_kPa: float, hold_s: float) -> Stage:
    if request.angles is not None:
        return Stage("angle", "Bend", "fit the angles that were measured before", 0.0)
    top_kPa = config.limits.max_kPa
    up = [top_kPa * step / ANGLES for step in range(ANGLES + 1)]
    levels = (*up, *reversed(up[:-1]))
    seconds = len(levels) * (hold_s + ANGLE_S)
    does = "up and down in steps: you type each angle"
    return Stage("angle", "Bend", does, seconds, 2.0 * kPa_per_kPa * top_kPa, levels_kPa=levels)
