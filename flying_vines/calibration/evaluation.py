"""The evaluation of a stage: from its telemetry to its results. Sensors and bend are evaluated here."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from flying_vines.calibration import valve, vine_air
from flying_vines.calibration.findings import (
    Chart,
    Estimate,
    Findings,
    MeasuredQuantity,
    Series,
    SettingProposal,
    thinned,
)
from flying_vines.calibration.plan import CalibrationPlan
from flying_vines.calibration.readings import Readings, noise_kPa
from flying_vines.files.extras import lacks
from flying_vines.physics.arrays import Array
from flying_vines.physics.gas import STANDARD_PRESSURE_KPA

MAX_WANDER = 4.0
"""Maximum standard deviation of the block means of a steady pressure, relative to the one that noise alone
would cause."""
BLOCKS = 10
MIN_CV_ZERO_KPA = 0.05
"""Smaller zeros are not proposed."""
MIN_RESERVOIR_ZERO_KPA = 1.0
UNSTEADY = "the reading changed: do not touch the vine, and open the reservoir fully"


@dataclass(frozen=True)
class StageRecording:
    """The data of a stage."""

    plan: CalibrationPlan
    stage: str
    readings: Readings
    """Since the reservoir was filled, or the vine was replaced or put back. In the stages `empty` and `zero`
    only those of `rest_s`."""
    findings: Findings
    ambient_kPa: float
    """Absolute; NaN if it is unknown."""

    def result(self) -> Findings:
        """Evaluate the stage; takes up to some seconds of CPU time."""
        match self.stage:
            case "empty":
                return reservoir_zero(self.readings)
            case "zero":
                return cv_zero(self.readings)
            case "angle":
                return bend_curve(self._pairs)
            case "vessel":
                litres = self.plan.request.vessel_L
                assert litres is not None
                return vine_air.vessel_volume(self._vine, litres)
        vine = self._vine
        found = Findings((self._reservoir_volume,)).renewed_by(vine_air.reservoir_leak(vine))
        if self.stage != "reservoir_leak":
            found = found.renewed_by(vine_air.volumes(vine)).renewed_by(vine_air.vine_leak(vine))
        if self.stage in ("vine_leak", "valve"):
            found = found.renewed_by(valve.outlet(self._less_zero, vine))
        if self.stage == "valve":
            ran_s = float(np.sum(self.readings.dvp)) * self.readings.step_s
            found = found.renewed_by(valve.inflation_valve(self._less_zero, vine))
            found = found.renewed_by(Findings((vine_air.venturi(vine, ran_s),)))
        return found

    @property
    def _less_zero(self) -> Readings:
        cv, reservoir = map(self.findings.estimate, ("cv_zero_kPa", "reservoir_zero_kPa"))
        return self.readings.less_zero(cv.value if cv else 0.0, reservoir.value if reservoir else 0.0)

    @property
    def _vine(self) -> vine_air.VineAir:
        plan = self.plan
        ambient_kPa = self.ambient_kPa if np.isfinite(self.ambient_kPa) else STANDARD_PRESSURE_KPA
        volume = self._reservoir_volume
        zero = self.findings.estimate("reservoir_zero_kPa")
        return vine_air.fit_vine_air(
            self._less_zero,
            vine_air.AirInputs(
                plan.user_config.pneumatics,
                volume.estimate or Estimate(volume.assumed or 1.0, 0.0),
                plan.top_kPa,
                plan.settling_s(self.stage),
                ambient_kPa,
                zero.sd if zero else vine_air.RESERVOIR_ZERO_SD_KPA,
            ),
        )

    @property
    def _reservoir_volume(self) -> MeasuredQuantity:
        """As measured, given, or assumed."""
        found = self.findings.get("reservoir_volume_L")
        known, given_L = self.plan.user_config.pneumatics, self.plan.request.reservoir_volume_L
        return found or vine_air.reservoir_volume(known, given_L)

    @property
    def _pairs(self) -> tuple[tuple[float, float], ...]:
        pairs = self.plan.request.angles
        if pairs is None:
            return self.findings.pairs
        return tuple(zip(pairs.pressure_kPa.tolist(), pairs.angle_deg.tolist(), strict=True))


# Zero and noise of the pressure sensors.


def mean_at_rest(column: Array) -> tuple[Estimate, bool]:
    """The mean, and True if the pressure was steady (`MAX_WANDER`)."""
    parts = np.array([np.mean(part) for part in np.array_split(column, BLOCKS)])
    spread = float(np.std(parts, ddof=1))
    steady = spread <= MAX_WANDER * max(noise_kPa(column), 1e-3) / sqrt(len(column) / BLOCKS)
    return Estimate(float(np.mean(column)), spread / sqrt(BLOCKS)), steady


def cv_zero(vented: Readings) -> Findings:
    """Zero of the vine's sensor, and the noise of both sensors."""
    zero, steady = mean_at_rest(vented.cv_kPa)
    finding = MeasuredQuantity("cv_zero_kPa", "vine's sensor at no pressure", "kPa", assumed=0.0)
    proposals: tuple[SettingProposal, ...] = ()
    if steady and abs(zero.value) > max(MIN_CV_ZERO_KPA, 2.0 * zero.sd):
        why = f"the vented vine reads {zero.value:+z.2f} kPa"
        proposals = (SettingProposal("cv_zero_kPa", round(-zero.value, 3), True, why),)
    return Findings(
        (
            finding.measured(zero, "" if steady else UNSTEADY),
            _noise("cv_noise_kPa", "vine's sensor, noise", vented.cv_kPa),
            _noise("reservoir_noise_kPa", "reservoir's sensor, noise", vented.reservoir_kPa),
        ),
        proposals,
        () if steady else (f"Zero: {UNSTEADY}",),
        (_chart(vented, zero),),
    )


