"""The valves: start, play and gain of the inflation valve, and the resistance of the outlet.

The inflation valve is measured by inflations at several rates:

    ∫ Q dt = G Σ max(0, x − u₀) p_r dt       over an inflation from one settled pressure to another

Q is the flow, u₀ the start and G the gain. x is the commanded opening after a play of width w: x follows a
rising command at once, and a falling command only after it has fallen by w. The left side is the air between
two settled pressures (`vine_air`), so lag and delay of the valve and warm gas in between do not matter.
Choked flow is proportional to the absolute supply pressure p_r. Slow inflations determine u₀, fast ones G.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import hypot

import numpy as np
from scipy.optimize import least_squares

from flying_vines.calibration.findings import (
    SD_95,
    Chart,
    Estimate,
    Findings,
    MeasuredQuantity,
    Series,
    SettingProposal,
    configured,
    thinned,
)
from flying_vines.calibration.readings import Readings, smooth
from flying_vines.calibration.vine_air import SMOOTHED_S, TOO_LITTLE, VineAir, inverse
from flying_vines.physics.arrays import Array
from flying_vines.physics.plant.valve_response import backlash

MAX_STEP_S = 0.0015
"""Slower telemetry does not contain every command of the valve."""
AVERAGED_S = 0.3
MIN_KPA = 1.5
"""Below this a pouch may still be filling."""
MIN_RISE_KPA = 3.0
MIN_INFLATIONS = 4
STARTS = np.arange(0.0, 0.7, 0.001)
PLAYS = np.arange(0.0, 0.26, 0.01)
REFINE_STEPS = (0.005, 0.0005, 1e-4)
"""Steps of play, start and ln gain for derivatives; half of the grid's, because doses are interpolated."""
PLAY_PRIOR = (0.07, 0.06)
"""Mean and standard deviation of w."""
AIR_SD = 0.01
"""Relative standard deviation of the air of an inflation."""
PRESSURE_SD_KPA = 0.03
"""Standard deviation of a settled pressure."""
START_SD = 0.001
"""Standard deviation of the start, which changes when the coil warms."""
MAX_START_SD = 0.1
MARGIN = 0.01
"""The proposed dead band ends this far below the start, so that the valve does not leak."""


@dataclass(frozen=True)
class SettledInflation:
    """An inflation from one settled pressure to another."""

    rows: slice
    from_kPa: float
    to_kPa: float
    air_SL: float


@dataclass(frozen=True)
class ValveFit:
    """The fitted valve."""

    start: Estimate
    play: Estimate
    gain: Estimate
    """SL/s per opening and kPa of absolute supply."""
    full: Estimate
    """SL/s per kPa of absolute supply, commanded fully open from shut."""
    inflations: tuple[SettledInflation, ...]
    expected_SL: Array


def inflations(readings: Readings, vine: VineAir) -> Iterator[SettledInflation]:
    """Inflations that began and ended at a settled pressure, with the outlet shut."""
    t_s, setpoint = readings.t_s, readings.setpoint_kPa
    change = np.diff(setpoint, prepend=setpoint[0])
    rising = readings.regulating & (change > 1e-6)
    moving = np.flatnonzero(np.abs(change) > 1e-6)
    at = np.flatnonzero(rising)
    if not len(at):
        return
    for rows in np.split(at, np.flatnonzero(np.diff(t_s[at]) > AVERAGED_S / 2.0) + 1):
        begin = int(rows[0]) - 1
        later = moving[np.searchsorted(moving, rows[-1], "right") :]
        end = int(later[0]) - 1 if len(later) else len(t_s) - 1
        before = slice(int(np.searchsorted(t_s, t_s[begin] - AVERAGED_S)), begin + 1)
        last = slice(int(np.searchsorted(t_s, t_s[end] - AVERAGED_S)), end + 1)
        settled = t_s[end] - t_s[rows[-1]] > vine.known.settling_s
        whole = slice(before.start, end + 1)
        if not settled or not readings.shut[whole].all() or not readings.regulating[whole].all():
            continue
        low, high = float(np.mean(readings.cv_kPa[before])), float(np.mean(readings.cv_kPa[last]))
        if low < MIN_KPA or high - low < MIN_RISE_KPA:
            continue
        during = slice(begin, end + 1)
        leaked = vine.leak_SL_per_s_kPa * float(np.sum(readings.cv_kPa[during])) * readings.step_s
        yield SettledInflation(during, low, high, vine.air_SL(low, high) + leaked)


