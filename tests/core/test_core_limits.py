"""The time limits of a bend while RC is lost and returns, and who may bend by a command."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config
from flying_vines.core.events import Action, VehicleMessage
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage
from flying_vines.vehicle.triggers import Trigger
from flying_vines.vine.intent import SetPressure

from .flights import HIGH, LOW, airborne, answers, assert_vented, bent, configured, notices, run_for

ACCEPTED, DENIED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_DENIED
USER_2, USER_4, USER_5 = mavlink.MAV_CMD_USER_2, mavlink.MAV_CMD_USER_4, mavlink.MAV_CMD_USER_5
VENT, HOLD, DISARM, ARM = 0.0, 1.0, 2.0, 3.0
STATION, GIMBAL, CAMERA = (255, 190), (1, 154), (2, 100)


def holding(hold_s: float, bent_s: float) -> config.Config:
    losses = config.LossesConfig(on_rc_loss="hold", hold_at_most_s=hold_s)
    return configured(losses=losses, limits=config.LimitsConfig(max_bent_s=bent_s))


def send(
    flight: SimulatedFlight, message: MavlinkMessage, sender: tuple[int, int], sequence: int = 0
) -> list[Action]:
    codec = MavlinkCodec(*sender)
    codec._out.seq = sequence or int(flight.world.now * 1000) % 256
    (received,) = MavlinkCodec(1, 191).decode(codec.encode(message, sender[0]))
    return flight.feed(VehicleMessage(flight.world.now, received))


def command(
    flight: SimulatedFlight,
    number: int,
    *params: float,
    sender: tuple[int, int] = STATION,
    confirmation: int = 0,
    sequence: int = 0,
) -> list[Action]:
    padded = [*params, *[0.0] * (7 - len(params))]
    message = mavlink.MAVLink_command_long_message(1, 191, number, confirmation, *padded)
    # Texts wait in a queue.
    return send(flight, message, sender, sequence) + run_for(flight, 0.1)


def heartbeat(flight: SimulatedFlight, sender: tuple[int, int], kind: int) -> None:
    send(flight, mavlink.MAVLink_heartbeat_message(kind, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3), sender)


def is_bent(flight: SimulatedFlight) -> bool:
    return flight.core.snapshot(flight.world.now).command_kPa > 1.0


def bent_for(flight: SimulatedFlight, history: Sequence[tuple[bool, float]]) -> tuple[float, float]:
    """The time for which the vine stays bent while RC is lost (False) and returns (True), and the part of it
    without RC."""
    began, held_s = flight.world.now, 0.0
    for good, lasts_s in history:
        flight.autopilot.return_rc() if good else flight.autopilot.lose_rc("frozen")
        until = flight.world.now + lasts_s
        while flight.world.now < until:
            run_for(flight, 0.05)
            if not is_bent(flight):
                return flight.world.now - began, held_s
            held_s += 0.05 if "rc" in flight.core.snapshot(flight.world.now).safe_state else 0.0
    return flight.world.now - began, held_s


def test_losses_that_hold_the_vine_do_not_prolong_a_bend() -> None:
    flight = bent(conf=holding(60.0, 20.0))
    lasted_s, _ = bent_for(flight, [(False, 4.0), (True, 4.0)] * 5)
    # A trigger bent it within the last two seconds.
    assert 18.0 < lasted_s < 18.5
    run_for(flight, 0.5)
    assert_vented(flight)


def test_repeated_losses_are_held_no_longer_than_one_loss() -> None:
    flight = bent(conf=holding(5.0, 110.0))
    _, held_s = bent_for(flight, [(False, 4.0), (True, 4.0)] * 5)
    assert 4.8 < held_s < 5.1
    run_for(flight, 0.5)
    assert_vented(flight)


def test_after_a_new_move_a_loss_is_held_for_the_whole_time_again() -> None:
    flight = bent(conf=holding(5.0, 110.0))
    for _ in range(3):
        _, held_s = bent_for(flight, [(False, 5.0), (True, 3.0)])
        assert is_bent(flight) and held_s > 3.0
        flight.autopilot.set_rc(9, LOW)
        run_for(flight, 1.0)
        flight.autopilot.set_rc(9, HIGH)
        run_for(flight, 1.0)


def test_a_hold_command_is_a_new_request() -> None:
    flight = bent(conf=holding(5.0, 10.0))
    run_for(flight, 6.0)
    assert answers(command(flight, USER_4, HOLD)) == [(USER_4, ACCEPTED)]
    run_for(flight, 9.8)
    assert is_bent(flight)
    run_for(flight, 0.5)
    assert not is_bent(flight)


@pytest.mark.long
@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.lists(st.tuples(st.booleans(), st.floats(0.1, 6.0)), min_size=1, max_size=8))
def test_no_sequence_of_losses_prolongs_a_bend(history: list[tuple[bool, float]]) -> None:
    flight = bent(conf=holding(4.0, 15.0))
    lasted_s, held_s = bent_for(flight, [*history, (False, 15.0)])
    assert held_s <= 4.0 + 0.1
    # The switch became steady before the two seconds with the bend were over.
    assert lasted_s <= 15.0 - 1.5 + 0.1
    assert not is_bent(flight)


# Every vent is executed.


@pytest.mark.parametrize("what", [VENT, DISARM])
def test_a_vent_that_is_taken_for_a_repeat_vents(what: float) -> None:
    flight = airborne()
    command(flight, USER_4, what)
    command(flight, USER_4, ARM)
    run_for(flight, 0.2)
    command(flight, USER_2, 45.0)
    run_for(flight, 1.0)
    assert flight.phlosar.cv_kPa > 10.0
    assert answers(command(flight, USER_4, what, confirmation=1)) == [(USER_4, ACCEPTED)]
    run_for(flight, 1.0)
    assert_vented(flight)


def test_a_straightening_that_is_taken_for_a_copy_straightens() -> None:
    flight = airborne()
    command(flight, mavlink.MAV_CMD_USER_1, 0.0, sequence=7)
    command(flight, USER_2, 45.0)
    run_for(flight, 1.0)
    command(flight, mavlink.MAV_CMD_USER_1, 0.0, sequence=7)
    run_for(flight, 1.0)
    assert_vented(flight)


def test_a_repeated_bend_is_not_executed_again() -> None:
    flight = airborne()
    command(flight, USER_2, 45.0)
    command(flight, USER_4, VENT)
    assert answers(command(flight, USER_2, 45.0, confirmation=1)) == [(USER_2, ACCEPTED)]
    run_for(flight, 1.0)
    assert_vented(flight)


def test_a_repeated_vent_clears_no_fault() -> None:
    flight = bent()
    command(flight, USER_4, VENT)
    flight.phlosar.reset_firmware()
    run_for(flight, 1.0)
    command(flight, USER_4, VENT, confirmation=1)
    assert "firmware_reset" in flight.core.snapshot(flight.world.now).safe_state
    command(flight, USER_4, VENT)
    assert "firmware_reset" not in flight.core.snapshot(flight.world.now).safe_state


# Who may bend, and who may only vent.


def test_a_gimbal_may_vent_and_nothing_else() -> None:
    flight = bent()
    heartbeat(flight, GIMBAL, mavlink.MAV_TYPE_GIMBAL)
    for number, param in ((USER_2, 30.0), (USER_4, HOLD), (USER_4, ARM), (USER_5, 1.0)):
        actions = command(flight, number, param, sender=GIMBAL)
        assert answers(actions) == [(number, DENIED)]
        assert any(text.endswith("1/154 is not a ground station") for text in notices(actions))
        run_for(flight, 2.0)  # the fourth refusal within 5 s would only be counted
    assert is_bent(flight)
    assert answers(command(flight, USER_4, VENT, sender=GIMBAL)) == [(USER_4, ACCEPTED)]
    run_for(flight, 0.7)
    assert_vented(flight)


def test_a_vent_by_an_unknown_sender_clears_no_fault() -> None:
    flight = bent()
    flight.phlosar.reset_firmware()
    run_for(flight, 1.0)
    command(flight, USER_4, VENT, sender=GIMBAL)
    assert "firmware_reset" in flight.core.snapshot(flight.world.now).safe_state


STATIONS = [(255, 190), (255, 0), (255, 230), (254, 190), (245, 190)]
"""QGroundControl and Mission Planner, pymavlink, MAVProxy, a second ground station, mavsdk."""
STRANGERS = [(0, 190), (0, 0), (1, 190), (1, 195), (1, 0), (2, 1), (7, 190), (239, 190), (255, 1), (255, 154)]


@pytest.mark.parametrize("sender", STATIONS)
def test_a_station_without_a_heartbeat_may_bend(sender: tuple[int, int]) -> None:
    assert answers(command(airborne(), USER_2, 30.0, sender=sender)) == [(USER_2, ACCEPTED)]


def test_another_program_with_our_own_ids_may_let_air_out_and_nothing_else() -> None:
    flight, namesake = bent(), (1, 191)
    assert answers(command(flight, USER_2, 30.0, sender=namesake)) == [(USER_2, DENIED)]
    assert is_bent(flight)
    assert answers(command(flight, USER_4, VENT, sender=namesake)) == [(USER_4, ACCEPTED)]
    run_for(flight, 0.5)
    assert_vented(flight)


@pytest.mark.parametrize("sender", STRANGERS)
def test_an_unknown_sender_may_not_bend(sender: tuple[int, int]) -> None:
    flight = airborne()
    assert answers(command(flight, USER_2, 30.0, sender=sender)) == [(USER_2, DENIED)]
    run_for(flight, 0.5)
    assert_vented(flight)


@pytest.mark.parametrize(
    "kind",
    [
        mavlink.MAV_TYPE_GIMBAL,
        mavlink.MAV_TYPE_QUADROTOR,
        mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
        mavlink.MAV_TYPE_CAMERA,
        mavlink.MAV_TYPE_GENERIC,
    ],
)
def test_a_heartbeat_counts_more_than_ids(kind: int) -> None:
    flight = airborne()
    heartbeat(flight, STATION, kind)
    assert answers(command(flight, USER_2, 30.0)) == [(USER_2, DENIED)]
    heartbeat(flight, (7, 25), mavlink.MAV_TYPE_GCS)
    assert answers(command(flight, USER_2, 30.0, sender=(7, 25))) == [(USER_2, ACCEPTED)]


@pytest.mark.parametrize("sender", [(0, 190), (1, 190)])
def test_no_heartbeat_of_id_0_or_of_our_own_vehicle_makes_a_station(sender: tuple[int, int]) -> None:
    flight = airborne()
    heartbeat(flight, sender, mavlink.MAV_TYPE_GCS)
    assert answers(command(flight, USER_2, 30.0, sender=sender)) == [(USER_2, DENIED)]


def test_a_script_on_the_autopilot_may_bend_and_not_arm() -> None:
    flight = airborne()
    assert answers(command(flight, USER_2, 30.0, sender=(1, 1))) == [(USER_2, ACCEPTED)]
    assert answers(command(flight, USER_4, ARM, sender=(1, 1))) == [(USER_4, DENIED)]


def test_a_hold_of_a_lost_rc_cannot_be_prolonged() -> None:
    flight = bent(conf=holding(2.0, 60.0))
    flight.autopilot.lose_rc("frozen")
    run_for(flight, 2.0)
    assert is_bent(flight)
    actions = command(flight, USER_4, HOLD)
    assert (USER_4, DENIED) in answers(actions)
    assert any("RC lost" in text for text in notices(actions))
    run_for(flight, 2.0)
    assert not is_bent(flight)


def test_a_bend_that_is_cut_short_by_a_straightening_teaches_the_estimate_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    flight, cuts = airborne(), list[str]()
    monkeypatch.setattr(flight.core._supply.reservoir, "cut_off", lambda: cuts.append("cut"))
    t = flight.world.now
    for later_s, kPa in ((0.0, 15.0), (0.05, 0.0), (0.1, 15.0)):
        flight.core._decide(
            t + later_s, Trigger(t + later_s, "command", {}, SetPressure(kPa), by_person=True)
        )
    assert cuts == ["cut"], "a new bend instead of a running one is one longer bend"
