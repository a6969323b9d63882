"""One run of one rig with its hidden effects: equations, integrator and the loop over the samples, compiled.

Pressures in kPa gauge, volumes in L, flows in SL/s, times in s; temperatures as T / ambient temperature.

Points that the definitions leave open are interpreted like this:

- A recorded input holds from its own sample to the next. Before the first sample everything was at rest and
  shut: a delayed opening is 0 until the first command arrives, and the solenoid had not been open.
- Effects on the inflation valve apply in the order delay, play, dead zone, lag. The play's output is within
  half its width of the command. Command 0 shuts the valve at once: the play's output is then 0.
- `line_delay` and `evp_lag` act only on the inflation valve; the Venturi's supply and the solenoid have no
  delay.
- `solenoid_slow_close`: after the command to close it stays open for the delay. If it is commanded to open in
  this time, it does not close at all.
- Readings: lag, then offset, then gain; the lag starts from rest at the initial pressure. A reading is
  taken just before the input of its own sample changes.
- `compressible_flow`: the conductance is matched at 690 kPa into 0 kPa with standard ambient pressure and
  with the rig's true resistance, so that with `evp_restriction` the restricted valve is matched.
  The pressure ratio there is 0.128; with a smaller b this flow is subcritical. Nothing flows back.
- `ambient_drop`: the states are the gauge pressures; they rise by the rate while the absolute pressures stay.
  Absolute pressure is gauge pressure plus the ambient of that moment.
- `cv_compliance` conserves mass: d(P_abs V)/dt = αΣQ. Together with `cv_heating` the wall's work enters the
  energy: V dP_abs/dt + γ P_abs dV/dt = γα(Q_in − T Q_out) − P_abs V/T (T − 1)/τ, which is the equation
  of one effect if the other is off.
- A viscous leak goes to the present ambient pressure, and lets air in if the gauge pressure is negative.
- Leaks count like other flows: out at the gas's temperature, in at ambient temperature.
- "Never backwards while the Venturi's supply valve is open" depends on the valve's command.

The integrator is Dormand and Prince's pair 5(4) with adaptive steps. Events at known times (samples,
delayed commands, a solenoid that turns late) end a step. Events at pressures (stall, choking, flow that
reverses) are found by the error control. All compiled code is in this file, because the compiler's cache
checks only this file.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AMBIENT_KPA = 101.325
ALPHA_KPA = 101.325
GAMMA = 1.4
RATED_KPA = 690.0
"""Pressure at which the ISO 6358 valve has the flow of Ohm's law."""
OUTLET_MATCH_KPA = 69.0
"""Pressure at which a solenoid that follows ISO 6358 has the flow of Ohm's law."""
LAMINAR = 0.999
"""Above this pressure ratio an outlet's flow falls linearly to zero, because the square root would be
infinitely steep."""
STATES = 8
"""Reservoir pressure, CV pressure, opening with lag, CV pressure with lag, temperatures of reservoir and CV,
warming of the coil, pressure of the second volume. Only the states up to the last changing one are
integrated."""


class Physics(NamedTuple):
    """A rig's numbers and its effects; the defaults are the baseline."""

    reservoir_L: float
    cv_L: float
    """Infinite: no control volume; the inflation valve opens to the atmosphere."""
    evp_kPa_s_per_SL: float
    dvp_kPa_s_per_SL: float
    solenoid_kPa_s_per_SL: float
    full_vacuum_kPa: float
    rated_supply_kPa: float

    reservoir_leak_SL_per_s_kPa: float = 0.0
    cv_leak_SL_per_s_kPa: float = 0.0
    critical_pressure_ratio: float = -1.0
    reservoir_wall_s: float = 0.0
    cv_wall_s: float = 0.0
    compliance_per_kPa: float = 0.0
    dead_zone: float = 0.0
    play: float = 0.0
    evp_lag_s: float = 0.0
    evp_delay_s: float = 0.0
    closing_s: float = 0.0
    stall_kPa: float = -math.inf
    cv_sensor_lag_s: float = 0.0
    cv_offset_kPa: float = 0.0
    cv_gain: float = 1.0
    reservoir_offset_kPa: float = 0.0
    reservoir_gain: float = 1.0
    ambient_drop_kPa_per_s: float = 0.0
    cv_viscous_leak_SL_per_s_kPa2: float = 0.0
    reservoir_viscous_leak_SL_per_s_kPa2: float = 0.0

    # Outside the table.
    coil_per_s: float = 0.0
    coil_cooling_s: float = math.inf
    evp_power: float = 1.0
    opening_force_per_kPa: float = 0.0
    cracking_kPa: float = 0.0
    outlet_critical_ratio: float = -1.0
    opening_s: float = 0.0
    vacuum_power: float = 1.0
    relief_kPa: float = math.inf
    relief_kPa_s_per_SL: float = 1.0
    second_L: float = 0.0
    second_kPa_s_per_SL: float = 1.0
    tube_kPa_s_per_SL: float = 0.0
    supply_line_kPa_s_per_SL: float = 0.0
    drift_kPa: float = 0.0
    drift_s: float = 1.0
    hum_kPa: float = 0.0
    hum_Hz: float = 0.0
    cv_ceiling_kPa: float = math.inf
    repeat_share: float = 0.0


