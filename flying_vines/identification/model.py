"""The extended simulation: the baseline, and beside it what a cause may switch on.

What is neutral leaves the baseline as it is. Pressures P are gauge, in kPa; P_a = P + ambient; θ is gas
temperature over ambient temperature; ΣQ what enters less what leaves, in SL/s; α = 101.325 kPa, γ = 1.4:

    reservoir                dP/dt = α ΣQ / V
      that cools             dP/dt = γ θ α ΣQ / V + (P_a/θ)(1 − θ)/τ
                             dθ/dt = (γ−1) θ² α ΣQ / (V P_a) + (1 − θ)/τ
    control volume           d(P_a V)/dt = α ΣQ,   V = V₀ (1 + k P) for P > 0
      that warms             d(P_a V)/dt = γ α (Q_in − θ Q_out) − (P_a V/θ)(θ − 1)/τ − (γ−1) P_a dV/dt,
                             air P_a V/(α θ) conserved
    ambient that falls       both gauge pressures rise by as much
    inflation valve          its opening follows what it is told with a lag (exactly)
    sensor of the CV         follows the pressure with a lag (exactly, for a straight line over each step)

The flows pass through `changed_flows`, where causes bring their own. Between two switchings classical
Runge–Kutta takes equal steps; where the Venturi stalls or the control volume begins to stretch, one is
divided. Everything here is in the part of Python that numba compiles; `chain` does that, and puts the causes'
functions in.
"""

from __future__ import annotations

from math import ceil, exp, expm1
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flying_vines.physics.baseline import ALPHA_KPA
from flying_vines.physics.plant.gas import GAMMA

SETTLED = 1e-3
"""Of its opening: so near to what it was told, a valve is there."""

Array = NDArray[np.float64]


class Numbers(NamedTuple):
    """What the simulation is told of a rig. The first seven are believed, the rest is neutral at 0."""

    reservoir_volume_L: float
    cv_volume_L: float
    """Infinite where the reservoir discharges to atmosphere."""
    evp_flow_resistance_kPa_s_per_SL: float
    dvp_flow_resistance_kPa_s_per_SL: float
    solenoid_flow_resistance_kPa_s_per_SL: float
    full_vacuum_kPa: float
    rated_supply_kPa: float
    reservoir_time_constant_s: float = 0.0
    cv_time_constant_s: float = 0.0
    cv_compliance_per_kPa: float = 0.0
    evp_lag_s: float = 0.0
    stall_supply_kPa: float = 0.0
    cv_sensor_lag_s: float = 0.0


class Moment(NamedTuple):
    """What flows depend on."""

    t_s: float
    ambient_kPa: float
    ambient_slope_kPa_per_s: float
    reservoir_kPa: float
    cv_kPa: float
    evp: float
    dvp: float
    solenoid: float


class Flows(NamedTuple):
    """Standard litres per second; losses go to ambient."""

    inflation: float
    motive: float
    outlet: float
    reservoir_loss: float
    cv_loss: float


class State(NamedTuple):
    """Gauge pressures in kPa, temperature ratios; also their rates of change."""

    reservoir_kPa: float
    reservoir_theta: float
    cv_kPa: float
    cv_theta: float


def changed_flows(numbers: Numbers, moment: Moment, flows: Flows, x: Array) -> Flows:
    """The flows as the causes' functions change them; here none does. `x` holds the causes' parameters."""
    return flows


def rates(numbers: Numbers, moment: Moment, state: State, stalled: bool, stretched: bool, x: Array) -> State:
    """The right-hand side, on one side of each edge."""
    n = numbers
    reservoir_kPa, theta_r, cv_kPa, theta_c = state
    inflation = moment.evp * (reservoir_kPa - cv_kPa) / n.evp_flow_resistance_kPa_s_per_SL
    motive = moment.dvp * reservoir_kPa / n.dvp_flow_resistance_kPa_s_per_SL
    outlet = 0.0
    if moment.solenoid > 0.0:
        vacuum_kPa = 0.0
        if not stalled:
            vacuum_kPa = n.full_vacuum_kPa * moment.dvp * min(1.0, reservoir_kPa / n.rated_supply_kPa)
        outlet = moment.solenoid * (cv_kPa + vacuum_kPa) / n.solenoid_flow_resistance_kPa_s_per_SL
        if moment.dvp > 0.0 and outlet < 0.0:
            outlet = 0.0
    q = changed_flows(n, moment, Flows(inflation, motive, outlet, 0.0, 0.0), x)

    fall = -moment.ambient_slope_kPa_per_s
    leaving = q.inflation + q.motive + q.reservoir_loss
    d_theta_r = 0.0
    if n.reservoir_time_constant_s > 0.0:
        absolute = reservoir_kPa + moment.ambient_kPa
        cooling = GAMMA * theta_r * ALPHA_KPA * leaving / n.reservoir_volume_L
        warmth = (1.0 - theta_r) / n.reservoir_time_constant_s
        d_reservoir = absolute / theta_r * warmth - cooling
        d_theta_r = warmth - (GAMMA - 1.0) / GAMMA * theta_r * cooling / absolute
    else:
        d_reservoir = -ALPHA_KPA * leaving / n.reservoir_volume_L

    # What comes in is at ambient temperature, wherever it comes in.
    entering = max(0.0, q.inflation) + max(0.0, -q.outlet) + max(0.0, -q.cv_loss)
    left = max(0.0, -q.inflation) + max(0.0, q.outlet) + max(0.0, q.cv_loss)
    absolute = cv_kPa + moment.ambient_kPa
    volume = n.cv_volume_L
    stretch = 0.0
    if stretched:
        stretch = n.cv_compliance_per_kPa * volume
        volume += stretch * cv_kPa
    d_theta_c = 0.0
    if n.cv_time_constant_s > 0.0:
        # The first law: work at the wall that gives way counts as well.
        heat = absolute * volume / theta_c * (theta_c - 1.0) / n.cv_time_constant_s
        energy = GAMMA * ALPHA_KPA * (entering - theta_c * left) - heat
        work = GAMMA * absolute * stretch
        d_absolute = (energy - work * fall) / (volume + work)
        d_volume = stretch * (d_absolute + fall)
        d_air = ALPHA_KPA * (entering - left)
        d_theta_c = theta_c * (
            d_absolute / absolute + d_volume / volume - theta_c * d_air / (absolute * volume)
        )
    else:
        work = absolute * stretch
        d_absolute = (ALPHA_KPA * (entering - left) - work * fall) / (volume + work)
    return State(d_reservoir + fall, d_theta_r, d_absolute + fall, d_theta_c)


