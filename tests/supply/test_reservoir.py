"""The reservoir estimate without the other parts, on telemetry with known truth."""

from __future__ import annotations

import math

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reservoir_bench import DEMONSTRATION, Bench

from examples import examples
from firmware_link.protocol import Fault, Mode, Telemetry
from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.true_rig import TrueRig
from flying_vines.physics.plant.volume import Wall
from flying_vines.supply import ReservoirEstimate, RigPrior, TelemetryReader, nominal
from flying_vines.supply.reservoir_filter import LEAK, RISE, ReservoirFilter, Spent
from flying_vines.supply.rig_file_prior import prior_of

PRIORS = (
    nominal(DEMONSTRATION),
    prior_of(DEMONSTRATION, TrueRig(none_found=True)),
    prior_of(DEMONSTRATION, TrueRig(likely=True)),
    prior_of(DEMONSTRATION, TrueRig(effects=Effects(reservoir_wall=Wall(), cv_wall=Wall()))),
    prior_of(DEMONSTRATION, TrueRig(effects=Effects(reservoir_wall=Wall(1e-3, 10.0, 0.5, 0.0)))),
    prior_of(
        DEMONSTRATION,
        TrueRig(
            causes={
                "cv_leak": {"flow_resistance_kPa_s_per_SL": 50.0},
                "cv_sensor_offset": {"offset_kPa": -25.0},
                "reservoir_cooling": {"time_constant_s": 0.01},
            }
        ),
    ),
)


@pytest.mark.parametrize("cost_kPa", [1.03, 2.07, 6.1, 12.2])
def test_learns_what_a_cycle_costs(cost_kPa: float) -> None:
    left = Bench(cost_kPa).fly(12)
    assert left.measured_cycles == pytest.approx(12.0, abs=0.2)
    assert left.cost_kPa == pytest.approx(cost_kPa, rel=0.08)


def test_before_use_the_interval_reaches_from_pouch_to_rigid() -> None:
    bench = Bench(start_kPa=690.0)
    bench.rest(2.0)
    left = bench.left()
    assert left.measured_cycles == 0.0
    pouch_kPa = 0.1 * (101.325 + 20.7) / 2.0
    assert left.low < 644.0 / pouch_kPa
    assert left.high > 644.0 / 2.07


def test_the_interval_shrinks_with_use() -> None:
    widths = []
    for cycles in (0, 2, 12):
        left = Bench(2.07).fly(cycles) if cycles else _unused().left()
        widths.append(math.log(left.high / left.low))
    assert widths[0] > 5.0 * widths[1]
    assert widths[1] > widths[2]


def _unused() -> Bench:
    bench = Bench()
    bench.rest(3.0)
    return bench


def test_a_burst_and_the_reservoir_that_recovers_from_it_change_little() -> None:
    bench = Bench(cost_kPa=2.07)
    bench.rest(5.0)
    bench.bend(12, hold_s=0.2, rest_s=0.15)
    assert bench.cold_kPa > 2.0 * bench.cost_kPa, "the burst must matter"
    after_burst = bench.left()
    for _ in range(6):
        bench.rest(5.0)
        left = bench.left()
        assert left.expected == pytest.approx(after_burst.expected, rel=0.05)
        assert after_burst.low < left.expected < after_burst.high
    assert bench.cold_kPa < 0.6
    assert bench.estimate.reservoir_kPa > bench.reservoir_kPa - 3.0


def test_a_leak_in_idle_time_is_seen_before_the_first_cycle_and_costs_more_at_a_slower_rhythm() -> None:
    counts = {}
    for leak_per_s in (0.0, 2e-3):
        for rest_s in (1.0, 8.0):
            bench = Bench(leak_per_s=leak_per_s)
            bench.rest(15.0)
            bench.bend(8, rest_s=rest_s)
            counts[leak_per_s, rest_s] = bench.left().expected
    assert counts[0.0, 8.0] == pytest.approx(counts[0.0, 1.0], rel=0.1)
    assert counts[2e-3, 1.0] < 0.8 * counts[0.0, 1.0]
    assert counts[2e-3, 8.0] < 0.6 * counts[2e-3, 1.0]


def test_partial_cycles_count_as_partial() -> None:
    bench = Bench()
    bench.rest(3.0)
    bench.bend(14, top_kPa=10.35)
    left = bench.left()
    assert left.measured_cycles == pytest.approx(6.0, abs=0.2)
    assert left.cost_kPa == pytest.approx(6.1, rel=0.1)