class Control(NamedTuple):
    """The control of the valves. The loop runs on a host: fully open outside a band, PI control within it."""

    closed_loop: bool
    venturi: bool = True
    """True if the loop uses the Venturi."""
    guard_kPa: float = math.inf
    """Open loop: above this reading the inflation valve is shut until the plan's next move. If that move
    would inflate, the inflation valve stays shut, and solenoid and Venturi follow the row. During any other
    inflation, solenoid and Venturi are shut."""
    stall_from: int = -1
    """The host hangs from the first sample after this one at which the inflation valve is shut; -1: never."""
    stall_samples: int = 0
    """Number of samples for which the host hangs and the inputs are constant."""


BAND_KPA = 1.0
PROPORTIONAL_PER_KPA = 0.23
INTEGRAL_PER_KPA_S = 0.12
VENT_BELOW_KPA, VENT_UNTIL_KPA = -0.25, -0.05
VACUUM_BELOW_KPA = -4.0
OPENING_DECIMALS = 4
"""An opening is rounded as in the recording."""

_compiled: Any = numba.njit(cache=True)


def _phi(ratio: float, critical: float) -> float:
    if ratio <= critical:
        return 1.0
    if ratio >= 1.0:
        return 0.0
    x = (ratio - critical) / (1.0 - critical)
    return math.sqrt(1.0 - x * x)


def _valve(opening: float, resistance: float, b: float, up: float, down: float, ambient: float) -> float:
    """Flow of an inflation or supply valve from gauge pressure `up` to `down`."""
    if b < 0.0:
        return opening * (up - down) / resistance
    if down >= up:
        return 0.0
    full = RATED_KPA + AMBIENT_KPA
    conductance = RATED_KPA / resistance / (full * phi(AMBIENT_KPA / full, b))
    return opening * conductance * (up + ambient) * phi((down + ambient) / (up + ambient), b)


def _outlet_iso(resistance: float, b: float, up: float, down: float) -> float:
    """Flow of a solenoid that chokes, absolute pressures, either way."""
    if down > up:
        return -outlet_iso(resistance, b, down, up)
    full = OUTLET_MATCH_KPA + AMBIENT_KPA
    conductance = OUTLET_MATCH_KPA / resistance / (full * phi(AMBIENT_KPA / full, b))
    ratio = down / up
    if ratio > LAMINAR:
        return conductance * up * phi(LAMINAR, b) * (1.0 - ratio) / (1.0 - LAMINAR)
    return conductance * up * phi(ratio, b)


def _flows(p: Physics, t: float, y: Array, u: float, d: float, s: bool) -> tuple[float, float, float]:
    """Flows through the inflation valve, the Venturi's supply valve and the outlet."""
    reservoir, cv = y[0], y[1]
    ambient = AMBIENT_KPA - p.ambient_drop_kPa_per_s * t
    b = p.critical_pressure_ratio
    opening = y[2] if p.evp_lag_s > 0.0 else u
    if p.opening_force_per_kPa > 0.0:
        opening = max(0.0, opening - p.opening_force_per_kPa * (RATED_KPA - reservoir))
    if p.evp_power != 1.0 and opening > 0.0:
        opening = opening**p.evp_power
    resistance = p.evp_kPa_s_per_SL * (1.0 + p.coil_per_s * y[6])
    q_e = valve(opening, resistance, b, reservoir, cv, ambient)
    q_m = valve(d, p.dvp_kPa_s_per_SL, b, reservoir, 0.0, ambient)
    q_o = 0.0
    if s:
        vacuum = 0.0
        if d > 0.0 and reservoir >= p.stall_kPa:
            supply = min(1.0, max(0.0, reservoir / p.rated_supply_kPa))
            vacuum = p.full_vacuum_kPa * d * (supply if p.vacuum_power == 1.0 else supply**p.vacuum_power)
        if p.outlet_critical_ratio >= 0.0:
            q_o = outlet_iso(p.solenoid_kPa_s_per_SL, p.outlet_critical_ratio, cv + ambient, ambient - vacuum)
        else:
            q_o = (cv + vacuum) / p.solenoid_kPa_s_per_SL
        if p.cracking_kPa > 0.0:
            q_o = max(0.0, cv + vacuum - p.cracking_kPa) / p.solenoid_kPa_s_per_SL
        if d > 0.0:
            q_o = max(0.0, q_o)
    return q_e, q_m, q_o


