"""Simulates a run: the firmware's regulator at 1 kHz, the plant, its sensors, and a recorder.

Valve commands change only at recorded samples, and are rounded as in the file. So the recorded openings,
replayed through the same plant, give the true pressures again. At `sample_rate_Hz = 1000` each step of the
firmware is a sample; at lower rates `regulation` tunes the regulator. A recorded reading is the reading that
the firmware used.
"""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from flying_vines.physics.arrays import Array, BoolArray
from flying_vines.physics.baseline import Inputs
from flying_vines.physics.plant.plant import Conditions, Setup, at_rest
from flying_vines.physics.plant.sensors import read, rested
from flying_vines.physics.plant.simulator import TICK_S, Simulator
from flying_vines.physics.plant.true_rig import TrueRig
from flying_vines.physics.rig import ControlVolume, Rig
from flying_vines.simulation.phlosar.regulator import SAFE, Regulator
from flying_vines.simulation.scenario.command import SetpointOverTime, ValveCommand, command_of, valves_of
from flying_vines.simulation.scenario.regulation import FASTEST_KPA_PER_S, tuning_for
from flying_vines.simulation.scenario.run_kinds import FIRMWARE_HZ, RunKind
from flying_vines.simulation.scenario.scenario import Scenario, ScenarioError

OPENING_DIGITS = 4
"""Decimal places of valve commands, in the simulation and in the file."""
_LIMIT_KPA = 200.0
_READINGS_OVER = 3
"""Number of consecutive readings above the limit that count as overpressure, as in the firmware."""


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
    controller: _Controller
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
        wanted_kPa, command_drive = controller.sample(t_s, reading)
        drive = Inputs(
            round(command_drive.evp, OPENING_DIGITS),
            round(command_drive.dvp, OPENING_DIGITS),
            command_drive.solenoid,
        )
        rows.append((t_s, wanted_kPa, *drive, *reading, true.cv_kPa, true.reservoir_kPa))
        inputs = Inputs(*drive)
        for step in range(first + 1, first + steps + 1):
            plant.advance(inputs)
            true = plant.conditions
            reading = sense(true)
            if step < first + steps:
                controller.watch(step / FIRMWARE_HZ, reading)
    return _recorded(run, nominal, np.array(rows, dtype=np.float64).T, controller.faults)


def simulate_scenario(rig: Rig | TrueRig, scenario: Scenario, seed: int = 1) -> tuple[ScenarioRun, ...]:
    """Simulate all runs of a scenario, each from rest."""
    return tuple(simulate(rig, run, seed, index=i) for i, run in enumerate(scenario.runs))


def _recorded(run: RunKind, rig: Rig, columns: Array, faults: str) -> ScenarioRun:
    time_s, command, evp, dvp, solenoid, cv, reservoir, true_cv, true_reservoir = columns
    if rig.cv is None:
        cv = true_cv = np.full_like(time_s, np.nan)
    if rig.pump is not None:
        reservoir = true_reservoir = np.full_like(time_s, np.nan)
    return ScenarioRun(
        run.label, time_s, command, evp, dvp, solenoid > 0.5, cv, reservoir, true_cv, true_reservoir, faults
    )


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


class _Controller(Protocol):
    """Commands the valves once per sample, and sees each reading in between."""

    @property
    def faults(self) -> str: ...

    def sample(self, t_s: float, reading: _Reading) -> tuple[float, Inputs]: ...

    def watch(self, t_s: float, reading: _Reading) -> None: ...


class _OpenLoop:
    faults = ""

    def __init__(self, valves: ValveCommand) -> None:
        self._valves = valves

    def sample(self, t_s: float, reading: _Reading) -> tuple[float, Inputs]:
        return float("nan"), self._valves(t_s, reading.cv_kPa)

    def watch(self, t_s: float, reading: _Reading) -> None:
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
        return wanted_kPa, self._step(reading)

    def watch(self, t_s: float, reading: _Reading) -> None:
        self._step(reading)

    def _step(self, reading: _Reading) -> Inputs:
        self._readings_over = self._readings_over + 1 if reading.cv_kPa > _LIMIT_KPA else 0
        if self._readings_over >= _READINGS_OVER:
            self.faults = "cv overpressure"
        if self.faults:
            return SAFE
        return self._regulator.step(
            self._wanted_kPa, FASTEST_KPA_PER_S, reading.cv_kPa, reading.reservoir_kPa
        )
