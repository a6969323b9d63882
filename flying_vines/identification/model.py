"""Simulates a recorded run with the plant, in as few integration steps as the gas allows.

It uses the plant's right-hand side and its Runge-Kutta step (`physics.plant.tick.runge_kutta`). The plant
takes at least one step for each tick of the firmware. Here, samples may be at any time, and a step is as long
as the gas allows. With a hose, a step may be longer than the hose's time constant. While no valve moves, the
outlet is shut and ambient is constant, a step may cover several samples. The readings within a step, and the
lag of a sensor, are computed from a cubic of time for the pressure. A step over an edge (the Venturi stalls,
the control volume begins to stretch) is divided there. numba compiles this file. EVP is the inflation valve,
DVP the valve that supplies the Venturi.
"""

from __future__ import annotations

from math import ceil, inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flying_vines.physics.arrays import Array
from flying_vines.physics.gas import ALPHA_KPA, STANDARD_TEMPERATURE_K
from flying_vines.physics.plant.ambient import Air
from flying_vines.physics.plant.exponential_integrator import exponential_runge_kutta, tubing_per_s
from flying_vines.physics.plant.numbers import PlantNumbers, ValveNumbers
from flying_vines.physics.plant.plant import Held
from flying_vines.physics.plant.rates import Floats, conditions, edges, rates
from flying_vines.physics.plant.sensors import SensorMemory, Transfer, lagged_kPa, transferred
from flying_vines.physics.plant.tick import runge_kutta
from flying_vines.physics.plant.volume import volume_and_work

SETTLED = 1e-3
"""A valve has arrived if its opening (0…1) is nearer than this to its target."""
_BRIEF = 1e-3
"""Time over which the rate of a pressure is calculated, as a share of the step."""
_FIRST, _GROWTH = 0.5, 0.25
"""Maximum first step after a valve has switched, in time constants of the tubing; maximum later step, as a
share of the time since the switching."""
_STIFF = 0.05
"""Steps up to this long (in time constants of the tubing) use plain Runge-Kutta, because the exponential
weights would lose digits."""
_PARTS = 8.0
"""With a lagging sensor, steps over an edge are shorter by this factor: the lag assumes a smooth pressure."""
_ON_EDGE = 1e-7
"""A state nearer than this to an edge (kPa, kPa·L) is on the edge."""


def pressurised(
    numbers: PlantNumbers,
    air: Air,
    state: Floats,
    reservoir_kPa: float,
    cv_kPa: float,
    reservoir_K: float,
    cv_K: float,
) -> Floats:
    """The state with other gauge pressures and gas temperatures; wall temperatures and valve openings stay.

    With a pump, the reservoir of the state is at ambient pressure.
    """
    _, _, wall_r, _, _, wall_c, _, evp, dvp, vented = state
    if numbers.pump_stall_kPa > 0.0:
        reservoir_kPa = 0.0
    ratio_r, ratio_c = reservoir_K / STANDARD_TEMPERATURE_K, cv_K / STANDARD_TEMPERATURE_K
    reservoir_pV = (reservoir_kPa + air.kPa) / numbers.reservoir_per_L
    volume_L, work_J = volume_and_work(numbers.cv, cv_kPa, air.kPa, 0.0)
    cv_pV = (cv_kPa + air.kPa) * volume_L
    line_SL = (cv_kPa + air.kPa) / (air.ratio * numbers.line_kPa_per_SL) if numbers.has_tubing else 0.0
    return (
        reservoir_pV / (ALPHA_KPA * ratio_r), reservoir_pV, wall_r,
        cv_pV / (ALPHA_KPA * ratio_c), cv_pV + (numbers.gamma - 1.0) * work_J, wall_c,
        line_SL, evp, dvp, vented,
    )  # fmt: skip


