"""A pump that fills a chamber, and a hose between two vessels, against closed forms."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace

import pytest

from flying_vines.physics.baseline import BaselineState, Inputs, step
from flying_vines.physics.effects import setup
from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.physics.plant.ambient import Recorded
from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.flow import Ohm
from flying_vines.physics.plant.plant import Plant, at_rest
from flying_vines.physics.plant.simulator import Simulator
from flying_vines.physics.plant.true_rig import true_rig_from, true_rig_text
from flying_vines.physics.plant.volume import Wall
from flying_vines.physics.rig import ControlVolume, Hose, Pump, Rig, RigError, Solenoid, rig_from

PUMPED = Rig(cv=ControlVolume(0.2), pump=Pump(0.05, 40.0))


def run(simulator: Simulator, seconds: float, *, pump: float = 0.0, vent: bool = False) -> Simulator:
    for _ in range(round(seconds * 1000)):
        simulator.advance(Inputs(pump, 0.0, vent))
    return simulator


def risen_kPa(t_s: float, *, flow: float = 0.05, stall_kPa: float = 40.0, opening: float = 1.0) -> float:
    """V dP/dt = α u Q (1 − P/P_max)."""
    return stall_kPa * (1.0 - math.exp(-ALPHA_KPA * opening * flow / (0.2 * stall_kPa) * t_s))


def test_a_pump_fills_a_chamber_exponentially_up_to_its_stall_pressure() -> None:
    simulator = run(Simulator(Plant(PUMPED)), 1.0, pump=0.6)
    assert simulator.conditions.cv_kPa == pytest.approx(risen_kPa(1.0, opening=0.6), rel=1e-9)
    run(simulator, 20.0, pump=1.0)
    assert simulator.conditions.cv_kPa == pytest.approx(40.0, abs=1e-3)
    assert simulator.conditions.reservoir_kPa == 0.0
    # Nothing flows back through it.
    over = Simulator(Plant(PUMPED), at_rest(Plant(PUMPED), cv_kPa=55.0))
    assert run(over, 1.0, pump=1.0).conditions.cv_kPa == pytest.approx(55.0)


def test_the_pumps_causes_scale_its_two_numbers() -> None:
    for cause, flow, stall_kPa in (("pump_flow", 0.06, 40.0), ("pump_stall", 0.05, 48.0)):
        plant = setup(PUMPED, cause, scale=1.2).plant
        expected = risen_kPa(0.7, flow=flow, stall_kPa=stall_kPa)
        assert run(Simulator(plant), 0.7, pump=1.0).conditions.cv_kPa == pytest.approx(expected, rel=1e-9)


def test_a_choked_supply_fills_a_chamber_at_a_constant_rate() -> None:
    """Up to P = b (P_max + p_a) − p_a the flow is Q_max/φ(r₀); here r₀ is below b, so φ(r₀) = 1."""
    supplied = Rig(cv=ControlVolume(0.2), pump=Pump(0.5, 400.0))
    plant = setup(supplied, "pump_curve", critical_pressure_ratio=0.5).plant
    simulator = run(Simulator(plant), 0.4, pump=1.0)
    assert simulator.conditions.cv_kPa == pytest.approx(ALPHA_KPA * 0.5 / 0.2 * 0.4, rel=1e-9)
    # Half open, half the flow; at the pressure of the supply, none.
    half = run(Simulator(plant), 0.8, pump=0.5)
    assert half.conditions.cv_kPa == pytest.approx(simulator.conditions.cv_kPa, rel=1e-9)
    assert run(simulator, 20.0, pump=1.0).conditions.cv_kPa == pytest.approx(400.0, abs=0.05)
    over = Simulator(plant, at_rest(plant, cv_kPa=410.0))
    assert run(over, 1.0, pump=1.0).conditions.cv_kPa == pytest.approx(410.0)


def test_a_choked_outlet_lets_the_absolute_pressure_fall_exponentially() -> None:
    """V dp/dt = −α C p while p_a/p is below b; C gives the flow of Ohm's law at 100 kPa gauge."""
    pumped = Rig(cv=ControlVolume(0.2), pump=Pump(0.5, 400.0), solenoid=Solenoid(300.0))
    plant = setup(pumped, "choked_outlet", critical_pressure_ratio=0.5).plant
    atmosphere = 101.325
    ratio = atmosphere / (100.0 + atmosphere)
    share = math.sqrt(1.0 - ((ratio - 0.5) / 0.5) ** 2)
    per_kPa = 100.0 / 300.0 / ((100.0 + atmosphere) * share)
    simulator = run(Simulator(plant, at_rest(plant, cv_kPa=300.0)), 0.5, vent=True)
    fallen = (300.0 + atmosphere) * math.exp(-ALPHA_KPA * per_kPa / 0.2 * 0.5)
    assert simulator.conditions.cv_kPa + atmosphere == pytest.approx(fallen, rel=1e-9)
    assert run(simulator, 20.0, vent=True).conditions.cv_kPa == pytest.approx(0.0, abs=0.05)


