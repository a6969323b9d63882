"""Displays show what is known: of a silent board, of a vent that nothing confirms, of a busy computer."""

from __future__ import annotations

import pytest

from flying_vines.core.events import Asked, Decision, Tick
from flying_vines.service.systemd import status_line
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vine.intent import VentVine

from .flights import airborne, bent, notices, run_for


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


@pytest.mark.parametrize("late_s", [0.0, 0.34])
def test_a_loss_while_this_computer_is_late_says_so(late_s: float) -> None:
    flight = bent()
    actions = flight.core.handle(Tick(flight.world.now + 0.02, late_s))
    flight.world.from_phlosar = lambda data: b""
    actions += run_for(flight, 1.0)
    lost = next(text for text in notices(actions) if "telemetry" in text)
    busy = " (this computer is too busy: late by 340 ms)" if late_s else ""
    assert lost == f"Vine: phloSAR telemetry stale, vent commanded{busy}"
    assert ("Vine: this computer is too busy: late by 340 ms" in notices(actions)) is bool(late_s)
    assert ("this computer" in flight.core.snapshot(flight.world.now).unstable) is bool(late_s)
