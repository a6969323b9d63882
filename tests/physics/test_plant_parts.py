"""Each part of the plant alone agrees with closed forms or published numbers."""

from __future__ import annotations

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from plant_flows import flows

from flying_vines.physics.baseline import Inputs
from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.physics.plant.ambient import (
    Climb,
    Recorded,
    Steady,
    air_at,
)
from flying_vines.physics.plant.effects import DVP, Effects
from flying_vines.physics.plant.flow import (
    Iso6358,
    Ohm,
    conductance_from_rating_SL_per_s_kPa,
    flow_SL_per_s,
    iso6358_matching,
)
from flying_vines.physics.plant.plant import Plant, at_rest
from flying_vines.physics.plant.simulator import Simulator
from flying_vines.physics.plant.valve_response import (
    Coil,
    SolenoidTiming,
    ValveMotion,
    backlash,
    current_A,
    dead_zone,
    resistance_ohm,
    solenoid_after,
    temperature_after_K,
)
from flying_vines.physics.plant.venturi import Ejector, nozzle_supply, outlet_SL_per_s
from flying_vines.physics.plant.volume import Compliant, Pouch, pressure_and_volume, volume_and_work
from flying_vines.physics.rig import Hose, Rig

pressures = st.floats(20.0, 900.0)


def test_conductances_from_ratings() -> None:
    evp = conductance_from_rating_SL_per_s_kPa(23.5, 690.0)
    assert evp == pytest.approx(4.95e-4, rel=1e-3)
    assert 101.325 * evp == pytest.approx(0.0502, rel=1e-3)  # dm³/(s·bar), as in data sheets
    assert conductance_from_rating_SL_per_s_kPa(67.0, 690.0) == pytest.approx(1.41e-3, rel=2e-3)


def test_a_matching_valve_passes_what_ohm_does_there() -> None:
    for b in (0.0, 0.1, 0.3, 0.6):
        valve = iso6358_matching(2042.0, critical_pressure_ratio=b).numbers()
        assert flow_SL_per_s(valve, 791.325, 101.325, 1.0, 1.0) == pytest.approx(690.0 / 2042.0, rel=1e-12)


def test_the_linear_laws_error_grows_below_its_point() -> None:
    """R_v of the real valve at 69, 100, 200, 345, 500 kPa, in kPa per SLPM, b = 0.3."""
    valve = iso6358_matching(690.0 / 23.5 * 60.0, critical_pressure_ratio=0.3).numbers()
    for kPa, expected in ((69.0, 15.0), (100.0, 17.5), (200.0, 22.4), (345.0, 26.0), (500.0, 28.0)):
        flow_SLPM = 60.0 * flow_SL_per_s(valve, kPa + 101.325, 101.325, 1.0, 1.0)
        assert kPa / flow_SLPM == pytest.approx(expected, abs=0.15)


@given(pressures, pressures, st.floats(0.0, 0.6), st.sampled_from([0.5, 0.6]), st.sampled_from([0.0, 7.0]))
def test_a_valves_law(p1: float, p2: float, b: float, m: float, cracking_kPa: float) -> None:
    law = Iso6358(1e-3, b, m, cracking_kPa).numbers()

    def valve(p1: float, p2: float) -> float:
        return flow_SL_per_s(law, p1, p2, 1.0, 1.0)

    forwards = valve(p1, p2)
    assert forwards == -valve(p2, p1)
    assert forwards * (p1 - p2) >= 0.0
    assert abs(forwards) <= 1e-3 * max(p1, p2)
    if abs(p1 - p2) <= cracking_kPa:
        assert forwards == 0.0
    assert valve(p1 + 1.0, p2) >= forwards - 1e-12
    assert valve(p1, p2 + 1.0) <= forwards + 1e-12
    assert abs(valve(p1 + 1e-7, p2) - forwards) < 1e-6


def test_a_hot_gas_flows_less_and_nothing_flows_back_where_it_must_not() -> None:
    assert flow_SL_per_s(Iso6358(1e-3).numbers(), 500.0, 100.0, 1.21, 1.0) == pytest.approx(0.5 / 1.1)
    cold = Iso6358(1e-3, temperature_dependent=False).numbers()
    assert flow_SL_per_s(cold, 500.0, 100.0, 1.21, 1.0) == 0.5
    assert flow_SL_per_s(Iso6358(1e-3, one_way=True).numbers(), 100.0, 500.0, 1.0, 1.0) == 0.0


