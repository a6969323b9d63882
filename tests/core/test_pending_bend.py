"""The notice that a requested bend cannot begin: its time and its text."""

from __future__ import annotations

import random
from collections.abc import Sequence

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from firmware_link.protocol import Setpoint, Vent
from flying_vines.core.events import Action, Asked, Decision, LinkChanged, ToFirmware
from flying_vines.core.pending_bend import PendingBend
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vine.intent import BendTo, StartBench, VentVine

from .flights import HIGH, LOW, MIDDLE, airborne, bent, ground_command, notices, run_for

UP_AGAIN = "switch down, then up"


def waiting(flight: SimulatedFlight) -> PendingBend | None:
    return flight.core.snapshot(flight.world.now).waiting


def vent_on_page(flight: SimulatedFlight) -> None:
    flight.feed(Asked(flight.world.now, "page", VentVine(), seen_at=flight.world.now))


def test_a_vent_by_another_person_waits_for_the_switch_and_is_reported_once() -> None:
    flight = bent()
    vent_on_page(flight)
    texts = notices(run_for(flight, 5.0))
    assert waiting(flight) == PendingBend("stopped earlier: vent by the page", f"{UP_AGAIN} within 2 s")
    assert texts == [f"Vine: waiting for: {UP_AGAIN} within 2 s"]
    flight.autopilot.set_rc(9, LOW)
    run_for(flight, 1.0)
    assert waiting(flight) is None
    flight.autopilot.set_rc(9, HIGH)
    assert notices(run_for(flight, 1.0)) == []
    assert waiting(flight) is None


def test_after_a_loss_of_rc_the_reason_is_shown_and_reported_when_rc_is_back() -> None:
    flight = bent()
    flight.autopilot.lose_rc("jump")
    texts = notices(run_for(flight, 3.0))
    assert not [text for text in texts if "waiting" in text]
    during = waiting(flight)
    assert during is not None and "RC lost" in during.stopped_by and during.awaited == UP_AGAIN
    flight.autopilot.return_rc()
    assert notices(run_for(flight, 4.0)) == ["Vine: RC is back", f"Vine: waiting for: {UP_AGAIN}"]
    assert waiting(flight) == during


def test_a_switch_that_is_not_down_when_the_link_opens_waits() -> None:
    flight = airborne()
    flight.autopilot.set_rc(9, MIDDLE)
    run_for(flight, 1.0)
    flight.feed(LinkChanged(flight.world.now, "vehicle", False))
    run_for(flight, 1.0)
    flight.feed(LinkChanged(flight.world.now, "vehicle", True))
    run_for(flight, 4.0)
    now = waiting(flight)
    assert now is not None and now.awaited == UP_AGAIN


def test_a_refused_bend_waits_with_the_reason() -> None:
    flight = airborne()
    flight.autopilot.disarm()
    run_for(flight, 2.0)
    flight.autopilot.set_rc(9, HIGH)
    run_for(flight, 1.0)
    assert waiting(flight) == PendingBend("refused: not armed", UP_AGAIN)


def test_a_command_that_a_failsafe_ended_waits_for_a_request() -> None:
    flight = airborne()
    ground_command(flight, mavlink.MAV_CMD_USER_2, 30.0)
    run_for(flight, 2.0)
    flight.phlosar.reset_firmware()
    run_for(flight, 3.0)
    now = waiting(flight)
    assert now is not None and now.awaited == "a new request" and "restarted" in now.stopped_by
    ground_command(flight, mavlink.MAV_CMD_USER_4, 0.0)
    run_for(flight, 0.5)
    assert waiting(flight) is None, "a person's vent cancels the request"


def test_the_end_of_bench_mode_is_reported() -> None:
    flight = airborne()
    flight.autopilot.disarm()
    run_for(flight, 2.0)
    for intent in (StartBench(), BendTo(30.0)):
        flight.feed(Asked(flight.world.now, "page", intent, seen_at=flight.world.now))
    run_for(flight, 1.0)
    flight.autopilot.takeoff(10.0)
    run_for(flight, 2.0)
    assert waiting(flight) == PendingBend(
        "stopped earlier: bench mode is over: the vehicle is armed", "a new request"
    )


class Oracle:
    """Derives from the actions only whether the vine moves, and who requested the last bend."""

    def __init__(self) -> None:
        self.moves = False
        self.asker = ""

    def take(self, actions: Sequence[Action]) -> None:
        for action in actions:
            match action:
                case ToFirmware(Setpoint()):
                    self.moves = True
                case ToFirmware(Vent()):
                    self.moves = False
                case Decision(trigger=("failsafe" | "link")) | Decision(safety="refused"):
                    pass
                case Decision(trigger=kind, setpoint_kPa=kPa):
                    self.asker = kind if kPa > 0.0 else ""


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2, 3))])
def test_the_notice_is_shown_exactly_while_a_request_has_no_effect(seed: int) -> None:
    """Random moves, requests and losses. The vine stays bent after each profile of the switch."""
    draw = random.Random(seed)
    flight = airborne()
    oracle, waited = Oracle(), 0

    def let(seconds: float) -> None:
        nonlocal waited
        for _ in range(round(seconds / 0.1)):
            oracle.take(run_for(flight, 0.1))
            shown = flight.core.snapshot(flight.world.now)
            by_switch = bool(shown.switch_position)
            by_request = oracle.asker in ("command", "page")
            if shown.switch_position is not None:
                expected = not oracle.moves and (by_switch or by_request)
                assert (shown.waiting is not None) == expected, (seed, flight.world.now, shown)
            if shown.waiting:
                waited += 1
                assert not oracle.moves and shown.waiting.stopped_by
                assert (UP_AGAIN in shown.waiting.awaited) >= by_switch

    for _ in range(14):
        match draw.randrange(8):
            case 0 | 1:
                flight.autopilot.set_rc(9, draw.choice((LOW, MIDDLE, HIGH)))
            case 2:
                oracle.take(flight.feed(Asked(flight.world.now, "page", VentVine())))
            case 3:
                oracle.take(ground_command(flight, mavlink.MAV_CMD_USER_2, draw.uniform(10.0, 60.0)))
            case 4:
                flight.autopilot.lose_rc("jump")
                let(draw.uniform(0.5, 2.0))
                flight.autopilot.return_rc()
            case 5:
                flight.phlosar.reset_firmware()
            case 6:
                flight.autopilot.mute(2.0)
            case 7:
                oracle.take(ground_command(flight, mavlink.MAV_CMD_USER_5, 1.0))
        let(draw.uniform(0.3, 2.0))
    assert waited > 3
