"""Simulates a run: the firmware's regulator at 1 kHz, the plant, its sensors, and a recorder.

Valve commands change only at recorded samples, and are rounded as in the file. So the recorded openings,
replayed through the same plant, give the true pressures again. At `sample_rate_Hz = 1000` each step of the
firmware is a sample; at lower rates `tuning_for` tunes the regulator. A recorded reading is the reading that
the firmware used.
"""

from __future__ import annotations

import math
import random
from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from flying_vines.physics.arrays import Array, BoolArray
from flying_vines.physics.baseline import Inputs
from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.physics.plant.plant import Conditions, Setup, at_rest
from flying_vines.physics.plant.sensors import read, rested
from flying_vines.physics.plant.simulator import TICK_S, Simulator
from flying_vines.physics.plant.true_rig import TrueRig
from flying_vines.physics.rig import ControlVolume, Rig
from flying_vines.simulation.phlosar.firmware import SAFE, Regulator, Tuning, standard_tuning
from flying_vines.simulation.scenario.scenario import (
    FIRMWARE_HZ,
    BendsRun,
    ChirpRun,
    DischargeRun,
    OpeningsRun,
    PrbsRun,
    ProfileRun,
    RunKind,
    Scenario,
    ScenarioError,
    SineRun,
    StepsRun,
    Valves,
)

SetpointOverTime = Callable[[float], float]
"""Setpoint (kPa gauge) as a function of time (s)."""
ValveCommand = Callable[[float, float], Inputs]
"""Openings as a function of time (s) and the control volume's reading (kPa). Called once per sample."""

_SLACK_S = 1e-9
"""Tolerance for rounding, so that a change at the time of a sample acts in this sample."""
_VENTURI_LEVELS = (0.0, 0.5, 1.0)

OPENING_DIGITS = 4
"""Decimal places of valve commands, in the simulation and in the file."""
_LIMIT_KPA = 200.0
_READINGS_OVER = 3
"""Number of consecutive readings above the limit that count as overpressure, as in the firmware."""
FASTEST_KPA_PER_S = 1e6
"""Practically no rate limit, so that a step stays a step."""
_OF_THE_ERROR = 0.4
"""Share of the error that one sample may correct."""
_HOLDS_OF_FULL_OPENING = 1.5
"""Error from which the valves open fully, as a multiple of the maximum pressure change in one sample."""
_TOLERATED_HOLDS = 0.09
"""Excess over the setpoint up to which the solenoid stays shut, as a multiple of the maximum pressure change
in one sample."""


@dataclass(frozen=True, eq=False)
class ScenarioRun:
    """The recorded run, one element per sample; gauge pressures.

    An opening holds until the next sample. `command_kPa` is NaN without regulation. The control volume's
    pressures are NaN if the rig has no control volume. The reservoir's pressures are NaN if the rig has a
    pump. A real rig cannot measure the true pressures.
    """

    label: str
    time_s: Array
    command_kPa: Array
    evp_opening: Array
    dvp_opening: Array
    solenoid: BoolArray
    cv_pressure_kPa: Array
    reservoir_pressure_kPa: Array
    true_cv_kPa: Array
    true_reservoir_kPa: Array
    faults: str
    """The fault that vented the vine for the rest of the run; empty if none."""


