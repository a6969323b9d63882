"""The paper's bench in a loop: the emulated firmware's regulator and the baseline plant, without noise.

No frames and no host: the command reaches the regulator at every step, as it did on the paper's bench, where
the microcontroller itself made it. The firmware's limits are those of `BENCH_FIRMWARE`, for the vine's own
(30 kPa) would end every test of the paper.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from flying_vines.fakes.firmware import SAFE, FirmwareSettings
from flying_vines.fakes.regulator import Regulator
from flying_vines.pneumatics.baseline import Inputs, State, step
from flying_vines.pneumatics.rig import ControlVolume, Reservoir, Rig

Array = NDArray[np.float64]

BENCH_FIRMWARE = FirmwareSettings(build="bench", cv_limit_kPa=150.0, rate_limit_kPa_per_s=1e6)
"""Room for a step of 69 kPa with its overshoot, and steps that are steps."""

FIXED_SOURCE = Reservoir(volume_L=1e9)
"""The pressure of a supply that no flow moves (Sec. V-C)."""


@dataclass(frozen=True)
class Bench:
    """What a test is run on."""

    rig: Rig = field(default_factory=Rig)
    firmware: FirmwareSettings = BENCH_FIRMWARE
    step_s: float = 0.001

    def with_cv(self, volume_L: float) -> Bench:
        """The same bench with another control volume."""
        return replace(self, rig=replace(self.rig, cv=ControlVolume(volume_L)))

    def with_fixed_source(self) -> Bench:
        """The same bench on a supply whose pressure does not change."""
        return replace(self, rig=replace(self.rig, reservoir=FIXED_SOURCE))


@dataclass(frozen=True)
class Trace:
    """What a test recorded."""

    table: Array
    """A column a step: time, command, control volume, reservoir, EVP, DVP, solenoid."""
    tripped: bool
    """The firmware's limit was passed, and the rest was spent venting."""

    @property
    def time_s(self) -> Array:
        return self.table[0, :]

    @property
    def command_kPa(self) -> Array:
        return self.table[1, :]

    @property
    def cv_kPa(self) -> Array:
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
    rig, dt_s = bench.rig, bench.step_s
    limit_kPa, rate_kPa_per_s = bench.firmware.cv_limit_kPa, bench.firmware.rate_limit_kPa_per_s
    regulator = Regulator(bench.firmware.regulator, cv_kPa)
    state = State(reservoir_kPa, cv_kPa)
    tripped = False
    rows: list[tuple[float, ...]] = []
    for i in range(round(duration_s / dt_s)):
        t = i * dt_s
        wanted = command_kPa(t)
        tripped = tripped or state.cv_kPa > limit_kPa
        if tripped:
            drive = SAFE
        else:
            regulator.aim(wanted, rate_kPa_per_s)
            drive = regulator.step(dt_s, state.cv_kPa, state.reservoir_kPa)
        rows.append((t, wanted, state.cv_kPa, state.reservoir_kPa, *drive))
        state = step(rig, state, Inputs(*drive), dt_s)
    return Trace(np.array(rows, dtype=np.float64).T, tripped)


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

    The control step is made a whole part of the cycle (at 15 Hz 67 steps, of 0.995 ms), so that a cycle
    ends on a sample. What is settling is cut away, and at least one cycle is kept; a command so slow that
    no cycle ends within `settle_s` is followed from its start on, and has nothing to settle.

    Args:
        frequency_Hz: of the command, Hz.
        peak_to_peak_kPa: of the command, kPa.
        reservoir_kPa: of the supply, kPa gauge.
        settle_s: cut away, to whole cycles, s.
        measure_s: kept at least, s.
    """
    if not frequency_Hz > 0.0:
        raise ValueError(f"a sine has a positive frequency, not {frequency_Hz} Hz")
    per_cycle = max(4, round(1.0 / (frequency_Hz * bench.step_s)))
    step_s = 1.0 / (frequency_Hz * per_cycle)
    # So that a cycle that ends on the mark counts as ended.
    settle = math.floor(settle_s * frequency_Hz + 1e-9)
    keep = max(1, math.ceil(measure_s * frequency_Hz - 1e-9))
    half = 0.5 * peak_to_peak_kPa
    omega = 2.0 * math.pi * frequency_Hz
    trace = run(
        replace(bench, step_s=step_s),
        lambda t: half - half * math.cos(omega * t),
        reservoir_kPa=reservoir_kPa,
        duration_s=(settle + keep) * per_cycle * step_s,
    )
    return Trace(trace.table[:, -keep * per_cycle :], trace.tripped)


def gain(trace: Trace, cycles: int) -> float:
    """Response over command at the command's frequency, by FFT (Sec. V-C).

    Args:
        trace: whole cycles, as from `follow_sine`.
        cycles: how many they are.
    """
    response = np.fft.rfft(trace.cv_kPa)[cycles]
    command = np.fft.rfft(trace.command_kPa)[cycles]
    return float(abs(response) / abs(command))
