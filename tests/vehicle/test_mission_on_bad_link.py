"""Missions on bad links, with disturbances: each item is seen once or missed."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mission_on_bad_link import (
    RESTART_S,
    Link,
    MissionOnBadLink,
    compare,
    fly,
    in_order,
    mission,
    numbers_of_before,
)

from flying_vines.simulation.autopilot import AutopilotKind

pytestmark = pytest.mark.long

KINDS: tuple[AutopilotKind, AutopilotKind] = ("ardupilot", "px4")


@pytest.mark.parametrize("kind", KINDS)
@given(seed=st.integers(0, 2**32), loss=st.sampled_from([0.0, 0.05, 0.3]), late_s=st.sampled_from([0.0, 0.3]))
@settings(max_examples=9, deadline=None)
def test_no_item_is_seen_twice_and_none_that_did_not_run(
    kind: AutopilotKind, seed: int, loss: float, late_s: float
) -> None:
    dice = random.Random(seed)
    flight = MissionOnBadLink(
        kind, dice, Link(loss, copies=0.2, late_s=late_s), mission(kind, dice, wild=True)
    )
    fly(flight, 20.0, happenings=dice.randrange(5))
    assert compare(flight).extra == []
    assert in_order(flight)


@pytest.mark.parametrize("kind", KINDS)
@given(seed=st.integers(0, 2**32), late_s=st.sampled_from([0.0, 0.1]))
@settings(max_examples=5, deadline=None)
def test_on_a_good_link_nothing_is_missed(kind: AutopilotKind, seed: int, late_s: float) -> None:
    dice = random.Random(seed)
    flight = MissionOnBadLink(kind, dice, Link(copies=0.2, late_s=late_s), mission(kind, dice, wild=True))
    fly(flight, 45.0)
    found = compare(flight)
    assert (found.missed, found.extra) == ([], [])


@pytest.mark.parametrize("kind", KINDS)
@given(seed=st.integers(0, 2**32))
@settings(max_examples=5, deadline=None)
def test_single_lost_frames_make_no_item_missing(kind: AutopilotKind, seed: int) -> None:
    # The bound: one lost frame at a time, in each direction, four seconds apart; an item and then a waypoint.
    dice = random.Random(seed)
    flight = MissionOnBadLink(kind, dice, Link(loss=0.5, spare_s=4.0), mission(kind, dice, wild=False))
    flight.run(10.0)
    flight.autopilot.start_mission()
    flight.run(50.0)
    found = compare(flight)
    assert len(flight.ran) >= 2
    assert (found.missed, found.extra) == ([], [])


@pytest.mark.parametrize("kind", KINDS)
@given(seed=st.integers(0, 2**32))
@settings(max_examples=4, deadline=None)
def test_a_service_that_starts_in_mid_mission_sees_only_later_items(kind: AutopilotKind, seed: int) -> None:
    dice = random.Random(seed)
    flight = MissionOnBadLink(kind, dice, Link(late_s=0.05), mission(kind, dice, wild=False))
    flight.run(3.0)
    flight.autopilot.start_mission()
    flight.run(dice.uniform(5.0, 20.0))
    flight.seen.clear()
    down_at, up_at = flight.t, flight.t + RESTART_S
    flight.start_service(down_s=RESTART_S)
    flight.run(35.0)
    assert compare(flight).extra == []
    # An item that runs before the streams of the autopilot were requested can only be missed.
    assert compare(flight, since=up_at + 2.0).missed == []
    assert [one for one in flight.seen if one.t < down_at] == []


@pytest.mark.parametrize("kind", KINDS)
def test_another_mission_of_the_same_length_never_runs_with_the_old_numbers(
    kind: AutopilotKind,
) -> None:
    ran = 0
    for seed in range(10):
        dice = random.Random(seed)
        first, other = mission(kind, dice, wild=False), random.Random(seed + 1)
        flight = MissionOnBadLink(kind, other, Link(loss=other.choice([0.0, 0.1])), first)
        flight.run(5.0)
        flight.autopilot.start_mission()
        flight.run(dice.uniform(3.0, 12.0))
        same_length = [mission(kind, random.Random(n), wild=False) for n in range(40)]
        flight.autopilot.set_mission(next(items for items in same_length if len(items) == len(first)))
        changed_at = flight.t
        flight.run(40.0)
        assert compare(flight).extra == []
        assert numbers_of_before(flight) == []
        ran += sum(t > changed_at for t, _ in flight.ran)
    assert ran > 20


def test_the_drawn_flights_have_executed_lost_and_unknown_items() -> None:
    ran = lost = unknown = 0
    for seed in range(8):
        dice = random.Random(seed)
        flight = MissionOnBadLink("ardupilot", dice, Link(0.5), mission("ardupilot", dice, wild=True))
        fly(flight, 20.0, happenings=3)
        ran += len(flight.ran)
        lost += len(compare(flight).missed)
        unknown += sum(one.numbers is None for one in flight.seen)
    assert ran > 40
    assert 0 < lost < ran
    assert unknown > 0
