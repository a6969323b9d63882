"""From which opening on the inflation valve passes air, how much more for how much more, and fully open.

    ∫ Q dt = G Σ max(0, x − u₀) p_r dt       over an inflation from one settled pressure to another

x is the opening that was told, behind a play of width w that a shut valve is at the lower end of: it rises
with the command, and follows it down only w later. The left side is the air that the settled pressures tell
(`air`), so neither the valve's lag and delay nor the warmth of the gas meanwhile matter; a supply that is
choked goes with its absolute pressure p_r. Slow inflations tell u₀, quick ones G.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import hypot

import numpy as np

from flying_vines.calibration.air import TOO_LITTLE, VineAir, inverse
from flying_vines.calibration.charts import Chart, Series
from flying_vines.calibration.estimate import SD_95, Estimate
from flying_vines.calibration.findings import MeasuredQuantity, Result, SettingProposal
from flying_vines.calibration.readings import Readings
from flying_vines.physics.arrays import Array

EVERY_STEP_S = 0.0015
"""Telemetry that comes less often does not tell what the valve was told."""
AVERAGED_S = 0.3
LEAST_KPA = 1.5
"""A vine that has less may still be filling its pouch."""
LEAST_RISE_KPA = 3.0
FEWEST = 4
STARTS = np.arange(0.0, 0.7, 0.001)
PLAYS = np.arange(0.0, 0.26, 0.01)
PLAY_PRIOR = (0.07, 0.06)
AIR_SHARE = 0.01
PRESSURE_KPA = 0.03
"""To which an inflation's air is known: a share of it, and what settled pressures are known to."""
START_SURE = 0.001
"""A coil that grows warm moves the start by so much."""
MARGIN = 0.01
"""Below where the valve starts: it is to be lifted to there, not to leak."""


@dataclass(frozen=True)
class SettledInflation:
    """From one settled pressure to another."""

    rows: slice
    from_kPa: float
    to_kPa: float
    air_SL: float


@dataclass(frozen=True)
class Opened:
    """What the inflations say."""

    start: Estimate
    play: Estimate
    gain: Estimate
    """SL/s per opening and kPa of absolute supply."""
    full: Estimate
    """SL/s per kPa of absolute supply, told fully open from shut."""
    inflations: tuple[SettledInflation, ...]
    expected_SL: Array


def inflations(readings: Readings, vine: VineAir) -> Iterator[SettledInflation]:
    """Those that began and ended settled, with the outlet shut."""
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
        if low < LEAST_KPA or high - low < LEAST_RISE_KPA:
            continue
        during = slice(begin, end + 1)
        leaked = vine.leak_SL_per_s_kPa * float(np.sum(readings.cv_kPa[during])) * readings.step_s
        yield SettledInflation(during, low, high, vine.air_SL(low, high) + leaked)


def played(told: Array, widths: Array) -> Array:
    """What a play of each width passes on of an opening, above its lower end, (rows told above 0, widths).

    A valve that is told to be shut is reset.
    """
    half = widths / 2.0
    rows = np.flatnonzero(told > 0.0)
    out = np.zeros((len(rows), len(widths)))
    held = np.zeros(len(widths))
    for at, row in enumerate(rows):
        if at == 0 or rows[at - 1] != row - 1:
            held = np.zeros(len(widths))
        held = np.maximum(told[row] - half, np.minimum(told[row] + half, held))
        out[at] = held + half
    return out


def open_valve(readings: Readings, vine: VineAir) -> Opened | str:
    """Start, play and gain; or why they cannot be told."""
    if readings.step_s > EVERY_STEP_S:
        rate_Hz = 1.0 / readings.step_s
        return f"telemetry came at {rate_Hz:.0f} Hz, and what the valve was told in between is not known"
    if vine.volume().low <= 0.0:
        return TOO_LITTLE
    found = tuple(inflations(readings, vine))
    if len(found) < FEWEST:
        return f"only {len(found)} inflations were settled at both ends"
    doses = np.array([_doses(readings, each.rows, vine.known.ambient_kPa) for each in found])
    air = np.array([each.air_SL for each in found])
    least = vine.air_SL(0.0, PRESSURE_KPA)
    sd = np.hypot(AIR_SHARE * air, least)
    cost, gains = _cost(doses, air, sd)
    prior = ((PLAYS - PLAY_PRIOR[0]) / PLAY_PRIOR[1]) ** 2
    play, start = np.unravel_index(int(np.argmin(cost + prior[:, None])), cost.shape)
    return _refined(doses, found, air, sd, (int(play), int(start)), float(gains[play, start]))