def simulate(rig: Rig | TrueRig, run: RunKind, seed: int = 1, *, index: int = 0) -> ScenarioRun:
    """One run of a scenario, from rest. The same arguments give the same numbers.

    Args:
        rig: the simulated rig; a `Rig` uses the baseline model with the rig's noise.
        run: the run to simulate.
        seed: of all random numbers.
        index: the run's index in its scenario, so that runs with the same seed differ.

    Raises `ScenarioError` if the run needs a control volume and the rig has none, or if the run needs the
    regulator and the rig has a pump.
    """
    rig = rig if isinstance(rig, TrueRig) else TrueRig(rig)
    nominal, setup = rig.nominal, rig.setup
    pattern = random.Random(f"{seed} {index} pattern")
    command = command_of(run, pattern)
    if nominal.cv is None and run.needs_cv:
        raise ScenarioError(f"runs[{index}]: {run.label} needs a control volume, and the rig has no [cv]")
    if nominal.pump is not None and command is not None:
        raise ScenarioError(
            f"runs[{index}]: {run.label} needs the regulator of the valves, and the rig has a pump; "
            'use runs of kind "openings"'
        )
    controller: _OpenLoop | _ClosedLoop
    if command is None or nominal.cv is None:
        valves = valves_of(run, pattern)
        assert valves is not None, "a run either regulates or moves the valves"
        controller = _OpenLoop(valves)
    else:
        controller = _ClosedLoop(nominal, nominal.cv, run, command)
    plant = Simulator(setup.plant, at_rest(setup.plant, run.reservoir_kPa, 0.0))
    true = plant.conditions
    sense = _Sensors(setup, random.Random(f"{seed} {index} noise"), true)
    reading = sense(true)
    steps = FIRMWARE_HZ // run.sample_rate_Hz
    rows: list[tuple[float, ...]] = []
    for sample in range(max(1, round(run.length_s * run.sample_rate_Hz))):
        first = sample * steps
        t_s = first / FIRMWARE_HZ
        wanted_kPa, drive = controller.sample(t_s, reading)
        openings = round(drive.evp, OPENING_DIGITS), round(drive.dvp, OPENING_DIGITS)
        inputs = Inputs(*openings, drive.solenoid)
        rows.append((t_s, wanted_kPa, *inputs, *reading, true.cv_kPa, true.reservoir_kPa))
        for step in range(first + 1, first + steps + 1):
            plant.advance(inputs)
            true = plant.conditions
            reading = sense(true)
            if step < first + steps:
                controller.watch(reading)
    time_s, wanted, evp, dvp, solenoid, cv, reservoir, true_cv, true_reservoir = np.array(rows).T
    if nominal.cv is None:
        cv = true_cv = np.full_like(time_s, np.nan)
    if nominal.pump is not None:
        reservoir = true_reservoir = np.full_like(time_s, np.nan)
    pressures = cv, reservoir, true_cv, true_reservoir
    return ScenarioRun(run.label, time_s, wanted, evp, dvp, solenoid > 0.5, *pressures, controller.faults)


def simulate_scenario(rig: Rig | TrueRig, scenario: Scenario, seed: int = 1) -> tuple[ScenarioRun, ...]:
    """Simulate all runs of a scenario, each from rest."""
    return tuple(simulate(rig, run, seed, index=i) for i, run in enumerate(scenario.runs))


class _Reading(NamedTuple):
    """kPa gauge."""

    cv_kPa: float
    reservoir_kPa: float


class _Sensors:
    """The sensors, read once per tick."""

    def __init__(self, setup: Setup, noise: random.Random, true: Conditions) -> None:
        self._cv, self._reservoir = setup.cv_sensor, setup.reservoir_sensor
        self._seen_cv, self._seen_reservoir = rested(true.line_kPa), rested(true.reservoir_kPa)
        self._gauss = noise.gauss

    def __call__(self, true: Conditions) -> _Reading:
        self._seen_cv, cv_kPa = read(self._cv, self._seen_cv, true.line_kPa, TICK_S, self._gauss(0.0, 1.0))
        self._seen_reservoir, reservoir_kPa = read(
            self._reservoir, self._seen_reservoir, true.reservoir_kPa, TICK_S, self._gauss(0.0, 1.0)
        )
        return _Reading(cv_kPa, reservoir_kPa)


class _OpenLoop:
    """Commands the valves once per sample (`sample`), and sees each reading in between (`watch`)."""

    faults = ""

    def __init__(self, valves: ValveCommand) -> None:
        self._valves = valves

    def sample(self, t_s: float, reading: _Reading) -> tuple[float, Inputs]:
        return float("nan"), self._valves(t_s, reading.cv_kPa)

    def watch(self, reading: _Reading) -> None:
        pass