def _rates(p: Physics, t: float, y: Array, u: float, d: float, s: bool, out: Array) -> None:
    """dy/dt; `u` is the opening after delay, play and dead zone."""
    q_e, q_m, q_o = flows(p, t, y, u, d, s)
    ambient = AMBIENT_KPA - p.ambient_drop_kPa_per_s * t
    rise = p.ambient_drop_kPa_per_s

    reservoir, warmth = y[0], y[4]
    q_leak = p.reservoir_leak_SL_per_s_kPa * reservoir
    q_leak += p.reservoir_viscous_leak_SL_per_s_kPa2 * ((reservoir + ambient) ** 2 - ambient**2)
    spent = ALPHA_KPA * (q_e + q_m + q_leak) / p.reservoir_L
    if p.reservoir_wall_s > 0.0:
        absolute = reservoir + ambient
        back = (1.0 - warmth) / p.reservoir_wall_s
        out[0] = -GAMMA * warmth * spent + absolute / warmth * back + rise
        out[4] = -(GAMMA - 1.0) * warmth * warmth * spent / absolute + back
    else:
        out[0] = -spent + rise
        out[4] = 0.0

    cv, warmth = y[1], y[5]
    q_leak = p.cv_leak_SL_per_s_kPa * cv + max(0.0, cv - p.relief_kPa) / p.relief_kPa_s_per_SL
    q_leak += p.cv_viscous_leak_SL_per_s_kPa2 * ((cv + ambient) ** 2 - ambient**2)
    q_second = 0.0
    if p.second_L > 0.0:
        q_second = (cv - y[7]) / p.second_kPa_s_per_SL
        out[7] = ALPHA_KPA * q_second / p.second_L + rise
    else:
        out[7] = 0.0
    q_in = max(0.0, q_e) + max(0.0, -q_o) + max(0.0, -q_leak) + max(0.0, -q_second)
    q_out = max(0.0, -q_e) + max(0.0, q_o) + max(0.0, q_leak) + max(0.0, q_second)
    out[1] = out[5] = 0.0
    if math.isfinite(p.cv_L):
        absolute = cv + ambient
        volume, slope = p.cv_L, 0.0
        if cv > 0.0 and p.compliance_per_kPa > 0.0:
            slope = p.cv_L * p.compliance_per_kPa
            volume += slope * cv
        if p.cv_wall_s > 0.0:
            heat = absolute * volume / warmth * (warmth - 1.0) / p.cv_wall_s
            energy = GAMMA * ALPHA_KPA * (q_in - warmth * q_out) - heat
            change = (energy - GAMMA * absolute * slope * rise) / (volume + GAMMA * absolute * slope)
            air = absolute * volume / (ALPHA_KPA * warmth)
            out[5] = warmth * (change / absolute + slope * (change + rise) / volume - (q_in - q_out) / air)
        else:
            change = (ALPHA_KPA * (q_in - q_out) - absolute * slope * rise) / (volume + absolute * slope)
        out[1] = change + rise

    out[2] = (u - y[2]) / p.evp_lag_s if p.evp_lag_s > 0.0 else 0.0
    out[3] = (cv - y[3]) / p.cv_sensor_lag_s if p.cv_sensor_lag_s > 0.0 else 0.0
    out[6] = u - y[6] / p.coil_cooling_s if p.coil_per_s > 0.0 else 0.0