def _doses(readings: Readings, rows: slice, ambient_kPa: float) -> Array:
    """Σ max(0, x − u₀) p_r dt for each play and start, (plays, starts)."""
    passed = played(readings.evp[rows], PLAYS)
    factor = readings.step_s * (float(np.mean(readings.reservoir_kPa[rows])) + ambient_kPa)
    doses = np.empty((len(PLAYS), len(STARTS)))
    for i in range(len(PLAYS)):
        sorted_ = np.sort(passed[:, i])
        above = np.concatenate([np.cumsum(sorted_[::-1])[::-1], [0.0]])
        first = np.searchsorted(sorted_, STARTS)
        doses[i] = factor * (above[first] - STARTS * (len(sorted_) - first))
    return doses


def _cost(doses: Array, air: Array, sd: Array) -> tuple[Array, Array]:
    """χ² and the best gain for each play and start."""
    weight = 1.0 / sd**2
    both = np.einsum("i,ijk->jk", weight * air, doses)
    squares = np.einsum("i,ijk->jk", weight, doses * doses)
    gain = both / np.maximum(squares, 1e-30)
    return float(np.sum(weight * air**2)) - gain * both, gain


def _refined(
    doses: Array,
    found: tuple[SettledInflation, ...],
    air: Array,
    sd: Array,
    best: tuple[int, int],
    gain: float,
) -> Opened | str:
    """Between the grid's points by Gauss and Newton, with intervals."""
    q = np.array([PLAYS[best[0]], STARTS[best[1]], np.log(max(gain, 1e-12))])

    def expected(q: Array) -> Array:
        i = min(max(q[0] / PLAYS[1], 0.0), len(PLAYS) - 1.001)
        k = min(max((q[1] - STARTS[0]) / (STARTS[1] - STARTS[0]), 0.0), len(STARTS) - 1.001)
        (i0, di), (k0, dk) = divmod(i, 1.0), divmod(k, 1.0)
        box = doses[:, int(i0) : int(i0) + 2, int(k0) : int(k0) + 2]
        along = box[:, 0] * (1.0 - di) + box[:, 1] * di
        return np.asarray(np.exp(q[2]) * (along[:, 0] * (1.0 - dk) + along[:, 1] * dk))

    steps = np.array([0.005, 0.0005, 1e-4])
    prior = np.array([1.0 / PLAY_PRIOR[1], 0.0, 0.0])
    for _ in range(8):
        at = expected(q)
        slopes = np.array([(expected(q + d) - expected(q - d)) / 2.0 / d.sum() for d in np.diag(steps)]).T
        a = np.vstack([slopes / sd[:, None], prior])
        off = np.concatenate([(air - at) / sd, [(PLAY_PRIOR[0] - q[0]) / PLAY_PRIOR[1]]])
        step = np.linalg.lstsq(a, off, rcond=None)[0]
        q = q + np.clip(step, [-0.02, -0.005, -0.2], [0.02, 0.005, 0.2])
        q[0] = min(max(q[0], 0.0), PLAYS[-1])
    residual = (air - expected(q)) / sd
    spread = max(1.0, float(residual @ residual) / max(1, len(air) - 3))
    covariance = np.linalg.pinv(a.T @ a) * spread
    play_sd, start_sd, gain_sd = np.sqrt(np.diag(covariance))
    if start_sd > 0.1:
        return "the inflations were too much alike to tell start and gain apart"
    value = float(np.exp(q[2]))
    # The two err together: what a wide open valve passes is known better than either.
    along = np.array([0.0, -1.0 / (1.0 - q[1]), 1.0])
    full_sd = float(np.sqrt(along @ covariance @ along))
    return Opened(
        Estimate(float(q[1]), float(np.hypot(start_sd, START_SURE))),
        Estimate(float(q[0]), float(play_sd)),
        Estimate(value, value * float(gain_sd)),
        Estimate(value * (1.0 - float(q[1])), value * (1.0 - float(q[1])) * full_sd),
        found,
        expected(q),
    )