def test_the_drift_of_a_cycles_cost_does_not_depend_on_the_size_of_a_cycle() -> None:
    drifts = []
    for swing_kPa in (20.7, 60.0):
        air = ReservoirFilter(
            nominal(msgspec.structs.replace(DEMONSTRATION, cycle_swing_kPa=swing_kPa)), 690.0
        )
        before = air.covariance[RISE][RISE]
        air.spend(Spent(1.0, swing_kPa, 0.0, 0.0, 0.0))
        drifts.append(air.covariance[RISE][RISE] - before)
    assert drifts[0] == pytest.approx(drifts[1])


def test_the_venturis_air_is_learned_and_ends_where_the_firmware_keeps_it_off() -> None:
    bench = Bench(cost_kPa=2.0)
    bench.venturi_kPa_per_s = 40.0
    bench.rest(3.0)
    for _ in range(10):
        bench.see(0.5, 0.0, 20.7, 0.5)
        bench.see(0.3, 20.7, 0.0, 1.0, dvp=1.0)
    assert bench.left().cost_kPa == pytest.approx(14.0, rel=0.1)
    bench.reservoir_kPa = 98.0
    bench.cold_kPa = 0.0
    bench.rest(5.0)
    assert bench.left().cost_kPa < 4.0


def test_a_refill_is_no_cycle_and_changes_no_cost() -> None:
    bench = Bench(start_kPa=400.0)
    before = bench.fly(10)
    bench.reservoir_kPa = 690.0
    bench.cold_kPa = 0.0
    bench.rest(20.0)
    after = bench.left()
    assert after.measured_cycles == before.measured_cycles
    assert after.cost_kPa == pytest.approx(before.cost_kPa, rel=0.1)
    assert after.expected == pytest.approx(before.expected + (690.0 - 400.0) / 6.1 + 12.0, rel=0.15)


@pytest.mark.parametrize("step_kPa", [5.5, 4.0])
def test_a_small_refill_changes_no_cost(step_kPa: float) -> None:
    bench = Bench(cost_kPa=1.1)
    before = bench.fly(8)
    bench.reservoir_kPa += step_kPa
    bench.rest(2.0)
    assert bench.left().cost_kPa == pytest.approx(before.cost_kPa, rel=0.02)


@pytest.mark.parametrize("leak_per_s", [0.01, 0.02, 0.05])
def test_a_fast_leak_is_learned_in_a_few_seconds(leak_per_s: float) -> None:
    bench = Bench(cost_kPa=2.07)
    bench.fly(8)
    bench.leak_per_s = leak_per_s
    bench.rest(4.0)
    assert bench.estimate.filter is not None
    assert bench.estimate.filter.mean[LEAK] == pytest.approx(leak_per_s, rel=0.1)


def test_readings_that_are_wild_or_missing_change_nothing() -> None:
    bench = Bench()
    bench.fly(8)
    before = bench.left()
    for reading_kPa, faults in (
        (math.nan, Fault.NONE),
        (0.0, Fault.NONE),
        (1030.0, Fault.NONE),
        (12.0, Fault.RESERVOIR_SENSOR),
    ):
        for _ in range(20):
            bench.t += 0.01
            bench.tell(reservoir_kPa=reading_kPa, faults=faults)
        bench.rest(1.0)
    after = bench.left()
    assert after.expected == pytest.approx(before.expected, rel=0.03)
    assert after.measured_cycles == before.measured_cycles


def test_a_gap_in_telemetry_widens_the_interval_and_no_more() -> None:
    bench = Bench()
    before = bench.fly(8)
    bench.t += 4.0
    bench.rest(0.2)
    after = bench.left()
    assert after.expected == pytest.approx(before.expected, rel=0.05)
    bench.t += 3600.0
    bench.rest(5.0)
    assert bench.left().cost_kPa == pytest.approx(before.cost_kPa, rel=0.1)
    assert bench.left().expected == pytest.approx(before.expected, rel=0.1)


def test_a_firmware_that_restarts_in_mid_cycle_costs_what_was_learned_nothing() -> None:
    bench = Bench()
    before = bench.fly(8)
    bench.see(0.5, 0.0, 20.7, 0.5)
    bench.rest(1.5)
    bench.bend(2)
    after = bench.left()
    assert after.cost_kPa == pytest.approx(before.cost_kPa, rel=0.1)
    assert after.measured_cycles == pytest.approx(before.measured_cycles + 3.0, abs=0.2)