def gas_after(numbers: PlantNumbers, air: Air, at_s: float, state: Floats, held: Held, h: float) -> Floats:
    """The state `h` seconds later, if the step crosses no edge."""
    if numbers.has_tubing:
        per_s, volume_L = tubing_per_s(numbers, air, state, held)
        if per_s * h > _STIFF:
            return exponential_runge_kutta(numbers, air, at_s, state, held, h, per_s, volume_L)
    return runge_kutta(numbers, air, at_s, state, held, h)


def step(numbers: PlantNumbers, air: Air, at_s: float, state: Floats, held: Held, h: float) -> Floats:
    """The state `h` seconds later. A step over an edge is divided there."""
    if not numbers.has_edges:
        return gas_after(numbers, air, at_s, state, held, h)
    seen = edges(numbers, air, at_s, state)
    held = Held(held.evp_target, held.dvp_target, held.solenoid_open, seen[0] < 0.0)
    end = gas_after(numbers, air, at_s, state, held, h)
    found = edges(numbers, air, at_s + h, end)
    for edge in range(3):
        over, under, part = seen[edge], found[edge], h
        if (over < 0.0) == (under < 0.0):
            continue
        # Regula falsi until the step ends on the edge or before it: a step over the edge is inaccurate.
        for _ in range(4):
            part *= over / (over - under)
            end = gas_after(numbers, air, at_s, state, held, part)
            under = edges(numbers, air, at_s + part, end)[edge]
            if abs(under) < _ON_EDGE or (under < 0.0) == (over < 0.0):
                break
        stalled = over >= 0.0 if edge == 0 else held.venturi_stalled
        held = Held(held.evp_target, held.dvp_target, held.solenoid_open, stalled)
        end = gas_after(numbers, air, at_s + part, end, held, h - part)
        found = edges(numbers, air, at_s + h, end)
    return end


def _allowed(valve: ValveNumbers, opening: float, target: float, h: float) -> float:
    """A step of at most `h` that resolves a moving valve."""
    if h * valve.lag_per_s > 1.0 and abs(opening - target) > SETTLED:
        return 1.0 / valve.lag_per_s
    return h


def _crossed(numbers: PlantNumbers, air: Air, at_s: float, h: float, state: Floats, end: Floats) -> bool:
    """True if a step has crossed an edge."""
    if not numbers.has_edges:
        return False
    before, after = edges(numbers, air, at_s, state), edges(numbers, air, at_s + h, end)
    return (
        (before[0] < 0.0) != (after[0] < 0.0)
        or (before[1] < 0.0) != (after[1] < 0.0)
        or (before[2] < 0.0) != (after[2] < 0.0)
    )


def _pressure_rates(
    numbers: PlantNumbers, air: Air, state: Floats, held: Held, h: float
) -> tuple[float, float]:
    """Rates of the gauge pressures at the sensors of control volume and reservoir, kPa/s."""
    dt = _BRIEF * h
    if numbers.has_edges:
        stalled = edges(numbers, air, 0.0, state)[0] < 0.0
        held = Held(held.evp_target, held.dvp_target, held.solenoid_open, stalled)
    change = rates(numbers, air, 0.0, state, held)
    s0, s1, s2, s3, s4, s5, s6, s7, s8, s9 = state
    soon = (
        s0 + dt * change[0], s1 + dt * change[1], s2, s3 + dt * change[3], s4 + dt * change[4], s5,
        s6 + dt * change[6], s7, s8, s9,
    )  # fmt: skip
    then = Air(air.kPa + air.kPa_per_s * dt, air.kPa_per_s, air.ratio + air.ratio_per_s * dt, air.ratio_per_s)
    found, later = conditions(numbers, air, state), conditions(numbers, then, soon)
    return (later.line_kPa - found.line_kPa) / dt, (later.reservoir_kPa - found.reservoir_kPa) / dt


def _constant(weather: Array) -> bool:
    """True if ambient pressure and temperature do not change."""
    for row in range(len(weather)):
        if weather[row, 0] != weather[0, 0] or weather[row, 1] != weather[0, 1]:
            return False
    return True