@pytest.mark.parametrize(
    "make",
    [
        lambda: Iso6358(0.0),
        lambda: Iso6358(1e-3, 1.0),
        lambda: Iso6358(1e-3, cracking_kPa=-1.0),
        lambda: Ohm(0.0),
        lambda: Compliant(-0.1),
        lambda: Pouch(0.0),
        lambda: Plant(Rig(), Effects(cv_shape=Pouch(0.2))),
        lambda: Effects(ejector=Ejector(nozzle_conductance_SL_per_s_kPa=1e-3)),
        lambda: Ejector(free_suction_per_motive=0.0),
        lambda: ValveMotion(dead_opening=1.0),
        lambda: SolenoidTiming(-0.1),
        lambda: Hose(0.0),
        lambda: Coil(supply_V=0.5),
        lambda: Recorded((0.0, 0.0), (100.0, 100.0), (290.0, 290.0)),
    ],
)
def test_what_cannot_be(make: object) -> None:
    assert callable(make)
    with pytest.raises(ValueError, match=r"\w"):
        make()


@given(st.floats(0.001, 0.05), st.floats(-50.0, 100.0), st.sampled_from([0.0, 0.4]))
def test_a_shape_is_found_again_from_its_energy(k: float, kPa: float, g: float) -> None:
    for shape in (Compliant(k), Pouch(0.01, k), Compliant()):
        chamber = shape.numbers(0.1, g)
        volume_L, work_J = volume_and_work(chamber, kPa, 95.0, 0.0)
        energy = (kPa + 95.0) * volume_L + g * work_J
        found = pressure_and_volume(chamber, energy, 95.0)
        assert found == pytest.approx((kPa + 95.0, volume_L), rel=1e-12)


def test_work_is_the_area_under_the_pressure() -> None:
    shape = Pouch(0.02, 0.01)
    volume_L, work_J = volume_and_work(shape.numbers(0.1, 0.4), 40.0, 101.325, 0.0)
    steps = 4000
    area = 101.325 * 0.08 + sum(
        (101.325 + 40.0 * (i + 0.5) / steps) * 0.1 * 0.01 * 40.0 / steps for i in range(steps)
    )
    assert volume_L == pytest.approx(0.14)
    assert work_J == pytest.approx(area, rel=1e-9)


def test_backlash_and_dead_zone() -> None:
    held, path = 0.0, []
    for command in (0.05, 0.3, 0.5, 0.45, 0.35, 0.2, 0.0, 0.1, 0.2):
        held = backlash(held, command, 0.2)
        path.append(held)
    assert path == pytest.approx([0.0, 0.2, 0.4, 0.4, 0.4, 0.3, 0.0, 0.0, 0.1])
    assert backlash(0.3, 0.7, 0.0) == 0.7
    assert [dead_zone(u, 0.25) for u in (0.0, 0.25, 0.625, 1.0)] == [0.0, 0.0, 0.5, 1.0]


def test_a_delayed_valve_still_follows_the_command_before() -> None:
    plant = Plant(Rig(), Effects(evp_motion=ValveMotion(delay_s=0.003)))
    simulator = Simulator(plant, initial=Inputs(0.9, 0.0, False))
    targets = []
    for command in (0.1, 0.2, 0.3, 0.4, 0.5):
        simulator.advance(Inputs(command, 0.0, False))
        targets.append(simulator.held.evp_target)
    assert targets == [0.9, 0.9, 0.9, 0.1, 0.2]


def test_a_slow_solenoid() -> None:
    commanded = [True] * 4 + [False] * 5 + [True, False, False, False, False]
    is_open, waited, seen = False, 0, []
    for commanded_open in commanded:
        is_open, waited = solenoid_after(is_open, waited, commanded_open, 2, 3)
        seen.append(int(is_open))
    assert seen == [0, 0, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0]


