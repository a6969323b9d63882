"""Air and energy are conserved for any rig and any commands."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plant_flows import flows

from examples import examples
from flying_vines.physics.baseline import Inputs
from flying_vines.physics.plant.ambient import Climb, Recorded, Steady, air_at
from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.flow import Iso6358, Ohm
from flying_vines.physics.plant.numbers import numbers_of
from flying_vines.physics.plant.plant import Held, Plant, State, at_rest
from flying_vines.physics.plant.rates import conditions, rates
from flying_vines.physics.plant.simulator import TICK_S, Simulator
from flying_vines.physics.plant.valve_response import SolenoidTiming, ValveMotion
from flying_vines.physics.plant.venturi import Ejector
from flying_vines.physics.plant.volume import Compliant, Pouch, Wall
from flying_vines.physics.rig import ControlVolume, Hose, Reservoir, Rig

R_J_PER_KG_K = 287.05
C_V = R_J_PER_KG_K / 0.4
C_P = C_V + R_J_PER_KG_K
KG_PER_SL = 101.325 / (R_J_PER_KG_K * 293.15)
"""101.325 kPa in a litre is 101.325 J."""

volumes = st.floats(0.05, 10.0)
openings = st.one_of(st.just(0.0), st.just(1.0), st.floats(0.0, 1.0))


def isos(conductance: float) -> st.SearchStrategy[Iso6358]:
    return st.builds(
        Iso6358,
        st.floats(conductance / 3.0, conductance * 3.0),
        st.floats(0.0, 0.6),
        st.sampled_from([0.5, 0.6]),
        st.sampled_from([0.0, 5.0]),
        st.sampled_from([0.99, 0.995]),
        st.booleans(),
        st.booleans(),
    )


walls = st.builds(
    Wall,
    st.one_of(st.just(math.inf), st.floats(0.05, 30.0)),
    st.floats(0.0, 3.0),
    st.one_of(st.just(math.inf), st.floats(5.0, 100.0)),
    st.floats(0.0, 2.0),
)
rigs = st.builds(Rig, st.builds(Reservoir, volumes), st.one_of(st.none(), st.builds(ControlVolume, volumes)))


def effects_with(walls: st.SearchStrategy[Wall | None]) -> st.SearchStrategy[Effects]:
    dvp = isos(1.4e-3)
    ejectors = st.builds(
        Ejector, st.sampled_from([0.0, 300.0]), st.none(), st.one_of(st.none(), st.just(0.6)), st.just(5.0)
    )
    return st.builds(
        Effects,
        evp_law=st.one_of(st.none(), isos(5e-4)),
        dvp_law=dvp,
        solenoid_law=st.one_of(st.none(), isos(3e-3)),
        ejector=st.one_of(st.none(), ejectors, st.just(Ejector(0.0, 1.2e-3, 0.6, scales_with_ambient=True))),
        reservoir_wall=walls,
        cv_wall=walls,
        evp_motion=st.sampled_from([None, ValveMotion(0.003, 0.1, 0.2, 0.01)]),
        dvp_motion=st.sampled_from([None, ValveMotion(time_constant_s=0.02)]),
        solenoid_timing=st.sampled_from([None, SolenoidTiming(0.005, 0.01)]),
        tubing=st.one_of(st.none(), st.builds(Hose, st.floats(0.005, 0.03), st.floats(3.0, 30.0))),
        cv_shape=st.sampled_from([None, Compliant(0.01), Pouch(), Pouch(0.02, 0.005)]),
        reservoir_leak=st.sampled_from([None, Ohm(500.0)]),
        cv_leak=st.sampled_from([None, Ohm(200.0), Iso6358(1e-4)]),
        ambient=st.sampled_from(
            [
                None,
                Steady(70.0, 260.0),
                Climb(0.2),
                Recorded((0.0, 0.05, 1.0), (101.0, 100.0, 104.0), (290.0, 280.0, 300.0)),
            ]
        ),
    )


plants = st.builds(Plant, rigs, effects_with(st.one_of(st.none(), walls)))
warm_plants = st.builds(Plant, rigs, effects_with(walls))
# An empty and a full reservoir, and a control volume above the reservoir's pressure.
reservoirs_kPa = st.one_of(st.just(0.0), st.floats(0.0, 5.0), st.floats(0.0, 760.0))
cvs_kPa = st.one_of(st.just(0.0), st.floats(-40.0, 30.0), st.floats(0.0, 800.0))
ratios = st.floats(0.8, 1.2)
commands = st.lists(st.builds(Inputs, openings, openings, st.booleans()), min_size=1, max_size=5)


def air_SL(state: State) -> float:
    return state.reservoir_air_SL + state.cv_air_SL + state.line_air_SL + state.vented_SL


@settings(max_examples=examples(800), deadline=None)
@given(plants, reservoirs_kPa, cvs_kPa, commands)
def test_no_air_is_lost_or_made(
    plant: Plant, reservoir_kPa: float, cv_kPa: float, given_commands: list[Inputs]
) -> None:
    simulator = Simulator(plant, at_rest(plant, reservoir_kPa, cv_kPa))
    before = air_SL(simulator.state)
    for command in given_commands:
        for _ in range(15):
            simulator.advance(command)
    assert air_SL(simulator.state) == pytest.approx(before, rel=1e-12)
    found = simulator.conditions
    assert found.reservoir_kPa + found.ambient_kPa > 0.0
    assert found.cv_kPa + found.ambient_kPa > 0.0
    assert 100.0 < found.reservoir_K < 600.0
    assert 100.0 < found.cv_K < 900.0
    if plant.rig.cv is not None:
        assert found.cv_kPa <= max(reservoir_kPa, cv_kPa) * 1.5 + 10.0


@settings(max_examples=examples(300), deadline=None)
@given(
    warm_plants,
    reservoirs_kPa,
    cvs_kPa,
    openings,
    openings,
    st.booleans(),
    st.floats(0.8, 1.2),
    st.floats(0.8, 1.2),
)
def test_the_first_law_at_every_instant(
    plant: Plant,
    reservoir_kPa: float,
    cv_kPa: float,
    evp: float,
    dvp: float,
    solenoid: bool,
    warm: float,
    cold: float,
) -> None:
    """The change of m c_v T of gas and walls is enthalpy of flows, heat, and work at the moving wall. In
    SI."""
    numbers, t_s = numbers_of(plant, TICK_S), 0.02
    air = air_at(plant.ambient, t_s)
    state = at_rest(plant, reservoir_kPa, cv_kPa, t_s=t_s, pouch_volume_L=0.03)
    state = state._replace(
        reservoir_pV_J=state.reservoir_pV_J * warm,
        cv_energy_J=state.cv_energy_J * cold,
        reservoir_wall_K=state.reservoir_wall_K * cold,
        cv_wall_K=state.cv_wall_K * warm,
        evp_opening=evp,
        dvp_opening=dvp,
    )
    held = Held(evp, dvp, solenoid)
    change = State(*rates(numbers, air, 0.0, state, held))
    flow = flows(numbers, air, 0.0, state, held)

    def enthalpy_W(SL_per_s: float, ratio: float) -> float:
        return KG_PER_SL * SL_per_s * C_P * ratio * 293.15

    out_of_reservoir = (
        enthalpy_W(flow.inflation_SL_per_s, flow.inflation_ratio)
        + enthalpy_W(flow.motive_SL_per_s, flow.motive_ratio)
        + enthalpy_W(flow.reservoir_leak_SL_per_s, flow.reservoir_leak_ratio)
    )

    def temperature_rate(air: float, air_rate: float, pV: float, pV_rate: float) -> float:
        return 293.15 / 101.325 * (pV_rate / air - pV * air_rate / air**2)

    mass = state.reservoir_air_SL * KG_PER_SL
    kelvin = conditions(numbers, air, state).reservoir_K
    stored_W = C_V * (
        mass
        * temperature_rate(
            state.reservoir_air_SL, change.reservoir_air_SL, state.reservoir_pV_J, change.reservoir_pV_J
        )
        + change.reservoir_air_SL * KG_PER_SL * kelvin
    )
    assert stored_W == pytest.approx(flow.reservoir_heat_W - out_of_reservoir, rel=1e-9, abs=1e-6)
    assert change.reservoir_air_SL == pytest.approx(
        -(flow.inflation_SL_per_s + flow.motive_SL_per_s + flow.reservoir_leak_SL_per_s), abs=1e-15
    )
    if plant.rig.cv is None:
        return

    if plant.effects.tubing is None:
        entering = enthalpy_W(flow.inflation_SL_per_s, flow.inflation_ratio) - enthalpy_W(
            flow.outlet_SL_per_s, flow.outlet_ratio
        )
    else:
        entering = enthalpy_W(flow.line_to_cv_SL_per_s, flow.line_to_cv_ratio)
    entering -= enthalpy_W(flow.cv_leak_SL_per_s, flow.cv_leak_ratio)

    def at(moment_s: float) -> tuple[float, float]:
        moved = State(*(value + moment_s * rate for value, rate in zip(state, change, strict=True)))
        found = conditions(numbers, air_at(plant.ambient, t_s + moment_s), moved)
        return found.cv_volume_L, found.cv_kPa + found.ambient_kPa

    # Shorter than all time constants. Where a pouch becomes full or flat, both sides differ.
    moment_s = 1e-7
    (volume_before, p_before), (_, p), (volume_after, p_after) = at(-moment_s), at(0.0), at(moment_s)
    work_W = p * (volume_after - volume_before) / (2.0 * moment_s)
    stored_W = (p_after * volume_after - p_before * volume_before) / 0.4 / (2.0 * moment_s)
    found = conditions(numbers, air, state)
    volume_L, gauge_kPa = found.cv_volume_L, found.cv_kPa
    flat_L = getattr(plant.effects.cv_shape, "flat_volume_L", plant.rig.cv.volume_L)
    edges_L = (flat_L, plant.rig.cv.volume_L)
    on_an_edge = abs(gauge_kPa) < 1e-3 and min(abs(volume_L - edge_L) for edge_L in edges_L) < 1e-5
    if not on_an_edge:
        assert stored_W == pytest.approx(entering + flow.cv_heat_W - work_W, rel=1e-4, abs=2e-3)
    if math.isfinite(plant.effects.cv_wall.capacity_J_per_K if plant.effects.cv_wall else math.inf):
        assert plant.effects.cv_wall is not None
        wall_W = plant.effects.cv_wall.capacity_J_per_K * change.cv_wall_K
        outside_W = plant.effects.cv_wall.outer_conductance_W_per_K * (found.ambient_K - state.cv_wall_K)
        assert wall_W == pytest.approx(outside_W - flow.cv_heat_W, abs=1e-9, rel=1e-9)


@settings(max_examples=examples(80), deadline=None)
@given(
    st.builds(Reservoir, volumes),
    st.builds(ControlVolume, volumes),
    st.one_of(st.none(), isos(5e-4)),
    st.floats(0.0, 760.0),
    st.floats(-40.0, 760.0),
    commands,
    st.floats(0.0, 3.0),
)
def test_a_closed_rig_keeps_its_energy(
    reservoir: Reservoir,
    cv: ControlVolume,
    law: Iso6358 | None,
    reservoir_kPa: float,
    cv_kPa: float,
    given_commands: list[Inputs],
    conductance: float,
) -> None:
    """Two volumes with walls, isolated: the energy of gas and walls is constant."""
    wall = Wall(conductance_W_per_K=conductance, capacity_J_per_K=20.0, outer_conductance_W_per_K=0.0)
    plant = Plant(Rig(reservoir, cv), Effects(evp_law=law, reservoir_wall=wall, cv_wall=wall))
    simulator = Simulator(plant, at_rest(plant, reservoir_kPa, cv_kPa))

    def energy_J(state: State) -> float:
        gas = (state.reservoir_pV_J + state.cv_energy_J) / 0.4
        return gas + 20.0 * (state.reservoir_wall_K + state.cv_wall_K)

    before = energy_J(simulator.state)
    for command in given_commands:
        for _ in range(40):
            simulator.advance(Inputs(command.evp, 0.0, False))
    assert energy_J(simulator.state) == pytest.approx(before, rel=1e-12)


@settings(max_examples=examples(60), deadline=None)
@given(warm_plants, st.floats(100.0, 760.0), commands)
def test_the_vented_air_is_the_sum_of_the_flows(
    plant: Plant, reservoir_kPa: float, given_commands: list[Inputs]
) -> None:
    """The balances agree with the independently summed flows."""
    simulator = Simulator(plant, at_rest(plant, reservoir_kPa))
    total = 0.0
    for command in given_commands:
        for _ in range(10):
            before, t_s = simulator.state, simulator.t_s
            simulator.advance(command)
            ends = [
                flows(simulator.numbers, air_at(plant.ambient, at_s), 0.0, state, simulator.held)
                for at_s, state in ((t_s, before), (simulator.t_s, simulator.state))
            ]
            for flow in ends:
                total += 0.0005 * (
                    flow.motive_SL_per_s
                    + flow.outlet_SL_per_s
                    + flow.reservoir_leak_SL_per_s
                    + flow.cv_leak_SL_per_s
                    + (flow.inflation_SL_per_s if plant.rig.cv is None else 0.0)
                )
    assert simulator.state.vented_SL == pytest.approx(total, abs=2e-3, rel=0.02)