def after_play(command: Array, widths: Array) -> Array:
    """x for each width of the play: (rows with a command above 0, widths).

    A command of 0 resets the play.
    """
    on = command > 0.0
    # The first 0 after a movement resets the play.
    kept = command[on | np.append(False, on[:-1])]
    out = np.empty((len(kept), len(widths)))
    for column, width in enumerate(widths.tolist()):
        held = 0.0
        for row, opening in enumerate(kept.tolist()):
            held = out[row, column] = backlash(held, opening, width)
    return np.asarray((out + widths / 2.0)[kept > 0.0])


def fit_valve(readings: Readings, vine: VineAir) -> ValveFit | str:
    """Start, play and gain; or the reason why they cannot be measured."""
    if readings.step_s > MAX_STEP_S:
        rate_Hz = 1.0 / readings.step_s
        return f"telemetry at {rate_Hz:.0f} Hz does not contain every command of the valve; 1000 Hz does"
    if vine.volume().low <= 0.0:
        return TOO_LITTLE
    found = tuple(inflations(readings, vine))
    if len(found) < MIN_INFLATIONS:
        return f"only {len(found)} inflations were settled at both ends"
    doses = np.array([_doses(readings, each.rows, vine.known.ambient_kPa) for each in found])
    air = np.array([each.air_SL for each in found])
    sd = np.hypot(AIR_SD * air, vine.air_SL(0.0, PRESSURE_SD_KPA))
    return _refined(doses, found, air, sd, _best_on_grid(doses, air, sd))


def _doses(readings: Readings, rows: slice, ambient_kPa: float) -> Array:
    """Σ max(0, x − u₀) p_r dt for each play and start, (plays, starts)."""
    openings = after_play(readings.evp[rows], PLAYS)
    factor = readings.step_s * (float(np.mean(readings.reservoir_kPa[rows])) + ambient_kPa)
    doses = np.empty((len(PLAYS), len(STARTS)))
    for i in range(len(PLAYS)):
        sorted_ = np.sort(openings[:, i])
        above = np.concatenate([np.cumsum(sorted_[::-1])[::-1], [0.0]])
        first = np.searchsorted(sorted_, STARTS)
        doses[i] = factor * (above[first] - STARTS * (len(sorted_) - first))
    return doses


def _best_on_grid(doses: Array, air: Array, sd: Array) -> Array:
    """Play, start and ln gain with the minimum χ² on the grid of plays and starts."""
    weight = 1.0 / sd**2
    both = np.einsum("i,ijk->jk", weight * air, doses)
    squares = np.einsum("i,ijk->jk", weight, doses * doses)
    gain = both / np.maximum(squares, 1e-30)
    prior = ((PLAYS - PLAY_PRIOR[0]) / PLAY_PRIOR[1]) ** 2
    play, start = np.unravel_index(int(np.argmin(prior[:, None] - gain * both)), gain.shape)
    return np.array([PLAYS[play], STARTS[start], np.log(max(gain[play, start], 1e-12))])


