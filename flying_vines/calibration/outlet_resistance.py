"""Resistance of the outlet, from the fall of the vine's pressure after it opens.

    R = ∫ P dt / n        n = V_cv P_0 / α: the air that leaves the vine

over a vent from P_0 to zero without the Venturi. R is a mean over the whole fall. The time that the outlet
needs to open does not count.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flying_vines.calibration.findings import Chart, Estimate, MeasuredQuantity, Result, Series, thinned
from flying_vines.calibration.readings import Readings, smooth
from flying_vines.calibration.vine_air import SMOOTHED_S, TOO_LITTLE, VineAir
from flying_vines.physics.arrays import Array

MIN_KPA = 8.0
EMPTY = 0.01
"""Below this share of the start pressure the vine counts as empty: the readings are only noise."""
MAX_S = 10.0
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
        end = min(rows.stop, int(np.searchsorted(t_s, t_s[begin] + MAX_S)))
        kPa = readings.cv_kPa[begin:end]
        if start_kPa < MIN_KPA or end - begin < 0.5 / readings.step_s:
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


def outlet(readings: Readings, vine: VineAir) -> Result:
    """The outlet's resistance while the Venturi is off."""
    finding = MeasuredQuantity(
        "outlet_flow_resistance_kPa_s_per_SL", "outlet, the Venturi at rest", "kPa·s/SL"
    )
    falls = list(vents(readings))
    if not falls:
        return Result((finding.unknown("no complete vent from a held pressure without the Venturi"),))
    litres = vine.volume()
    if litres.low <= 0.0:
        return Result((finding.unknown(TOO_LITTLE),))
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
    return Result((finding.measured(Estimate(mean, sd), note),), charts=(chart,))