def _latest(switch_s: Array, at: int, now: float) -> int:
    """The number of the last switching time that is not after `now`."""
    while at + 1 < len(switch_s) and switch_s[at + 1] <= now:
        at += 1
    return at


def _next_switch_s(switch_s: Array, at: int) -> float:
    """The next switching time after the one with this number; infinite if there is none."""
    return switch_s[at + 1] if at + 1 < len(switch_s) else inf


def _smooth(numbers: PlantNumbers, air: Air, state: Floats, held: Held, h: float, since_s: float) -> bool:
    """True if valves and tubing have settled enough for a step of `h`, `since_s` after the last switching."""
    if tubing_per_s(numbers, air, state, held)[0] > 0.0 and h > _GROWTH * since_s:
        return False
    evp_moves = numbers.evp.lag_per_s > 0.0 and abs(state[7] - held.evp_target) > SETTLED
    dvp_moves = numbers.dvp.lag_per_s > 0.0 and abs(state[8] - held.dvp_target) > SETTLED
    return not (evp_moves or dvp_moves)


class SensorPair(NamedTuple):
    """The numbers of both sensors."""

    cv: Transfer
    reservoir: Transfer


class Seen(NamedTuple):
    """States of both sensors."""

    cv: SensorMemory
    reservoir: SensorMemory


def _seen_at(
    sensor: Transfer, seen: SensorMemory, rate: float, kPa: float, kPa_rate: float, h: float
) -> SensorMemory:
    """The sensor's state after a step of `h` to a pressure; `rate` and `kPa_rate` are its rates, kPa/s."""
    lagged = lagged_kPa(sensor.time_constant_s, seen.lagged_kPa, seen.true_kPa, rate, kPa, kPa_rate, h)
    return SensorMemory(kPa, lagged, 0.0)


def _seen_within(
    sensor: Transfer, seen: SensorMemory, rate: float, end_kPa: float, end_rate: float, h: float, at_s: float
) -> SensorMemory:
    """The sensor's state `at_s` after the start of a step of `h`.

    The pressure is a cubic of time, with the rates `rate` and `end_rate` (kPa/s) at the ends of the step.
    """
    x = at_s / h
    change = end_kPa - seen.true_kPa
    first, last = rate * h, end_rate * h
    square, cube = 3.0 * change - 2.0 * first - last, first + last - 2.0 * change
    kPa = seen.true_kPa + x * (first + x * (square + x * cube))
    kPa_per_s = (first + x * (2.0 * square + x * 3.0 * cube)) / h
    return _seen_at(sensor, seen, rate, kPa, kPa_per_s, at_s)


def _started(
    numbers: PlantNumbers,
    air: Air,
    state: Floats,
    seen: Seen,
    initial_kPa: Array,
    reservoir_K: float,
    cv_K: float,
) -> tuple[Floats, Seen]:
    """State and sensors at a start, with these pressures (reservoir, control volume) and gas temperatures.

    A lagging sensor keeps its difference from the true pressure.
    """
    state = pressurised(numbers, air, state, initial_kPa[0], initial_kPa[1], reservoir_K, cv_K)
    found = conditions(numbers, air, state)
    cv_late = seen.cv.lagged_kPa - seen.cv.true_kPa
    reservoir_late = seen.reservoir.lagged_kPa - seen.reservoir.true_kPa
    return state, Seen(
        SensorMemory(found.line_kPa, found.line_kPa + cv_late, 0.0),
        SensorMemory(found.reservoir_kPa, found.reservoir_kPa + reservoir_late, 0.0),
    )