def _refined(
    doses: Array, found: tuple[SettledInflation, ...], air: Array, sd: Array, best: Array
) -> ValveFit | str:
    """Refine the best point of the grid, and compute intervals."""

    def expected(q: Array) -> Array:
        i = min(max(q[0] / PLAYS[1], 0.0), len(PLAYS) - 1.001)
        k = min(max(q[1] / STARTS[1], 0.0), len(STARTS) - 1.001)
        (i0, di), (k0, dk) = divmod(i, 1.0), divmod(k, 1.0)
        box = doses[:, int(i0) : int(i0) + 2, int(k0) : int(k0) + 2]
        along = box[:, 0] * (1.0 - di) + box[:, 1] * di
        return np.asarray(np.exp(q[2]) * (along[:, 0] * (1.0 - dk) + along[:, 1] * dk))

    def residual(q: Array) -> Array:
        return np.append((air - expected(q)) / sd, (PLAY_PRIOR[0] - q[0]) / PLAY_PRIOR[1])

    def slopes(q: Array) -> Array:
        at_q = residual(q)
        return np.array([(residual(q + step) - at_q) / step.sum() for step in np.diag(REFINE_STEPS)]).T

    bounds = ([0.0, 0.0, -np.inf], [PLAYS[-1], STARTS[-1], np.inf])
    fit = least_squares(residual, best, slopes, bounds, x_scale="jac", ftol=1e-5)
    q, residuals = fit.x, fit.fun[:-1]
    spread = max(1.0, float(residuals @ residuals) / max(1, len(air) - 3))
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * spread
    play_sd, start_sd, gain_sd = np.sqrt(np.diag(covariance))
    if start_sd > MAX_START_SD:
        return "the inflations were too much alike to separate start and gain"
    gain, full = float(np.exp(q[2])), float(np.exp(q[2]) * (1.0 - q[1]))
    # The errors of start and gain are correlated, so the flow of the fully open valve has a smaller error.
    along = np.array([0.0, -1.0 / (1.0 - q[1]), 1.0])
    return ValveFit(
        Estimate(float(q[1]), float(np.hypot(start_sd, START_SD))),
        Estimate(float(q[0]), float(play_sd)),
        Estimate(gain, gain * float(gain_sd)),
        Estimate(full, full * float(np.sqrt(along @ covariance @ along))),
        found,
        expected(q),
    )


def inflation_valve(readings: Readings, vine: VineAir) -> Findings:
    """Start, gain and resistance of the valve, and the dead band to set in the firmware."""
    p, known = vine.known.pneumatics, vine.known
    start = MeasuredQuantity("evp_start", "inflation valve, start", "opening")
    gain = MeasuredQuantity("evp_gain_SL_per_s", "inflation valve's gain, full reservoir", "SL/s per opening")
    full = configured("evp_flow_resistance_kPa_s_per_SL", "inflation valve, fully open", "kPa·s/SL", p)
    fit = fit_valve(readings, vine)
    if isinstance(fit, str):
        return Findings(tuple(finding.unknown(fit) for finding in (start, gain, full)))
    rows = np.concatenate([readings.reservoir_kPa[each.rows] for each in fit.inflations])
    at_kPa = float(np.mean(rows))
    supply_kPa = p.full_kPa + known.ambient_kPa
    note = f"at {p.full_kPa:g} kPa; measured at {at_kPa:.0f}"
    litres = vine.volume()
    relative_sd = hypot(litres.sd / litres.value, known.flow_sd(at_kPa))
    found = (
        start.measured(fit.start, f"opening from shut; play {fit.play.value:.2f}"),
        gain.measured(fit.gain.times(supply_kPa, relative_sd)),
        inverse(full, p.full_kPa, fit.full.times(supply_kPa, relative_sd), note),
    )
    lift = max(0.0, round(fit.start.low - MARGIN, 3))
    why = f"the valve passes air from {fit.start.value:.3f} on"
    proposal = SettingProposal("evp_dead_band", min(lift, 0.6), False, why)
    return Findings(found, (proposal,), charts=(_chart(readings, vine, fit, at_kPa),))


def _chart(readings: Readings, vine: VineAir, fit: ValveFit, at_kPa: float) -> Chart:
    """Mean flow of each inflation against its mean commanded opening while the valve was open."""
    x, y = [], []
    for each, expected in zip(fit.inflations, fit.expected_SL, strict=True):
        command = readings.evp[each.rows]
        above = command[command > fit.start.value]
        if len(above) and expected > 0.0:
            # x: the opening at which the fitted line has the expected flow. So the vertical distance of the
            # point from the line is the residual.
            mean = expected / (fit.gain.value * len(above) * readings.step_s)
            supply = float(np.mean(readings.reservoir_kPa[each.rows])) + vine.known.ambient_kPa
            x.append(fit.start.value + mean / supply)
            y.append(each.air_SL / (len(above) * readings.step_s) / supply)
    supply_kPa = at_kPa + vine.known.ambient_kPa
    line = np.linspace(fit.start.value, 1.0, 50)
    flow = fit.gain.value * (line - fit.start.value) * supply_kPa
    share = SD_95 * fit.full.sd / fit.full.value
    lead = np.array([0.0, fit.start.value])
    return Chart(
        "valve",
        "Inflation valve",
        "commanded opening",
        f"flow at {at_kPa:.0f} kPa, SL/s",
        (
            Series("inflations", "points", np.array(x), np.array(y) * supply_kPa),
            Series("fitted", "line", np.concatenate([lead, line]), np.concatenate([[0.0, 0.0], flow])),
            Series("95 %", "band", line, flow * (1.0 - share), flow * (1.0 + share)),
        ),
        f"starts at {fit.start.value:.3f}",
    )