def reservoir_zero(empty: Readings) -> Findings:
    """Zero of the reservoir's sensor, from readings of the open, empty reservoir."""
    zero, steady = mean_at_rest(empty.reservoir_kPa)
    finding = MeasuredQuantity("reservoir_zero_kPa", "reservoir's sensor at no pressure", "kPa", assumed=0.0)
    if not steady:
        return Findings((finding.unknown(UNSTEADY),))
    proposals: tuple[SettingProposal, ...] = ()
    if abs(zero.value) > max(MIN_RESERVOIR_ZERO_KPA, 2.0 * zero.sd):
        why = f"the empty reservoir reads {zero.value:+.1f} kPa"
        proposals = (SettingProposal("reservoir_zero_kPa", round(-zero.value, 2), True, why),)
    return Findings((finding.measured(zero),), proposals)


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


# Bend curve and hysteresis, from the angles that a person entered.


def bend_curve(pairs: tuple[tuple[float, float], ...]) -> Findings:
    """Fit pairs (gauge kPa, degrees), in the order in which they were measured."""
    top = MeasuredQuantity("bend_top_deg", "bend at the highest pressure", "deg", key="vine.curve")
    width = MeasuredQuantity("hysteresis_kPa", "hysteresis of the bend", "kPa", key="vine.hysteresis_kPa")
    try:
        from flying_vines.identification.bend_curve import Pairs, PairsError, fit
        from flying_vines.identification.bend_curve.pairs import MIN_PAIRS
    except ImportError as error:
        why = f"{lacks(error)}; findings.json has the pairs for `vine fit`"
        return Findings((top.unknown(why), width.unknown(why)))
    if len(pairs) < MIN_PAIRS:
        why = f"{len(pairs)} angles were entered; a curve needs at least {MIN_PAIRS}, up and down"
        return Findings((top.unknown(why), width.unknown(why)))
    kPa, deg = np.array(pairs).T
    try:
        found = fit(Pairs(kPa, deg))
    except PairsError as error:
        return Findings((top.unknown(str(error)), width.unknown(str(error))))
    last = found.curve[-1]
    sd = found.rms_deg / float(np.sqrt(len(pairs)))
    hysteresis = width.unknown("no angle was entered on the way down")
    if found.hysteresis_kPa is not None:
        h = found.hysteresis_kPa
        hysteresis = width.measured(Estimate.of_interval(h.value, h.low, h.high), minimum=0.0)
    line_kPa, line_deg = np.array(found.curve).T
    shift = found.written_hysteresis_kPa
    chart = Chart(
        "angle", "Angle against pressure", "vine, kPa", "bend, degrees",
        (
            Series("seen", "points", kPa, deg),
            Series("on the way up", "line", line_kPa, line_deg),
            Series("on the way down", "line", np.maximum(0.0, line_kPa - shift), line_deg),
        ),
    )  # fmt: skip
    return Findings(
        (top.measured(Estimate(last[1], sd), f"at {last[0]:g} kPa"), hysteresis),
        remarks=found.notes,
        charts=(chart,),
        curve=found.curve,
        hysteresis_kPa=shift,
    )