def test_a_warm_coil_passes_less_current() -> None:
    coil = Coil()
    assert current_A(coil, 1.0, 293.15) == pytest.approx(0.37, abs=0.003)
    assert resistance_ohm(coil, 318.15) == pytest.approx(13.5 * 1.0975)
    assert current_A(coil, 1.0, 318.15) < 0.93 * current_A(coil, 1.0, 293.15)


def test_a_coil_comes_to_rest_where_heat_in_is_heat_out() -> None:
    coil = Coil(heat_capacity_J_per_K=1.0)
    final_K = 293.15
    for _ in range(20_000):
        final_K = temperature_after_K(coil, final_K, current_A(coil, 1.0, final_K), 293.15, 0.05)
    current = current_A(coil, 1.0, final_K)
    assert current**2 * resistance_ohm(coil, final_K) == pytest.approx((final_K - 293.15) / 25.0, rel=1e-9)
    assert 320.0 < final_K < 350.0
    assert temperature_after_K(
        dataclasses.replace(coil, thermal_resistance_K_per_W=0.0), 300.0, 1.0, 290.0, 1.0
    ) == pytest.approx(290.0)


def test_a_valve_driven_by_a_warm_coil_opens_less() -> None:
    plant = Plant(Rig(), Effects(evp_coil=Coil(heat_capacity_J_per_K=0.05), evp_motion=ValveMotion()))
    simulator = Simulator(plant)
    openings = []
    for _ in range(5000):
        simulator.advance(Inputs(0.9, 0.0, False))
        openings.append(simulator.state.evp_opening)
    assert openings[0] == pytest.approx(0.9, abs=0.01)
    assert openings[-1] < 0.95 * openings[0]


def test_the_pressure_at_the_valves_is_above_the_one_in_the_volume() -> None:
    """By R Q while air flows; a part of the flow is stored in the tube. Without flow both are equal."""
    plant = Plant(Rig(), Effects(tubing=Hose(0.005, 8.0)))
    simulator = Simulator(plant)
    for _ in range(50):
        simulator.advance(Inputs(1.0, 0.0, False))
    found = simulator.conditions
    air = air_at(plant.ambient, simulator.t_s)
    flow = flows(simulator.numbers, air, 0.0, simulator.state, simulator.held).line_to_cv_SL_per_s
    assert found.line_kPa - found.cv_kPa == pytest.approx(8.0 * flow, rel=1e-12)
    assert flow == pytest.approx((690.0 - found.line_kPa) / 2042.0 * 0.1 / 0.105, rel=0.05)
    for _ in range(50):
        simulator.advance(Inputs(0.0, 0.0, False))
    assert simulator.conditions.line_kPa == pytest.approx(simulator.conditions.cv_kPa, abs=1e-9)


def test_a_sealed_tank_shows_more_at_altitude() -> None:
    plant = Plant(Rig(), Effects(ambient=Climb(0.2)))
    simulator = Simulator(plant)
    for _ in range(1000):
        simulator.advance(Inputs(0.0, 0.0, False))
    assert simulator.conditions.reservoir_kPa == pytest.approx(690.2, abs=1e-9)
    recorded = Recorded((0.0, 10.0), (101.325, 79.5), (293.15, 280.15))
    assert recorded.at(5.0) == pytest.approx((90.4125, 286.65, -2.1825))
    assert recorded.at(-1.0) == (101.325, 293.15, 0.0)
    assert recorded.at(11.0) == (79.5, 280.15, 0.0)
    assert Steady().at(3.0) == (101.325, 293.15, 0.0)


def test_a_sealed_fill_in_the_cold() -> None:
    """690 kPa at 20 °C is 582 at −20 °C and 757 at 45 °C."""
    start = at_rest(Plant())
    for celsius, expected in ((-20.0, 582.0), (0.0, 636.0), (45.0, 757.0)):
        plant = Plant(Rig(), Effects(ambient=Steady(101.325, 273.15 + celsius)))
        assert Simulator(plant, start).conditions.reservoir_kPa == pytest.approx(expected, abs=1.0)


