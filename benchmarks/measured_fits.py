"""Independent fits of measured rigs: own equations, scipy's integrator and least squares.

Gauge pressures in kPa, volumes in L, flows in standard litres per second (SL/s), times in s; temperatures are
divided by the ambient temperature. Volumes are assumed, so for a leak only the product of volume and
resistance is known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import odeint
from scipy.optimize import least_squares

Array = NDArray[np.float64]

ALPHA_KPA = 101.325
"""Pressure rise of 1 L by 1 SL."""
AMBIENT_KPA = 101.325
ORIFICE_CRITICAL_RATIO = 0.5
AIR_GAMMA = 1.4
CO2_GAMMA, CO2_KG_PER_MOL = 1.289, 0.04401
GAS_CONSTANT, ROOM_K = 8.314, 293.15
NOZZLE_M = 0.6e-3
_LAMINAR = 0.99
_FALL_S = 4.0
"""Longer than a discharge takes."""
_LOW_KPA = 50.0
"""A run that falls below this shows the sensor's offset."""


@dataclass(frozen=True)
class Fitted:
    """A law, its parameters by name, and its residual."""

    law: str
    parameters: dict[str, float]
    rms_kPa: float


@dataclass(frozen=True, eq=False)
class Readings:
    """One run: times, gauge pressures, and the input (opening or PWM share, held until the next)."""

    time_s: Array
    pressure_kPa: Array
    input: Array


def ohm(p_kPa: float, strength: float) -> float:
    """Flow of a leak by Ohm's law; `strength` is its resistance in kPa s/SL."""
    return p_kPa / strength


def viscous(p_kPa: float, strength: float) -> float:
    """Flow of a laminar leak of a gas; `strength` is C in (p1² − p2²)/C, kPa² s/SL."""
    return ((p_kPa + AMBIENT_KPA) ** 2 - AMBIENT_KPA**2) / strength


def orifice(p_kPa: float, strength: float) -> float:
    """Flow of a small hole by ISO 6358; `strength` is 1/conductance, kPa s/SL of absolute pressure."""
    return (
        (p_kPa + AMBIENT_KPA) * _phi(AMBIENT_KPA / (p_kPa + AMBIENT_KPA), ORIFICE_CRITICAL_RATIO) / strength
    )


LEAKS: dict[str, Callable[[float, float], float]] = {"ohm": ohm, "viscous": viscous, "orifice": orifice}


def leak(run: Readings, volume_L: float) -> list[Fitted]:
    """Fits of each leak law to a closed vessel, the best first.

    For a vessel that empties quickly, Ohm's law with gas that cools is also fitted.
    """
    fits = [_leak(run, volume_L, law) for law in LEAKS]
    if run.pressure_kPa.min() < _LOW_KPA:
        fits.append(_leak(run, volume_L, "ohm", cooling=True))
    return sorted(fits, key=lambda one: one.rms_kPa)


def _leak(run: Readings, volume_L: float, law: str, cooling: bool = False) -> Fitted:
    time_s, read = run.time_s - run.time_s[0], run.pressure_kPa
    flow = LEAKS[law]
    offset_kPa = 10.0 if read.min() < _LOW_KPA else 1e-6
    fallen = np.flatnonzero(read <= read[0] - 0.5 * (read[0] - read.min()))[0]
    first = ALPHA_KPA * flow(float(read[0]), 1.0) / volume_L
    guess = first * max(float(time_s[fallen]), 1.0) / max(float(read[0] - read[fallen]), 0.1)

    def model(x: Array) -> Array:
        strength, wall_s = math.exp(x[0]), math.exp(x[3])

        def rate(_: float, y: Array) -> list[float]:
            air, warmth = float(y[0]), float(y[1])
            gone = ALPHA_KPA * flow(max(air * warmth - AMBIENT_KPA, 0.0), strength) / volume_L
            if not cooling:
                return [-gone, 0.0]
            return [-gone, -(AIR_GAMMA - 1.0) * warmth * gone / air + (1.0 - warmth) / wall_s]

        solved = odeint(rate, [x[1] + AMBIENT_KPA, 1.0], time_s, tfirst=True, rtol=1e-8, atol=1e-7)
        drawn: Array = solved[:, 0] * solved[:, 1] - AMBIENT_KPA + x[2]
        return drawn

    fit = least_squares(
        lambda x: model(x) - read,
        [math.log(guess), float(read[0]), 0.0, 0.0],
        bounds=([-np.inf, 0.0, -offset_kPa, -5.0], [np.inf, np.inf, offset_kPa, 7.0]),
        x_scale=[1.0, 10.0, 1.0, 1.0],
        diff_step=1e-5,
    )
    name = {
        "ohm": "flow_resistance_kPa_s_per_SL",
        "viscous": "conductance_constant_kPa2_s_per_SL",
        "orifice": "inverse_conductance_kPa_s_per_SL",
    }[law]
    strength = math.exp(fit.x[0])
    found = {name: strength, "volume_times_it": strength * volume_L}
    if offset_kPa > 1.0:
        found["offset_kPa"] = float(fit.x[2])
    if cooling:
        found["time_constant_s"] = math.exp(fit.x[3])
    return Fitted(law + (", cooling" if cooling else ""), found, _rms(fit.fun))


