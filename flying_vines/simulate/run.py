"""A run: the emulated firmware at 1 kHz, a plant, noisy sensors, and a recorder.

The valves take a new word only when a sample is recorded, rounded as it is written. So a recorded opening
is what the valve was told from its own sample until the next, all the time, and the openings of the file,
replayed through the same plant, give the true pressures again. At `sample_rate_Hz = 1000` that is every
step of the firmware; below, its regulator has the gains of `regulation`. A recorded reading is the very one
on which the firmware acted.
"""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from firmware_link.protocol import PROTOCOL_VERSION, Codec, Hello, Setpoint
from flying_vines.fakes.firmware import Firmware
from flying_vines.fakes.regulator import Drive
from flying_vines.pneumatics.baseline import Inputs, State
from flying_vines.pneumatics.rig import ControlVolume, Rig, Sensors
from flying_vines.simulate.command import Command, ValveCommand, command_of, valves_of
from flying_vines.simulate.kinds import FIRMWARE_HZ, Kind
from flying_vines.simulate.plant import BaselinePlant, PlantMaker
from flying_vines.simulate.regulation import firmware_for
from flying_vines.simulate.scenario import Scenario, ScenarioError

Array = NDArray[np.float64]

OPENING_DIGITS = 4
"""After the point: of what is told to a valve, and of what is written."""
_STEP_US = 1_000_000 // FIRMWARE_HZ
_TTL_MS = 300


@dataclass(frozen=True, eq=False)
class Run:
    """What a run recorded, an element a sample; gauge pressures.

    Openings hold from their sample until the next. `command_kPa` is NaN where nothing regulated, the control
    volume's pressures where the rig has none. The true pressures are what a real rig would not tell.
    """

    label: str
    time_s: Array
    command_kPa: Array
    evp_opening: Array
    dvp_opening: Array
    solenoid: NDArray[np.bool_]
    cv_pressure_kPa: Array
    reservoir_pressure_kPa: Array
    true_cv_kPa: Array
    true_reservoir_kPa: Array
    faults: str
    """What the firmware latched, and vented for; empty if nothing."""


def simulate(rig: Rig, run: Kind, seed: int = 1, *, plant: PlantMaker = BaselinePlant, index: int = 0) -> Run:
    """One run of a scenario, from rest. The same arguments give the same numbers.

    Args:
        rig: what the plant is made from; its sensors' noise.
        run: what to do.
        seed: of the noise and of what is drawn at random.
        plant: makes the plant, at rest with given pressures.
        index: the run's place in its scenario, so that runs of one seed differ.

    Raises ScenarioError when the run needs a control volume and the rig has none.
    """
    noise = random.Random(f"{seed} {index} noise")
    pattern = random.Random(f"{seed} {index} pattern")
    state = State(run.reservoir_kPa, 0.0)
    command = command_of(run, pattern)
    if rig.cv is None and run.needs_cv:
        raise ScenarioError(f"runs[{index}]: {run.label} needs a control volume, and the rig has no [cv]")
    controller: _Controller
    if command is None or rig.cv is None:
        valves = valves_of(run, pattern)
        assert valves is not None, "a run either regulates or moves the valves"
        controller = _OpenLoop(valves)
    else:
        controller = _ClosedLoop(rig, rig.cv, run, command)
    moving = plant(rig, state)
    sense = _Senses(rig.sensors, noise)
    steps = FIRMWARE_HZ // run.sample_rate_Hz
    step_s = 1.0 / FIRMWARE_HZ
    rows: list[tuple[float, ...]] = []
    for sample in range(max(1, round(run.length_s * run.sample_rate_Hz))):
        step = sample * steps
        t_s = step / FIRMWARE_HZ
        reading = sense(state)
        wanted_kPa, told = controller.sample(t_s, reading)
        drive = Drive(round(told.evp, OPENING_DIGITS), round(told.dvp, OPENING_DIGITS), told.solenoid)
        rows.append((t_s, wanted_kPa, *drive, reading.cv_kPa, reading.reservoir_kPa, state[1], state[0]))
        inputs = Inputs(*drive)
        if not controller.watches:
            for _ in range(steps):
                state = moving.advance(inputs, step_s)
            continue
        for between in range(1, steps):
            state = moving.advance(inputs, step_s)
            controller.watch((step + between) / FIRMWARE_HZ, sense(state))
        state = moving.advance(inputs, step_s)
    return _recorded(run, rig, np.array(rows, dtype=np.float64).T, controller.faults)


