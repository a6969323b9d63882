"""What each stage's telemetry is made into: from all that was recorded so far to a stage's result."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flying_vines.calibration import air, angle, outlet, valve, vessel, zero
from flying_vines.calibration.estimate import Estimate
from flying_vines.calibration.findings import Findings, MeasuredQuantity, Result
from flying_vines.calibration.plan import CalibrationPlan
from flying_vines.calibration.readings import Readings
from flying_vines.physics.constants import STANDARD_PRESSURE_KPA


@dataclass(frozen=True)
class StageRecording:
    """What a stage is judged by."""

    plan: CalibrationPlan
    stage: str
    readings: Readings
    """Of all since the bottle and what hangs on it were last changed; of a rest, that rest alone."""
    findings: Findings
    ambient_kPa: float
    """Absolute; NaN where nobody says."""

    def result(self) -> Result:
        """What it gave; takes up to some seconds of CPU time."""
        match self.stage:
            case "empty":
                return zero.reservoir_zero(self.readings)
            case "zero":
                return zero.cv_zero(self.readings)
            case "angle":
                return angle.curve(self._pairs)
            case "vessel":
                litres = self.plan.wish.vessel_L
                assert litres is not None
                believed_L = self.plan.believed.pneumatics.reservoir_volume_L
                return vessel.bottle_volume(self._vine, litres, believed_L)
        vine = self._vine
        result = _together(Result((self._bottle,)), air.bottle_leak(vine))
        if self.stage != "bottle_leak":
            result = _together(result, air.volumes(vine), air.vine_leak(vine))
        if self.stage in ("vine_leak", "valve"):
            result = _together(result, outlet.outlet(self._less_zero, vine))
        if self.stage == "valve":
            ran_s = float(np.sum(self.readings.dvp)) * self.readings.step_s
            found = Result((air.venturi(vine, ran_s),))
            result = _together(result, valve.inflation_valve(self._less_zero, vine), found)
        return result

    @property
    def _less_zero(self) -> Readings:
        zero_kPa = self.findings.estimate("cv_zero_kPa")
        return self.readings.less_zero(zero_kPa.value if zero_kPa else 0.0)

    @property
    def _vine(self) -> air.VineAir:
        plan = self.plan
        ambient_kPa = self.ambient_kPa if np.isfinite(self.ambient_kPa) else STANDARD_PRESSURE_KPA
        bottle = self._bottle
        litres = bottle.believed or 1.0
        known = Estimate(litres, 0.0)
        if bottle.value is not None and bottle.low is not None and bottle.high is not None:
            known = Estimate.of_interval(bottle.value, bottle.low, bottle.high)
        return air.read_air(
            self._less_zero,
            air.AirInputs(plan.believed.pneumatics, known, plan.top_kPa, plan.settling_s, ambient_kPa),
        )

    @property
    def _bottle(self) -> MeasuredQuantity:
        """What is known of its volume by now."""
        believed_L = self.plan.believed.pneumatics.reservoir_volume_L
        found = self.findings.get("reservoir_volume_L")
        if found is not None:
            return found
        given_L = self.plan.wish.bottle_volume_L
        return vessel.believed(believed_L) if given_L is None else vessel.given(given_L, believed_L)

    @property
    def _pairs(self) -> tuple[tuple[float, float], ...]:
        pairs = self.plan.wish.angles
        if pairs is None:
            return self.findings.pairs
        return tuple(zip(pairs.pressure_kPa.tolist(), pairs.angle_deg.tolist(), strict=True))


def _together(*results: Result) -> Result:
    """Of several estimators."""
    return Result(
        tuple(finding for result in results for finding in result.findings),
        tuple(proposal for result in results for proposal in result.proposals),
        tuple(remark for result in results for remark in result.remarks),
        tuple(chart for result in results for chart in result.charts),
    )