def discharge(
    runs: Sequence[Readings], volume_L: float, gamma: float = CO2_GAMMA, cold_flow: bool = False
) -> Fitted:
    """A nozzle (ISO 6358) empties a vessel whose gas cools as it expands and is warmed by the wall.

    Shared parameters: conductance, critical ratio, wall time constant, sensor offset. Parameters of each run:
    pressure before, and opening time, which is between two samples. With `cold_flow` the mass flow grows as
    the gas cools, by the inverse root of the temperature, as in a nozzle. Without `cold_flow` the mass flow
    depends on the pressures only.
    """
    # From one sample before the recorded opening of the valve, until some time after the vessel is empty.
    cut = [max(0, int(np.flatnonzero(run.input > 0.0)[0]) - 1) for run in runs]
    ends = [
        int(np.searchsorted(run.time_s, run.time_s[i] + _FALL_S)) for run, i in zip(runs, cut, strict=True)
    ]
    times = [run.time_s[i:end] for run, i, end in zip(runs, cut, ends, strict=True)]
    reads = [run.pressure_kPa[i:end] for run, i, end in zip(runs, cut, ends, strict=True)]

    def one(x: Array, time_s: Array, start_kPa: float, open_s: float) -> Array:
        conductance, critical, wall_s, offset_kPa = math.exp(x[0]), float(x[1]), math.exp(x[2]), float(x[3])

        def rate(_: float, y: Array) -> list[float]:
            air, warmth = float(y[0]), float(y[1])
            p = max(air * warmth, AMBIENT_KPA)
            flow = conductance * p * _phi(AMBIENT_KPA / p, critical)
            if cold_flow:
                flow /= math.sqrt(warmth)
            gone = ALPHA_KPA * flow / volume_L
            return [-gone, -(gamma - 1.0) * warmth * gone / air + (1.0 - warmth) / wall_s]

        after = np.clip(time_s - open_s, 0.0, None)
        solved = odeint(
            rate, [start_kPa + AMBIENT_KPA, 1.0], [0.0, *after], tfirst=True, rtol=1e-7, atol=1e-6
        )
        air, warmth = solved[1:].T
        drawn: Array = air * warmth - AMBIENT_KPA + offset_kPa
        return drawn

    def residuals(x: Array) -> Array:
        parts = [
            one(x, t, float(x[4 + 2 * i]), float(t[0] + x[5 + 2 * i])) - read
            for i, (t, read) in enumerate(zip(times, reads, strict=True))
        ]
        return np.concatenate(parts)

    low, high = [-np.inf, 0.0, math.log(0.01), -10.0], [np.inf, 0.95, math.log(100.0), 10.0]
    own: list[float] = []
    for t, read in zip(times, reads, strict=True):
        own += [float(read[0]), _opening_s(t, read)]
        low += [0.0, 0.0]
        high += [np.inf, 3.0 * float(t[1] - t[0])]
    # The misfit has a kink where the opening time passes a sample, so try several starts.
    fits = [
        least_squares(
            residuals,
            [math.log(ideal_nozzle()), critical, math.log(wall_s), -1.0, *own],
            bounds=(low, high),
            x_scale=[0.1, 0.1, 0.3, 1.0] + [10.0, 0.03] * len(times),
            diff_step=1e-4,
        )
        for critical in (0.3, 0.52)
        for wall_s in (0.3, 1.0)
    ]
    fit = min(fits, key=lambda one: float(one.cost))
    conductance = math.exp(fit.x[0])
    found = {
        "conductance_SL_per_s_kPa": conductance,
        "of_ideal_nozzle": conductance / ideal_nozzle(),
        "critical_pressure_ratio": float(fit.x[1]),
        "time_constant_s": math.exp(fit.x[2]),
        "offset_kPa": float(fit.x[3]),
    }
    return Fitted("choked, cooling" + (", cold flow" if cold_flow else ""), found, _rms(fit.fun))


def _opening_s(time_s: Array, read: Array) -> float:
    """Time from the first sample to the opening, where the line through the first fall meets the first
    pressure."""
    k = int(np.flatnonzero(read < 0.97 * read[0])[0])
    slope = float((read[k + 1] - read[k]) / (time_s[k + 1] - time_s[k]))
    return max(0.0, float(time_s[k] - time_s[0] - (read[k] - read[0]) / slope))


