"""The evaluation of a stage: from its telemetry to its results."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flying_vines.calibration import angle, outlet_resistance, valve, vine_air, zero
from flying_vines.calibration.findings import Estimate, Findings, MeasuredQuantity, Result
from flying_vines.calibration.plan import CalibrationPlan
from flying_vines.calibration.readings import Readings
from flying_vines.physics.constants import STANDARD_PRESSURE_KPA


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

    def result(self) -> Result:
        """Evaluate the stage; takes up to some seconds of CPU time."""
        match self.stage:
            case "empty":
                return zero.reservoir_zero(self.readings)
            case "zero":
                return zero.cv_zero(self.readings)
            case "angle":
                return angle.curve(self._pairs)
            case "vessel":
                litres = self.plan.request.vessel_L
                assert litres is not None
                assumed_L = self.plan.user_config.pneumatics.reservoir_volume_L
                return vine_air.vessel_volume(self._vine, litres, assumed_L)
        vine = self._vine
        results = [Result((self._reservoir_volume,)), vine_air.bottle_leak(vine)]
        if self.stage != "bottle_leak":
            results += [vine_air.volumes(vine), vine_air.vine_leak(vine)]
        if self.stage in ("vine_leak", "valve"):
            results.append(outlet_resistance.outlet(self._less_zero, vine))
        if self.stage == "valve":
            ran_s = float(np.sum(self.readings.dvp)) * self.readings.step_s
            results.append(valve.inflation_valve(self._less_zero, vine))
            results.append(Result((vine_air.venturi(vine, ran_s),)))
        return _together(results)

    @property
    def _less_zero(self) -> Readings:
        cv, reservoir = map(self.findings.estimate, ("cv_zero_kPa", "reservoir_zero_kPa"))
        return self.readings.less_zero(cv.value if cv else 0.0, reservoir.value if reservoir else 0.0)

    @property
    def _vine(self) -> vine_air.VineAir:
        plan = self.plan
        ambient_kPa = self.ambient_kPa if np.isfinite(self.ambient_kPa) else STANDARD_PRESSURE_KPA
        volume = self._reservoir_volume
        known = Estimate(volume.assumed or 1.0, 0.0)
        if volume.value is not None and volume.low is not None and volume.high is not None:
            known = Estimate.of_interval(volume.value, volume.low, volume.high)
        zero = self.findings.estimate("reservoir_zero_kPa")
        return vine_air.fit_vine_air(
            self._less_zero,
            vine_air.AirInputs(
                plan.user_config.pneumatics,
                known,
                plan.top_kPa,
                plan.settling_s(self.stage),
                ambient_kPa,
                zero.sd if zero else vine_air.RESERVOIR_ZERO_SD_KPA,
            ),
        )

    @property
    def _reservoir_volume(self) -> MeasuredQuantity:
        """As measured, given, or assumed."""
        assumed_L = self.plan.user_config.pneumatics.reservoir_volume_L
        found = self.findings.get("reservoir_volume_L")
        if found is not None:
            return found
        given_L = self.plan.request.bottle_volume_L
        if given_L is None:
            return vine_air.assumed_volume(assumed_L)
        return vine_air.given_volume(given_L, assumed_L)

    @property
    def _pairs(self) -> tuple[tuple[float, float], ...]:
        pairs = self.plan.request.angles
        if pairs is None:
            return self.findings.pairs
        return tuple(zip(pairs.pressure_kPa.tolist(), pairs.angle_deg.tolist(), strict=True))


def _together(results: list[Result]) -> Result:
    return Result(
        tuple(finding for result in results for finding in result.findings),
        tuple(proposal for result in results for proposal in result.proposals),
        tuple(remark for result in results for remark in result.remarks),
        tuple(chart for result in results for chart in result.charts),
    )