class Told(NamedTuple):
    """What holds from a time on: what the valves are told, and the air around."""

    t_s: float
    evp: float
    dvp: float
    solenoid: float
    ambient_kPa: float
    ambient_slope_kPa_per_s: float
    opening: float
    """Where the inflation valve is, on its way to `evp`."""


def opening_after(numbers: Numbers, told: Told, h: float) -> float:
    """Where the inflation valve is `h` seconds on."""
    if numbers.evp_lag_s <= 0.0:
        return told.evp
    return told.evp + (told.opening - told.evp) * exp(-h / numbers.evp_lag_s)


def opening_midway(numbers: Numbers, told: Told, h: float) -> float:
    """With which Simpson's rule gives the valve's mean opening over `h` seconds exactly."""
    lag_s = numbers.evp_lag_s
    if lag_s <= 0.0 or abs(h) < 1e-6 * lag_s:
        return opening_after(numbers, told, 0.5 * h)
    mean = lag_s / h * -expm1(-h / lag_s)
    return told.evp + (told.opening - told.evp) * (6.0 * mean - 1.0 - exp(-h / lag_s)) / 4.0


def after(numbers: Numbers, told: Told, h: float) -> Told:
    """The same `h` seconds on."""
    ambient = told.ambient_kPa + told.ambient_slope_kPa_per_s * h
    opening = opening_after(numbers, told, h)
    return Told(
        told.t_s + h, told.evp, told.dvp, told.solenoid, ambient, told.ambient_slope_kPa_per_s, opening
    )


def step(numbers: Numbers, told: Told, state: State, h: float, x: Array) -> State:
    """The state `h` seconds on."""
    stalled = told.dvp > 0.0 and state.reservoir_kPa < numbers.stall_supply_kPa
    stretched = numbers.cv_compliance_per_kPa > 0.0 and state.cv_kPa >= 0.0
    begin = opening_after(numbers, told, 0.0)
    middle = opening_midway(numbers, told, h)
    end = opening_after(numbers, told, h)
    k1 = rates(numbers, _at(told, 0.0, begin, state), state, stalled, stretched, x)
    s2 = _moved(state, k1, 0.5 * h)
    k2 = rates(numbers, _at(told, 0.5 * h, middle, s2), s2, stalled, stretched, x)
    s3 = _moved(state, k2, 0.5 * h)
    k3 = rates(numbers, _at(told, 0.5 * h, middle, s3), s3, stalled, stretched, x)
    s4 = _moved(state, k3, h)
    k4 = rates(numbers, _at(told, h, end, s4), s4, stalled, stretched, x)
    sixth = h / 6.0
    return State(
        state.reservoir_kPa + sixth * (k1[0] + 2.0 * (k2[0] + k3[0]) + k4[0]),
        state.reservoir_theta + sixth * (k1[1] + 2.0 * (k2[1] + k3[1]) + k4[1]),
        state.cv_kPa + sixth * (k1[2] + 2.0 * (k2[2] + k3[2]) + k4[2]),
        state.cv_theta + sixth * (k1[3] + 2.0 * (k2[3] + k3[3]) + k4[3]),
    )


def _moved(state: State, rate: State, h: float) -> State:
    return State(
        state[0] + h * rate[0], state[1] + h * rate[1], state[2] + h * rate[2], state[3] + h * rate[3]
    )


