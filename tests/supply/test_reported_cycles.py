"""The reported air: no jump without an event, and nothing learned from half a movement."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations

import pytest
from reservoir_bench import DEMONSTRATION, Bench

from firmware_link.protocol import Mode
from flying_vines.supply import CyclesLeft, ReportedCycles, ReservoirEstimate, nominal
from flying_vines.supply.learned_file import learned_from, text_of
from flying_vines.supply.reported_cycles import RHYTHM

PRIOR = nominal(DEMONSTRATION)


class Reported:
    """A bench with a report every two seconds."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.cycles = ReportedCycles(bench.estimate)
        self.events: list[str] = []

    def tell(self, lost: bool = False) -> CyclesLeft | None:
        event = self.cycles.update(self.bench.t, lost)
        self.events += [event] if event else []
        return self.cycles.left

    @property
    def left(self) -> CyclesLeft:
        left = self.tell()
        assert left is not None
        return left

    def rest(self, seconds: float) -> list[CyclesLeft]:
        lefts = []
        for _ in range(round(seconds / 2.0)):
            self.bench.rest(2.0)
            lefts.append(self.left)
        return lefts

    def bend(self, times: int = 1) -> list[CyclesLeft]:
        lefts = []
        for _ in range(times):
            self.bench.bend()
            lefts.append(self.left)
        return lefts


def cut_off(bench: Bench) -> None:
    """A bend at 40 kPa/s that is vented after 0.2 s. The vine has hardly any pressure yet."""
    for i in range(20):
        bench.t += 0.01
        bench.reservoir_kPa -= bench.cost_kPa * 0.4 / 20.7
        bench.tell(0.4 * i, evp=1.0, solenoid=False)
    for _ in range(100):
        bench.t += 0.01
        bench.tell(mode=Mode.VENT)


def overlap(a: CyclesLeft, b: CyclesLeft) -> bool:
    return a.low <= b.high and b.low <= a.high


def test_a_movement_that_was_cut_off_teaches_nothing() -> None:
    lefts = []
    for times in (0, 3):
        bench = Bench()
        bench.fly(5)
        for _ in range(times):
            cut_off(bench)
        bench.bend()
        lefts.append(bench.left())
    without, after = lefts
    assert after.measured_cycles == pytest.approx(without.measured_cycles, abs=0.1)
    assert after.floor_kPa == pytest.approx(without.floor_kPa, rel=0.1)
    assert after.cost_kPa == pytest.approx(without.cost_kPa, rel=0.1)


def test_air_that_a_cut_off_movement_took_without_a_rise_is_no_cost_of_a_bend() -> None:
    bench = Bench(cost_kPa=2.07)
    before = bench.fly(5)
    for _ in range(5):
        bench.reservoir_kPa -= 3.0  # fills the pouch
        cut_off(bench)
    assert bench.left().cost_kPa == pytest.approx(before.cost_kPa, rel=0.05)


def test_a_movement_that_the_core_replaces_is_cut_off_even_if_the_vine_has_followed() -> None:
    bench = Bench()
    before = bench.fly(5)
    bench.see(0.2, 0.0, 8.0)
    bench.estimate.cut_off()
    bench.see(0.1, 8.0, 0.0, 1.2)
    bench.bend()
    assert bench.left().measured_cycles == pytest.approx(before.measured_cycles + 1.0, abs=0.1)


def test_a_turn_that_no_supply_could_fill_sets_no_floor() -> None:
    bench = Bench()
    before = bench.fly(5)
    for i in (*range(20), *range(19, -1, -1)):
        bench.t += 0.01
        bench.reservoir_kPa -= bench.cost_kPa * 0.2 / 20.7
        bench.tell(0.4 * i, evp=1.0, solenoid=False, mode=Mode.REGULATE)
    bench.rest(1.0)
    bench.bend()
    assert bench.left().floor_kPa < before.floor_kPa + 20.0


