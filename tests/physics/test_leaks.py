"""Leaks of a held volume against closed forms."""

from __future__ import annotations

import math

import pytest

from flying_vines.physics.baseline import Inputs
from flying_vines.physics.plant.compiled import replay
from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.flow import Iso6358, Ohm
from flying_vines.physics.plant.leak import Curve, Viscous, curve_of, curve_SL_per_s, leak_of, leak_SL_per_s
from flying_vines.physics.plant.plant import Plant, at_rest
from flying_vines.physics.plant.simulator import Simulator
from flying_vines.physics.plant.true_rig import true_rig_from, true_rig_text
from flying_vines.physics.rig import ControlVolume, Rig, RigError

P0 = 101.325
SHUT = Inputs(0.0, 0.0, False)


def held(effects: Effects, seconds: float, cv_kPa: float = 60.0) -> tuple[float, float]:
    """Gauge pressures of a 2 L reservoir from 600 kPa and a 0.5 L control volume, all valves shut."""
    plant = Plant(Rig(cv=ControlVolume(0.5)), effects)
    simulator = Simulator(plant, at_rest(plant, 600.0, cv_kPa), tick_s=0.01)
    for _ in range(round(seconds / 0.01)):
        simulator.advance(SHUT)
    return simulator.conditions.reservoir_kPa, simulator.conditions.cv_kPa


def through_a_gap(start_kPa: float, volume_L: float, constant: float, t_s: float) -> float:
    """The integral of dp/dt = −α (p² − p_a²)/(C V): (p − p_a)/(p + p_a) falls at the rate 2 p_a α/(C V)."""
    share = start_kPa / (start_kPa + 2.0 * P0) * math.exp(-2.0 * P0 * P0 * t_s / (constant * volume_L))
    return 2.0 * P0 * share / (1.0 - share)


def test_a_viscous_leak_empties_a_held_volume_as_its_integral() -> None:
    effects = Effects(cv_viscous_leak=Viscous(4e5), reservoir_viscous_leak=Viscous(2e6))
    reservoir_kPa, cv_kPa = held(effects, 5.0)
    assert cv_kPa == pytest.approx(through_a_gap(60.0, 0.5, 4e5, 5.0), rel=1e-9)
    assert reservoir_kPa == pytest.approx(through_a_gap(600.0, 2.0, 2e6, 5.0), rel=1e-9)


def test_a_hole_chokes() -> None:
    effects = Effects(cv_orifice_leak=Iso6358(2e-4, 0.5), reservoir_orifice_leak=Iso6358(5e-4, 0.5))
    reservoir_kPa, cv_kPa = held(effects, 5.0, 300.0)
    assert cv_kPa + P0 == pytest.approx((300.0 + P0) * math.exp(-2e-4 * P0 * 5.0 / 0.5), rel=1e-9)
    assert reservoir_kPa + P0 == pytest.approx((600.0 + P0) * math.exp(-5e-4 * P0 * 5.0 / 2.0), rel=1e-9)


def test_leaks_of_one_volume_add_up() -> None:
    laws = (Ohm(3e3), Viscous(7e5), Iso6358(2e-5, 0.5))
    both = leak_SL_per_s(leak_of(laws), 180.0, P0, 1.0, 1.0)
    assert both == pytest.approx(sum(leak_SL_per_s(leak_of([law]), 180.0, P0, 1.0, 1.0) for law in laws))
    assert leak_SL_per_s(leak_of(laws[:2]), 50.0, P0, 1.0, 1.0) < 0.0
    with pytest.raises(ValueError, match="one orifice"):
        leak_of((laws[2], laws[2]))