def _at(told: Told, h: float, opening: float, state: State) -> Moment:
    slope = told.ambient_slope_kPa_per_s
    ambient = told.ambient_kPa + slope * h
    return Moment(told.t_s + h, ambient, slope, state[0], state[2], opening, told.dvp, told.solenoid)


def height(numbers: Numbers, edge: int, state: State) -> float:
    """How far a state is above an edge, kPa: where the Venturi stalls (0), where the CV stretches (1)."""
    return state.reservoir_kPa - numbers.stall_supply_kPa if edge == 0 else state.cv_kPa


def crosses(numbers: Numbers, told: Told, edge: int, state: State, end: State) -> bool:
    """Whether the law has a jump at this edge, and lies between these states."""
    if edge == 0 and (numbers.stall_supply_kPa <= 0.0 or told.dvp <= 0.0 or told.solenoid <= 0.0):
        return False
    if edge == 1 and numbers.cv_compliance_per_kPa <= 0.0:
        return False
    return (height(numbers, edge, state) < 0.0) != (height(numbers, edge, end) < 0.0)


def careful_step(numbers: Numbers, told: Told, state: State, h: float, x: Array) -> State:
    """The state `h` seconds on; where an edge lies between, it is stepped to and from."""
    end = step(numbers, told, state, h, x)
    for edge in range(2):
        if not crosses(numbers, told, edge, state, end):
            continue
        # Regula falsi; what has passed an edge is not to be trusted, so it is come to from this side.
        over, under, part = height(numbers, edge, state), height(numbers, edge, end), h
        for _ in range(4):
            part *= over / (over - under)
            end = step(numbers, told, state, part, x)
            under = height(numbers, edge, end)
            if abs(under) < 1e-7 or (under < 0.0) == (over < 0.0):
                break
        beyond = -1e-9 if over >= 0.0 else 1e-9
        if edge == 0:
            end = State(numbers.stall_supply_kPa + beyond, end[1], end[2], end[3])
        else:
            end = State(end[0], end[1], beyond, end[3])
        end = step(numbers, after(numbers, told, part), end, h - part, x)
    return end


def lagged(lag_s: float, reading: float, before: float, now: float, h: float) -> float:
    """A first-order lag `h` seconds on, exactly for a pressure that went straight from `before` to `now`."""
    if lag_s <= 0.0:
        return now
    behind = lag_s * (now - before) / h
    return now - behind + (reading - before + behind) * exp(-h / lag_s)


def run(
    numbers: Numbers,
    time_s: Array,
    switch_s: Array,
    openings: Array,
    ambient_kPa: Array,
    start: NDArray[np.intp],
    initial: Array,
    longest_s: float,
    x: Array,
    out: Array,
) -> None:
    """Simulate one run.

    Args:
        time_s: (n,) when readings are taken; the first is the beginning.
        switch_s: (m,) rising, when the openings change; the first is at or before the beginning.
        openings: (m, 3) of EVP, DVP and solenoid, each row from its switching until the next.
        ambient_kPa: (n,) absolute; straight from reading to reading.
        start: (s,) at which samples the pressures are set anew; the first is 0.
        initial: (s, 2) to which gauge pressures of reservoir and control volume.
        longest_s: the longest step.
        x: the causes' parameters, as `changed_flows` reads them.
        out: (n, 2) receives what the sensors of control volume and reservoir would read, kPa gauge.
    """
    state = State(initial[0, 0], 1.0, initial[0, 1], 1.0)
    seen = opening = 0.0
    started = 0
    switches = len(switch_s)
    now = time_s[0]
    at = 0
    last = len(time_s) - 1
    for i in range(last + 1):
        if started < len(start) and start[started] == i:
            late = seen - state.cv_kPa if started > 0 else 0.0
            state = State(initial[started, 0], state[1], initial[started, 1], state[3])
            seen = state.cv_kPa + late
            started += 1
        out[i, 0] = seen
        out[i, 1] = state.reservoir_kPa
        if i == last:
            break
        climb = (ambient_kPa[i + 1] - ambient_kPa[i]) / (time_s[i + 1] - time_s[i])
        while now < time_s[i + 1]:
            while at + 1 < switches and switch_s[at + 1] <= now:
                at += 1
            until = time_s[i + 1]
            if at + 1 < switches and switch_s[at + 1] < until:
                until = switch_s[at + 1]
            ambient = ambient_kPa[i] + climb * (now - time_s[i])
            told = Told(now, openings[at, 0], openings[at, 1], openings[at, 2], ambient, climb, opening)
            left = until - now
            while left > 0.0:
                h = left / max(1, ceil(left / longest_s - 1e-9))
                if abs(told.opening - told.evp) > SETTLED and h > numbers.evp_lag_s > 0.0:
                    h = numbers.evp_lag_s
                before = state.cv_kPa
                state = careful_step(numbers, told, state, h, x)
                seen = lagged(numbers.cv_sensor_lag_s, seen, before, state.cv_kPa, h)
                told = after(numbers, told, h)
                left = left - h if left - h > 1e-12 else 0.0
            opening = told.opening
            now = until
