"""The plant agrees with closed forms: no effects, adiabatic, isothermal, choked flow."""

from __future__ import annotations

import pytest
from closed_forms import (
    adiabatic_choked_discharge_kPa_abs,
    choked_time_constant_s,
    isothermal_choked_discharge_kPa_abs,
    polytropic_temperature_K,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from examples import examples
from flying_vines.physics import baseline
from flying_vines.physics.baseline import Inputs
from flying_vines.physics.gas import GAMMA
from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.flow import Iso6358
from flying_vines.physics.plant.plant import Plant, air_SL, at_rest
from flying_vines.physics.plant.simulator import Simulator
from flying_vines.physics.plant.volume import Pouch, Wall
from flying_vines.physics.rig import ControlVolume, Evp, Reservoir, Rig

volumes = st.floats(0.05, 10.0)
rigs = st.builds(
    Rig,
    reservoir=st.builds(Reservoir, volumes),
    cv=st.one_of(st.none(), st.builds(ControlVolume, volumes)),
)
openings = st.one_of(st.just(0.0), st.just(1.0), st.floats(0.0, 1.0))
commands = st.lists(st.builds(Inputs, openings, openings, st.booleans()), min_size=1, max_size=5)

OPEN = Inputs(1.0, 0.0, False)
SHUT = Inputs(0.0, 0.0, False)
ADIABATIC = Wall()


def run(simulator: Simulator, command: Inputs, seconds: float) -> Simulator:
    for _ in range(round(seconds * 1000)):
        simulator.advance(command)
    return simulator


def discharging(
    effects: Effects, *, volume_L: float = 2.0, kPa: float = 690.0, resistance: float = 2042.0
) -> Simulator:
    rig = Rig(reservoir=Reservoir(volume_L), cv=None, evp=Evp(resistance))
    plant = Plant(rig, effects)
    return Simulator(plant, at_rest(plant, kPa))


@settings(max_examples=examples(40), deadline=None)
@given(rigs, st.floats(0.0, 760.0), st.floats(-50.0, 60.0), commands)
def test_without_effects_it_is_the_baseline(
    rig: Rig, reservoir_kPa: float, cv_kPa: float, given_commands: list[Inputs]
) -> None:
    cv_kPa = 0.0 if rig.cv is None else cv_kPa
    plant = Plant(rig)
    simulator = Simulator(plant, at_rest(plant, reservoir_kPa, cv_kPa))
    state = baseline.BaselineState(reservoir_kPa, cv_kPa)
    for command in given_commands:
        for _ in range(20):
            simulator.advance(command)
            state = baseline.step(rig, state, command, 0.001)
            found = simulator.conditions
            assert found.reservoir_kPa == pytest.approx(state.reservoir_kPa, abs=1e-9)
            assert found.cv_kPa == pytest.approx(state.cv_kPa, abs=1e-9)


def test_choked_and_isothermal_is_an_exponential_of_absolute_pressure() -> None:
    simulator = run(discharging(Effects(evp_law=Iso6358(5e-4, 0.3))), OPEN, 20.0)
    tau_s = choked_time_constant_s(2.0, 5e-4)
    expected = isothermal_choked_discharge_kPa_abs(791.325, 20.0, tau_s) - 101.325
    assert expected > 101.325 / 0.3 - 101.325
    assert simulator.conditions.reservoir_kPa == pytest.approx(expected, rel=1e-9)


def test_choked_and_adiabatic_is_the_closed_form() -> None:
    simulator = run(discharging(Effects(evp_law=Iso6358(5e-4, 0.3), reservoir_wall=ADIABATIC)), OPEN, 15.0)
    tau_s = choked_time_constant_s(2.0, 5e-4)
    expected = adiabatic_choked_discharge_kPa_abs(791.325, 15.0, tau_s)
    assert expected > 101.325 / 0.3
    found = simulator.conditions
    assert found.reservoir_kPa + 101.325 == pytest.approx(expected, rel=1e-9)
    assert found.reservoir_K == pytest.approx(polytropic_temperature_K(293.15, 791.325, expected), rel=1e-9)


@given(st.floats(0.05, 10.0), st.floats(50.0, 760.0), st.floats(0.05, 1.0))
@settings(max_examples=20, deadline=None)
def test_gas_left_behind_without_heat_is_polytropic(volume_L: float, kPa: float, opening: float) -> None:
    """For any flow law: T = T₀ (p/p₀)^((γ−1)/γ)."""
    simulator = run(
        discharging(Effects(reservoir_wall=ADIABATIC), volume_L=volume_L, kPa=kPa),
        Inputs(opening, 0.0, False),
        0.3,
    )
    found = simulator.conditions
    expected = polytropic_temperature_K(293.15, kPa + 101.325, found.reservoir_kPa + 101.325)
    assert found.reservoir_K == pytest.approx(expected, rel=1e-8)


def test_filling_an_empty_rigid_volume_without_heat_warms_it_by_gamma() -> None:
    """Air at T₀ that flows into a vacuum reaches γ T₀."""
    plant = Plant(Rig(cv=ControlVolume(0.5)), Effects(cv_wall=ADIABATIC))
    simulator = run(Simulator(plant, at_rest(plant, 690.0, -101.2)), OPEN, 1.0)
    entered = GAMMA * 293.15
    start_SL, now_SL = air_SL(0.125, 0.5), simulator.state.cv_air_SL
    expected = (start_SL * 293.15 + (now_SL - start_SL) * entered) / now_SL
    assert simulator.conditions.cv_K == pytest.approx(expected, rel=1e-9)


def test_between_the_limits_of_heat_transfer() -> None:
    def after(effects: Effects, seconds: float = 10.0) -> float:
        return run(discharging(effects), OPEN, seconds).conditions.reservoir_kPa

    isothermal = after(Effects())
    adiabatic = after(Effects(reservoir_wall=ADIABATIC))
    some = after(Effects(reservoir_wall=Wall(10.0)))
    assert adiabatic + 10.0 < some < isothermal - 10.0
    assert after(Effects(reservoir_wall=Wall(0.005))) == pytest.approx(isothermal, abs=0.05)
    assert after(Effects(reservoir_wall=Wall(conductance_W_per_K=3000.0))) == pytest.approx(
        isothermal, abs=0.05
    )
    assert after(Effects(reservoir_wall=Wall(1e9))) == pytest.approx(adiabatic, abs=1e-5)
    # A wall that is much lighter than the gas, and insulated outside, gives no heat.
    light = Wall(0.1, capacity_J_per_K=1e-3, outer_conductance_W_per_K=0.0)
    adiabatic = after(Effects(reservoir_wall=ADIABATIC), 1.0)
    assert after(Effects(reservoir_wall=light), 1.0) == pytest.approx(adiabatic, abs=0.05)


@pytest.mark.long
def test_a_reservoir_that_is_shut_again_recovers_what_its_temperature_lost() -> None:
    """The stop method: T at the moment of shutting is T_room p / p_recovered, absolute."""
    simulator = run(discharging(Effects(evp_law=Iso6358(5e-4), reservoir_wall=Wall(3.0))), OPEN, 10.0)
    then = simulator.conditions
    now = run(simulator, SHUT, 45.0).conditions
    recovered = (then.reservoir_kPa + 101.325) / (now.reservoir_kPa + 101.325) * 293.15
    assert now.reservoir_kPa - then.reservoir_kPa > 10.0
    assert then.reservoir_K == pytest.approx(recovered, rel=1e-5)


def test_a_pouch_fills_at_ambient_pressure_and_holds_0_120_SL() -> None:
    """0.1 L at 20.7 kPa holds V (p_a + P) / α = 0.120 SL, not the 0.020 SL of a rigid volume."""
    plant = Plant(Rig(), Effects(cv_shape=Pouch(flat_volume_L=0.0005)))
    simulator = Simulator(plant, at_rest(plant))
    flow = Inputs(0.3, 0.0, False)
    while simulator.conditions.cv_volume_L < 0.0999:
        assert simulator.conditions.cv_kPa == 0.0
        simulator.advance(flow)
    while simulator.conditions.cv_kPa < 20.7:
        simulator.advance(flow)
    found = simulator.conditions
    assert simulator.state.cv_air_SL == pytest.approx(0.1 * (101.325 + found.cv_kPa) / 101.325, rel=1e-12)
    assert simulator.state.cv_air_SL == pytest.approx(0.120, abs=0.001)
    assert found.cv_volume_L == 0.1


def test_a_pouch_fills_without_heat_at_the_temperature_of_what_enters() -> None:
    """At constant pressure inflow does not change T; in a rigid volume it warms the gas."""
    plant = Plant(Rig(), Effects(cv_shape=Pouch(), cv_wall=ADIABATIC))
    simulator = run(Simulator(plant, at_rest(plant)), Inputs(0.3, 0.0, False), 0.5)
    found = simulator.conditions
    assert 0.01 < found.cv_volume_L < 0.1
    assert found.cv_K == pytest.approx(293.15, rel=1e-9)