# The outlet: R = ∫ P dt / n over a vent from P_0 to zero without the Venturi. n = V_cv P_0 / α is the air
# that leaves the vine. R is a mean over the whole fall, without the time that the outlet needs to open.

MIN_VENT_KPA = 8.0
EMPTY = 0.01
"""Below this share of the start pressure the vine counts as empty: the readings are only noise."""
MAX_VENT_S = 10.0
QUICK_S = 0.005
COLD = 0.15
"""A fast vent cools the air. Up to twice this share of the air leaves later, while it warms, at almost no
pressure. So the result is increased by this share, and its interval covers an increase of 0 to twice this
share."""
DETECTED = (0.95, 0.85)
"""Shares of the pressure at the start. A line through both points gives the time when the fall begins."""


def vents(readings: Readings) -> Iterator[tuple[Array, Array]]:
    """(time since the outlet opened, pressure) of each vent that began at a held pressure."""
    venting = readings.solenoid & (readings.evp == 0.0) & (readings.dvp == 0.0) & ~readings.regulating
    for rows in readings.stretches(venting):
        begin, t_s = rows.start, readings.t_s
        before = slice(max(0, begin - round(0.1 / readings.step_s)), begin)
        if not readings.shut[before].all() or before.stop == before.start:
            continue
        start_kPa = float(np.mean(readings.cv_kPa[before]))
        end = min(rows.stop, int(np.searchsorted(t_s, t_s[begin] + MAX_VENT_S)))
        kPa = readings.cv_kPa[begin:end]
        if start_kPa < MIN_VENT_KPA or end - begin < 0.5 / readings.step_s:
            continue
        quick = smooth(kPa, max(1, round(QUICK_S / readings.step_s)))
        high, low = (int(np.argmax(quick < share * start_kPa)) for share in DETECTED)
        if low <= high:
            continue
        slope_s = (t_s[begin + low] - t_s[begin + high]) / (DETECTED[0] - DETECTED[1])
        opened_s = t_s[begin + high] - (1.0 - DETECTED[0]) * slope_s
        empty = np.flatnonzero(smooth(kPa, max(1, round(SMOOTHED_S / readings.step_s))) < EMPTY * start_kPa)
        stop = int(empty[0]) if len(empty) else len(kPa)
        yield t_s[begin : begin + stop] - opened_s, kPa[:stop]


def outlet(readings: Readings, vine: VineAir) -> Findings:
    """The outlet's resistance while the Venturi is off."""
    finding = MeasuredQuantity(
        "outlet_flow_resistance_kPa_s_per_SL", "outlet, the Venturi at rest", "kPa·s/SL"
    )
    falls = list(vents(readings))
    if not falls:
        return Findings((finding.unknown("no complete vent from a held pressure without the Venturi"),))
    litres = vine.volume()
    if litres.low <= 0.0:
        return Findings((finding.unknown(TOO_LITTLE),))
    resistances = []
    for t_s, kPa in falls:
        open_ = t_s > 0.0
        start_kPa = float(np.mean(kPa[~open_])) if np.any(~open_) else float(kPa[0])
        resistances.append(float(np.sum(kPa[open_])) * readings.step_s / vine.air_SL(0.0, start_kPa))
    n = len(resistances)
    spread = float(np.std(resistances, ddof=1)) / np.sqrt(n) if n > 1 else 0.05 * resistances[0]
    mean = float(np.mean(resistances)) * (1.0 + COLD)
    sd = float(np.hypot(spread, mean * np.hypot(litres.sd / litres.value, COLD / np.sqrt(3.0))))
    t_s, kPa = falls[-1]
    chart = Chart(
        "vent", "Venting", "time since it opened, s", "vine, kPa",
        (Series("readings", "points", thinned(t_s), thinned(kPa)),),
        f"{mean:.3g} kPa·s/SL, mean of {n} vents",
    )  # fmt: skip
    note = f"mean of the fall from {kPa[0]:.0f} kPa"
    return Findings((finding.measured(Estimate(mean, sd), note),), charts=(chart,))
