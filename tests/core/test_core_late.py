"""No bend is late, and none uses the numbers of a replaced mission."""

from __future__ import annotations

from collections import deque

import pytest
from mission_on_bad_link import SCRIPT, WP
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config
from flying_vines.core.events import Action, Decision
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.autopilot.rc_input import RcSource
from flying_vines.simulation.phlosar.mishaps import Reset
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.mission.item import AutopilotKind, MissionItem
from flying_vines.vehicle.notice import Notice
from flying_vines.vehicle.triggers import Trigger
from flying_vines.vine.intent import (
    ArmPneumatics,
    BendTo,
    ClearLatchedFaults,
    DisarmPneumatics,
    Hold,
    Intent,
    SetPressure,
    StartProfile,
    VentVine,
)

from .flights import HIGH, LOW, airborne, assert_vented, decisions, ground_command, run_for
from .prepared import prepared

TAKEOFF, DELAY, LAND = 22, 93, 21


def mission(angle_deg: float) -> list[MissionItem]:
    rows = [
        (WP, (0.0, 0.0)),
        (TAKEOFF, (0.0, 0.0)),
        (DELAY, (8.0, 0.0)),
        (SCRIPT, (1.0, angle_deg)),
        (DELAY, (8.0, 0.0)),
        (SCRIPT, (1.0, angle_deg / 2)),
        (DELAY, (8.0, 0.0)),
        (LAND, (0.0, 0.0)),
    ]
    return [
        MissionItem(seq, command, (*params, 0.0, 0.0, 0.0, 0.0, 10.0 if command == TAKEOFF else 0.0), 3)
        for seq, (command, params) in enumerate(rows)
    ]


def flying(until_item_s: float = 0.0) -> SimulatedFlight:
    """A flight on the way to item 3, this time before it runs."""
    return prepared(_flying, until_item_s)


def _flying(until_item_s: float) -> SimulatedFlight:
    autopilot = FakeAutopilot("ardupilot", mission=mission(40.0))
    flight = SimulatedFlight(config.default(), autopilot)
    flight.run(3.0)
    autopilot.start_mission()
    while autopilot.flight.height_m < 9.9:
        flight.run(flight.world.now + 0.1)
    flight.run(flight.world.now + 8.0 - until_item_s)
    assert autopilot.payload_log == []
    return flight


def items(actions: list[Action]) -> list[Decision]:
    return [a for a in actions if isinstance(a, Decision) and a.trigger == "mission_item"]


def texts_of(actions: list[Action]) -> list[str]:
    return [a.text for a in actions if isinstance(a, Notice)]


def test_an_item_is_carried_out_at_once_with_its_numbers() -> None:
    flight = flying(2.0)
    (decision,) = items(flight.run(flight.world.now + 4.0))
    (ran_at, _) = flight.autopilot.payload_log[0]
    assert (decision.what["seq"], decision.intent, decision.safety) == (3, "bend 40°", "accepted")
    assert decision.t - ran_at < 0.03


def test_a_mission_that_was_just_replaced_gives_its_new_numbers() -> None:
    flight = flying(2.0)
    flight.run(flight.world.now + 1.5)
    flight.autopilot.set_mission(mission(11.0))
    actions = flight.run(flight.world.now + 12.0)
    assert [(d.what["seq"], d.intent, d.safety) for d in items(actions)] == [
        (3, "bend 11°", "accepted"),
        (5, "bend 5.5°", "accepted"),
    ]
    assert len([text for text in texts_of(actions) if "mission changed" in text]) == 1


