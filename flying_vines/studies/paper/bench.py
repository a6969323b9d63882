"""The paper's bench in closed loop: the firmware's regulator and a plant.

There are no serial frames and no host. The regulator gets the command at every step, as on the paper's bench,
where the microcontroller generated the command. The firmware's limits are left out, because the vine's limits
(30 kPa, 200 kPa/s) would prevent most tests of the paper. The loop is compiled, so it needs numba.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from flying_vines.physics.plant.effects import Effects, likely_effects
from flying_vines.physics.plant.plant import Plant, at_rest
from flying_vines.physics.plant.sensors import Sensor
from flying_vines.physics.plant.simulator import TICK_S
from flying_vines.physics.plant.true_rig import likely_sensors
from flying_vines.physics.rig import ControlVolume, Reservoir, Rig, Sensors
from flying_vines.simulation.phlosar.closed_loop import SetpointChange, closed_loop
from flying_vines.simulation.phlosar.firmware import Tuning

AT_ONCE_KPA_PER_S = 1e6
"""Setpoint rate, so fast that a step stays a step."""

SETTLE_S, MEASURE_S = 3.0, 3.0
"""Maximum time that is cut off the start of a sine response, and minimum time that is kept; both are rounded
to whole cycles."""

FIXED_SOURCE = Reservoir(volume_L=1e9)
"""A supply with a constant pressure (Sec. V-C)."""


PAPERS_TUNING: Tuning = {
    "on_off_error_kPa": 1.0,
    "opening_s": TICK_S,
    "filling_lead_s": 0.0,
    "venting_lead_s": 0.0,
    "patience_kPa_s": 0.0,
    "warming_s": 0.0,
    "waiting_s": 0.0,
}
"""The paper's regulator: on-off control beyond 1 kPa without prediction, and PID within 1 kPa."""


@dataclass(frozen=True)
class Bench:
    """The bench of a test; default: the baseline plant with perfect sensors."""

    rig: Rig = field(default_factory=Rig)
    effects: Effects = field(default_factory=Effects)
    sensors: tuple[Sensor, Sensor] = (Sensor(), Sensor())
    """Sensors of control volume and reservoir."""
    noise_seed: int | None = None
    """Seed of the sensor noise; None: no noise."""
    tuning: Tuning = field(default_factory=lambda: PAPERS_TUNING)

    def with_cv(self, volume_L: float) -> Bench:
        """The same bench with another control volume."""
        return replace(self, rig=replace(self.rig, cv=ControlVolume(volume_L)))

    def with_fixed_source(self) -> Bench:
        """The same bench on a supply whose pressure does not change."""
        return replace(self, rig=replace(self.rig, reservoir=FIXED_SOURCE))


LIKELY = Bench(effects=likely_effects(pouch=False), sensors=likely_sensors(Sensors()), noise_seed=1)
"""The high-fidelity plant: all probable effects of a real rig, with rigid control volumes."""


Trace = NDArray[np.void]
"""The record of a test, a row for each ms: `time_s`, `target_kPa` (the command), `cv_reading_kPa`,
`reservoir_kPa`, and the openings `evp`, `dvp` and `solenoid`, which hold until the next row. EVP is the
inflation valve, DVP supplies the Venturi."""


def run(
    bench: Bench,
    command_kPa: Callable[[float], float],
    *,
    reservoir_kPa: float,
    duration_s: float,
    cv_kPa: float = 0.0,
) -> Trace:
    """Follow a command from rest, in closed loop.

    Args:
        command_kPa: the setpoint over time in s, kPa gauge.
        reservoir_kPa: start pressure of the reservoir, kPa gauge.
        duration_s: length of the test.
        cv_kPa: start pressure of the control volume, kPa gauge.
    """
    if not (duration_s > 0.0 and math.isfinite(duration_s)):
        raise ValueError(f"the length of a test must be positive, not {duration_s} s")
    if bench.rig.cv is None:
        raise ValueError("a test in closed loop needs a control volume")
    plant = Plant(bench.rig, bench.effects)
    commands = [
        SetpointChange(i * TICK_S, command_kPa(i * TICK_S), AT_ONCE_KPA_PER_S)
        for i in range(round(duration_s / TICK_S))
    ]
    cv_sensor, reservoir_sensor = bench.sensors
    return closed_loop(
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


def follow_sine(
    bench: Bench,
    *,
    frequency_Hz: float,
    peak_to_peak_kPa: float,
    reservoir_kPa: float,
) -> Trace:
    """The response to a sine that starts at its minimum, 0 kPa (Sec. V-C), in whole cycles to within 0.5 ms.

    Settling cycles are cut off, and at least one cycle remains. A slow command that completes no cycle within
    `SETTLE_S` is recorded from its start.

    Args:
        frequency_Hz: frequency of the command.
        peak_to_peak_kPa: peak to peak of the command.
        reservoir_kPa: supply pressure, kPa gauge.
    """
    if not frequency_Hz > 0.0:
        raise ValueError(f"the frequency of a sine must be positive, not {frequency_Hz} Hz")
    # The margins are for rounding errors: a cycle that ends exactly at the limit counts.
    settle = math.floor(SETTLE_S * frequency_Hz + 1e-9)
    keep = max(1, math.ceil(MEASURE_S * frequency_Hz - 1e-9))
    half = 0.5 * peak_to_peak_kPa
    omega = 2.0 * math.pi * frequency_Hz
    trace = run(
        bench,
        lambda t: half - half * math.cos(omega * t),
        reservoir_kPa=reservoir_kPa,
        duration_s=(settle + keep) / frequency_Hz,
    )
    return trace[-round(keep / frequency_Hz / TICK_S) :]


def gain(trace: Trace, cycles: int) -> float:
    """Response over command at the command's frequency, by FFT (Sec. V-C).

    Args:
        trace: whole cycles, as from `follow_sine`.
        cycles: their number.
    """
    response = np.fft.rfft(trace["cv_reading_kPa"])[cycles]
    command = np.fft.rfft(trace["target_kPa"])[cycles]
    return float(abs(response) / abs(command))
