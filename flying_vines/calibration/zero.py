"""Zero and noise of the pressure sensors."""

from __future__ import annotations

from math import sqrt

import numpy as np

from flying_vines.calibration.findings import (
    Chart,
    Estimate,
    MeasuredQuantity,
    Result,
    Series,
    SettingProposal,
    thinned,
)
from flying_vines.calibration.readings import Readings
from flying_vines.physics.arrays import Array

MAX_WANDER = 4.0
"""Maximum standard deviation of the block means of a steady pressure, relative to the one that noise alone
would cause."""
BLOCKS = 10
MIN_CV_ZERO_KPA = 0.05
"""Smaller zeros are not proposed."""
MIN_RESERVOIR_ZERO_KPA = 1.0
UNSTEADY = "the reading changed: do not touch the vine, and open the bottle fully"


def noise_kPa(column: Array) -> float:
    """Standard deviation of the noise, from differences of successive readings. Slow changes do not count."""
    return float(np.std(np.diff(column))) / sqrt(2.0)


def mean_at_rest(column: Array) -> tuple[Estimate, bool]:
    """The mean, and True if the pressure was steady (`MAX_WANDER`)."""
    parts = np.array([np.mean(part) for part in np.array_split(column, BLOCKS)])
    spread = float(np.std(parts, ddof=1))
    steady = spread <= MAX_WANDER * max(noise_kPa(column), 1e-3) / sqrt(len(column) / BLOCKS)
    return Estimate(float(np.mean(column)), spread / sqrt(BLOCKS)), steady


def cv_zero(vented: Readings) -> Result:
    """Zero of the vine's sensor, and the noise of both sensors."""
    zero, steady = mean_at_rest(vented.cv_kPa)
    finding = MeasuredQuantity("cv_zero_kPa", "vine's sensor at no pressure", "kPa", assumed=0.0)
    proposals: tuple[SettingProposal, ...] = ()
    if steady and abs(zero.value) > max(MIN_CV_ZERO_KPA, 2.0 * zero.sd):
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
    """Zero of the reservoir's sensor, from readings of the open, empty reservoir."""
    zero, steady = mean_at_rest(empty.reservoir_kPa)
    finding = MeasuredQuantity("reservoir_zero_kPa", "bottle's sensor at no pressure", "kPa", assumed=0.0)
    if not steady:
        return Result((finding.unknown(UNSTEADY),))
    proposals: tuple[SettingProposal, ...] = ()
    if abs(zero.value) > max(MIN_RESERVOIR_ZERO_KPA, 2.0 * zero.sd):
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
