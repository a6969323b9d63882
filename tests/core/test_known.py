"""Displays show what is known: of a silent board, of a vent that nothing confirms, of a busy computer."""

from __future__ import annotations

import pytest

from flying_vines.core.events import Action, Asked, Decision, Tick
from flying_vines.service.systemd import status_line
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vine.intent import VentVine

from .flights import airborne, bent, run_for, shown


def silent_flight() -> SimulatedFlight:
    """A flight with a bent vine whose board falls silent for 9 s. The port stays open."""
    flight = bent()
    flight.world.from_phlosar = lambda data: b""
    run_for(flight, 9.0)
    return flight


def test_a_silent_board_is_neither_ready_nor_vented() -> None:
    flight = silent_flight()
    shown = flight.core.snapshot(flight.world.now)
    assert shown.firmware == "silent for 9 s"
    assert shown.doing == "vent sent, not confirmed"
    assert shown.round_trip_s is None
    assert "phloSAR silent for 9 s" in status_line(shown) and "ready" not in status_line(shown)


def test_a_vent_that_nothing_confirms_says_so() -> None:
    flight = silent_flight()
    actions = flight.core.handle(Asked(flight.world.now, "page", VentVine()))
    (decision,) = (action for action in actions if isinstance(action, Decision))
    assert (decision.safety, decision.reason) == ("accepted", "not confirmed: phloSAR silent for 9 s")


def test_a_vine_that_still_has_pressure_is_venting_and_then_vented() -> None:
    flight = bent()
    flight.core.handle(Asked(flight.world.now, "page", VentVine()))
    assert flight.core.snapshot(flight.world.now).doing == "venting"
    run_for(flight, 5.0)
    assert flight.core.snapshot(flight.world.now).doing == "vented"


def test_a_silent_autopilot_is_shown_as_silent() -> None:
    flight = airborne()
    for i in range(500):
        flight.core.handle(Tick(flight.world.now + 0.02 * i))
    assert flight.core.snapshot(flight.world.now + 10.0).vehicle.endswith("silent for 10 s")


LATE = "Vine: this computer is too busy: late by"
DEAD_MAN = "Vine: firmware fault: dead-man timer ran out, vented"
WAITING = "Vine: waiting for: switch down, then up"
KEEPS_UP = "Vine: this computer keeps up again"


@pytest.mark.parametrize(
    "stall_s, texts",
    [
        (0.1, []),
        (0.6, [DEAD_MAN, f"{LATE} 600 ms", WAITING, KEEPS_UP]),
        (3.0, [f"{LATE} 3.0 s, vented", DEAD_MAN, WAITING, KEEPS_UP]),
    ],
)
def test_a_stall_of_this_computer_is_the_loss(stall_s: float, texts: list[str]) -> None:
    """What waited in the queues comes before the tick, and shows losses that are our own."""
    flight = bent()
    actions = flight.stall(flight.world.now + stall_s)
    assert shown([*actions, *run_for(flight, 12.0)]) == texts


def test_many_stalls_are_few_lines() -> None:
    flight = bent()
    actions: list[Action] = []
    for _ in range(20):
        actions += [*flight.stall(flight.world.now + 1.5), *run_for(flight, 0.4)]
    texts = shown([*actions, *run_for(flight, 12.0)])
    assert len(texts) <= 5 and not any("stale" in text or "silent" in text for text in texts), texts


def test_a_loss_that_outlasts_the_stall_is_told() -> None:
    flight = bent()
    actions = flight.stall(flight.world.now + 0.6)
    flight.world.from_phlosar = lambda data: b""
    actions += run_for(flight, 1.0)
    assert "this computer" in flight.core.snapshot(flight.world.now).unstable
    stale = "Vine: phloSAR telemetry stale, vent commanded"
    assert stale not in shown(actions) and stale in shown(run_for(flight, 2.0))
    assert "this computer" not in flight.core.snapshot(flight.world.now).unstable