def _over_samples(
    numbers: PlantNumbers,
    sensors: SensorPair,
    air: Air,
    state: Floats,
    seen: Seen,
    held: Held,
    time_s: Array,
    until_s: float,
    since_s: float,
    out: Array,
) -> tuple[int, Floats, Seen]:
    """One step over several samples, if the gas allows it. Fills their readings, except the first.

    Args:
        time_s: from the sample at which the step begins to the last one to which it may lead.
        until_s: the step does not lead beyond this time.
        since_s: time since the last switching, at the beginning of the step.

    Returns:
        the number of samples that the step leads ahead, 0 if it is not possible; state and sensors.
    """
    ahead = 0
    while ahead < len(time_s) - 1 and time_s[ahead + 1] <= until_s:
        ahead += 1
    h = time_s[ahead] - time_s[0]
    if ahead < 2 or not _smooth(numbers, air, state, held, h, since_s):
        return 0, state, seen
    end = step(numbers, air, 0.0, state, held, h)
    if _crossed(numbers, air, 0.0, h, state, end):
        return 0, state, seen
    first, last = _pressure_rates(numbers, air, state, held, h), _pressure_rates(numbers, air, end, held, h)
    found = conditions(numbers, air, end)
    cv, reservoir = seen.cv, seen.reservoir
    for k in range(1, ahead + 1):
        after_s = time_s[k] - time_s[0]
        cv = _seen_within(sensors.cv, seen.cv, first[0], found.line_kPa, last[0], h, after_s)
        reservoir = _seen_within(
            sensors.reservoir, seen.reservoir, first[1], found.reservoir_kPa, last[1], h, after_s
        )
        out[k, 0] = transferred(sensors.cv, cv, 0.0)
        out[k, 1] = transferred(sensors.reservoir, reservoir, 0.0)
    return ahead, end, Seen(cv, reservoir)


def _in_steps(
    numbers: PlantNumbers,
    sensors: SensorPair,
    air: Air,
    state: Floats,
    seen: Seen,
    held: Held,
    span_s: float,
    since_s: float,
    longest_s: float,
    is_read: bool,
) -> tuple[Air, Floats, Seen]:
    """Air, state and sensors after `span_s`, in which no valve switches and no sample is read.

    Args:
        since_s: time since the last switching, at the beginning.
        longest_s: maximum step.
        is_read: the sensors are read at the end. Sensors without a lag are only followed then.
    """
    lagging = sensors.cv.time_constant_s > 0.0 or sensors.reservoir.time_constant_s > 0.0
    line_per_s, _ = tubing_per_s(numbers, air, state, held)
    then, rate = air, (0.0, 0.0)
    if lagging:
        rate = _pressure_rates(numbers, air, state, held, span_s)
    done, left = 0.0, span_s
    while left > 0.0:
        allowed = longest_s
        if line_per_s > 0.0:
            allowed = min(longest_s, max(_FIRST / line_per_s, _GROWTH * (since_s + done)))
        h = left / max(1, ceil(left / allowed - 1e-9))
        h = _allowed(numbers.evp, state[7], held.evp_target, h)
        h = _allowed(numbers.dvp, state[8], held.dvp_target, h)
        end = step(numbers, air, done, state, held, h)
        if lagging and h > longest_s / _PARTS and _crossed(numbers, air, done, h, state, end):
            h /= _PARTS
            end = step(numbers, air, done, state, held, h)
        state = end
        done += h
        left = left - h if left - h > 1e-12 else 0.0
        then = Air(
            air.kPa + air.kPa_per_s * done, air.kPa_per_s, air.ratio + air.ratio_per_s * done, air.ratio_per_s
        )
        if lagging or (left <= 0.0 and is_read):
            found, before = conditions(numbers, then, state), rate
            if lagging:
                rate = _pressure_rates(numbers, then, state, held, h)
            seen = Seen(
                _seen_at(sensors.cv, seen.cv, before[0], found.line_kPa, rate[0], h),
                _seen_at(sensors.reservoir, seen.reservoir, before[1], found.reservoir_kPa, rate[1], h),
            )
    return then, state, seen


