"""What a sensor says of no pressure, and how noisy it is."""

from __future__ import annotations

from math import sqrt

import numpy as np

from flying_vines.calibration.charts import Chart, Series, thinned
from flying_vines.calibration.estimate import Estimate
from flying_vines.calibration.findings import MeasuredQuantity, Result, SettingProposal
from flying_vines.calibration.readings import Readings
from flying_vines.physics.arrays import Array

DISTURBED = 4.0
"""So many times the noise of a block's mean apart, and the pressure was not at rest."""
BLOCKS = 10
WORTH_KPA = 0.05
"""A smaller zero is left alone."""
RESERVOIR_WORTH_KPA = 1.0
UNSTEADY = "the reading wandered: was the vine touched, or the bottle open only a little?"


def noise_kPa(column: Array) -> float:
    """Standard deviation from one reading to the next, whatever the pressure does meanwhile."""
    return float(np.std(np.diff(column))) / sqrt(2.0)


def mean_at_rest(column: Array) -> tuple[Estimate, bool]:
    """The mean of a stretch, and whether it was steady: the blocks' means differ as noise makes them."""
    parts = np.array([np.mean(part) for part in np.array_split(column, BLOCKS)])
    apart = float(np.std(parts, ddof=1))
    steady = apart <= DISTURBED * max(noise_kPa(column), 1e-3) / sqrt(len(column) / BLOCKS)
    return Estimate(float(np.mean(column)), apart / sqrt(BLOCKS)), steady


def cv_zero(vented: Readings) -> Result:
    """Of the vine's sensor, and the noise of both."""
    zero, steady = mean_at_rest(vented.cv_kPa)
    finding = MeasuredQuantity("cv_zero_kPa", "vine's sensor at no pressure", "kPa", believed=0.0)
    proposals: tuple[SettingProposal, ...] = ()
    if steady and abs(zero.value) > max(WORTH_KPA, 2.0 * zero.sd):
        why = f"the vented vine reads {zero.value:+z.2f} kPa"
        proposals = (SettingProposal("cv_zero_kPa", round(-zero.value, 3), True, why),)
    return Result(
        (
            finding.measured(zero, "" if steady else UNSTEADY),
            _noise("cv_noise_kPa", "vine's sensor, noise", vented.cv_kPa),
            _noise("reservoir_noise_kPa", "bottle's sensor, noise", vented.reservoir_kPa),
        ),
        proposals,
        () if steady else (f"Zero: {UNSTEADY}",),
        (_chart(vented, zero),),
    )


def reservoir_zero(empty: Readings) -> Result:
    """Of the bottle's sensor, while the bottle is open and empty."""
    zero, steady = mean_at_rest(empty.reservoir_kPa)
    finding = MeasuredQuantity("reservoir_zero_kPa", "bottle's sensor at no pressure", "kPa", believed=0.0)
    if not steady:
        return Result((finding.unknown(UNSTEADY),))
    proposals: tuple[SettingProposal, ...] = ()
    if abs(zero.value) > max(RESERVOIR_WORTH_KPA, 2.0 * zero.sd):
        why = f"the empty bottle reads {zero.value:+.1f} kPa"
        proposals = (SettingProposal("reservoir_zero_kPa", round(-zero.value, 2), True, why),)
    return Result((finding.measured(zero),), proposals)


def _noise(name: str, what: str, column: Array) -> MeasuredQuantity:
    sd = noise_kPa(column)
    return MeasuredQuantity(name, what, "kPa").measured(Estimate(sd, sd / sqrt(2.0 * len(column))))


def _chart(vented: Readings, zero: Estimate) -> Chart:
    t_s = vented.t_s - vented.t_s[0]
    ends_s = t_s[[0, -1]]
    return Chart(
        "zero",
        "Sensor zero",
        "time, s",
        "vine, kPa",
        (
            Series("readings", "points", thinned(t_s), thinned(vented.cv_kPa)),
            Series("95 %", "band", ends_s, np.full(2, zero.low), np.full(2, zero.high)),
            Series(f"zero {zero.value:+.3f} kPa", "line", ends_s, np.full(2, zero.value)),
        ),
    )