def test_air_that_is_lost_in_a_new_way_is_noticed() -> None:
    bench = Bench()
    before = bench.fly(8)
    bench.reservoir_kPa *= 0.5
    bench.rest(3.0)
    after = bench.left()
    assert after.expected < 0.6 * before.expected
    assert math.log(after.high / after.low) > math.log(before.high / before.low)


def test_nothing_is_known_before_the_first_reading() -> None:
    estimate = ReservoirEstimate(nominal(DEMONSTRATION))
    assert estimate.cycles_left() is None
    assert math.isnan(estimate.reservoir_kPa)


def test_a_sensor_whose_zero_is_low_does_not_hide_the_reservoir() -> None:
    reader, estimate = TelemetryReader(nominal(DEMONSTRATION)), ReservoirEstimate(nominal(DEMONSTRATION))
    for i in range(100):
        message = Telemetry(0, Mode.VENT, Fault.NONE, 0, 0.0, -2.5, 600.0, 0.0, 0.0, True)
        estimate.update(reader.read(0.01 * i, message))
    assert estimate.filter is not None
    assert estimate.filter.absolute_kPa == pytest.approx(701.325, abs=1.0)


def test_a_regulation_that_begins_where_the_sensor_has_its_zero_begins_no_inflation() -> None:
    reader, estimate = TelemetryReader(nominal(DEMONSTRATION)), ReservoirEstimate(nominal(DEMONSTRATION))
    down = [3.0 - 0.2 * i for i in range(10)]
    up = [1.2 + 0.4 * i for i in range(49)]
    t, reservoir_kPa = 0.0, 690.0
    for _ in range(6):
        commands = [(Mode.VENT, 0.0)] * 100
        commands += [(Mode.REGULATE, kPa) for kPa in (*down, *up, *[20.4] * 30, *reversed(up))]
        for mode, setpoint in commands:
            t += 0.01
            reservoir_kPa -= 0.02
            cv, evp = max(3.0, setpoint), 0.5 if mode is Mode.REGULATE else 0.0
            telemetry = Telemetry(0, mode, Fault.NONE, 0, setpoint, cv, reservoir_kPa, evp, 0.0, evp == 0.0)
            estimate.update(reader.read(t, telemetry))
    left = estimate.cycles_left()
    assert left is not None
    # Six cycles began. The last one has not ended, and the first one does not count.
    assert left.measured_cycles == pytest.approx(4 * (20.4 - 1.2) / 20.7, abs=0.05)
    assert left.floor_kPa < 0.5 * reservoir_kPa


def test_the_air_of_a_rise_is_proportional_to_it() -> None:
    bench = Bench()
    bench.fly(10)
    assert bench.estimate.spending_kPa(20.7) == pytest.approx(6.1, rel=0.15)
    assert bench.estimate.spending_kPa(41.4) == pytest.approx(2.0 * bench.estimate.spending_kPa(20.7))
    assert ReservoirEstimate(nominal(DEMONSTRATION)).spending_kPa(20.7) == pytest.approx(2.07)


@settings(max_examples=examples(40), deadline=None)
@given(
    st.sampled_from(PRIORS),
    st.lists(
        st.tuples(
            st.floats(-1.0, 30.0),  # seconds since the last
            st.floats(0.0, 30.0),
            st.floats(-15.0, 206.0),
            st.floats(-15.0, 1034.0),
            st.floats(0.0, 1.0),
            st.floats(0.0, 1.0),
            st.booleans(),
            st.integers(1, 30),
        ),
        max_size=30,
    ),
)
def test_any_telemetry_gives_finite_numbers(
    prior: RigPrior, samples: list[tuple[float, float, float, float, float, float, bool, int]]
) -> None:
    reader, estimate = TelemetryReader(prior), ReservoirEstimate(prior)
    t = 0.0
    for wait_s, setpoint, cv, reservoir, evp, dvp, solenoid, times in samples:
        t += wait_s
        for _ in range(times):
            t += 0.01
            message = Telemetry(0, Mode.REGULATE, Fault.NONE, 0, setpoint, cv, reservoir, evp, dvp, solenoid)
            estimate.update(reader.read(t, message))
        left = estimate.cycles_left()
        if left is not None:
            assert 0.0 <= left.low <= left.expected <= left.high
            assert left.cost_kPa > 0.0
            assert math.isfinite(left.expected)
        assert math.isfinite(estimate.spending_kPa(20.7))
