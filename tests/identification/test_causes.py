"""Properties of every cause of the catalogue."""

from __future__ import annotations

import inspect

import pytest

from flying_vines.physics.cause import Cause
from flying_vines.physics.effects import catalogue, cause_named

TABLE = {
    "reservoir_leak": "flow_resistance_kPa_s_per_SL",
    "cv_leak": "flow_resistance_kPa_s_per_SL",
    "compressible_flow": "critical_pressure_ratio",
    "reservoir_cooling": "time_constant_s",
    "cv_heating": "time_constant_s",
    "cv_compliance": "per_kPa",
    "dead_volume": "volume_L",
    "reservoir_volume": "scale",
    "evp_restriction": "scale",
    "evp_dead_zone": "opening",
    "evp_hysteresis": "width",
    "evp_lag": "time_constant_s",
    "line_delay": "delay_s",
    "solenoid_slow_close": "delay_s",
    "venturi_stall": "supply_pressure_kPa",
    "cv_sensor_lag": "time_constant_s",
    "cv_sensor_offset": "offset_kPa",
    "cv_sensor_gain": "gain",
    "reservoir_sensor_offset": "offset_kPa",
    "reservoir_sensor_gain": "gain",
    "ambient_drop": "rate_kPa_per_s",
    "hose": "flow_resistance_kPa_s_per_SL",
    "pump_flow": "scale",
    "pump_stall": "scale",
    "pump_curve": "critical_pressure_ratio",
    "choked_outlet": "critical_pressure_ratio",
    "evp_heating": "share",
    "cv_sensor_drift": "rate_kPa_per_min",
    "reservoir_sensor_drift": "rate_kPa_per_min",
    "viscous_leak": "conductance_constant_kPa2_s_per_SL",
    "reservoir_viscous_leak": "conductance_constant_kPa2_s_per_SL",
    "orifice_leak": "sonic_conductance_SL_per_s_kPa",
    "reservoir_orifice_leak": "sonic_conductance_SL_per_s_kPa",
}
"""Names of the rig-data format."""


def test_the_catalogue_has_the_formats_names() -> None:
    assert {cause.name: cause.parameters[0].name for cause in catalogue()} == TABLE


def test_a_cause_takes_its_parameters_by_their_names() -> None:
    for cause in catalogue():
        assert cause.apply is not None
        assert list(inspect.signature(cause.apply).parameters)[1:] == [p.name for p in cause.parameters]


@pytest.mark.parametrize("cause", catalogue(), ids=lambda cause: cause.name)
def test_a_cause_has_a_description(cause: Cause) -> None:
    assert cause.what.endswith(".") and cause.experiment.endswith(".")
    for parameter in cause.parameters:
        assert parameter.source
        assert parameter.low < parameter.high
        for seed in parameter.seeds:
            assert parameter.low <= seed <= parameter.high
            assert parameter.to_model(parameter.to_search(seed)) == pytest.approx(seed)


def test_an_offset_or_a_drift_is_small_beside_the_readings() -> None:
    """A cuff of 27 kPa has a suitable sensor, not one that is off by 20 kPa."""
    offset = cause_named("cv_sensor_offset")
    (parameter,) = offset.within_readings({"cv": 27.0, "reservoir": 0.0}).parameters
    assert (parameter.low, parameter.high) == pytest.approx((-8.1, 8.1))
    assert offset.within_readings({"cv": 200.0, "reservoir": 0.0}) == offset
    assert offset.within_readings({"cv": 0.0, "reservoir": 0.0}) == offset
    (drift,) = (
        cause_named("reservoir_sensor_drift").within_readings({"cv": 0.0, "reservoir": 100.0}).parameters
    )
    assert (drift.low, drift.high) == (-5.0, 5.0)
