"""Parameters that a pilot sets are active at once and saved. They never change during a bend."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config
from flying_vines.core.events import Action, Decision, KeepParameters, StoredState, ToVehicle, VehicleMessage
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage

REAL32 = mavlink.MAV_PARAM_TYPE_REAL32
BEND = 31011


class Field:
    """A vine on the bench, and a ground station."""

    def __init__(self) -> None:
        text = config.default_text().replace("bench_mode = false", "bench_mode = true")
        self.flight = SimulatedFlight(config.parse(text, "bench.toml"), FakeAutopilot("ardupilot"))
        self.actions: list[Action] = self.flight.run(3.0)
        self._station = MavlinkCodec(255, 190)

    def send(self, message: MavlinkMessage) -> list[Action]:
        """Send a message, and run for a moment. Returns the actions."""
        (received,) = MavlinkCodec(1, 191).decode(self._station.encode(message, 255))
        actions = self.flight.feed(VehicleMessage(self.flight.world.now, received))
        actions += self.flight.run(self.flight.world.now + 0.2)
        self.actions += actions
        return actions

    def set(self, name: str, value: float) -> float:
        """Set a parameter. Returns the value that the service reports."""
        actions = self.send(mavlink.MAVLink_param_set_message(1, 191, name.encode(), value, REAL32))
        (answer,) = (m for m in sent(actions) if m.get_type() == "PARAM_VALUE")
        assert answer.param_id == name
        return float(answer.param_value)

    def bend(self, angle_deg: float) -> Decision:
        message = mavlink.MAVLink_command_long_message(1, 191, BEND, 0, angle_deg, 0, 0, 0, 0, 0, 0)
        (decision,) = (action for action in self.send(message) if isinstance(action, Decision))
        return decision


def sent(actions: list[Action]) -> list[MavlinkMessage]:
    return [action.message for action in actions if isinstance(action, ToVehicle)]


def test_a_slower_rate_is_used_for_the_next_bend_and_is_saved() -> None:
    field = Field()
    assert field.set("VINE_MAX_RATE", 5.0) == 5.0
    assert field.flight.core.config.limits.max_rate_kPa_per_s == 5.0
    field.bend(60.0)
    began_kPa = field.flight.phlosar.cv_kPa
    field.flight.run(field.flight.world.now + 2.0)
    assert field.flight.phlosar.cv_kPa - began_kPa == pytest.approx(10.0, abs=1.0)
    (stored,) = (action for action in field.actions if isinstance(action, KeepParameters))
    assert stored.values == {"VINE_MAX_RATE": 5.0}


def test_settings_of_the_vine_do_not_change_while_it_is_bent() -> None:
    field = Field()
    field.bend(30.0)
    assert field.set("VINE_MAX_RATE", 5.0) == 60.0
    assert field.set("VINE_RATE_HZ", 1.0) == 1.0
    field.send(mavlink.MAVLink_command_long_message(1, 191, 31013, 0, 0, 0, 0, 0, 0, 0, 0))
    field.flight.run(field.flight.world.now + 3.0)
    assert field.set("VINE_MAX_RATE", 5.0) == 5.0


def test_limits_reach_safety() -> None:
    field = Field()
    assert field.set("VINE_RESERVE_KPA", 2000.0) == 2000.0
    refused = field.bend(30.0)
    assert refused.safety == "refused" and "reservoir at" in refused.reason


def test_a_profile_that_a_parameter_makes_too_strong_is_clipped_and_reported() -> None:
    field = Field()
    assert field.set("VINE_MAX_KPA", 10.0) == 10.0
    clipped = field.bend(60.0)
    assert (clipped.safety, clipped.reason, clipped.setpoint_kPa) == ("limited", "to 10 kPa", 10.0)
    field.flight.run(field.flight.world.now + 3.0)
    assert field.flight.phlosar.cv_kPa == pytest.approx(10.0, abs=0.5)


def test_another_switch_channel_waits_for_a_new_move() -> None:
    field = Field()
    field.flight.autopilot.set_rc(9, 2000)
    field.flight.autopilot.set_rc(7, 2000)
    field.flight.run(field.flight.world.now + 2.0)
    field.send(mavlink.MAVLink_command_long_message(1, 191, 31013, 0, 0, 0, 0, 0, 0, 0, 0))
    field.flight.run(field.flight.world.now + 3.0)
    assert field.set("VINE_SW_CHAN", 7.0) == 7.0
    quiet = field.flight.run(field.flight.world.now + 3.0)
    assert not [action for action in quiet if isinstance(action, Decision)]
    field.flight.autopilot.set_rc(7, 1000)
    field.flight.run(field.flight.world.now + 1.0)
    field.flight.autopilot.set_rc(7, 1500)
    moved = field.flight.run(field.flight.world.now + 1.0)
    (decision,) = (action for action in moved if isinstance(action, Decision))
    assert (decision.what["channel"], decision.intent) == (7, "bend-half")


def test_saved_parameters_are_active_from_the_start() -> None:
    from flying_vines.core.core import Core

    core = Core(config.default(), stored=StoredState({"VINE_MAX_KPA": 10.0, "VINE_RC_ACTION": 1.0}))
    assert core.config.limits.max_kPa == 10.0
    assert core.config.losses.on_rc_loss == "hold"


@pytest.mark.parametrize(
    ("pause_s", "values", "answers"),
    [
        (0.5, (5.0, 5.0), [5.0, 5.0]),
        (0.5, (5.0, 7.0, 5.0), [5.0, 7.0, 7.0]),  # it may be a router's copy of the first request
        (2.5, (5.0, 7.0, 5.0), [5.0, 7.0, 5.0]),
    ],
)
def test_each_request_with_one_sequence_number_is_answered_and_a_copy_changes_nothing(
    pause_s: float, values: tuple[float, ...], answers: list[float]
) -> None:
    field, ours = Field(), MavlinkCodec(1, 191)
    got = []
    for value in values:
        message = mavlink.MAVLink_param_set_message(1, 191, b"VINE_MAX_RATE", value, REAL32)
        now = field.flight.world.now
        actions: list[Action] = []
        for received in ours.decode(MavlinkCodec(255, 190).encode(message, 255), now):
            actions += field.flight.feed(VehicleMessage(now, received))
        actions += field.flight.run(now + pause_s)
        got += [m.param_value for m in sent(actions) if m.get_type() == "PARAM_VALUE"]
    assert got == answers
