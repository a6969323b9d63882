"""The rig's gas enters the energy balance and the choked flows."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
from closed_forms import adiabatic_choked_discharge_kPa_abs, choked_time_constant_s, polytropic_temperature_K

from flying_vines.physics.baseline import Inputs
from flying_vines.physics.effects import setup
from flying_vines.physics.gas import (
    AIR,
    ALPHA_KPA,
    GASES,
    Gas,
    nozzle_critical_ratio,
    sonic_conductance_ratio,
)
from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.flow import Iso6358, flow_SL_per_s
from flying_vines.physics.plant.leak import orifice
from flying_vines.physics.plant.plant import Plant, at_rest
from flying_vines.physics.plant.simulator import Simulator
from flying_vines.physics.plant.true_rig import true_rig_from, true_rig_text
from flying_vines.physics.plant.volume import Wall
from flying_vines.physics.rig import ControlVolume, Rig, RigError, rig_from

OPEN = Inputs(1.0, 0.0, False)


def test_the_choked_flow_of_a_nozzle_per_area() -> None:
    """Mass flow A p √(γ/(R T)) (2/(γ+1))^…, over the density at the standard state, in each gas."""

    def flow_m3_per_s(gamma: float, molar_mass_g_per_mol: float) -> float:
        R = 8.314462618 / (molar_mass_g_per_mol / 1000.0)
        mass = math.sqrt(gamma / (R * 293.15)) * (2 / (gamma + 1)) ** ((gamma + 1) / (2 * (gamma - 1)))
        return float(mass / (101325.0 / (R * 293.15)))

    for name, gas in GASES.items():
        expected = flow_m3_per_s(*gas) / flow_m3_per_s(*AIR)
        assert sonic_conductance_ratio(gas) == pytest.approx(expected, rel=1e-12), name
    assert sonic_conductance_ratio(GASES["He"]) == pytest.approx(2.85, abs=0.01)
    assert sonic_conductance_ratio(GASES["CO2"]) == pytest.approx(0.79, abs=0.01)
    assert nozzle_critical_ratio(1.4) == pytest.approx(0.5283, abs=1e-4)


@pytest.mark.parametrize("name", ["CO2", "He"])
def test_an_adiabatic_discharge_is_the_closed_form_of_the_gas(name: str) -> None:
    gas = GASES[name]
    plant = Plant(Rig(cv=None, gas=Gas(name)), Effects(evp_law=Iso6358(5e-4, 0.3), reservoir_wall=Wall()))
    simulator = Simulator(plant, at_rest(plant, 690.0))
    for _ in range(3000):
        simulator.advance(OPEN)
    tau_s = choked_time_constant_s(2.0, 5e-4 * sonic_conductance_ratio(gas))
    expected = adiabatic_choked_discharge_kPa_abs(791.325, 3.0, tau_s, gas.gamma)
    assert expected > 101.325 / 0.3
    found = simulator.conditions
    assert found.reservoir_kPa + 101.325 == pytest.approx(expected, rel=1e-9)
    kelvin = polytropic_temperature_K(293.15, 791.325, expected, gas.gamma)
    assert found.reservoir_K == pytest.approx(kelvin, rel=1e-9)


def test_gas_that_enters_a_vessel_warms_it_by_gamma() -> None:
    plant = Plant(Rig(cv=ControlVolume(0.5), gas=Gas("Ar")), Effects(cv_wall=Wall()))
    simulator = Simulator(plant, at_rest(plant, 690.0, -101.2))
    for _ in range(1000):
        simulator.advance(OPEN)
    start_SL, now_SL = 0.125 * 0.5 / ALPHA_KPA, simulator.state.cv_air_SL
    expected = (start_SL + (now_SL - start_SL) * 5.0 / 3.0) * 293.15 / now_SL
    assert simulator.conditions.cv_K == pytest.approx(expected, rel=1e-9)


def test_a_wall_gives_a_gas_its_heat_in_joules() -> None:
    """Isolated warm gas and its wall reach the mean temperature, weighted by heat capacity."""
    wall = Wall(conductance_W_per_K=2.0, capacity_J_per_K=30.0, outer_conductance_W_per_K=0.0)
    plant = Plant(Rig(gas=Gas("CO2")), Effects(reservoir_wall=wall))
    state = at_rest(plant)
    simulator = Simulator(plant, state._replace(reservoir_pV_J=state.reservoir_pV_J * 1.2), tick_s=0.02)
    for _ in range(5000):
        simulator.advance(Inputs(0.0, 0.0, False))
    gas_J_per_K = state.reservoir_pV_J / 0.289 / 293.15
    expected = (gas_J_per_K * 1.2 + 30.0) * 293.15 / (gas_J_per_K + 30.0)
    assert simulator.conditions.reservoir_K == pytest.approx(expected, abs=1e-3)


def test_gas_cools_at_a_wall_with_its_own_heat_capacity() -> None:
    """T − T_w falls exponentially with m c_v / hA, m c_v = p V / ((γ − 1) T)."""
    plant = Plant(Rig(gas=Gas("CO2")), Effects(reservoir_wall=Wall(conductance_W_per_K=2.0)))
    state = at_rest(plant)
    simulator = Simulator(plant, state._replace(reservoir_pV_J=state.reservoir_pV_J * 1.2))
    for _ in range(5000):
        simulator.advance(Inputs(0.0, 0.0, False))
    gas_J_per_K = state.reservoir_pV_J / 0.289 / 293.15
    warmer = 0.2 * math.exp(-5.0 * 2.0 / gas_J_per_K)
    assert simulator.conditions.reservoir_K == pytest.approx(293.15 * (1.0 + warmer), rel=1e-7)


def test_matched_valves_pass_what_ohms_law_gives_with_any_gas() -> None:
    rig = Rig(gas=Gas("He"))
    law = setup(rig, "compressible_flow", critical_pressure_ratio=0.3).plant.effects.evp_law
    assert law is not None
    flow = flow_SL_per_s(law.numbers(rig.gas.properties), 690.0 + 101.325, 101.325, 1.0, 1.0)
    assert flow == pytest.approx(690.0 / 2042.0)


def test_a_hole_chokes_at_the_ratio_of_the_gas() -> None:
    assert orifice(1e-5).critical_pressure_ratio == 0.5
    assert orifice(1e-5, GASES["Ar"]).critical_pressure_ratio == pytest.approx(
        0.5 * 0.4871 / 0.5283, abs=1e-4
    )


def test_a_rig_file_names_its_gas() -> None:
    for table in ({"name": "co2"}, {"gamma": 1.3, "molar_mass_g_per_mol": 16.04}):
        rig = true_rig_from({"cv": {}, "gas": table})
        text = true_rig_text(rig)
        assert true_rig_from(tomllib.loads(text)) == rig
    assert rig.nominal.gas.properties == (1.3, 16.04)
    assert "gas" not in true_rig_text(true_rig_from({"cv": {}}))


@pytest.mark.parametrize(
    ("table", "why"),
    [
        ({"name": "laughing"}, "'laughing' is not a known gas"),
        ({"gamma": 1.3}, "both gamma and molar_mass_g_per_mol"),
        ({"gamma": 2.0, "molar_mass_g_per_mol": 20.0}, "between 1 and 5/3"),
        ({"gamma": 1.3, "molar_mass_g_per_mol": 0.0}, "must be from 1 to 500"),
        ({"colour": "blue"}, "unknown key 'gas.colour'"),
    ],
)
def test_an_impossible_gas_is_refused(table: dict[str, object], why: str) -> None:
    with pytest.raises(RigError, match=why):
        rig_from({"gas": table})


def test_a_fit_simulates_the_gas_too() -> None:
    pytest.importorskip("numba")
    from flying_vines.identification.case import Case, RecordedRun
    from flying_vines.identification.simulate import Simulation
    from flying_vines.physics.effects import cause_named
    from flying_vines.physics.plant.compiled import replay

    rig = Rig(cv=ControlVolume(0.5), gas=Gas("CO2"))
    made = setup(rig, "cv_heating", time_constant_s=1.5)
    openings = np.tile((1.0, 0.0, 0.0), (2000, 1))
    table = replay(made.plant, openings, at_rest(made.plant, 650.0, 5.0), record_every=20).table
    time_s, shut = table["time_s"].copy(), np.zeros(100)
    run = RecordedRun("run", time_s, None, shut + 1.0, shut, shut, shut, shut, None, None, False)
    simulation = Simulation(Case(Path("memory"), rig, (run,), ()))
    found = simulation.readings(0, {}, [(cause_named("cv_heating"), (1.5,))], np.array([[650.0, 5.0]]))
    assert found.cv_kPa == pytest.approx(table["cv_kPa"], abs=3e-4)
