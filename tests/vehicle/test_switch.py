"""The switch acts only on observed moves."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule

from examples import examples
from flying_vines.vehicle.radio.switch import (
    BOUNDARIES_US,
    SAMPLING_SLACK_S,
    MovedUnseen,
    SwitchMove,
    SwitchReader,
    SwitchReady,
)

DEBOUNCE_S, SETTLE_S, HYSTERESIS_US = 0.15, 1.0, 25.0
MIDDLES_US = {2: (1000, 2000), 3: (1000, 1500, 2000), 6: (1165, 1295, 1425, 1555, 1685, 1815)}
RATES_HZ = (10.0, 20.0, 50.0)

Event = SwitchMove | MovedUnseen | SwitchReady


class Bench:
    """A switch with even samples; `hold` keeps the stick at a pulse width for some time."""

    def __init__(self, positions: int = 3, rate_Hz: float = 20.0) -> None:
        self.switch = SwitchReader(positions, DEBOUNCE_S, SETTLE_S, HYSTERESIS_US)
        self.period_s = 1.0 / rate_Hz
        self.samples = 0
        self.events: list[Event] = []

    @property
    def now_s(self) -> float:
        return self.samples * self.period_s

    def sample(self, pulse_us: float) -> Event | None:
        event = self.switch.sample(self.now_s, pulse_us)
        self.samples += 1
        if event is not None:
            self.events.append(event)
        return event

    def hold(self, pulse_us: float, for_s: float) -> list[Event]:
        before = len(self.events)
        for _ in range(round(for_s / self.period_s)):
            self.sample(pulse_us)
        return self.events[before:]

    def moves(self) -> list[tuple[int, int]]:
        return [(event.before, event.position) for event in self.events if isinstance(event, SwitchMove)]


def settled(positions: int = 3, rate_Hz: float = 20.0, pulse_us: float = 1000) -> Bench:
    bench = Bench(positions, rate_Hz)
    assert isinstance(bench.hold(pulse_us, SETTLE_S + 0.2)[0], SwitchReady)
    bench.events.clear()
    return bench


def nearest(positions: int, pulse_us: float) -> int:
    return sum(pulse_us >= boundary for boundary in BOUNDARIES_US[positions])


@pytest.mark.parametrize("rate_Hz", RATES_HZ)
@pytest.mark.parametrize("positions", [2, 3, 6])
def test_each_move_there_and_back_is_seen_in_time(positions: int, rate_Hz: float) -> None:
    bench = settled(positions, rate_Hz, MIDDLES_US[positions][0])
    path = [*range(1, positions), *range(positions - 2, -1, -1), positions - 1, 0]
    before = 0
    for position in path:
        began_s = bench.now_s
        while not bench.events:
            bench.sample(MIDDLES_US[positions][position])
            assert bench.now_s - began_s < DEBOUNCE_S + 2 * bench.period_s + 1e-9
        assert bench.events == [SwitchMove(position, before)]
        bench.events.clear()
        bench.hold(MIDDLES_US[positions][position], 0.2)
        before = position
    assert bench.events == []


@pytest.mark.parametrize("pulse_us", [1000, 1500, 2000])
def test_a_switch_that_stands_anywhere_at_start_does_nothing(pulse_us: int) -> None:
    bench = Bench()
    assert bench.hold(pulse_us, 20.0) == [SwitchReady(nearest(3, pulse_us))]


def test_a_move_before_it_is_settled_only_starts_the_settling_anew() -> None:
    bench = Bench()
    assert bench.hold(1000, 0.9) == []
    assert bench.hold(2000, 0.9) == []
    assert bench.hold(2000, 0.3) == [SwitchReady(2)]


def test_a_move_while_lost_is_reported_and_does_nothing() -> None:
    bench = settled(pulse_us=2000)
    bench.switch.lose()
    assert bench.hold(1000, 5.0) == [MovedUnseen(0, 2)]
    assert bench.hold(2000, 1.0) == [SwitchMove(2, 0)]


def test_a_loss_without_a_move_only_settles() -> None:
    bench = settled(pulse_us=2000)
    bench.switch.lose()
    assert bench.hold(2000, 5.0) == [SwitchReady(2)]


def test_the_position_is_remembered_over_several_losses() -> None:
    bench = settled(pulse_us=2000)
    for _ in range(3):
        bench.switch.lose()
        assert bench.hold(1000, 0.5) == []
    assert bench.hold(1000, 5.0) == [MovedUnseen(0, 2)]


def test_a_move_half_debounced_at_a_loss_is_gone() -> None:
    bench = settled()
    bench.hold(2000, 0.1)
    bench.switch.lose()
    assert bench.hold(2000, 0.8) == []
    assert bench.hold(2000, 0.5) == [MovedUnseen(2, 0)]


def test_the_jump_of_a_receiver_in_failsafe_is_no_move() -> None:
    # The channels jump about 50 ms before the autopilot reports it.
    for rate_Hz in RATES_HZ:
        bench = settled(pulse_us=2000, rate_Hz=rate_Hz)
        assert bench.hold(1500, 0.1) == []
        bench.switch.lose()
        assert bench.hold(2000, 3.0) == [SwitchReady(2)]


@pytest.mark.parametrize("rate_Hz", RATES_HZ)
@pytest.mark.parametrize("positions", [2, 3, 6])
def test_noise_at_a_boundary_gives_no_moves(positions: int, rate_Hz: float) -> None:
    dice = random.Random(positions)
    for boundary_us in BOUNDARIES_US[positions]:
        bench = Bench(positions, rate_Hz)
        for _ in range(int(60 * rate_Hz)):
            bench.sample(boundary_us + dice.choice([-HYSTERESIS_US, HYSTERESIS_US, dice.uniform(-25, 25)]))
        assert bench.moves() == []


@given(
    side_us=st.floats(-HYSTERESIS_US, HYSTERESIS_US),
    glitch_us=st.integers(900, 2100),
    length=st.integers(1, 2),
)
def test_a_glitch_does_not_pull_a_switch_across_a_boundary_it_rests_at(
    side_us: float, glitch_us: int, length: int
) -> None:
    bench = settled(pulse_us=1000)
    bench.hold(1300 + side_us, 1.0)
    for _ in range(length):
        bench.sample(glitch_us)
    bench.hold(1300 + side_us, 2.0)
    assert bench.moves() == []


@pytest.mark.parametrize("rate_Hz", RATES_HZ)
@pytest.mark.parametrize("positions", [2, 3, 6])
@pytest.mark.parametrize("noise_us", [0.0, 20.0])
def test_a_slow_sweep_goes_through_every_position_once(
    positions: int, rate_Hz: float, noise_us: float
) -> None:
    dice = random.Random(3)
    bench = settled(positions, rate_Hz, 1000)
    duration_s = 30.0
    for direction in (1, -1):
        for i in range(int(duration_s * rate_Hz)):
            way_us = 1000.0 * i / (duration_s * rate_Hz)
            pulse_us = 1000.0 + way_us if direction > 0 else 2000.0 - way_us
            bench.sample(pulse_us + dice.uniform(-noise_us, noise_us))
    up = [(i, i + 1) for i in range(positions - 1)]
    assert bench.moves() == up + [(b, a) for a, b in reversed(up)]


@pytest.mark.parametrize("rate_Hz", RATES_HZ)
def test_fast_flicks_are_each_seen(rate_Hz: float) -> None:
    bench = settled(rate_Hz=rate_Hz)
    for pulse_us in (2000, 1000, 2000, 1000, 1500, 2000):
        bench.hold(pulse_us, 0.5)
    assert bench.moves() == [(0, 2), (2, 0), (0, 2), (2, 0), (0, 1), (1, 2)]


@pytest.mark.parametrize("rate_Hz", RATES_HZ)
def test_passing_through_the_middle_is_no_stop_there(rate_Hz: float) -> None:
    bench = settled(rate_Hz=rate_Hz)
    bench.hold(1500, 0.1)
    bench.hold(2000, 0.5)
    assert bench.moves() == [(0, 2)]


@given(
    positions=st.sampled_from([2, 3, 6]),
    steps=st.lists(
        st.tuples(st.floats(0.015, 0.3), st.one_of(st.none(), st.floats(800, 2200))), min_size=1, max_size=150
    ),
)
@settings(max_examples=examples(200), deadline=None)
def test_an_accepted_position_is_that_of_the_pulse(
    positions: int, steps: list[tuple[float, float | None]]
) -> None:
    switch = SwitchReader(positions, DEBOUNCE_S, SETTLE_S, HYSTERESIS_US)
    t, last_event_position = 0.0, None
    for after_s, pulse_us in steps:
        t += after_s
        if pulse_us is None:
            switch.lose()
            assert switch.position is None
            continue
        event = switch.sample(t, pulse_us)
        if event is not None:
            last_event_position = event.position
            assert event.position == switch.position
            inside = {nearest(positions, pulse_us + reach) for reach in (-25.0, 0.0, 25.0)}
            assert event.position in inside
        if switch.position is not None:
            assert switch.position == last_event_position


class Judge(RuleBasedStateMachine):
    """Before every Move the switch was seen for the settling time and the debounce time."""

    @initialize(positions=st.sampled_from([2, 3, 6]), rate_Hz=st.sampled_from(RATES_HZ))
    def begin(self, positions: int, rate_Hz: float) -> None:
        self.positions = positions
        self.switch = SwitchReader(positions, DEBOUNCE_S, SETTLE_S, HYSTERESIS_US)
        self.period_s = 1.0 / rate_Hz
        self.t = 100.0
        self.seen: list[tuple[float, float]] = []
        self.ready_at: float | None = None
        self.position: int | None = None
        self.before_loss: int | None = None

    def stayed_s(self, position: int, reach_us: float = HYSTERESIS_US) -> float:
        """How long the pulses since the last loss have allowed this position."""
        edges_us = [float("-inf"), *BOUNDARIES_US[self.positions], float("inf")]
        low_us, high_us = edges_us[position] - reach_us, edges_us[position + 1] + reach_us
        since = self.t
        for t, pulse_us in reversed(self.seen):
            if not low_us <= pulse_us <= high_us:
                break
            since = t
        return self.t - since

    def take(self, pulse_us: float) -> None:
        self.t += self.period_s
        self.seen.append((self.t, pulse_us))
        match self.switch.sample(self.t, pulse_us):
            case SwitchMove(position, before):
                assert self.ready_at is not None
                assert before == self.position != position
                assert self.stayed_s(position) >= DEBOUNCE_S - SAMPLING_SLACK_S
                self.position = position
            case SwitchReady(position):
                assert self.ready_at is None
                assert self.before_loss in (None, position)
                self.settle(position)
            case MovedUnseen(position, before):
                assert self.ready_at is None
                assert before == self.before_loss != position
                self.settle(position)
            case None:
                # Pulses that stay in the middle of a position are accepted in the end.
                for position in range(self.positions):
                    if self.stayed_s(position, -HYSTERESIS_US - 1) >= SETTLE_S + self.period_s:
                        assert self.position == position

    def settle(self, position: int) -> None:
        assert self.stayed_s(position) >= SETTLE_S - SAMPLING_SLACK_S
        self.ready_at, self.position, self.before_loss = self.t, position, None

    @rule(pulse_us=st.integers(800, 2200), samples=st.integers(1, 30))
    def stay(self, pulse_us: int, samples: int) -> None:
        for _ in range(samples):
            self.take(pulse_us)

    @rule(position=st.integers(0, 5), samples=st.integers(1, 70))
    def stand(self, position: int, samples: int) -> None:
        for _ in range(samples):
            self.take(MIDDLES_US[self.positions][position % self.positions])

    @rule(boundary=st.integers(0, 4), noise=st.lists(st.integers(-40, 40), min_size=1, max_size=30))
    def waver(self, boundary: int, noise: list[int]) -> None:
        boundaries = BOUNDARIES_US[self.positions]
        for offset_us in noise:
            self.take(boundaries[boundary % len(boundaries)] + offset_us)

    @rule()
    def lose(self) -> None:
        self.switch.lose()
        if self.position is not None:
            self.before_loss = self.position
        self.seen.clear()
        self.ready_at = self.position = None


TestJudge = Judge.TestCase
TestJudge.settings = settings(max_examples=60, stateful_step_count=25, deadline=None)
