"""Requests of page and broker: what they may request, how late, and which faults they clear."""

from __future__ import annotations

import math

import pytest

from flying_vines.config import config
from flying_vines.config.config import Config
from flying_vines.core.events import Asked, Decision, KeepDisarmed, Stop
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.triggers import Trigger
from flying_vines.vine.intent import (
    ArmPneumatics,
    Asker,
    BendTo,
    ClearLatchedFaults,
    DisarmPneumatics,
    Hold,
    Intent,
    SetPressure,
    StartBench,
    StartProfile,
    StopBench,
    VentVine,
)

from .flights import HIGH, LOW, airborne, assert_vented, bent, configured, on_the_ground, run_for
from .prepared import prepared

TAKES_AIR: list[Intent] = [
    BendTo(30.0),
    SetPressure(9.0),
    StartProfile("bend-half"),
    Hold(),
]
LETS_OUT: list[Intent] = [
    VentVine(),
    DisarmPneumatics(),
    StartProfile("straight"),
    BendTo(0.0),
    SetPressure(0.0),
]


def open_to(*commands: str) -> Config:
    return configured(mqtt=config.MqttConfig(commands=commands))  # type: ignore[arg-type]


def ask(
    flight: SimulatedFlight, by: Asker, intent: Intent, age_s: float | None = 0.0, seen_s: float | None = 0.0
) -> Decision:
    """Send a request. It was made `age_s` ago, when the sender saw the state of `seen_s` ago."""
    now = flight.world.now
    made_at = None if age_s is None else now - age_s
    seen_at = None if seen_s is None else now - seen_s
    (decision,) = (
        action
        for action in flight.feed(Asked(now, by, intent, made_at, seen_at))
        if isinstance(action, Decision)
    )
    return decision


def on_the_bench() -> SimulatedFlight:
    flight = on_the_ground()
    assert ask(flight, "page", StartBench()).safety == "accepted"
    return flight


# Age of requests.


@pytest.mark.parametrize("by", ["page", "broker"])
def test_a_late_request_is_refused_and_its_age_is_reported(by: Asker) -> None:
    flight = on_the_bench()
    late = ask(flight, by, BendTo(30.0), age_s=9.04)
    assert (late.safety, late.reason) == ("refused", "too late: requested 9.0 s ago")
    run_for(flight, 1.0)
    assert_vented(flight)


@pytest.mark.parametrize(
    "intent",
    [*TAKES_AIR, ArmPneumatics(), ClearLatchedFaults(), StartBench()],
    ids=lambda intent: str(intent),
)
def test_a_late_request_may_only_let_air_out(intent: Intent) -> None:
    flight = on_the_bench()
    late = ask(flight, "page", intent, age_s=1.1)
    assert (late.safety, late.reason) == ("refused", "too late: requested 1.1 s ago")
    run_for(flight, 0.5)
    assert_vented(flight)


def test_if_there_are_two_reasons_the_age_is_reported() -> None:
    late = ask(on_the_bench(), "page", ClearLatchedFaults(), age_s=1.1, seen_s=None)
    assert (late.safety, late.reason) == ("refused", "too late: requested 1.1 s ago")


@pytest.mark.parametrize("age_s", [0.0, 0.95, -3.0, None])
def test_a_recent_request_is_executed(age_s: float | None) -> None:
    assert ask(on_the_bench(), "page", BendTo(30.0), age_s=age_s).safety == "accepted"


@pytest.mark.parametrize("by", ["page", "broker"])
@pytest.mark.parametrize("intent", LETS_OUT, ids=lambda intent: str(intent))
def test_letting_air_out_is_never_late(by: Asker, intent: Intent) -> None:
    flight = bent()
    assert ask(flight, by, intent, age_s=60.0).safety == "accepted"
    run_for(flight, 1.0)
    assert_vented(flight)


@pytest.mark.parametrize("intent", LETS_OUT, ids=lambda intent: str(intent))
def test_letting_air_out_is_accepted_while_the_service_is_stopping(intent: Intent) -> None:
    flight = on_the_bench()
    ask(flight, "page", BendTo(30.0))
    run_for(flight, 1.0)
    flight.feed(Stop(flight.world.now))
    refused = ask(flight, "page", BendTo(30.0))
    assert (refused.safety, refused.reason) == ("refused", "the service is stopping")
    assert ask(flight, "page", intent).safety == "accepted"
    run_for(flight, 1.0)
    assert_vented(flight)


def test_a_disarm_while_the_service_is_stopping_is_stored() -> None:
    flight = bent()
    flight.feed(Stop(flight.world.now))
    now = flight.world.now
    assert KeepDisarmed(now, True) in flight.feed(Asked(now, "page", DisarmPneumatics(), now, now))


def test_late_requests_after_a_pause_of_the_process_are_not_executed() -> None:
    flight = on_the_bench()
    asked_at = flight.world.now
    flight.stall(asked_at + 9.0)
    (late,) = (
        action
        for action in flight.feed(Asked(flight.world.now, "page", BendTo(30.0), asked_at))
        if isinstance(action, Decision)
    )
    assert "too late: requested 9.0 s ago" in late.reason
    run_for(flight, 1.0)
    assert_vented(flight)


# Permitted requests.


