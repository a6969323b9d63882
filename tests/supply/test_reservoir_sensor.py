"""A wrong sensor of the reservoir is found: cycles unknown. Warming and cold gas are no fault."""

from __future__ import annotations

import random

import pytest
from reservoir_bench import Bench

from flying_vines.config.config import PneumaticsConfig
from flying_vines.supply import ReportedCycles

RISES = "reservoir sensor rises without filling: cycles unknown"
STAYS = "reservoir sensor does not fall as the vine fills: cycles unknown"
NOISE = random.Random(7)


def stuck(_: float) -> float:
    return NOISE.gauss(690.0, 0.3)


def stick(bench: Bench) -> None:
    reading_kPa = bench.reservoir_kPa - bench.cold_kPa
    bench.lie = lambda _: NOISE.gauss(reading_kPa, 0.3)


def bends_until_found(bench: Bench, most: int) -> int:
    for bends in range(1, most + 1):
        bench.bend()
        if bench.in_doubt:
            return bends
    pytest.fail(f"not found in {most} bends")


def drift(bench: Bench, kPa_per_s: float) -> None:
    began_s = bench.t
    bench.lie = lambda reading_kPa: reading_kPa + kPa_per_s * (bench.t - began_s)


def test_a_sensor_that_is_stuck_with_noise_from_the_start_is_found_within_twelve_bends() -> None:
    bench = Bench()
    bench.lie = stuck
    bench.rest(3.0)
    assert bends_until_found(bench, 12) > 1
    assert bench.in_doubt == STAYS


def test_a_sensor_that_sticks_in_flight_is_found_within_four_bends() -> None:
    bench = Bench()
    bench.fly(8)
    assert bench.in_doubt == ""
    stick(bench)
    bends_until_found(bench, 4)
    assert bench.in_doubt == STAYS


@pytest.mark.parametrize(("kPa_per_s", "most"), [(2.0, 6), (10.0, 1)])
def test_a_sensor_that_drifts_up_is_found(kPa_per_s: float, most: int) -> None:
    bench = Bench()
    bench.fly(8)
    drift(bench, kPa_per_s)
    bends_until_found(bench, most)


def test_a_sensor_that_drifts_up_while_nothing_bends_is_found() -> None:
    bench = Bench()
    bench.fly(8)
    drift(bench, 0.5)
    bench.bend(3)
    bench.rest(60.0)
    assert bench.in_doubt == RISES


@pytest.mark.parametrize("jump_kPa", [15.0, 450.0])
def test_a_jump_up_of_an_armed_vehicles_reading_is_no_refill(jump_kPa: float) -> None:
    bench = Bench(start_kPa=200.0)
    cycles = ReportedCycles(bench.estimate)
    bench.fly(4)
    assert cycles.update(bench.t, False) == ""
    bench.lie = lambda reading_kPa: reading_kPa + jump_kPa
    bench.rest(2.0)
    assert bench.in_doubt == RISES
    assert cycles.update(bench.t, False, bool(bench.in_doubt)) == ""
    assert cycles.left is None


def test_a_rise_that_the_check_allows_is_not_called_a_refill_in_flight() -> None:
    bench = Bench(start_kPa=400.0)
    cycles = ReportedCycles(bench.estimate)
    bench.fly(4)
    cycles.update(bench.t, False, armed=True)
    assert bench.estimate.filter is not None
    bench.estimate.filter.jumped_kPa = 7.0
    bench.t += 20.0
    assert cycles.update(bench.t, False, armed=True).startswith("reservoir pressure rose, ")


def test_a_refill_of_a_disarmed_vehicle_is_no_fault_and_gives_new_cycles() -> None:
    bench = Bench(start_kPa=200.0)
    cycles = ReportedCycles(bench.estimate)
    bench.fly(4)
    cycles.update(bench.t, False)
    bench.armed = False
    bench.rest(2.0)
    bench.reservoir_kPa, bench.cold_kPa = 690.0, -20.0
    bench.rest(2.0)
    assert cycles.update(bench.t, False, bool(bench.in_doubt)).startswith("reservoir refilled, ")
    bench.armed = True
    bench.bend(8)
    assert bench.in_doubt == ""