def _advance(
    p: Physics,
    t: float,
    end: float,
    y: Array,
    held: tuple[float, float, bool],
    last: float,
    tolerance_kPa: float,
    active: int,
    k: Array,
) -> float:
    """Advance `y` from `t` to `end` with constant inputs. Returns the step size for the next call.

    An error counts in kPa for pressures, and in thousandths for states of the order of one.
    """
    u, d, s = held
    trial = np.empty(STATES)
    trial[:] = y
    h = min(end - t, last)
    rates(p, t, y, u, d, s, k[0])
    while end - t > 1e-12:
        whole = h >= end - t
        step = end - t if whole else h
        for i in range(active):
            trial[i] = y[i] + step * k[0, i] / 5.0
        rates(p, t + step / 5.0, trial, u, d, s, k[1])
        for i in range(active):
            trial[i] = y[i] + step * (3.0 * k[0, i] + 9.0 * k[1, i]) / 40.0
        rates(p, t + 0.3 * step, trial, u, d, s, k[2])
        for i in range(active):
            trial[i] = y[i] + step * (44.0 / 45.0 * k[0, i] - 56.0 / 15.0 * k[1, i] + 32.0 / 9.0 * k[2, i])
        rates(p, t + 0.8 * step, trial, u, d, s, k[3])
        for i in range(active):
            trial[i] = y[i] + step * (
                19372.0 / 6561.0 * k[0, i]
                - 25360.0 / 2187.0 * k[1, i]
                + 64448.0 / 6561.0 * k[2, i]
                - 212.0 / 729.0 * k[3, i]
            )
        rates(p, t + 8.0 / 9.0 * step, trial, u, d, s, k[4])
        for i in range(active):
            trial[i] = y[i] + step * (
                9017.0 / 3168.0 * k[0, i]
                - 355.0 / 33.0 * k[1, i]
                + 46732.0 / 5247.0 * k[2, i]
                + 49.0 / 176.0 * k[3, i]
                - 5103.0 / 18656.0 * k[4, i]
            )
        rates(p, t + step, trial, u, d, s, k[5])
        for i in range(active):
            trial[i] = y[i] + step * (
                35.0 / 384.0 * k[0, i]
                + 500.0 / 1113.0 * k[2, i]
                + 125.0 / 192.0 * k[3, i]
                - 2187.0 / 6784.0 * k[4, i]
                + 11.0 / 84.0 * k[5, i]
            )
        rates(p, t + step, trial, u, d, s, k[6])
        worst = 0.0
        for i in range(active):
            error = step * (
                71.0 / 57600.0 * k[0, i]
                - 71.0 / 16695.0 * k[2, i]
                + 71.0 / 1920.0 * k[3, i]
                - 17253.0 / 339200.0 * k[4, i]
                + 22.0 / 525.0 * k[5, i]
                - k[6, i] / 40.0
            )
            of_order_one = i == 2 or 4 <= i <= 6
            worst = max(worst, abs(error) * (1000.0 if of_order_one else 1.0))
        worst /= tolerance_kPa
        if worst <= 1.0 or step <= 1e-7:
            t = end if whole else t + step
            y[:active] = trial[:active]
            k[0, :] = k[6, :]
        grown = step * min(5.0, max(0.2, 0.9 * max(worst, 1e-9) ** -0.2))
        if not (whole and worst <= 1.0 and grown < h):
            h = max(1e-7, grown)
    return h


def _active(p: Physics) -> int:
    """Number of states that can change."""
    if p.second_L > 0.0:
        return 8
    if p.coil_per_s > 0.0:
        return 7
    if p.cv_wall_s > 0.0:
        return 6
    if p.reservoir_wall_s > 0.0:
        return 5
    if p.cv_sensor_lag_s > 0.0:
        return 4
    return 3 if p.evp_lag_s > 0.0 else 2


