"""How easily air leaves: the outlet's resistance, from how the vine's pressure falls when it opens.

    R = ∫ P dt / n        n = V_cv P_0 / α: all that was in it above ambient pressure

over a vent from P_0 to nothing, without the Venturi: a mean over the way down. The time that the outlet takes
to open is left out.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flying_vines.calibration.air import SMOOTHED_S, TOO_LITTLE, VineAir, smooth
from flying_vines.calibration.charts import Chart, Series, thinned
from flying_vines.calibration.estimate import Estimate
from flying_vines.calibration.findings import MeasuredQuantity, Result
from flying_vines.calibration.readings import Readings
from flying_vines.physics.arrays import Array

LEAST_KPA = 8.0
EMPTY = 0.01
"""Of the pressure at the start: what is left then is in the noise."""
LONGEST_S = 10.0
QUICK_S = 0.005
COLD = 0.15
"""Air that is let out quickly leaves cold air behind: up to twice this share of it leaves only later, as it
warms, at next to no pressure. Half of that is added, and all and nothing are in the interval."""
DETECTED = (0.95, 0.85)
"""Of the pressure at the start: a line through these two is where the fall begins."""


def vents(readings: Readings) -> Iterator[tuple[Array, Array]]:
    """Time since the outlet opened and pressure, of each vent from a vine that was held."""
    venting = readings.solenoid & (readings.evp == 0.0) & (readings.dvp == 0.0) & ~readings.regulating
    for rows in readings.stretches(venting):
        begin, t_s = rows.start, readings.t_s
        before = slice(max(0, begin - round(0.1 / readings.step_s)), begin)
        if not readings.shut[before].all() or before.stop == before.start:
            continue
        start_kPa = float(np.mean(readings.cv_kPa[before]))
        end = min(rows.stop, int(np.searchsorted(t_s, t_s[begin] + LONGEST_S)))
        kPa = readings.cv_kPa[begin:end]
        if start_kPa < LEAST_KPA or end - begin < 0.5 / readings.step_s:
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
    """The outlet's resistance, the Venturi at rest."""
    finding = MeasuredQuantity(
        "outlet_flow_resistance_kPa_s_per_SL", "outlet, the Venturi at rest", "kPa·s/SL"
    )
    falls = list(vents(readings))
    if not falls:
        return Result((finding.unknown("no vent from a held pressure was seen at once and whole"),))
    litres = vine.volume()
    if litres.low <= 0.0:
        return Result((finding.unknown(TOO_LITTLE),))
    found = []
    for t_s, kPa in falls:
        open_ = t_s > 0.0
        start_kPa = float(np.mean(kPa[~open_])) if np.any(~open_) else float(kPa[0])
        found.append(float(np.sum(kPa[open_])) * readings.step_s / vine.air_SL(0.0, start_kPa))
    spread = float(np.std(found, ddof=1)) / np.sqrt(len(found)) if len(found) > 1 else 0.05 * found[0]
    mean = float(np.mean(found)) * (1.0 + COLD)
    sd = float(np.hypot(spread, mean * np.hypot(litres.sd / litres.value, COLD / np.sqrt(3.0))))
    t_s, kPa = falls[-1]
    chart = Chart(
        "vent", "Venting", "time since it opened, s", "vine, kPa",
        (Series("read", "points", thinned(t_s), thinned(kPa)),),
        f"{mean:.3g} kPa·s/SL, mean of {len(found)} vents",
    )  # fmt: skip
    note = f"mean of the way down from {kPa[0]:.0f} kPa"
    return Result((finding.measured(Estimate(mean, sd), note),), charts=(chart,))
