"""Who may change what the service does: our autopilot and ground stations. Everybody may read."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config
from flying_vines.core.events import Action, Decision, KeepParameters, StoredState, ToVehicle, VehicleMessage
from flying_vines.core.request_lines import MAX_LINES, MAX_SOURCES
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.component.telemetry import MUTED_S, SLOW_S
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage

from .flights import (
    HIGH,
    LOW,
    airborne,
    answers,
    assert_vented,
    bent,
    ground_command,
    notices,
    on_the_ground,
    run_for,
)

STATIONS = {
    "QGroundControl, Mission Planner": (255, 190),
    "MAVProxy": (255, 230),
    "mavsdk": (245, 190),
    "pymavlink": (255, 0),
}
STRANGERS = [(77, 77), (1, 25), (2, 1), (254, 77), (0, 0), (1, 190)]
SET_INTERVAL, GET_INTERVAL, REQUEST_MESSAGE = 511, 510, 512
NAMED_VALUE = 251
ACCEPTED, DENIED = 0, 2


def send(flight: SimulatedFlight, message: MavlinkMessage, sender: tuple[int, int]) -> list[Action]:
    """Send a message, and run for a moment. Returns the actions."""
    codec = MavlinkCodec(*sender)
    codec._out.seq = int(flight.world.now * 1000) % 256
    (received,) = MavlinkCodec(1, 191).decode(codec.encode(message, sender[0]))
    actions = flight.feed(VehicleMessage(flight.world.now, received))
    return [*actions, *run_for(flight, 0.3)]


def set_parameter(
    flight: SimulatedFlight, name: str, value: float, sender: tuple[int, int]
) -> tuple[list[float], list[Action]]:
    """The values in the answers, and all actions."""
    message = mavlink.MAVLink_param_set_message(1, 191, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32)
    actions = send(flight, message, sender)
    return [m.param_value for m in sent(actions, "PARAM_VALUE")], actions


def command(flight: SimulatedFlight, number: int, *params: float, sender: tuple[int, int]) -> list[Action]:
    numbers = [*params, *[0.0] * (7 - len(params))]
    return send(flight, mavlink.MAVLink_command_long_message(1, 191, number, 0, *numbers), sender)


def sent(actions: list[Action], kind: str) -> list[MavlinkMessage]:
    messages = [action.message for action in actions if isinstance(action, ToVehicle)]
    return [message for message in messages if message.get_type() == kind]


# Parameters.


@pytest.mark.parametrize("sender", STRANGERS)
@pytest.mark.parametrize(("name", "value", "present"), [("VINE_SW_CHAN", 6, 9), ("VINE_RC_ACTION", 1, 0)])
def test_a_stranger_changes_no_parameter(
    sender: tuple[int, int], name: str, value: float, present: float
) -> None:
    flight = on_the_ground()
    told, actions = set_parameter(flight, name, value, sender)
    assert told == [present]
    assert not [action for action in actions if isinstance(action, KeepParameters)]
    who = f"{sender[0]}/{sender[1]} is not a ground station"
    assert notices(actions) == [f"Vine: {name} stays {present}: {who}"]


@pytest.mark.parametrize("station", STATIONS)
def test_every_usual_station_sets_parameters_also_without_its_heartbeat(station: str) -> None:
    told, actions = set_parameter(on_the_ground(), "VINE_SW_CHAN", 7.0, STATIONS[station])
    assert told == [7.0]
    (kept,) = [action for action in actions if isinstance(action, KeepParameters)]
    assert kept.values == {"VINE_SW_CHAN": 7.0}


def test_a_station_with_unusual_ids_sets_parameters_after_its_heartbeat() -> None:
    flight = on_the_ground()
    heartbeat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3)
    send(flight, heartbeat, (77, 77))
    assert set_parameter(flight, "VINE_SW_CHAN", 7.0, (77, 77))[0] == [7.0]


def test_a_stranger_that_tries_again_and_again_gets_all_answers_and_the_pilot_few_texts() -> None:
    flight, texts = on_the_ground(), []
    for number in range(40):
        told, actions = set_parameter(flight, "VINE_SW_HYST_US", float(number), (77, number))
        assert told == [25.0]
        texts += notices(actions)
    assert 1 <= len(texts) <= MAX_SOURCES + 2 * MAX_LINES
    run_for(flight, 6.0)
    assert set_parameter(flight, "VINE_SW_HYST_US", 25.0, (77, 77))[0] == [25.0], "no change, no text"


@pytest.mark.parametrize("sender", STRANGERS)
def test_a_stranger_may_read(sender: tuple[int, int]) -> None:
    flight = on_the_ground()
    read = mavlink.MAVLink_param_request_read_message(1, 191, b"VINE_SW_CHAN", -1)
    assert [m.param_value for m in sent(send(flight, read, sender), "PARAM_VALUE")] == [9.0]
    ping = sent(send(flight, mavlink.MAVLink_ping_message(1, 2, 1, 191), sender), "PING")
    assert len(ping) == 1
    asked = command(flight, REQUEST_MESSAGE, 148.0, sender=sender)
    assert (REQUEST_MESSAGE, ACCEPTED) in answers(asked)
    asked = command(flight, GET_INTERVAL, NAMED_VALUE, sender=sender)
    assert (GET_INTERVAL, ACCEPTED) in answers(asked)


def test_changed_parameters_that_the_configuration_does_not_bound_are_a_warning_at_every_start() -> None:
    stored = {"VINE_SW_CHAN": 7.0, "VINE_RC_ACTION": 1.0, "VINE_MAX_KPA": 10.0, "VINE_RATE_HZ": 1.0}
    flight = SimulatedFlight(config.default(), FakeAutopilot("ardupilot"), stored=StoredState(stored))
    told = notices(flight.run(4.0))
    assert [text for text in told if "VINE_" in text] == [
        "Vine: VINE_SW_CHAN is 7, configuration: 9",
        "Vine: VINE_RC_ACTION is 1, configuration: 0",
    ]


def test_the_flight_modes_channel_of_the_autopilot_is_refused() -> None:
    flight = on_the_ground()
    mode = mavlink.MAVLink_param_value_message(b"FLTMODE_CH", 8.0, mavlink.MAV_PARAM_TYPE_INT8, 1, 65535)
    send(flight, mode, (1, 1))
    told, actions = set_parameter(flight, "VINE_SW_CHAN", 8.0, (255, 190))
    assert (told, notices(actions)) == ([9.0], ["Vine: VINE_SW_CHAN stays 9: 8 is the flight mode's channel"])


# The rate of the named values.


def values_in(flight: SimulatedFlight, for_s: float) -> int:
    """How many times CV_KPA is sent."""
    actions = run_for(flight, for_s)
    return sum(message.name == "CV_KPA" for message in sent(actions, "NAMED_VALUE_FLOAT"))


@pytest.mark.parametrize("sender", STRANGERS)
@pytest.mark.parametrize("interval_us", [-1.0, 8e6, 0.2e6])
def test_a_stranger_changes_no_rate(sender: tuple[int, int], interval_us: float) -> None:
    flight = airborne()
    actions = command(flight, SET_INTERVAL, NAMED_VALUE, interval_us, sender=sender)
    assert answers(actions) == [(SET_INTERVAL, DENIED)]
    who = f"{sender[0]}/{sender[1]} is not a ground station"
    assert notices(actions) == [f"Vine: rate of values unchanged: {who}"]
    assert values_in(flight, 4.0) == pytest.approx(8, abs=1)


@pytest.mark.parametrize(
    ("interval_us", "what"), [(-1.0, "switched the values off"), (8e6, "slowed the values to one in 8 s")]
)
def test_values_that_a_station_mutes_return_by_themselves(interval_us: float, what: str) -> None:
    flight = airborne()
    actions = command(flight, SET_INTERVAL, NAMED_VALUE, interval_us, sender=(255, 190))
    assert answers(actions) == [(SET_INTERVAL, ACCEPTED)]
    assert notices(actions) == [f"Vine: 255/190 {what}, for {MUTED_S:.0f} s"]
    assert values_in(flight, MUTED_S - 0.5) <= MUTED_S / 8.0
    assert values_in(flight, 4.0) == pytest.approx(8, abs=1)


def test_a_moderate_rate_stays() -> None:
    flight = airborne()
    actions = command(flight, SET_INTERVAL, NAMED_VALUE, SLOW_S * 1e6, sender=(255, 190))
    assert notices(actions) == []
    run_for(flight, MUTED_S)
    assert values_in(flight, 4 * SLOW_S) == pytest.approx(4, abs=1)


# Floods by many senders: a vent acts, and is answered.


def bends_by_many(flight: SimulatedFlight, first: int, last: int) -> list[Action]:
    """A refused command of each of many senders, all at once."""
    actions: list[Action] = []
    for number in range(first, last):
        message = mavlink.MAVLink_command_long_message(1, 191, 31011, 0, 20.0, 0, 0, 0, 0, 0, 0)
        system, component = 2 + number % 200, 30 + number // 200
        frame = MavlinkCodec(system, component).encode(message, system)
        (received,) = MavlinkCodec(1, 191).decode(frame)
        actions += flight.feed(VehicleMessage(flight.world.now, received))
    return actions


@pytest.mark.parametrize("clock_known", [True, False])
@pytest.mark.parametrize(("before", "after"), [(0, 60), (0, 300), (20, 60), (100, 300)])
def test_among_the_commands_of_hundreds_of_senders_a_vent_acts_and_is_answered(
    before: int, after: int, clock_known: bool
) -> None:
    flight = bent()
    if not clock_known:
        flight.core._vehicle.state.clock.forget()
    actions = bends_by_many(flight, 0, before)
    actions += ground_command(flight, 31013, 0.0)
    actions += bends_by_many(flight, before, before + after)
    actions += run_for(flight, 1.5)
    assert (31013, ACCEPTED) in answers(actions)
    assert_vented(flight)


def test_a_bend_of_unknown_age_that_cannot_wait_is_refused_as_late() -> None:
    flight = airborne()
    flight.core._vehicle.state.clock.forget()
    actions = ground_command(flight, 31011, 30.0)
    actions += bends_by_many(flight, 0, 60)
    (decision, *_) = [action for action in actions if isinstance(action, Decision)]
    assert (decision.safety, decision.reason) == ("refused", "came 60.0 s late")


# RC overrides.


@pytest.mark.parametrize(("vehicle", "bends"), [(1, False), (0, False), (2, True)])
def test_an_override_of_another_vehicle_says_nothing_about_our_switch(vehicle: int, bends: bool) -> None:
    flight = airborne()
    send(flight, mavlink.MAVLink_rc_channels_override_message(vehicle, 1, *[LOW] * 18), (255, 190))
    run_for(flight, 2.6)  # an override lasts 3 s
    flight.autopilot.set_rc(9, HIGH)
    actions = run_for(flight, 1.0)
    assert ("Vine: switch ch9 moved as an override ended, move it again" in notices(actions)) is not bends
    assert (flight.phlosar.cv_kPa > 15.0) is bends