def inflation_valve(readings: Readings, vine: VineAir) -> Result:
    """The valve's start, gain and resistance, and what follows for the firmware."""
    p, known = vine.known.pneumatics, vine.known
    start = MeasuredQuantity("evp_start", "inflation valve passes air from", "opening")
    gain = MeasuredQuantity("evp_gain_SL_per_s", "inflation valve's gain, full bottle", "SL/s per opening")
    full = MeasuredQuantity(
        "evp_flow_resistance_kPa_s_per_SL",
        "inflation valve, fully open",
        "kPa·s/SL",
        believed=p.evp_flow_resistance_kPa_s_per_SL,
        key="pneumatics.evp_flow_resistance_kPa_s_per_SL",
    )
    opened = open_valve(readings, vine)
    if isinstance(opened, str):
        return Result(tuple(finding.unknown(opened) for finding in (start, gain, full)))
    rows = np.concatenate([readings.reservoir_kPa[each.rows] for each in opened.inflations])
    at_kPa = float(np.mean(rows))
    supply_kPa = p.full_kPa + known.ambient_kPa
    note = f"at {p.full_kPa:g} kPa; measured at {at_kPa:.0f}"
    litres = vine.volume()
    sure = hypot(litres.sd / litres.value, known.supply_sure(at_kPa))
    found = (
        start.measured(opened.start, f"from shut; play {opened.play.value:.2f}"),
        gain.measured(opened.gain.times(supply_kPa, sure)),
        inverse(full, p.full_kPa, opened.full.times(supply_kPa, sure), note),
    )
    lift = max(0.0, round(opened.start.low - MARGIN, 3))
    why = f"the valve passes air from {opened.start.value:.3f} on"
    proposal = SettingProposal("evp_dead_band", min(lift, 0.6), False, why)
    return Result(found, (proposal,), charts=(_chart(readings, vine, opened, at_kPa),))


def _chart(readings: Readings, vine: VineAir, opened: Opened, at_kPa: float) -> Chart:
    """Mean flow of each inflation against the mean opening that it was told while the valve was open."""
    x, y = [], []
    for each, expected in zip(opened.inflations, opened.expected_SL, strict=True):
        told = readings.evp[each.rows]
        above = told[told > opened.start.value]
        if len(above) and expected > 0.0:
            # Where the fitted line has what was expected of it: so its distance is what is left.
            mean = expected / (opened.gain.value * len(above) * readings.step_s)
            supply = float(np.mean(readings.reservoir_kPa[each.rows])) + vine.known.ambient_kPa
            x.append(opened.start.value + mean / supply)
            y.append(each.air_SL / (len(above) * readings.step_s) / supply)
    supply_kPa = at_kPa + vine.known.ambient_kPa
    line = np.linspace(opened.start.value, 1.0, 50)
    flow = opened.gain.value * (line - opened.start.value) * supply_kPa
    share = SD_95 * opened.full.sd / opened.full.value
    lead = np.array([0.0, opened.start.value])
    return Chart(
        "valve",
        "Inflation valve",
        "opening told",
        f"flow at {at_kPa:.0f} kPa, SL/s",
        (
            Series("inflations", "points", np.array(x), np.array(y) * supply_kPa),
            Series("fitted", "line", np.concatenate([lead, line]), np.concatenate([[0.0, 0.0], flow])),
            Series("95 %", "band", line, flow * (1.0 - share), flow * (1.0 + share)),
        ),
        f"starts at {opened.start.value:.3f}",
    )