@pytest.mark.parametrize("kind", ["text lost", "answers lost"])
def test_an_item_that_is_not_confirmed_is_refused_and_reported(kind: str) -> None:
    flight = flying(2.0)
    lost = b"Mission: 3" if kind == "text lost" else b"\x49\x00\x00"  # MISSION_ITEM_INT
    flight.from_autopilot = lambda frame: b"" if lost in frame else frame
    actions = flight.run(flight.world.now + 5.0)
    (decision,) = items(actions)
    if kind == "text lost":
        assert (decision.intent, decision.safety) == ("bend 40°", "accepted")
        assert decision.t - flight.autopilot.payload_log[0][0] < 1.0
    else:
        assert (decision.safety, decision.reason) == ("refused", "params not confirmed")
        assert "Vine: refused item 3: params not confirmed" in texts_of(actions)


@pytest.mark.parametrize("stall_s", [3.0, 6.0])
def test_a_process_that_stopped_bends_nothing_when_it_continues(stall_s: float) -> None:
    flight = flying(1.0)
    actions = flight.stall(flight.world.now + stall_s)
    assert len(flight.autopilot.payload_log) == 1
    actions += flight.run(flight.world.now + 2.0)
    (decision,) = items(actions)
    assert (decision.what["seq"], decision.safety) == (3, "refused")
    assert "s late" in decision.reason
    assert flight.phlosar.cv_kPa < 1.0


class Queue:
    """A wire that queues the autopilot's frames, so that each comes later than the one before."""

    def __init__(self, flight: SimulatedFlight, later_s_per_s: float, longest_s: float) -> None:
        self._flight, self._later, self._longest_s = flight, later_s_per_s, longest_s
        self._began = flight.world.now
        self._waiting: deque[tuple[float, bytes]] = deque()

    def __call__(self, frame: bytes) -> bytes:
        now = self._flight.world.now
        delay_s = min(self._longest_s, self._later * (now - self._began))
        self._waiting.append((now + delay_s, frame))
        arrived = b""
        while self._waiting and self._waiting[0][0] <= now:
            arrived += self._waiting.popleft()[1]
        return arrived


@pytest.mark.parametrize(("kind", "receiver"), [("ardupilot", None), ("px4", "sbus")])
def test_a_link_that_delays_more_and_more_vents_the_vine_and_the_switch_bends_nothing(
    kind: AutopilotKind, receiver: RcSource | None
) -> None:
    autopilot = FakeAutopilot(kind, rc_failsafe_mode=None, receiver=receiver)
    flight = airborne(autopilot=autopilot)
    flight.autopilot.set_rc(9, HIGH)
    assert [d.safety for d in decisions(run_for(flight, 3.0))] == ["accepted"]
    flight.from_autopilot = Queue(flight, later_s_per_s=0.5, longest_s=4.0)
    actions = run_for(flight, 5.0)
    assert "Vine: vehicle link more than 1 s late, vented" in texts_of(actions)
    assert_vented(flight)
    for pulse_us in (LOW, HIGH):
        flight.autopilot.set_rc(9, pulse_us)
        actions += run_for(flight, 7.0)
    assert [d.intent for d in decisions(actions) if d.safety == "refused"] == ["bend-full"]
    assert_vented(flight)
    flight.from_autopilot = Queue(flight, 0.0, 0.0)
    assert "Vine: vehicle link is in time again" in texts_of(run_for(flight, 2.0))
    flight.autopilot.set_rc(9, LOW)
    run_for(flight, 5.0)
    flight.autopilot.set_rc(9, HIGH)
    assert [d.safety for d in decisions(run_for(flight, 3.0))] == ["accepted"]


def test_on_a_link_that_is_late_from_the_start_the_switch_bends_nothing() -> None:
    autopilot = FakeAutopilot("ardupilot", rc_failsafe_mode=None)
    flight = SimulatedFlight(config.default(), autopilot)
    flight.from_autopilot = Queue(flight, 1e9, 3.0)
    autopilot.set_rc(9, LOW)
    flight.run(2.0)
    autopilot.takeoff(10.0)
    autopilot.flight.height_m = 10.0
    flight.run(12.0)
    autopilot.set_rc(9, HIGH)
    actions = run_for(flight, 6.0)
    (refused,) = decisions(actions)
    assert (refused.safety, refused.reason) == ("refused", "vehicle link more than 1 s late")
    assert_vented(flight)