def test_a_pump_takes_its_air_from_ambient() -> None:
    """Also if the gas has its own temperature: the air enters at ambient temperature."""
    warming = Recorded((0.0, 2.0), (101.3, 101.0), (290.0, 310.0))
    effects = Effects(reservoir_wall=Wall(), reservoir_leak=Ohm(100.0), cv_wall=Wall(2.0), ambient=warming)
    plant = Plant(replace(PUMPED, hose=Hose(0.05, 20.0)), effects)
    start = at_rest(plant)
    end = run(run(Simulator(plant), 1.0, pump=1.0), 0.5, vent=True).state
    gained = sum(end[i] - start[i] for i in (0, 3, 6))
    assert end.vented_SL == pytest.approx(-gained, abs=1e-12)
    assert end.reservoir_air_SL == pytest.approx(start.reservoir_air_SL, abs=1e-12)
    adiabatic = Plant(replace(PUMPED, cv=ControlVolume(0.2)), Effects(cv_wall=Wall()))
    simulator = run(Simulator(adiabatic), 0.5, pump=1.0)
    first = at_rest(adiabatic).cv_air_SL
    entered = simulator.state.cv_air_SL - first
    warm_K = (first + 1.4 * entered) * 293.15 / (first + entered)
    assert simulator.conditions.cv_K == pytest.approx(warm_K, rel=1e-9)


def test_without_effects_a_rig_with_a_pump_is_the_baseline() -> None:
    simulator, state = Simulator(Plant(PUMPED)), BaselineState(0.0, 0.0)
    for i in range(1500):
        inputs = Inputs(0.8 if i < 900 else 0.0, 0.0, i > 1200)
        simulator.advance(inputs)
        state = step(PUMPED, state, inputs, 0.001)
        assert simulator.conditions.cv_kPa == pytest.approx(state.cv_kPa, abs=1e-9)


def test_two_vessels_come_to_one_pressure_through_a_hose() -> None:
    """The difference falls with τ = R / (α (1/V₁ + 1/V₂)), and the amount of air is constant."""
    plant = Plant(Rig(cv=ControlVolume(0.3), hose=Hose(0.1, 40.0)))
    start = at_rest(plant, cv_kPa=10.0)
    simulator = Simulator(plant, start._replace(line_air_SL=start.line_air_SL * 1.5))
    apart_kPa = simulator.conditions.line_kPa - simulator.conditions.cv_kPa
    found = run(simulator, 0.05).conditions
    tau_s = 40.0 / ALPHA_KPA / (1.0 / 0.3 + 1.0 / 0.1)
    assert found.line_kPa - found.cv_kPa == pytest.approx(apart_kPa * math.exp(-0.05 / tau_s), rel=1e-6)
    now = simulator.state
    assert now.cv_air_SL + now.line_air_SL == pytest.approx(start.cv_air_SL + 1.5 * start.line_air_SL)


def test_the_hose_of_a_rig_is_the_hose_of_the_cause() -> None:
    caused = setup(Rig(), "hose", flow_resistance_kPa_s_per_SL=40.0, volume_L=0.1).plant
    assert caused.tubing == Plant(Rig(hose=Hose(0.1, 40.0))).tubing


@pytest.mark.parametrize(
    "text",
    [
        "[cv]\nvolume_L = 0.2\n[pump]\nfree_flow_SL_per_s = 0.05\nstall_pressure_kPa = 40\n",
        "[cv]\nvolume_L = 0.2\n[hose]\nvolume_L = 0.1\n[tolerance_percent]\nhose.volume_L = 30\n",
    ],
)
def test_a_rig_file_comes_back(text: str) -> None:
    rig = true_rig_from(tomllib.loads(text))
    again = true_rig_text(rig)
    assert true_rig_from(tomllib.loads(again)) == rig
    assert ("[reservoir]" in again) == ("pump" not in text)


def test_a_pumps_cause_needs_a_pump() -> None:
    with pytest.raises(RigError, match=r"the rig has no \[pump\]"):
        true_rig_from({"cv": {}, "causes": {"pump_flow": {"scale": 1.2}}})


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("[cv]\n[pump]\n[reservoir]\n", r"has no \[reservoir\]"),
        ("[cv]\n[pump]\n[evp]\n", r"has no \[evp\]"),
        ("[pump]\n", r"add \[cv\]"),
        ("[hose]\n", r"add \[cv\]"),
        ("[cv]\n[pump]\nfree_flow_SL_per_s = 0\n", "from 1e-06 to 1000, not 0"),
        ("[cv]\n[pump]\nflow = 1\n", "unknown key 'pump.flow'"),
    ],
)
def test_an_impossible_rig_is_refused(text: str, why: str) -> None:
    with pytest.raises(RigError, match=why):
        rig_from(tomllib.loads(text))