class _ClosedLoop:
    """The firmware's regulator, with an overpressure limit above the pressures of all scenarios."""

    def __init__(self, rig: Rig, cv: ControlVolume, run: RunKind, command: SetpointOverTime) -> None:
        self.faults = ""
        self._regulator = Regulator(tuning_for(rig, cv, run.reservoir_kPa, run.sample_rate_Hz))
        self._command = command
        self._wanted_kPa = 0.0
        self._readings_over = 0

    def sample(self, t_s: float, reading: _Reading) -> tuple[float, Inputs]:
        wanted_kPa = self._command(t_s)
        # The serial protocol sends setpoints in single precision.
        self._wanted_kPa = float(np.float32(wanted_kPa))
        return wanted_kPa, self.watch(reading)

    def watch(self, reading: _Reading) -> Inputs:
        self._readings_over = self._readings_over + 1 if reading.cv_kPa > _LIMIT_KPA else 0
        if self._readings_over >= _READINGS_OVER:
            self.faults = "cv overpressure"
        if self.faults:
            return SAFE
        return self._regulator.step(
            self._wanted_kPa, FASTEST_KPA_PER_S, reading.cv_kPa, reading.reservoir_kPa
        )


def tuning_for(rig: Rig, cv: ControlVolume, reservoir_kPa: float, sample_rate_Hz: int) -> Tuning:
    """The regulator's tuning for valves that move only once per sample.

    At the firmware's own rate it is the standard one. A valve that is constant for 20 ms changes the pressure
    of a 0.1 L vine by up to 7 kPa; with the gains for 1 ms the pressure would oscillate.
    """
    if sample_rate_Hz >= FIRMWARE_HZ:
        return {}
    hold_s = 1.0 / sample_rate_Hz
    rate_kPa_per_s = ALPHA_KPA * reservoir_kPa / (rig.evp.flow_resistance_kPa_s_per_SL * cv.volume_L)
    # The maximum pressure change in one sample.
    hold_kPa = rate_kPa_per_s * hold_s
    standard = standard_tuning()
    share = min(1.0, _OF_THE_ERROR / (standard["proportional_per_kPa"] * hold_kPa))
    return {
        "filling_lead_s": standard["filling_lead_s"] + hold_s,
        "venting_lead_s": standard["venting_lead_s"] + hold_s,
        "passive_first_s": standard["passive_first_s"] + 2.0 * hold_s,
        "on_off_error_kPa": max(standard["on_off_error_kPa"], _HOLDS_OF_FULL_OPENING * hold_kPa),
        "tolerated_kPa": max(standard["tolerated_kPa"], _TOLERATED_HOLDS * hold_kPa),
        "proportional_per_kPa": share * standard["proportional_per_kPa"],
        "integral_per_kPa_s": min(1.0, 1.0 / hold_kPa) * standard["integral_per_kPa_s"],
        "integral_forgets": max(1.0, hold_kPa / 2.0) * standard["integral_forgets"],
    }


# The commands of a run over time.


def command_of(run: RunKind, pattern: random.Random) -> SetpointOverTime | None:
    """The setpoint of a run; None if the run does not regulate."""
    match run:
        case StepsRun():
            return _held(run.pressures_kPa, run.holds_s)
        case BendsRun():
            holds_s = (run.hold_s, run.rest_s) * run.cycles
            return _held((run.bend_kPa, 0.0) * run.cycles, holds_s)
        case SineRun():
            return _swing(run.low_kPa, run.high_kPa, lambda t_s: run.frequency_Hz * t_s)
        case ChirpRun():
            return _swing(run.low_kPa, run.high_kPa, lambda t_s: chirp_cycles(run, t_s))
        case PrbsRun(levels_kPa=levels) if levels:
            drawn = list(_draw(run, levels, pattern))
            return _held([level for level, _ in drawn], [hold_s for _, hold_s in drawn])
        case ProfileRun():
            return run.motion().setpoint_kPa
    return None


def valves_of(run: RunKind, pattern: random.Random) -> ValveCommand | None:
    """The openings of a run; None if the run regulates."""
    match run:
        case DischargeRun():
            drive = Inputs(run.opening, 0.0, True) if run.valve == "evp" else Inputs(0.0, run.opening, False)
            return lambda t_s, cv_kPa: drive
        case OpeningsRun():
            return _Sequence(run.valves)
        case PrbsRun(levels_opening=levels) if levels:
            return _RandomValves(run, pattern)
    return None


