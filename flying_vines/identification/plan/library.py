"""The candidate runs of a plan. Each shows some part of the rig and has several possible lengths.

Runs of commands are pressures over time: the service and its firmware can do them. Runs of openings move the
valves one by one, without a regulator. They show most about the valves, but need a rig that accepts openings.
Their times are from the nominal rig, so that a small vine is filled for a shorter time than a large vessel.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import ceil, log

from flying_vines.physics.constants import ALPHA_KPA
from flying_vines.physics.rig import ControlVolume, Rig
from flying_vines.simulation.scenario.kinds import OpeningsRun, ProfileRun, RunKind, ScenarioSegment, Valves
from flying_vines.vine.profile import HoldFor, Step

Visit = tuple[float, float]
"""A share of the highest pressure, and the seconds for which it is held."""

MAX_KPA = 20.7
"""Default maximum pressure of the control volume, gauge: the default limit of the service."""
FULL_KPA, HALF_KPA, LOW_KPA = 690.0, 400.0, 180.0
"""Reservoir pressures at the start of a run, gauge. A Venturi has its rated vacuum from about 600 kPa on."""
GUARD = 1.6
"""A valve closes early at this multiple of its target pressure, because the rig is not nominal."""
_SAMPLE_S = 0.02
_SEED = 7
"""Seed of the random runs: the same rig gets the same plan."""


@dataclass(frozen=True)
class CandidateRun:
    """A run made of parts: `make(n)` gives its first n parts."""

    name: str
    shows: str
    """The purpose of the run, in words."""
    make: Callable[[int], RunKind]
    counts: tuple[int, ...]
    """Numbers of parts from which a plan may choose, rising."""
    commanded: bool
    """True if it consists of pressure commands only."""


def library(rig: Rig, most_kPa: float = MAX_KPA) -> tuple[CandidateRun, ...]:
    """All runs that a rig can do."""
    runs = [*_discharges(rig)]
    if rig.cv is not None:
        runs += [*_commands(most_kPa), *_openings(rig, rig.cv, most_kPa)]
    return tuple(runs)


def _commands(most_kPa: float) -> Iterator[CandidateRun]:
    """Profiles that the service can do."""

    def profile(
        name: str, shows: str, supply_kPa: float, visits: list[Visit], counts: tuple[int, ...]
    ) -> CandidateRun:
        def make(count: int) -> RunKind:
            segments: list[ScenarioSegment] = []
            for share, hold_s in visits[:count]:
                segments += [Step(to_kPa=round(share * most_kPa, 2)), HoldFor(hold_s)]
            return ProfileRun(name=name, reservoir_kPa=supply_kPa, segments=tuple(segments))

        return CandidateRun(name, shows, make, counts, True)

    stairs = [(share, 2.0) for share in (0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0)]
    yield profile("staircase", "pressures up and down by steps, each held", FULL_KPA, 2 * stairs, (4, 8, 16))
    bends = [(1.0, 0.6), (0.0, 0.6)] * 10
    for supply_kPa, word in ((FULL_KPA, "full"), (HALF_KPA, "half"), (LOW_KPA, "low")):
        shows = f"fast bends from a {word} reservoir"
        yield profile(f"bends_{word}", shows, supply_kPa, bends, (8, 20))
    yield profile(
        "vents",
        "repeated vents from the highest pressure, with the Venturi if the firmware uses it",
        FULL_KPA,
        [(1.0, 1.5), (0.0, 2.0)] * 6,
        (4, 12),
    )
    yield profile("hold", "one pressure held for a long time", FULL_KPA, [(1.0, 7.5)] * 4, (2, 4))
    yield profile("rest", "no movement", FULL_KPA, [(0.0, 10.0)] * 4, (1, 2, 4))
    drawn = random.Random(_SEED)
    visits = [(drawn.random(), round(drawn.uniform(0.3, 1.5), 2)) for _ in range(40)]
    for supply_kPa, word in ((FULL_KPA, "full"), (HALF_KPA, "half"), (LOW_KPA, "low")):
        yield profile(
            f"random_{word}",
            f"random pressures, from a {word} reservoir",
            supply_kPa,
            visits,
            (10, 20, 40),
        )


def _openings(rig: Rig, cv: ControlVolume, most_kPa: float) -> Iterator[CandidateRun]:
    """Runs that move the valves one by one."""

    def fill(supply_kPa: float, opening: float, to_kPa: float, share: float = 1.0) -> Valves:
        """Inflation to `to_kPa` on the nominal rig, or a share of it."""
        return Valves(
            for_s=_samples(share * filling_s(rig, cv, supply_kPa, opening, to_kPa)),
            evp=opening,
            until_kPa=GUARD * to_kPa,
        )

    emptying_s = rig.solenoid.flow_resistance_kPa_s_per_SL * cv.volume_L / ALPHA_KPA
    vent = Valves(for_s=_samples(max(0.3, 5.0 * emptying_s)), solenoid=True)
    pull = Valves(for_s=_samples(max(1.0, 5.0 * emptying_s)), solenoid=True, dvp=1.0)
    shut = Valves(for_s=0.5)

    stairs = []
    for opening in (0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0, 0.8, 0.6, 0.45, 0.3, 0.2, 0.1):
        whole = fill(HALF_KPA, 1.0, 0.8 * most_kPa)
        stairs.append([Valves(for_s=whole.for_s, evp=opening, until_kPa=whole.until_kPa), shut, vent])
    yield _of_openings(
        "opening_stairs",
        "pulses of equal length, with the inflation valve opened wider each time, then less",
        HALF_KPA,
        stairs,
        (7, 13),
    )
    for supply_kPa, word in ((FULL_KPA, "full"), (HALF_KPA, "half")):
        for opening, how in ((1.0, "fast"), (0.5, "slow")):
            shutting = [[fill(supply_kPa, opening, most_kPa), Valves(for_s=8.0)], [Valves(for_s=12.0), vent]]
            shows = f"filled {how} from a {word} reservoir, then all valves shut"
            yield _of_openings(f"fill_hold_{how}_{word}", shows, supply_kPa, shutting, (1, 2))
    for supply_kPa, word in ((FULL_KPA, "full"), (HALF_KPA, "half"), (LOW_KPA, "low")):
        cycles = [[fill(supply_kPa, 0.7, 0.6 * most_kPa), shut, pull, shut]] * 6
        shows = f"filled, then emptied by the Venturi, from a {word} reservoir"
        yield _of_openings(f"vent_venturi_{word}", shows, supply_kPa, cycles, (2, 4, 6))
    cycles = [[fill(FULL_KPA, 0.7, 0.6 * most_kPa), shut, vent, shut]] * 6
    yield _of_openings("vent_solenoid", "filled, then vented by the solenoid alone", FULL_KPA, cycles, (3, 6))
    pulses = []
    drawn = random.Random(_SEED)
    for _ in range(24):
        opening, count = drawn.choice((0.3, 0.5, 0.75, 1.0)), drawn.choice((1, 2, 4))
        pulse = fill(FULL_KPA, opening, 0.8 * most_kPa, 1.0 / count)
        out = Valves(for_s=_samples(drawn.uniform(0.3, 1.0) * vent.for_s), solenoid=True)
        pulses.append([pulse, Valves(for_s=0.1)] * count + [out, Valves(for_s=0.1)])
    shows = "random pulses of inflation valve and solenoid"
    yield _of_openings("pulses", shows, FULL_KPA, pulses, (8, 24))


def _discharges(rig: Rig) -> Iterator[CandidateRun]:
    """Discharges of the reservoir in steps, with a rest after each step."""
    through_evp = rig.cv is not None
    for name, through, out in (
        ("discharge_dvp", "Venturi", Valves(for_s=4.0, dvp=1.0)),
        ("discharge_evp", "inflation valve", Valves(for_s=4.0, evp=1.0, solenoid=through_evp)),
        ("discharge_evp_half", "half-open inflation valve", Valves(for_s=4.0, evp=0.5, solenoid=through_evp)),
    ):
        stretches = [[out, Valves(for_s=6.0, solenoid=out.solenoid)]] * 4
        shows = f"the reservoir discharged through the {through} in steps, with rests"
        yield _of_openings(name, shows, FULL_KPA, stretches, (1, 2, 4))


def _of_openings(
    name: str, shows: str, supply_kPa: float, parts: list[list[Valves]], counts: tuple[int, ...]
) -> CandidateRun:
    def make(count: int) -> RunKind:
        valves = tuple(one for part in parts[:count] for one in part)
        return OpeningsRun(name=name, reservoir_kPa=supply_kPa, valves=valves)

    return CandidateRun(name, shows, make, counts, False)


def filling_s(rig: Rig, cv: ControlVolume, supply_kPa: float, opening: float, to_kPa: float) -> float:
    """Time for which the inflation valve must be open on the nominal rig."""
    time_constant_s = rig.evp.flow_resistance_kPa_s_per_SL * cv.volume_L / (ALPHA_KPA * opening)
    return time_constant_s * log(supply_kPa / (supply_kPa - to_kPa))


def _samples(seconds: float) -> float:
    """A time rounded up to whole samples, at least one."""
    return round(max(1, ceil(seconds / _SAMPLE_S - 1e-6)) * _SAMPLE_S, 6)
