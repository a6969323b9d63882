"""The candidate runs of a plan. Each shows some part of the rig and has several possible lengths.

Runs of commands are pressures over time: the service and its firmware can do them. Runs of openings move the
valves one by one, without a regulator. These runs show the most about the valves, but need a rig that accepts
openings. The times of the openings are calculated for the nominal rig: a small vine is filled for a shorter
time than a large vessel.

`nominal_run` simulates a run on the nominal rig, without noise, to get its valve commands sample by sample.
In runs of pressures the firmware's regulator controls the baseline at 1 kHz. As in `simulate`, the valves get
a new command once a sample. The loop is compiled: a run of a minute takes milliseconds.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from math import ceil, log

import numpy as np

from flying_vines.identification.recording import RecordedRun
from flying_vines.physics.arrays import Array
from flying_vines.physics.compiler import compiled, record
from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.physics.plant.ambient import Air
from flying_vines.physics.plant.compiled import floats_of
from flying_vines.physics.plant.loops import NOT_INLINED
from flying_vines.physics.plant.numbers import PlantNumbers, numbers_of
from flying_vines.physics.plant.plant import Held, Plant, at_rest
from flying_vines.physics.plant.rates import Floats, conditions
from flying_vines.physics.plant.tick import runge_kutta
from flying_vines.physics.rig import ControlVolume, Rig
from flying_vines.simulation.phlosar.closed_loop import regulator_step
from flying_vines.simulation.phlosar.firmware import Regulator
from flying_vines.simulation.scenario.run import (
    FASTEST_KPA_PER_S,
    OPENING_DIGITS,
    command_of,
    tuning_for,
    valves_of,
)
from flying_vines.simulation.scenario.scenario import (
    FIRMWARE_HZ,
    MOST_KPA,
    OpeningsRun,
    ProfileRun,
    RunKind,
    ScenarioSegment,
    Valves,
)
from flying_vines.vine.profile import HoldFor, Step

Visit = tuple[float, float]
"""A share of the highest pressure, and the seconds for which it is held."""

MAX_KPA = 20.7
"""Default maximum pressure of the control volume, gauge: the default limit of the service."""
FULL_KPA, HALF_KPA, LOW_KPA = 690.0, 400.0, 180.0
"""Reservoir pressures at the start of a run, gauge. A Venturi has its rated vacuum from about 600 kPa on."""
GUARD = 1.6
"""Inflation ends early at this multiple of the target pressure, because the real rig may fill faster."""
LOW_SHARE = 0.5
"""Maximum pressure of the control volume, over that of the reservoir, in runs from a part-full reservoir."""
MOST_SHARE = 0.8
"""The same ratio for all runs: near the supply pressure, filling takes very long."""
OUTLETS = ("evp", "dvp")
"""Inflation valve and the valve of the Venturi."""
REST_S, MAX_REST_S = 40.0, 1800.0
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


Supplies = Mapping[str, float]
"""Reservoir pressures at the start of a run, gauge, by the words full, half and low."""


def library(
    rig: Rig,
    most_kPa: float = MAX_KPA,
    full_kPa: float = FULL_KPA,
    rest_s: float = REST_S,
    outlets: Collection[str] = OUTLETS,
) -> tuple[CandidateRun, ...]:
    """All runs that a rig can do.

    Args:
        most_kPa, full_kPa: highest pressures of the control volume and of the reservoir, gauge.
        rest_s: the longest time for which a reservoir alone stays shut.
        outlets: valves through which the reservoir can be discharged.
    """
    if rig.pump is not None and rig.cv is not None:
        # A pump at full drive fills as an inflation valve does from a reservoir at the stall pressure.
        supplies = {"full": rig.pump.stall_pressure_kPa}
        return tuple(_openings(rig, rig.cv, min(most_kPa, MOST_SHARE * supplies["full"]), supplies))
    parts = {"full": full_kPa, "half": HALF_KPA / FULL_KPA * full_kPa, "low": LOW_KPA / FULL_KPA * full_kPa}
    # A nearly empty reservoir cannot fill the control volume to the highest pressure.
    supplies = {word: kPa for word, kPa in parts.items() if word == "full" or most_kPa <= LOW_SHARE * kPa}
    runs = [*_discharges(rig, full_kPa, outlets)]
    if rig.cv is None:
        runs += [*_rests(supplies, rest_s)]
    else:
        most_kPa = min(most_kPa, MOST_SHARE * full_kPa)
        runs += [*_commands(min(most_kPa, MOST_KPA), supplies), *_openings(rig, rig.cv, most_kPa, supplies)]
    return tuple(runs)


def _commands(most_kPa: float, supplies: Supplies) -> Iterator[CandidateRun]:
    """Profiles that the service can do."""
    full_kPa = supplies["full"]

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
    yield profile("staircase", "pressures up and down by steps, each held", full_kPa, 2 * stairs, (4, 8, 16))
    bends = [(1.0, 0.6), (0.0, 0.6)] * 10
    for word, supply_kPa in supplies.items():
        shows = f"fast bends from a {word} reservoir"
        yield profile(f"bends_{word}", shows, supply_kPa, bends, (8, 20))
    yield profile(
        "vents",
        "repeated vents from the highest pressure, with the Venturi if the firmware uses it",
        full_kPa,
        [(1.0, 1.5), (0.0, 2.0)] * 6,
        (4, 12),
    )
    yield profile("hold", "one pressure held for a long time", full_kPa, [(1.0, 7.5)] * 4, (2, 4))
    yield profile("rest", "no movement", full_kPa, [(0.0, 10.0)] * 4, (1, 2, 4))
    drawn = random.Random(_SEED)
    visits = [(drawn.random(), round(drawn.uniform(0.3, 1.5), 2)) for _ in range(40)]
    for word, supply_kPa in supplies.items():
        yield profile(
            f"random_{word}", f"random pressures, from a {word} reservoir", supply_kPa, visits, (10, 20, 40)
        )


def _openings(rig: Rig, cv: ControlVolume, most_kPa: float, supplies: Supplies) -> Iterator[CandidateRun]:
    """Runs that move the valves one by one."""
    full_kPa = supplies["full"]
    half_kPa = supplies.get("half", full_kPa)

    def fill(supply_kPa: float, opening: float, to_kPa: float, share: float = 1.0) -> Valves:
        """Inflation to `to_kPa` on the nominal rig, or for a share of that time."""
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
        whole = fill(half_kPa, 1.0, 0.8 * most_kPa)
        stairs.append([Valves(for_s=whole.for_s, evp=opening, until_kPa=whole.until_kPa), shut, vent])
    yield _of_openings(
        "opening_stairs",
        "pulses of equal length, with the inflation valve opened wider each time, then less",
        half_kPa,
        stairs,
        (7, 13),
    )
    for word, supply_kPa in supplies.items():
        if word == "low":
            continue
        for opening, how in ((1.0, "fast"), (0.5, "slow")):
            shutting = [[fill(supply_kPa, opening, most_kPa), Valves(for_s=8.0)], [Valves(for_s=12.0), vent]]
            supply = "" if rig.pump else f" from a {word} reservoir"
            shows = f"filled {how}{supply}, then all valves shut"
            yield _of_openings(f"fill_hold_{how}_{word}", shows, supply_kPa, shutting, (1, 2))
    for word, supply_kPa in supplies.items():
        if not rig.has("venturi"):
            continue
        cycles = [[fill(supply_kPa, 0.7, 0.6 * most_kPa), shut, pull, shut]] * 6
        shows = f"filled, then emptied by the Venturi, from a {word} reservoir"
        yield _of_openings(f"vent_venturi_{word}", shows, supply_kPa, cycles, (2, 4, 6))
    cycles = [[fill(full_kPa, 0.7, 0.6 * most_kPa), shut, vent, shut]] * 6
    yield _of_openings("vent_solenoid", "filled, then vented by the solenoid alone", full_kPa, cycles, (3, 6))
    pulses = []
    drawn = random.Random(_SEED)
    for _ in range(24):
        opening, count = drawn.choice((0.3, 0.5, 0.75, 1.0)), drawn.choice((1, 2, 4))
        pulse = fill(full_kPa, opening, 0.8 * most_kPa, 1.0 / count)
        out = Valves(for_s=_samples(drawn.uniform(0.3, 1.0) * vent.for_s), solenoid=True)
        pulses.append([pulse, Valves(for_s=0.1)] * count + [out, Valves(for_s=0.1)])
    shows = "random pulses of inflation valve and solenoid"
    yield _of_openings("pulses", shows, full_kPa, pulses, (8, 24))


def _discharges(rig: Rig, full_kPa: float, outlets: Collection[str]) -> Iterator[CandidateRun]:
    """Discharges of the reservoir in steps, with a rest after each step."""
    full, half = (Valves(for_s=4.0, evp=evp, solenoid=rig.cv is not None) for evp in (1.0, 0.5))
    for outlet, name, through, out in (
        ("dvp", "discharge_dvp", "Venturi", Valves(for_s=4.0, dvp=1.0)),
        ("evp", "discharge_evp", "inflation valve", full),
        ("evp", "discharge_evp_half", "half-open inflation valve", half),
    ):
        if outlet not in outlets:
            continue
        stretches = [[out, Valves(for_s=6.0, solenoid=out.solenoid)]] * 4
        shows = f"the reservoir discharged through the {through} in steps, with rests"
        yield _of_openings(name, shows, full_kPa, stretches, (1, 2, 4))


def _rests(supplies: Supplies, rest_s: float) -> Iterator[CandidateRun]:
    """The reservoir alone, shut: how it leaks at each pressure, and how its sensor drifts."""
    rate_Hz = 50 if rest_s <= 2.0 * REST_S else 10
    rest_s = min(rest_s, MAX_REST_S)
    for word, supply_kPa in supplies.items():
        shut = [[Valves(for_s=round(rest_s / 4 * rate_Hz) / rate_Hz)]] * 4
        shows = f"all valves shut, with a {word} reservoir"
        yield _of_openings(f"rest_{word}", shows, supply_kPa, shut, (1, 2, 4), rate_Hz)


def _of_openings(
    name: str,
    shows: str,
    supply_kPa: float,
    parts: list[list[Valves]],
    counts: tuple[int, ...],
    rate_Hz: int = 50,
) -> CandidateRun:
    def make(count: int) -> RunKind:
        valves = tuple(one for part in parts[:count] for one in part)
        return OpeningsRun(name=name, reservoir_kPa=supply_kPa, valves=valves, sample_rate_Hz=rate_Hz)

    return CandidateRun(name, shows, make, counts, False)


def filling_s(rig: Rig, cv: ControlVolume, supply_kPa: float, opening: float, to_kPa: float) -> float:
    """Time for which the inflation valve must be open on the nominal rig."""
    source = rig.evp if rig.pump is None else rig.pump
    time_constant_s = source.flow_resistance_kPa_s_per_SL * cv.volume_L / (ALPHA_KPA * opening)
    return time_constant_s * log(supply_kPa / (supply_kPa - to_kPa))


def _samples(seconds: float) -> float:
    """A time rounded up to whole samples, at least one."""
    return round(max(1, ceil(seconds / _SAMPLE_S - 1e-6)) * _SAMPLE_S, 6)


def nominal_run(rig: Rig, kind: RunKind) -> RecordedRun:
    """The run as a recording; its readings are only placeholders: 0, or NaN without a control volume."""
    samples = max(1, round(kind.length_s * kind.sample_rate_Hz))
    time_s = np.arange(samples) / kind.sample_rate_Hz
    valves = valves_of(kind, random.Random(0))
    if valves is not None:
        # The pressure only matters for closing a valve early, which does not happen on the nominal rig.
        openings = np.array([valves(t, 0.0) for t in time_s.tolist()], dtype=np.float64)
    else:
        openings = _regulated(rig, kind, time_s)
    evp, dvp, solenoid = openings.T
    unread = np.zeros_like(time_s)
    cv_kPa = np.full_like(time_s, np.nan) if rig.cv is None else unread
    return RecordedRun(
        kind.label, time_s, None, evp, dvp, solenoid, cv_kPa, unread, None, None, rig.cv is None
    )


def _regulated(rig: Rig, kind: RunKind, time_s: Array) -> Array:
    command = command_of(kind, random.Random(0))
    assert command is not None and rig.cv is not None, "a run either regulates or moves the valves"
    regulator = Regulator(tuning_for(rig, rig.cv, kind.reservoir_kPa, kind.sample_rate_Hz))
    openings = np.empty((len(time_s), 3))
    plant = Plant(rig)
    compiled(regulate_held, NOT_INLINED)(
        record(numbers_of(plant, 1.0 / FIRMWARE_HZ)),
        floats_of(at_rest(plant, kind.reservoir_kPa)),
        regulator.address,
        np.array([command(t) for t in time_s.tolist()]),
        FIRMWARE_HZ // kind.sample_rate_Hz,
        openings,
    )
    return openings


def regulate_held(
    numbers: PlantNumbers, state: Floats, regulator: int, wanted_kPa: Array, ticks: int, openings: Array
) -> None:
    """Fill `openings` (n, 3): the valve commands of each sample, which hold for `ticks` ticks."""
    air = Air(ALPHA_KPA, 0.0, 1.0, 0.0)
    drive = np.empty(4)
    for sample in range(len(wanted_kPa)):
        evp = dvp = solenoid = 0.0
        for tick in range(ticks):
            found = conditions(numbers, air, state)
            target_kPa = wanted_kPa[sample]
            regulator_step(
                regulator, target_kPa, FASTEST_KPA_PER_S, found.cv_kPa, found.reservoir_kPa, drive.ctypes
            )
            if tick == 0:
                evp, dvp = round(drive[0], OPENING_DIGITS), round(drive[1], OPENING_DIGITS)
                solenoid = drive[2]
                openings[sample] = evp, dvp, solenoid
            held = Held(evp, dvp, solenoid > 0.0, False)
            state = runge_kutta(numbers, air, 0.0, state, held, 1.0 / FIRMWARE_HZ)