def chirp_cycles(run: ChirpRun, t_s: float) -> float:
    """Number of cycles of a chirp until `t_s`: the integral of its frequency."""
    ratio = run.to_Hz / run.from_Hz
    if run.sweep == "linear" or math.isclose(ratio, 1.0, rel_tol=1e-9):
        return run.from_Hz * t_s + 0.5 * (run.to_Hz - run.from_Hz) * t_s**2 / run.duration_s
    log_ratio = math.log(ratio)
    return run.from_Hz * run.duration_s / log_ratio * math.expm1(log_ratio * t_s / run.duration_s)


def _swing(low_kPa: float, high_kPa: float, cycles: Callable[[float], float]) -> SetpointOverTime:
    half = 0.5 * (high_kPa - low_kPa)
    return lambda t_s: low_kPa + half * (1.0 - math.cos(2.0 * math.pi * cycles(t_s)))


def _held(
    levels: list[float] | tuple[float, ...], holds_s: list[float] | tuple[float, ...]
) -> SetpointOverTime:
    ends_s = list(accumulate(holds_s))
    return lambda t_s: levels[min(bisect_right(ends_s, t_s + _SLACK_S), len(levels) - 1)]


def _draw(run: PrbsRun, levels: tuple[float, ...], pattern: random.Random) -> Iterator[tuple[float, float]]:
    """Random levels and hold times until the end of the run; no level twice in a row."""
    level = None
    begin_s = 0.0
    while begin_s < run.duration_s:
        level = pattern.choice([other for other in levels if other != level])
        hold_s = pattern.uniform(run.min_hold_s, run.max_hold_s)
        yield level, hold_s
        begin_s += hold_s


class _Sequence:
    """A sequence of openings."""

    def __init__(self, valves: tuple[Valves, ...]) -> None:
        self._valves = valves
        self._at = 0
        self._ends_s = valves[0].for_s

    def __call__(self, t_s: float, cv_kPa: float) -> Inputs:
        while self._at < len(self._valves) - 1 and self._is_over(t_s, cv_kPa):
            left_early = t_s + _SLACK_S < self._ends_s
            self._at += 1
            self._ends_s = (t_s if left_early else self._ends_s) + self._valves[self._at].for_s
        now = self._valves[self._at]
        return Inputs(now.evp, now.dvp, now.solenoid)

    def _is_over(self, t_s: float, cv_kPa: float) -> bool:
        until_kPa = self._valves[self._at].until_kPa
        return t_s + _SLACK_S >= self._ends_s or (until_kPa is not None and cv_kPa >= until_kPa)


class _RandomValves:
    """Random openings, drawn one by one, because the next one depends on the control volume's pressure."""

    def __init__(self, run: PrbsRun, pattern: random.Random) -> None:
        self._run = run
        self._pattern = pattern
        self._drive = Inputs(0.0, 0.0, False)
        self._ends_s = 0.0

    def __call__(self, t_s: float, cv_kPa: float) -> Inputs:
        full = cv_kPa >= self._run.most_kPa
        while t_s + _SLACK_S >= self._ends_s:
            self._ends_s += self._pattern.uniform(self._run.min_hold_s, self._run.max_hold_s)
            self._drive = self._next(full)
        if full and self._drive.evp > 0.0:
            self._drive = Inputs(0.0, 0.0, False)
        return self._drive

    def _next(self, full: bool) -> Inputs:
        run, pattern, last = self._run, self._pattern, self._drive
        # All three numbers are always drawn, so that one reading does not change all later openings.
        vent = pattern.random() < run.vent_share
        venturi = pattern.choice(_VENTURI_LEVELS)
        level = pattern.choice([other for other in run.levels_opening if other != last.evp or last.solenoid])
        return Inputs(0.0, venturi, True) if vent or full else Inputs(level, 0.0, False)