@given(st.floats(1e-5, 1e-2), st.floats(1e-4, 1e-2), st.floats(102.0, 900.0))
def test_valve_and_nozzle_pass_the_same(valve: float, nozzle: float, supply: float) -> None:
    flow, between = nozzle_supply(valve, nozzle, supply, 101.325)
    assert flow == pytest.approx(valve * math.sqrt(supply**2 - between**2), rel=1e-5, abs=1e-9)
    assert flow == pytest.approx(nozzle * math.sqrt(between**2 - 101.325**2), rel=1e-5, abs=1e-9)


def test_the_nozzle_takes_most_of_the_pressure() -> None:
    """Computed independently with b = 0.3: 45.7 SLPM at 643 kPa before the nozzle; b = 0 gives 7 % less."""
    flow, between = nozzle_supply(DVP.sonic_conductance_SL_per_s_kPa, 1.185e-3, 791.325, 101.325)
    assert 60.0 * flow == pytest.approx(45.7, rel=0.08)
    assert between == pytest.approx(643.0, rel=0.06)


def drawn(ejector: Ejector, law: Ohm | Iso6358, p: float, theta: float, vacuum: float, free: float) -> float:
    """Flow from a volume at `p` into an ejector with the free suction `free`."""
    venturi = dataclasses.replace(ejector, free_suction_per_motive=1.0).numbers(Rig().venturi)
    return outlet_SL_per_s(venturi, law.numbers(), p, theta, 101.325, 1.0, vacuum, free)


@given(
    st.floats(20.0, 300.0),
    st.floats(0.8, 1.2),
    st.floats(0.1, 80.0),
    st.floats(0.001, 1.0),
    st.floats(0.0, 0.6),
    st.floats(1.0, 30.0),
)
def test_the_suction_flow_of_an_ejector_is_that_of_its_characteristic(
    p: float, theta: float, vacuum: float, free: float, b: float, passage: float
) -> None:
    ejector = Ejector(passage_resistance_kPa_s_per_SL=passage)
    law = Iso6358(3e-3, b)
    quick = drawn(ejector, law, p, theta, vacuum, free)
    # With an index other than 1/2 the pressure in between is found by iteration.
    slow = drawn(ejector, dataclasses.replace(law, subsonic_index=0.5 + 1e-12), p, theta, vacuum, free)
    assert quick == pytest.approx(slow, rel=1e-5, abs=1e-7)
    ohmic = drawn(ejector, Ohm(70.0), p, theta, vacuum, free)
    if p > 101.325 - vacuum:
        port = p - 70.0 * ohmic - 101.325
        assert ohmic == pytest.approx(
            free + port / passage if port > 0.0 else free * (1.0 + port / vacuum), rel=1e-9, abs=1e-12
        )


@given(st.floats(1.0, 150.0), st.floats(0.0, 0.6))
def test_a_venturi_at_rest_is_an_open_pipe(p: float, b: float) -> None:
    law = Iso6358(3e-3, b)
    flow = drawn(Ejector(passage_resistance_kPa_s_per_SL=5.0), law, p, 1.0, 0.0, 0.0)
    through = flow_SL_per_s(law.numbers(), p, 101.325 + 5.0 * flow, 1.0, 1.0)
    assert flow == pytest.approx(through, rel=1e-6, abs=1e-7)


def test_a_stalled_venturi_makes_no_vacuum() -> None:
    plant = Plant(Rig(), Effects(ejector=Ejector(stall_supply_kPa=300.0)))
    for kPa, lowest, highest in ((299.0, -0.01, 0.01), (500.0, -46.0, -30.0)):
        simulator = Simulator(plant, at_rest(plant, kPa))
        for _ in range(150):
            simulator.advance(Inputs(0.0, 1.0, True))
        assert lowest < simulator.conditions.cv_kPa < highest


def test_thin_air_makes_less_vacuum() -> None:
    effects = Effects(ejector=Ejector(scales_with_ambient=True), ambient=Steady(79.5, 293.15))
    simulator = Simulator(Plant(Rig(), effects))
    for _ in range(700):
        simulator.advance(Inputs(0.0, 1.0, True))
    assert simulator.conditions.reservoir_kPa > 600.0
    assert simulator.conditions.cv_kPa == pytest.approx(-55.0 * 79.5 / ALPHA_KPA, rel=1e-3)