def ideal_nozzle() -> float:
    """Conductance in SL/(s kPa) of a loss-free nozzle of `NOZZLE_M` for CO2: isentropic choked flow."""
    gamma = CO2_GAMMA
    shape = (2.0 / (gamma + 1.0)) ** ((gamma + 1.0) / (2.0 * (gamma - 1.0)))
    area_m2 = math.pi / 4.0 * NOZZLE_M**2
    kg_per_s_Pa = area_m2 * shape * math.sqrt(gamma * CO2_KG_PER_MOL / (GAS_CONSTANT * ROOM_K))
    kg_per_SL = 101_325.0 * CO2_KG_PER_MOL / (GAS_CONSTANT * ROOM_K) / 1000.0
    return float(kg_per_s_Pa * 1000.0 / kg_per_SL)


def pump(runs: Sequence[Readings], volume_L: float) -> Fitted:
    """A pump with a dead zone and spin-up, without flow at its stall pressure, fills a leaking vessel.

    Shared parameters: free flow, stall pressure, dead zone, spin-up time constant, leak. Parameter of each
    run: first pressure.
    """

    def one(x: Array, run: Readings, start_kPa: float) -> Array:
        free, stall_kPa, dead, spin_s, leak_R = np.exp(x[0]), np.exp(x[1]), x[2], np.exp(x[3]), np.exp(x[4])
        wanted = np.clip((run.input - dead) / (1.0 - dead), 0.0, 1.0)
        time_s = run.time_s
        # The speed is exact. The pressure's equation is linear, with the speed in the middle of the step.
        speed, p = 0.0, start_kPa
        drawn = np.empty_like(time_s)
        for i, dt in enumerate([*np.diff(time_s), 0.0]):
            drawn[i] = p
            middle = wanted[i] + (speed - wanted[i]) * math.exp(-dt / 2.0 / spin_s)
            speed = wanted[i] + (speed - wanted[i]) * math.exp(-dt / spin_s)
            gain = ALPHA_KPA / volume_L * middle * free
            # A check valve: the pump never sucks.
            pumping = gain if p < stall_kPa else 0.0
            slope = pumping / stall_kPa + ALPHA_KPA / (volume_L * leak_R)
            p = pumping / slope + (p - pumping / slope) * math.exp(-slope * dt)
        return drawn

    def residuals(x: Array) -> Array:
        return np.concatenate([one(x, run, float(x[5 + i])) - run.pressure_kPa for i, run in enumerate(runs)])

    highest = max(float(run.pressure_kPa.max()) for run in runs)
    rise = max(float(np.max(run.pressure_kPa[5:] - run.pressure_kPa[:-5])) for run in runs)
    step_s = float(np.median(np.diff(runs[0].time_s)))
    firsts = [float(run.pressure_kPa[0]) for run in runs]
    free = math.log(rise / (5.0 * step_s) * volume_L / ALPHA_KPA)
    best = None
    # A stronger pump with a larger leak fits nearly as well, so try several starts.
    for leak_R in (3e2, 3e3):
        for spin_s in (0.03, 0.2):
            start = [free, math.log(1.3 * highest), 0.15, math.log(spin_s), math.log(leak_R), *firsts]
            low = [-15.0, math.log(highest / 2.0), 0.0, math.log(1e-3), math.log(1.0)] + [-50.0] * len(runs)
            high = [10.0, math.log(100.0 * highest), 0.9, math.log(5.0), math.log(1e7)] + [100.0] * len(runs)
            fit = least_squares(
                residuals, start, bounds=(low, high), x_scale=[0.3, 0.3, 0.1, 0.5, 0.5] + [1.0] * len(runs)
            )
            if best is None or fit.cost < best.cost:
                best = fit
    assert best is not None
    found = {
        "free_flow_SL_per_s": math.exp(best.x[0]),
        "stall_kPa": math.exp(best.x[1]),
        "opening": float(best.x[2]),
        "time_constant_s": math.exp(best.x[3]),
        "flow_resistance_kPa_s_per_SL": math.exp(best.x[4]),
    }
    return Fitted("pump, leak, lag", found, _rms(best.fun))


def _phi(ratio: float, critical: float) -> float:
    """The flow function of ISO 6358, but straight near a ratio of 1: the slope of the square root is infinite
    there, and the real flow is laminar."""
    if ratio <= critical:
        return 1.0
    if ratio > _LAMINAR:
        return _phi(_LAMINAR, critical) * max(0.0, 1.0 - ratio) / (1.0 - _LAMINAR)
    x = (ratio - critical) / (1.0 - critical)
    return math.sqrt(1.0 - x * x)


def _rms(residuals: Array) -> float:
    return float(np.sqrt(np.mean(residuals**2)))