def test_a_slow_refill_that_ends_as_the_vehicle_is_armed_is_no_fault() -> None:
    bench = Bench(start_kPa=400.0)
    bench.fly(3)
    bench.armed = False
    for _ in range(100):
        bench.reservoir_kPa += 0.5
        bench.rest(0.37)
    bench.armed = True
    bench.bend(5)
    assert bench.in_doubt == ""


def test_gas_that_warms_up_after_fast_bends_is_no_fault() -> None:
    bench = Bench(cost_kPa=9.0)
    bench.recovery_s = 30.0
    bench.rest(3.0)
    bench.bend(15, hold_s=0.2, rest_s=0.2)
    bench.rest(120.0)
    assert bench.in_doubt == ""


def test_the_sun_is_no_fault() -> None:
    bench = Bench()
    bench.rest(3.0)
    for _ in range(120):
        bench.reservoir_kPa += 0.1
        bench.rest(1.0)
    bench.bend(5)
    assert bench.in_doubt == ""


@pytest.mark.parametrize("seed", range(3))
def test_a_rig_that_uses_half_of_the_expected_air_is_not_stuck(seed: int) -> None:
    """The demonstration's rigid vine would take 1 kPa for each bend."""
    bench = Bench(cost_kPa=0.5, seed=seed)
    bench.rest(3.0)
    bench.bend(60)
    assert bench.in_doubt == ""


def test_bends_that_become_cheaper_are_no_fault() -> None:
    bench = Bench(cost_kPa=6.1)
    bench.fly(10)
    bench.cost_kPa = 5.2
    bench.bend(20)
    assert bench.in_doubt == ""


def test_a_reservoir_of_20_L_falls_slowly_and_is_not_stuck() -> None:
    bench = Bench(cost_kPa=0.6, pneumatics=PneumaticsConfig(reservoir_volume_L=20.0))
    bench.rest(3.0)
    bench.bend(60)
    assert bench.in_doubt == ""


def test_a_sensor_that_was_frozen_for_30_s_is_found_and_is_right_again() -> None:
    bench = Bench()
    cycles = ReportedCycles(bench.estimate)
    bench.fly(8)
    cycles.update(bench.t, False)
    frozen_kPa = bench.reservoir_kPa - bench.cold_kPa
    bench.lie = lambda _: frozen_kPa
    until_s = bench.t + 30.0
    while bench.t < until_s:
        bench.bend()
    assert bench.in_doubt.startswith("reservoir sensor ")
    cycles.update(bench.t, False, in_doubt=True)
    bench.lie = lambda reading_kPa: reading_kPa
    bench.rest(4.0)
    assert bench.in_doubt, "one low reading is no proof"
    bench.rest(4.0)
    assert bench.in_doubt == ""
    event = cycles.update(bench.t, False, in_doubt=False)
    assert event == "reservoir sensor is believed again, cycles left are learned again"
    bench.bend(6)
    cycles.update(bench.t, False)
    left = cycles.left
    assert left is not None
    truth = (bench.reservoir_kPa - left.floor_kPa) / bench.cost_kPa
    assert left.low < truth < left.high


def test_the_finding_outlasts_gaps_in_telemetry() -> None:
    bench = Bench()
    bench.fly(8)
    drift(bench, 10.0)
    bench.bend()
    bench.t += 0.3
    bench.rest(0.5)
    bench.t += 5.0
    bench.rest(0.5)
    assert bench.in_doubt
    assert bench.checks.counts["reservoir_sensor"] == 1


def test_the_account_continues_over_a_gap() -> None:
    bench = Bench()
    bench.fly(8)
    bench.t += 5.0
    bench.lie = lambda reading_kPa: reading_kPa + 20.0
    bench.rest(2.0)
    assert bench.in_doubt == RISES


def test_a_person_may_believe_the_sensor_and_a_stuck_one_is_found_again() -> None:
    bench = Bench()
    bench.fly(8)
    stick(bench)
    bends_until_found(bench, 4)
    bench.sensor.clear()
    bench.rest(1.0)
    assert bench.in_doubt == ""
    bends_until_found(bench, 4)
