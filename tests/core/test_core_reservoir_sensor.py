"""What the pilot sees of the reservoir while its sensor is wrong."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial

from firmware_link.protocol import Telemetry
from flying_vines.core.events import Action, Asked, KeepLearned, ToVehicle
from flying_vines.simulation.phlosar.mishaps import Filled
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.supply import CyclesLeft
from flying_vines.terminal.screen import air
from flying_vines.vine import intent

from .flights import HIGH, LOW, airborne, bent, decisions, notices, run_for
from .test_core_board import change_telemetry

RISES = "Vine: reservoir sensor rises without filling: cycles unknown"


def values_sent(actions: Sequence[Action]) -> set[str]:
    return {
        action.message.name
        for action in actions
        if isinstance(action, ToVehicle) and action.message.get_type() == "NAMED_VALUE_FLOAT"
    }


def cycles(flight: SimulatedFlight) -> CyclesLeft | None:
    return flight.core.snapshot(flight.world.now).cycles


def aloft(reservoir_kPa: float = 600.0) -> SimulatedFlight:
    flight = airborne(phlosar=SimulatedPhlosar(reservoir_kPa=reservoir_kPa))
    run_for(flight, 4.0)
    assert cycles(flight) is not None
    return flight


def lie(flight: SimulatedFlight, reading_kPa: Callable[[float], float]) -> None:
    def changed(telemetry: Telemetry) -> Telemetry:
        return dataclasses.replace(telemetry, reservoir_kPa=reading_kPa(telemetry.reservoir_kPa))

    change_telemetry(flight, changed)


def test_a_jump_up_in_flight_makes_the_cycles_unknown_everywhere() -> None:
    flight = bent()
    assert cycles(flight) is not None
    lie(flight, lambda kPa: kPa + 45.0)
    actions = run_for(flight, 2.0)
    assert RISES in notices(actions)
    assert not any("refilled" in text for text in notices(actions))
    later = run_for(flight, 12.0)
    assert cycles(flight) is None
    assert air(cycles(flight)) == ("not known", "not known")
    assert values_sent(later).isdisjoint({"CYC_LEFT", "MIN_LEFT"})
    assert "RES_KPA" in values_sent(later), "the reading itself is shown"


def test_a_refill_of_an_armed_vehicle_is_no_refill() -> None:
    flight = aloft(400.0)
    flight.phlosar.inject("reservoir", Filled(680.0))
    assert RISES in notices(run_for(flight, 3.0))
    assert cycles(flight) is None


def test_what_a_wrong_sensor_taught_is_not_stored() -> None:
    flight = aloft()
    lie(flight, lambda kPa: kPa + 45.0)
    stored = [a.text for a in run_for(flight, 25.0) if isinstance(a, KeepLearned)]
    assert stored == [""]


def test_bends_go_on_and_the_cycles_come_back_when_the_sensor_is_right() -> None:
    flight = aloft()
    lie(flight, lambda kPa: kPa + 45.0)
    assert RISES in notices(run_for(flight, 2.0))
    flight.autopilot.set_rc(9, HIGH)
    assert [decision.safety for decision in decisions(run_for(flight, 2.0))] == ["accepted"]
    lie(flight, lambda kPa: kPa)
    texts = notices(run_for(flight, 10.0))
    assert "Vine: reservoir sensor is believed again, cycles left are learned again" in texts
    assert cycles(flight) is not None


def test_a_pilot_who_straightens_the_vine_in_flight_does_not_end_the_doubt() -> None:
    flight = aloft()
    lie(flight, lambda kPa: kPa + 45.0)
    for level in (HIGH, LOW):
        run_for(flight, 3.0)
        flight.autopilot.set_rc(9, level)
    run_for(flight, 2.0)
    assert cycles(flight) is None


def test_on_the_ground_a_person_who_has_seen_it_ends_the_doubt() -> None:
    flight = aloft()
    lie(flight, lambda kPa: kPa + 45.0)
    run_for(flight, 3.0)
    flight.autopilot.disarm()
    run_for(flight, 2.0)
    assert cycles(flight) is None
    clear = partial(Asked, by="page", intent=intent.ClearLatchedFaults())
    flight.feed(clear(flight.world.now, seen_at=8.0))
    run_for(flight, 1.0)
    assert cycles(flight) is None, "the page did not show it yet"
    texts = notices(flight.feed(clear(flight.world.now, seen_at=flight.world.now)))
    texts += notices(run_for(flight, 3.0))
    assert "Vine: reservoir sensor is believed again, cycles left are learned again" in texts
    assert cycles(flight) is not None