LATE: list[tuple[Intent, str]] = [
    (BendTo(30.0), "refused"),
    (SetPressure(5.0), "refused"),
    (BendTo(500.0), "refused"),
    (StartProfile("of another vine"), "refused"),
    (Hold(), "refused"),
    (ClearLatchedFaults(), "refused"),
    (ArmPneumatics(), "refused"),
    (StartProfile("straight"), "accepted"),
    (VentVine(), "accepted"),
    (DisarmPneumatics(), "accepted"),
]


def decide(flight: SimulatedFlight, intent: Intent, age_s: float, kind: str = "command") -> Decision:
    t = flight.world.now
    return flight.core._decide(t, Trigger(t, kind, {}, intent, by_person=True, age_s=age_s))


@pytest.mark.parametrize(("intent", "verdict"), LATE)
def test_late_requests_may_only_let_air_out(intent: Intent, verdict: str) -> None:
    decision = decide(flying(2.0), intent, 1.1)
    assert decision.safety == verdict
    assert decision.reason == ("came 1.1 s late" if verdict == "refused" else "")


def test_a_request_older_than_the_latest_is_not_executed() -> None:
    flight = flying(4.0)
    assert decide(flight, BendTo(10.0), 0.0).safety == "accepted"
    flight.run(flight.world.now + 0.2)
    assert decide(flight, BendTo(30.0), 0.5).reason == "a newer request came first"
    assert decide(flight, StartProfile("straight"), 0.5).reason == "a newer request came first"
    assert decide(flight, StartProfile("straight"), 5.0).reason == "came 5.0 s late"
    assert decide(flight, VentVine(), 5.0).safety == "accepted"
    assert decide(flight, BendTo(20.0), 0.1).safety == "accepted"


def test_a_request_while_the_autopilot_is_silent_is_not_called_late() -> None:
    flight = flying(2.0)
    flight.autopilot.mute(60.0)
    run_for(flight, 17.0)
    decision = decide(flight, BendTo(30.0), 17.0)
    assert (decision.safety, decision.reason) == ("refused", "autopilot silent for 3 s")


def test_a_trigger_without_an_intent_is_refused() -> None:
    flight = flying(2.0)
    t = flight.world.now
    assert flight.core._decide(t, Trigger(t, "command", {}, None)).safety == "refused"


def test_clearing_without_a_fault_does_not_cancel_a_move_that_waits_for_its_confirmation() -> None:
    flight = airborne(autopilot=FakeAutopilot("px4", receiver="sbus"))
    flight.autopilot.set_rc(9, HIGH)
    actions = run_for(flight, 0.5)
    assert decisions(actions) == []
    (cleared,) = decisions(ground_command(flight, mavlink.MAV_CMD_USER_5, 1.0))
    assert (cleared.safety, cleared.reason) == ("accepted", "no fault was latched")
    assert [d.trigger for d in decisions(run_for(flight, 2.5))] == ["switch"]
    assert flight.phlosar.cv_kPa > 15.0


def test_clearing_a_fault_cancels_a_move_that_waits_for_its_confirmation() -> None:
    flight = airborne(autopilot=FakeAutopilot("px4", receiver="sbus"))
    flight.phlosar.inject("board", Reset())
    run_for(flight, 2.0)
    assert flight.core.snapshot(flight.world.now).safe_state
    flight.autopilot.set_rc(9, HIGH)
    run_for(flight, 0.5)
    (cleared,) = decisions(ground_command(flight, mavlink.MAV_CMD_USER_5, 1.0))
    assert (cleared.safety, cleared.reason) == ("accepted", "")
    assert decisions(run_for(flight, 2.5)) == []
    assert flight.core.snapshot(flight.world.now).safe_state == {}