def simulate_scenario(
    rig: Rig, scenario: Scenario, seed: int = 1, *, plant: PlantMaker = BaselinePlant
) -> tuple[Run, ...]:
    """All runs of a scenario, each from rest, as `simulate`."""
    return tuple(simulate(rig, run, seed, plant=plant, index=i) for i, run in enumerate(scenario.runs))


def _recorded(run: Kind, rig: Rig, columns: Array, faults: str) -> Run:
    time_s, command, evp, dvp, solenoid, cv, reservoir, true_cv, true_reservoir = columns
    if rig.cv is None:
        cv = true_cv = np.full_like(time_s, np.nan)
    return Run(
        run.label, time_s, command, evp, dvp, solenoid > 0.5, cv, reservoir, true_cv, true_reservoir, faults
    )


class _Senses:
    """The sensors."""

    def __init__(self, sensors: Sensors, noise: random.Random) -> None:
        self._cv_std_kPa = sensors.cv_noise_std_kPa
        self._reservoir_std_kPa = sensors.reservoir_noise_std_kPa
        self._gauss = noise.gauss

    def __call__(self, state: State) -> State:
        cv_kPa = self._gauss(state.cv_kPa, self._cv_std_kPa)
        return State(self._gauss(state.reservoir_kPa, self._reservoir_std_kPa), cv_kPa)


class _Controller(Protocol):
    """What tells the valves: once a sample, and, if it `watches`, shown each reading in between."""

    watches: bool

    @property
    def faults(self) -> str: ...

    def sample(self, t_s: float, reading: State) -> tuple[float, Drive]: ...

    def watch(self, t_s: float, reading: State) -> None: ...


class _OpenLoop:
    watches = False
    faults = ""

    def __init__(self, valves: ValveCommand) -> None:
        self._valves = valves

    def sample(self, t_s: float, reading: State) -> tuple[float, Drive]:
        return float("nan"), self._valves(t_s, reading.cv_kPa)

    def watch(self, t_s: float, reading: State) -> None:
        pass


class _ClosedLoop:
    """The emulated firmware, and a host that sends it a setpoint with every sample."""

    watches = True

    def __init__(self, rig: Rig, cv: ControlVolume, run: Kind, command: Command) -> None:
        self._settings = firmware_for(rig, cv, run.reservoir_kPa, run.sample_rate_Hz)
        self._firmware = Firmware(self._settings)
        self._command = command
        self._codec = Codec()
        self._number = 0
        # A step before the run begins: the board has booted, and listens.
        self._firmware.step(0, 0.0, run.reservoir_kPa)
        self._firmware.receive(self._codec.encode(Hello(PROTOCOL_VERSION, 1)))

    @property
    def faults(self) -> str:
        return ", ".join(
            fault.name.lower().replace("_", " ") for fault in self._firmware.faults if fault.name
        )

    def sample(self, t_s: float, reading: State) -> tuple[float, Drive]:
        wanted_kPa = self._command(t_s)
        self._number = (self._number + 1) & 0xFFFF
        setpoint = Setpoint(wanted_kPa, self._settings.rate_limit_kPa_per_s, _TTL_MS, self._number)
        self._firmware.receive(self._codec.encode(setpoint))
        return wanted_kPa, self._step(t_s, reading)

    def watch(self, t_s: float, reading: State) -> None:
        self._step(t_s, reading)

    def _step(self, t_s: float, reading: State) -> Drive:
        now_us = _STEP_US + round(t_s * 1e6)
        drive = self._firmware.step(now_us, reading.cv_kPa, reading.reservoir_kPa)
        self._firmware.take_output()
        return drive