def test_a_rig_file_may_name_several_leaks() -> None:
    rig = true_rig_from(
        {
            "cv": {},
            "causes": {
                "cv_leak": {"flow_resistance_kPa_s_per_SL": 300.0},
                "viscous_leak": {"conductance_constant_kPa2_s_per_SL": 1e5},
            },
            "effects": {"reservoir_leak": {"kind": "viscous", "conductance_constant_kPa2_s_per_SL": 1e7}},
        }
    )
    effects = rig.setup.plant.effects
    assert (effects.cv_leak, effects.cv_viscous_leak) == (Ohm(300.0), Viscous(1e5))
    assert effects.reservoir_leak == Viscous(1e7)
    assert 'kind = "viscous"' in true_rig_text(rig)
    with pytest.raises(RigError, match="needs a control volume"):
        true_rig_from({"causes": {"orifice_leak": {"sonic_conductance_SL_per_s_kPa": 1e-5}}})


def test_a_function_of_pressure_is_a_leak() -> None:
    """Q = k (p − p_a)² empties a volume as 1/(1/p₀ + α k t/V)."""
    curve = curve_of(lambda p_kPa: 4e-6 * p_kPa**2, 60.0)
    _, cv_kPa = held(Effects(cv_leak_curve=curve), 20.0)
    assert cv_kPa == pytest.approx(1.0 / (1.0 / 60.0 + P0 * 4e-6 * 20.0 / 0.5), rel=2e-4)
    reservoir = curve_of(lambda p_kPa: 1e-7 * p_kPa**2, 700.0)
    reservoir_kPa, _ = held(Effects(reservoir_leak_curve=reservoir), 20.0)
    assert reservoir_kPa == pytest.approx(1.0 / (1.0 / 600.0 + P0 * 1e-7 * 20.0 / 2.0), rel=2e-4)


def test_a_straight_function_is_exactly_a_resistance_also_when_compiled() -> None:
    plants = [
        Plant(Rig(cv=ControlVolume(0.5)), effects)
        for effects in (Effects(cv_leak=Ohm(800.0)), Effects(cv_leak_curve=curve_of(lambda p: p / 800.0)))
    ]
    ohm, curve = (replay(p, [(0.0, 0.0, 0.0)] * 500, at_rest(p, 600.0, 60.0)).table["cv_kPa"] for p in plants)
    assert ohm[-1] < 57.0 and curve == pytest.approx(ohm, rel=1e-12)


def test_a_curve_between_points_below_ambient_and_beyond_its_end() -> None:
    measured = Curve(((0.0, 0.0), (10.0, 0.0), (30.0, 0.02))).numbers
    at = (5.0, 10.0, 20.0, 30.0, 40.0, -20.0)
    assert [curve_SL_per_s(measured, p_kPa) for p_kPa in at] == pytest.approx(
        [0.0, 0.0, 0.01, 0.02, 0.03, -0.01], abs=2e-4
    )
    rig = true_rig_from({"cv": {}, "effects": {"cv_leak_curve": {"points": [[0, 0], [10, 0], [30, 0.02]]}}})
    assert rig.setup.plant.effects.cv_leak_curve == Curve(((0.0, 0.0), (10.0, 0.0), (30.0, 0.02)))


@pytest.mark.parametrize(
    ("points", "says"),
    [
        (((0.0, 0.0),), "a leak's curve needs its points"),
        (((0.0, 0.1), (1.0, 0.2)), "the first at 0 kPa without flow"),
        (
            ((0.0, 0.0), (1.0, 0.2), (2.0, 0.1)),
            "flow of a leak's curve must not fall: at 2 kPa it is 0.1 SL/s",
        ),
        (
            ((0.0, 0.0), (2.0, 0.1), (1.5, 0.2)),
            "pressures of a leak's curve must rise: 1.5 kPa is after 2 kPa",
        ),
        (((0.0, 0.0), (math.inf, 0.1)), "must rise: inf kPa"),
        (((0.0, 0.0), (1.0, math.inf)), "it is inf SL/s"),
    ],
)
def test_an_impossible_curve_is_refused(points: tuple[tuple[float, float], ...], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        Curve(points)


def test_the_flow_of_a_curve_may_stay_constant() -> None:
    flat = Curve(((0.0, 0.0), (10.0, 0.02), (30.0, 0.02))).numbers
    assert curve_SL_per_s(flat, 20.0) == pytest.approx(0.02, abs=2e-4)