def test_a_pause_is_a_wait_and_not_the_rhythm() -> None:
    reported = Reported(Bench(cost_kPa=2.07, leak_per_s=1e-3))
    reported.rest(6.0)
    reported.bend(4)
    before = reported.rest(120.0)[-1]
    after = reported.bend(2)[-1]
    assert reported.events == []
    assert overlap(before, after)
    assert after.expected > 0.8 * before.expected


def test_a_long_wait_is_no_rhythm_either_after_slow_bends() -> None:
    rhythms_s = []
    for wait_s in (8.0, 300.0):
        bench = Bench(cost_kPa=2.07, leak_per_s=1e-3)
        bench.rest(6.0)
        for rest_s in (*[8.0] * 5, wait_s):
            bench.bend()
            bench.rest(rest_s)
        bench.bend()
        bench.left()
        assert bench.estimate.basis is not None
        rhythms_s.append(bench.estimate.basis.cycle.spent.time_s)
    assert rhythms_s[1] == pytest.approx(rhythms_s[0], rel=0.02)


def test_a_slower_rhythm_with_a_leak_gives_the_reason_for_the_lower_number() -> None:
    reported = Reported(Bench(cost_kPa=2.07, leak_per_s=1e-3))
    reported.rest(6.0)
    before = reported.bend(6)[-1]
    for _ in range(14):
        reported.bench.rest(20.0)
        after = reported.bend()[-1]
    assert after.high < 0.7 * before.low
    assert RHYTHM in {event.split(":")[0] for event in reported.events}


def test_intervals_of_two_minutes_have_a_value_in_common_with_no_event() -> None:
    """A bend suddenly takes 1.5 times the air, while the filter has a small uncertainty."""
    reported = Reported(Bench(cost_kPa=6.1))
    reported.rest(6.0)
    lefts = reported.bend(12)
    reported.bench.cost_kPa = 9.5
    raw = []
    for _ in range(10):
        lefts += reported.bend()
        raw.append(reported.bench.left())
    assert reported.events == []
    assert any(not overlap(one, lefts[11]) for one in raw), "the bench must show the leap"
    for a, b in combinations(lefts[11:], 2):
        gone = 1.6 * (b.measured_cycles - a.measured_cycles)
        assert b.high >= a.low - gone


def test_below_the_floor_0_stays_0_without_an_event() -> None:
    """Any amount of air below the floor is shown as 0, so a change of that amount is no jump."""
    reported = Reported(Bench(start_kPa=300.0))
    reported.rest(6.0)
    reported.bend(4)
    reported.bench.reservoir_kPa = 5.0
    reported.rest(30.0)
    events = len(reported.events)
    for step_kPa in (1.0, -1.0, 1.0):
        for _ in range(12):
            reported.bench.reservoir_kPa += step_kPa
            assert {round(left.high) for left in reported.rest(2.0)} == {0}
    assert len(reported.events) == events


def test_a_refill_and_a_burst_are_reported_once_each() -> None:
    reported = Reported(Bench(start_kPa=500.0))
    reported.rest(6.0)
    reported.bend(5)
    reported.bench.reservoir_kPa, reported.bench.cold_kPa = 690.0, 0.0
    reported.rest(30.0)
    reported.bench.reservoir_kPa = 300.0
    reported.rest(30.0)
    assert len(reported.events) == 2
    assert reported.events[0].startswith("reservoir refilled, ")
    assert reported.events[1].startswith("reservoir lost air at once, ")