def _fly(
    p: Physics,
    control: Control,
    start: tuple[float, float],
    time_s: Array,
    plan: Array,
    noise_kPa: Array,
    chance: Array,
    tolerance_kPa: float,
) -> Array:
    """One run, with a row for each sample: openings of EVP and DVP, solenoid, clean readings and noisy
    readings of CV and reservoir, and 1 where the host hung.

    `plan` is command, EVP, DVP, solenoid. In closed loop the command counts, otherwise the openings.
    `noise_kPa` is for both readings, `chance` is uniform in 0…1. A clean reading is a reading before the
    noise: the chi-square of the truth compares noisy with clean readings.
    """
    n = time_s.size
    out = np.zeros((n, 8))
    y = np.zeros(STATES)
    y[0], y[1] = start
    y[3] = y[7] = start[1]
    y[4] = y[5] = 1.0
    k = np.zeros((7, STATES))
    moving = active_states(p)
    step = 0.001
    u = d = target = backlash = integral = 0.0
    s = is_open = venting = guarded = instead = False
    arriving = 0
    open_until, open_from = -math.inf, math.inf
    hung = 0
    for i in range(n):
        t = time_s[i]
        # Readings, with the previous inputs.
        q_e, q_m, q_o = flows(p, t, y, target, d, is_open)
        cv = y[3] if p.cv_sensor_lag_s > 0.0 else y[1]
        cv += p.tube_kPa_s_per_SL * (q_e - q_o)
        offset = p.cv_offset_kPa + p.drift_kPa * (1.0 - math.exp(-(t - time_s[0]) / p.drift_s))
        cv = p.cv_gain * (cv + offset) + p.hum_kPa * math.sin(2.0 * math.pi * p.hum_Hz * t)
        reservoir = y[0] - p.supply_line_kPa_s_per_SL * (q_e + q_m)
        reservoir = p.reservoir_gain * (reservoir + p.reservoir_offset_kPa)
        out[i, 3], out[i, 4] = min(cv, p.cv_ceiling_kPa), reservoir
        out[i, 5], out[i, 6] = min(cv + noise_kPa[i, 0], p.cv_ceiling_kPa), reservoir + noise_kPa[i, 1]
        if i > 0 and chance[i] < p.repeat_share:
            out[i, 3:7] = out[i - 1, 3:7]

        # The inputs from this sample to the next.
        s_before = s
        if control.stall_samples > hung and i > control.stall_from >= 0 and (hung > 0 or u == 0.0):
            hung += 1
            out[i, 7] = 1.0
        elif control.closed_loop:
            error = plan[i, 0] - out[i, 5]
            dt = 0.0 if i == 0 else t - time_s[i - 1]
            if abs(error) < BAND_KPA:
                integral = min(1.0, max(0.0, integral + INTEGRAL_PER_KPA_S * error * dt))
                u = min(1.0, max(0.0, PROPORTIONAL_PER_KPA * error + integral))
            else:
                u = 1.0 if error > 0.0 else 0.0
            venting = error < (VENT_UNTIL_KPA if venting else VENT_BELOW_KPA)
            if venting:
                u = 0.0
                integral = 0.0
            u = round(u, OPENING_DECIMALS)
            s = venting
            d = 1.0 if control.venturi and venting and error < VACUUM_BELOW_KPA else 0.0
        else:
            u, d, s = plan[i, 1], plan[i, 2], plan[i, 3] > 0.5
            if control.guard_kPa < math.inf:
                if i == 0 or np.any(plan[i, 1:] != plan[i - 1, 1:]):
                    instead = u > 0.0 and (guarded or out[i, 5] > control.guard_kPa)
                    guarded = False
                guarded = not instead and (guarded or out[i, 5] > control.guard_kPa)
                if u > 0.0 and not instead:
                    d, s = 0.0, False
                if guarded or instead:
                    u = 0.0
        out[i, 0], out[i, 1], out[i, 2] = u, d, s
        if s_before and not s:
            open_until = t + p.closing_s
        if s and not s_before:
            open_from = t + p.opening_s

        end = time_s[i + 1] if i + 1 < n else t
        while True:
            while arriving <= i and time_s[arriving] + p.evp_delay_s <= t + 1e-12:
                command = out[arriving, 0]
                if command == 0.0:
                    backlash = 0.0
                else:
                    backlash = min(command + p.play / 2.0, max(command - p.play / 2.0, backlash))
                target = max(0.0, (backlash - p.dead_zone) / (1.0 - p.dead_zone))
                arriving += 1
            is_open = (s and t >= open_from - 1e-12) or t < open_until - 1e-12
            if t >= end:
                break
            until = end
            if arriving <= i:
                until = min(until, time_s[arriving] + p.evp_delay_s)
            if s and t < open_from - 1e-12:
                until = min(until, open_from)
            if t < open_until - 1e-12:
                until = min(until, open_until)
            step = advance(p, t, until, y, (target, d, is_open), step, tolerance_kPa, moving, k)
            t = until
    return out


phi: Callable[[float, float], float] = _compiled(_phi)
valve: Callable[[float, float, float, float, float, float], float] = _compiled(_valve)
outlet_iso: Callable[[float, float, float, float], float] = _compiled(_outlet_iso)
flows = _compiled(_flows)
rates = _compiled(_rates)
advance = _compiled(_advance)
active_states = _compiled(_active)
fly = _compiled(_fly)
