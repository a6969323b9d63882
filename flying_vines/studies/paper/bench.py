"""The paper's bench in a loop: the firmware's regulator and a plant.

No frames and no host: the command reaches the regulator at every step, as it did on the paper's bench, where
the microcontroller itself made it. The firmware's limits are left out, for the vine's (30 kPa, 200 kPa/s)
would end every test of the paper. Compiled: it needs numba.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from flying_vines.physics.arrays import Array
from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.likely import likely_effects
from flying_vines.physics.plant.plant import Plant, at_rest
from flying_vines.physics.plant.sensors import Sensor
from flying_vines.physics.plant.simulator import TICK_S
from flying_vines.physics.plant.true_rig import likely_sensors
from flying_vines.physics.rig import ControlVolume, Reservoir, Rig, Sensors
from flying_vines.simulation.phlosar.closed_loop import SetpointChange, closed_loop
from flying_vines.simulation.phlosar.regulator import Tuning

AT_ONCE_KPA_PER_S = 1e6
"""So that a step is a step."""

FIXED_SOURCE = Reservoir(volume_L=1e9)
"""The pressure of a supply that no flow moves (Sec. V-C)."""


PAPERS_TUNING: Tuning = {
    "on_off_error_kPa": 1.0,
    "opening_s": TICK_S,
    "filling_lead_s": 0.0,
    "venting_lead_s": 0.0,
    "patience_kPa_s": 0.0,
    "warming_s": 0.0,
    "waiting_s": 0.0,
}
"""As the paper has it: on-off beyond 1 kPa, at once and without a look ahead, and PID within."""


@dataclass(frozen=True)
class Bench:
    """What a test is run on: by default the baseline plant, with sensors that are perfect."""

    rig: Rig = field(default_factory=Rig)
    effects: Effects = field(default_factory=Effects)
    sensors: tuple[Sensor, Sensor] = (Sensor(), Sensor())
    """The control volume's, the reservoir's."""
    noise_seed: int | None = None
    """Of the sensors' noise; None: none."""
    tuning: Tuning = field(default_factory=lambda: PAPERS_TUNING)

    def with_cv(self, volume_L: float) -> Bench:
        """The same bench with another control volume."""
        return replace(self, rig=replace(self.rig, cv=ControlVolume(volume_L)))

    def with_fixed_source(self) -> Bench:
        """The same bench on a supply whose pressure does not change."""
        return replace(self, rig=replace(self.rig, reservoir=FIXED_SOURCE))


LIKELY = Bench(effects=likely_effects(pouch=False), sensors=likely_sensors(Sensors()), noise_seed=1)
"""The high-fidelity plant: all that a real one probably has, and rigid vessels as control volumes."""


@dataclass(frozen=True)
class Trace:
    """What a test recorded."""

    table: Array
    """A column a millisecond: time, command, the control volume's reading, reservoir, EVP, DVP, solenoid."""

    @property
    def time_s(self) -> Array:
        return self.table[0, :]

    @property
    def command_kPa(self) -> Array:
        return self.table[1, :]

    @property
    def cv_kPa(self) -> Array:
        """As the sensor reads it."""
        return self.table[2, :]

    @property
    def reservoir_kPa(self) -> Array:
        return self.table[3, :]

    @property
    def openings(self) -> Array:
        """EVP, DVP and solenoid, each holding from its sample to the next."""
        return self.table[4:, :]


def run(
    bench: Bench,
    command_kPa: Callable[[float], float],
    *,
    reservoir_kPa: float,
    duration_s: float,
    cv_kPa: float = 0.0,
) -> Trace:
    """Follow a command from rest, closed loop.

    Args:
        command_kPa: the setpoint over time in s, kPa gauge.
        reservoir_kPa: at the start, kPa gauge.
        duration_s: how long, s.
        cv_kPa: control volume at the start, kPa gauge.
    """
    if not (duration_s > 0.0 and math.isfinite(duration_s)):
        raise ValueError(f"a test lasts a positive time, not {duration_s} s")
    if bench.rig.cv is None:
        raise ValueError("a test in closed loop needs a control volume")
    plant = Plant(bench.rig, bench.effects)
    commands = [
        SetpointChange(i * TICK_S, command_kPa(i * TICK_S), AT_ONCE_KPA_PER_S)
        for i in range(round(duration_s / TICK_S))
    ]
    cv_sensor, reservoir_sensor = bench.sensors
    flown = closed_loop(
        plant,
        commands,
        duration_s,
        at_rest(plant, reservoir_kPa, cv_kPa),
        tuning=bench.tuning,
        cv_sensor=cv_sensor,
        reservoir_sensor=reservoir_sensor,
        seed=bench.noise_seed,
        record_every=1,
    ).table
    columns = ("time_s", "target_kPa", "cv_reading_kPa", "reservoir_kPa", "evp", "dvp", "solenoid")
    return Trace(np.array([flown[column] for column in columns]))


def follow_sine(
    bench: Bench,
    *,
    frequency_Hz: float,
    peak_to_peak_kPa: float,
    reservoir_kPa: float,
    settle_s: float = 3.0,
    measure_s: float = 3.0,
) -> Trace:
    """The response to a sine that starts at its least value, 0 kPa (Sec. V-C), in whole cycles.

    Whole to half a millisecond. What is settling is cut away, and at least one cycle is kept; a command so
    slow that no cycle ends within `settle_s` is followed from its start on, and has nothing to settle.

    Args:
        frequency_Hz: of the command, Hz.
        peak_to_peak_kPa: of the command, kPa.
        reservoir_kPa: of the supply, kPa gauge.
        settle_s: cut away, to whole cycles, s.
        measure_s: kept at least, s.
    """
    if not frequency_Hz > 0.0:
        raise ValueError(f"a sine has a positive frequency, not {frequency_Hz} Hz")
    # So that a cycle that ends on the mark counts as ended.
    settle = math.floor(settle_s * frequency_Hz + 1e-9)
    keep = max(1, math.ceil(measure_s * frequency_Hz - 1e-9))
    half = 0.5 * peak_to_peak_kPa
    omega = 2.0 * math.pi * frequency_Hz
    trace = run(
        bench,
        lambda t: half - half * math.cos(omega * t),
        reservoir_kPa=reservoir_kPa,
        duration_s=(settle + keep) / frequency_Hz,
    )
    return Trace(trace.table[:, -round(keep / frequency_Hz / TICK_S) :])


def gain(trace: Trace, cycles: int) -> float:
    """Response over command at the command's frequency, by FFT (Sec. V-C).

    Args:
        trace: whole cycles, as from `follow_sine`.
        cycles: how many they are.
    """
    response = np.fft.rfft(trace.cv_kPa)[cycles]
    command = np.fft.rfft(trace.command_kPa)[cycles]
    return float(abs(response) / abs(command))