def test_the_number_after_a_jump_agrees_with_that_at_the_jump() -> None:
    """With an unknown leak the number at a burst may be far too low, but the next one agrees with it."""
    bench = Bench()
    reported = Reported(bench)
    reported.rest(6.0)
    reported.bend(5)
    before, air = reported.left, bench.estimate.filter
    assert air is not None
    predicted = [replace(before, expected=21.0, low=10.0, high=40.0)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench.estimate, "cycles_left", lambda: predicted[-1])
        air.jumped_kPa = -300.0
        assert reported.left.expected == 21.0
        assert reported.events == ["reservoir lost air at once, 21 cycles left (10-40)"]
        bench.t += 2.0
        predicted.append(replace(before, expected=70.0, low=51.0, high=96.0))
        after = reported.left
    assert (after.low, after.expected, after.high) == pytest.approx((40.0, 70.0, 96.0), abs=0.5)
    assert len(reported.events) == 1


def test_a_latched_loss_reports_0_until_it_is_cleared_and_then_learns_again() -> None:
    reported = Reported(Bench())
    reported.rest(6.0)
    before = reported.bend(6)[-1]
    for _ in range(10):
        reported.bench.rest(2.0)
        left = reported.tell(lost=True)
        assert left is not None
        assert (left.expected, left.low, left.high, left.minutes, left.lost) == (0.0, 0.0, 0.0, 0.0, True)
    assert reported.tell(lost=False) is None
    assert reported.events == ["cycles left are learned again"]
    reported.bench.rest(2.0)
    after = reported.left
    assert after.measured_cycles == 0.0
    assert after.high / after.low > 2.0 * before.high / before.low


def test_minutes_are_the_time_to_the_floor_at_the_leak() -> None:
    reported = Reported(Bench(cost_kPa=2.07, leak_per_s=1e-3, start_kPa=600.0))
    reported.bend(3)
    left = reported.rest(120.0)[-1]
    truth = math.log(reported.bench.reservoir_kPa / left.floor_kPa) / 1e-3 / 60.0
    assert left.minutes == pytest.approx(truth, rel=0.1)
    assert left.minutes_low < truth < left.minutes_high


def test_bends_like_the_last_one_scale_with_their_air() -> None:
    bench = Bench()
    bench.fly(8)
    assert bench.left().per_cycle == pytest.approx(1.0, abs=0.1)
    bench.bend(2, top_kPa=10.35)
    left = bench.left()
    assert left.bend_kPa == pytest.approx(10.35, abs=0.5)
    assert left.per_cycle == pytest.approx(2.0, rel=0.15)


def test_a_restart_keeps_what_was_learned_of_this_rig_only() -> None:
    bench = Bench()
    before = bench.fly(8)
    learned = bench.estimate.learned
    assert learned is not None
    text = text_of(PRIOR, learned)
    again, problem = learned_from(text, PRIOR)
    assert (again, problem) == (learned, "")
    bench.estimate = ReservoirEstimate(PRIOR, again)
    bench.rest(2.0)
    after = bench.left()
    assert after.measured_cycles == before.measured_cycles
    assert after.expected == pytest.approx(before.expected, rel=0.05)
    assert after.high / after.low < 1.2 * before.high / before.low
    other = replace(PRIOR, response_s=0.11)
    assert learned_from(text, other) == (None, "another rig or changed numbers: air is learned again")


def test_a_restart_with_what_was_learned_is_reported_once() -> None:
    reported = Reported(Bench())
    reported.rest(6.0)
    reported.bend(8)
    assert reported.events == []
    learned = reported.bench.estimate.learned
    reported.bench.estimate = ReservoirEstimate(PRIOR, learned)
    reported.cycles = ReportedCycles(reported.bench.estimate)
    reported.bench.rest(2.0)
    left = reported.left
    reported.rest(20.0)
    assert reported.events == [f"as learned before: {left}"]


@pytest.mark.parametrize("text", ["{", "[]", '{"rig": 3}', "\0", '{"rig":"x","learned":{}}'])
def test_a_damaged_file_is_reported_and_not_used(text: str) -> None:
    learned, problem = learned_from(text, PRIOR)
    assert learned is None
    assert "learned again" in problem


def test_no_file_is_no_problem() -> None:
    assert learned_from("", PRIOR) == (None, "")