NOT_INLINED = (gas_after, runge_kutta, exponential_runge_kutta, rates, conditions)
"""Functions that the compiler must not inline, because they are called from several places."""


def run(
    numbers: PlantNumbers,
    sensors: SensorPair,
    time_s: Array,
    switch_s: Array,
    openings: Array,
    weather: Array,
    start: NDArray[np.intp],
    initial: Array,
    longest_s: tuple[float, float, float],
    out: Array,
) -> None:
    """Simulate one run.

    Args:
        time_s: (n,) times of the readings; the run starts at the first.
        switch_s: (m,) rising times at which the openings change; the first is not after the start.
        openings: (m, 3) EVP, DVP and solenoid; a row holds until the next switching time.
        weather: (n, 2) ambient pressure in kPa absolute, and temperature ratio; linear between readings.
        start: (s,) indices of the samples at which the pressures are set; the first is 0.
        initial: (s, 2) gauge pressures of reservoir and control volume that are set there, kPa.
        longest_s: maximum step from sample to sample with the solenoid shut, and with it open; maximum step
            over several samples.
        out: (n, 2) receives the readings of control volume and reservoir, kPa gauge.
    """
    air = Air(weather[0, 0], 0.0, weather[0, 1], 0.0)
    ambient_K = air.ratio * STANDARD_TEMPERATURE_K
    state: Floats = (1.0, 1.0, ambient_K, 1.0, 1.0, ambient_K, 0.0, 0.0, 0.0, 0.0)
    seen = Seen(SensorMemory(0.0, 0.0, 0.0), SensorMemory(0.0, 0.0, 0.0))
    constant = _constant(weather)
    i = started = at = 0
    last = len(time_s) - 1
    while True:
        if started < len(start) and start[started] == i:
            reservoir_K = cv_K = ambient_K
            if started > 0:
                found = conditions(numbers, air, state)
                reservoir_K, cv_K = found.reservoir_K, found.cv_K
            state, seen = _started(numbers, air, state, seen, initial[started], reservoir_K, cv_K)
            started += 1
        out[i, 0] = transferred(sensors.cv, seen.cv, 0.0)
        out[i, 1] = transferred(sensors.reservoir, seen.reservoir, 0.0)
        if i == last:
            break
        now = time_s[i]
        at = _latest(switch_s, at, now)
        # With an open outlet the flow is not smooth: no air flows back in while the Venturi runs.
        if constant and not openings[at, 2] > 0.0:
            held = Held(openings[at, 0], openings[at, 1], False, False)
            until = min(now + longest_s[2], _next_switch_s(switch_s, at))
            since_s = now - max(switch_s[at], time_s[0])
            next_start = start[started] if started < len(start) else last
            ahead, state, seen = _over_samples(
                numbers, sensors, air, state, seen, held, time_s[i : next_start + 1], until,
                since_s, out[i:],
            )  # fmt: skip
            if ahead > 0:
                i += ahead
                continue
        between_s = time_s[i + 1] - now
        climb = (weather[i + 1, 0] - weather[i, 0]) / between_s
        warming = (weather[i + 1, 1] - weather[i, 1]) / between_s
        while now < time_s[i + 1]:
            at = _latest(switch_s, at, now)
            until = min(time_s[i + 1], _next_switch_s(switch_s, at))
            after_s = now - time_s[i]
            air = Air(weather[i, 0] + climb * after_s, climb, weather[i, 1] + warming * after_s, warming)
            held = Held(openings[at, 0], openings[at, 1], openings[at, 2] > 0.0, False)
            air, state, seen = _in_steps(
                numbers, sensors, air, state, seen, held, until - now,
                now - max(switch_s[at], time_s[0]), longest_s[1] if held.solenoid_open else longest_s[0],
                until >= time_s[i + 1],
            )  # fmt: skip
            now = until
        i += 1
