"""The bounds of the causes are physical limits, for lab rigs of any size."""

from __future__ import annotations

import math

import pytest
from closed_forms import isa_pressure_kPa
from hidden_truth.effects import CAUSES, EFFECTS
from hidden_truth.rig import Rig as HiddenRig

from flying_vines.physics.cause import Parameter
from flying_vines.physics.effects import catalogue, cause_named, causes_of, setup
from flying_vines.physics.plant.commands import HEATED_PART
from flying_vines.physics.rig import ControlVolume, Pump, Rig

PARAMETERS = {f"{cause.name}.{p.name}": p for cause in catalogue() for p in cause.parameters}
AIR_DIFFUSIVITY_M2_PER_S = 2.1e-5
NARROW_M = 2e-3


def parameter(name: str) -> Parameter:
    return PARAMETERS[name]


@pytest.mark.parametrize("name", CAUSES)
def test_strengths_of_the_independent_simulator_are_within_the_bounds(name: str) -> None:
    effect, own = EFFECTS[name], cause_named(name).parameters[0]
    assert effect.parameter == own.name
    for cv_L in (0.05, 1.0):
        for size in (effect.low, effect.high, *((-effect.low, -effect.high) if effect.either_sign else ())):
            value = effect.value(size, HiddenRig(cv_L=cv_L))
            assert own.low < value < own.high
            weaker = effect.weaken(value, 0.1) if effect.weaken else value
            assert own.low < weaker < own.high


def test_ambient_pressure_stays_on_earth() -> None:
    bound = parameter("ambient_drop.rate_kPa_per_s")
    for rate in (bound.low, bound.high):
        ambient = setup(Rig(), "ambient_drop", rate_kPa_per_s=rate).plant.ambient
        for t_s in (0.0, 60.0, 600.0, 3600.0):
            assert isa_pressure_kPa(6100.0) < ambient.at(t_s)[0] < isa_pressure_kPa(-700.0)


@pytest.mark.parametrize("cause", ["cv_heating", "reservoir_cooling"])
def test_heat_does_not_cross_air_faster_than_by_conduction_through_2_mm(cause: str) -> None:
    conducted_s = NARROW_M**2 / (math.pi**2 * AIR_DIFFUSIVITY_M2_PER_S)
    assert parameter(f"{cause}.time_constant_s").low >= 0.9 * conducted_s


def test_a_sensor_is_off_by_a_share_of_its_span() -> None:
    made = setup(Rig())
    for who, sensor in (("cv", made.cv_sensor), ("reservoir", made.reservoir_sensor)):
        offset = parameter(f"{who}_sensor_offset.offset_kPa")
        assert -offset.low == offset.high <= 0.1 * sensor.span_kPa
        drift = parameter(f"{who}_sensor_drift.rate_kPa_per_min")
        assert -drift.low == drift.high <= 0.05 * sensor.span_kPa


def test_no_valve_loses_all_its_flow_to_heat() -> None:
    assert parameter("evp_heating.share").high < 1.0
    # The time of each part of a warming valve must be longer than a tick.
    assert HEATED_PART * parameter("evp_heating.time_constant_s").low > 0.001


def test_a_rig_can_only_have_causes_of_its_parts() -> None:
    def names(rig: Rig) -> set[str]:
        return {cause.name for cause in causes_of(rig)}

    every = {cause.name for cause in catalogue()}
    assert every - names(Rig()) == {"pump_flow", "pump_stall", "pump_curve", "choked_outlet"}
    pumped = names(Rig(cv=ControlVolume(0.2), pump=Pump()))
    assert {"pump_flow", "cv_leak", "hose"} < pumped
    assert not {name for name in pumped if name.startswith(("reservoir", "venturi", "compressible"))}
    assert not {"cv_leak", "dead_volume", "hose", "pump_flow"} & names(Rig(cv=None))