@pytest.mark.parametrize("intent", TAKES_AIR, ids=lambda intent: str(intent))
def test_the_page_takes_no_air_in_flight(intent: Intent) -> None:
    flight = airborne()
    refused = ask(flight, "page", intent)
    assert (refused.safety, refused.reason) == (
        "refused",
        "the page cannot bend the vine while the vehicle is armed",
    )
    run_for(flight, 1.0)
    assert_vented(flight)


def test_the_page_takes_no_air_in_flight_with_a_bench_configuration() -> None:
    flight = airborne(configured(interlocks=config.InterlocksConfig(bench_mode=True)))
    assert ask(flight, "page", BendTo(30.0)).safety == "refused"


def test_a_configuration_for_the_bench_is_bench_mode() -> None:
    flight = on_the_ground(configured(interlocks=config.InterlocksConfig(bench_mode=True)))
    assert ask(flight, "page", BendTo(30.0)).safety == "accepted"


def test_the_page_takes_air_on_the_ground_only_in_bench_mode() -> None:
    flight = on_the_ground()
    for intent in TAKES_AIR:
        assert ask(flight, "page", intent).reason == "the page can bend the vine only in bench mode"
    ask(flight, "page", StartBench())
    assert ask(flight, "page", BendTo(30.0)).safety == "accepted"
    assert ask(flight, "page", Hold()).safety == "accepted"


def test_the_page_arms_disarms_and_clears_in_flight() -> None:
    flight = airborne()
    wanted: tuple[Intent, ...] = (DisarmPneumatics(), ArmPneumatics(), ClearLatchedFaults())
    for intent in wanted:
        assert ask(flight, "page", intent).safety == "accepted"


def test_the_broker_may_do_what_the_configuration_lists() -> None:
    flight = airborne(open_to("vent", "bend"))
    assert ask(flight, "broker", BendTo(30.0)).safety == "accepted"
    assert ask(flight, "broker", SetPressure(9.0)).reason == "mqtt.commands does not list pressure"
    unlisted: tuple[Intent, ...] = (ArmPneumatics(), ClearLatchedFaults(), StartBench(), Hold())
    for intent in unlisted:
        assert ask(flight, "broker", intent).reason.startswith("mqtt.commands does not list ")
    lets_out: tuple[Intent, ...] = (StopBench(), VentVine())
    for out in lets_out:
        assert "mqtt.commands" not in ask(flight, "broker", out).reason


# Cleared faults.


def with_latched_fault() -> SimulatedFlight:
    """A flight with a fault that latched two seconds ago; its cause is gone."""
    return prepared(_with_latched_fault)


def _with_latched_fault() -> SimulatedFlight:
    flight = bent(conf=open_to("vent", "clear_faults"))
    flight.phlosar.reset_firmware()
    run_for(flight, 2.0)
    assert faults(flight) == {"firmware_reset"}
    return flight


def faults(flight: SimulatedFlight) -> set[str]:
    return set(flight.core.snapshot(flight.world.now).safe_state)


@pytest.mark.parametrize("by", ["page", "broker"])
@pytest.mark.parametrize("intent", [VentVine(), StartProfile("straight"), ClearLatchedFaults()])
def test_a_fault_that_was_seen_is_cleared(by: Asker, intent: Intent) -> None:
    flight = with_latched_fault()
    assert ask(flight, by, intent, seen_s=0.5).safety == "accepted"
    assert faults(flight) == set()


@pytest.mark.parametrize("by", ["page", "broker"])
@pytest.mark.parametrize("intent", [VentVine(), StartProfile("straight"), ClearLatchedFaults()])
@pytest.mark.parametrize("seen_s", [3.0, None, -1e6], ids=["before", "nothing", "before the computer began"])
def test_a_fault_that_was_not_seen_stays(by: Asker, intent: Intent, seen_s: float | None) -> None:
    flight = with_latched_fault()
    decision = ask(flight, by, intent, seen_s=seen_s)
    assert faults(flight) == {"firmware_reset"}
    if isinstance(intent, ClearLatchedFaults) and seen_s != 3.0:
        assert decision.reason == "the request does not say which state the person saw"
    else:
        assert decision.safety == "accepted"


def test_a_fault_of_the_firmware_that_was_not_seen_stays() -> None:
    flight = bent(conf=open_to("vent"))
    before = flight.world.now
    # The firmware's dead-man runs out.
    flight.stall(before + 1.0)
    run_for(flight, 0.5)
    assert faults(flight) == {"firmware_fault"}
    for seen_at, left in ((before, {"firmware_fault"}), (flight.world.now, set())):
        flight.feed(Asked(flight.world.now, "broker", VentVine(), flight.world.now, seen_at))
        run_for(flight, 0.5)
        assert faults(flight) == left


def test_an_item_of_the_mission_clears_no_fault() -> None:
    flight = with_latched_fault()
    t = flight.world.now
    decision = flight.core._decide(t, Trigger(t, "mission_item", {}, StartProfile("straight")))
    assert decision.safety == "accepted"
    assert faults(flight) == {"firmware_reset"}


def test_the_pilots_switch_and_the_calibration_on_the_terminal_clear_every_fault() -> None:
    flight = with_latched_fault()
    flight.autopilot.set_rc(9, LOW)
    run_for(flight, 1.0)
    assert faults(flight) == set()
    flight.autopilot.set_rc(9, HIGH)
    flight = with_latched_fault()
    ask(flight, "calibration", VentVine(), age_s=None, seen_s=None)
    assert faults(flight) == set()
    assert not math.isnan(flight.core.snapshot(flight.world.now).cv_kPa)
