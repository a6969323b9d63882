"""The whole core in simulated time between a simulated autopilot and a simulated phloSAR."""

from __future__ import annotations

import dataclasses
import itertools
import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from firmware_link.protocol import ClearFaults, Fault, Setpoint
from flying_vines.config import config
from flying_vines.core.core import Core
from flying_vines.core.events import (
    Action,
    Decision,
    FirmwareMessage,
    KeepLatched,
    KeepLearned,
    LinkChanged,
    Stop,
    StoredState,
    ToFirmware,
    ToVehicle,
    VehicleMessage,
)
from flying_vines.core.safety import INTERNAL_ERROR
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.phlosar.mishaps import Hole, Open, StuckAt
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.simulation.simulated_world import SimulatedFlight, SimulatedWorld
from flying_vines.supply import ReservoirEstimate
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.mission.item import MissionItem

from .flights import (
    HIGH,
    LOW,
    MIDDLE,
    airborne,
    answers,
    assert_vented,
    begin_bent,
    bent,
    configured,
    decisions,
    ground_command,
    notices,
    run_for,
    setpoints,
    shown,
)


@pytest.mark.parametrize("likely", [False, True])
def test_the_switch_bends_and_straightens(likely: bool) -> None:
    flight = bent(SimulatedPhlosar() if likely else None)
    flight.autopilot.set_rc(9, LOW)
    (decision,) = decisions(run_for(flight, 2.0))
    assert (decision.trigger, decision.intent) == ("switch", "straight")
    assert_vented(flight)


def test_a_copied_flight_continues_like_its_original() -> None:
    def flown(flight: SimulatedFlight) -> list[str]:
        actions: list[Action] = []
        for pulse_us in (LOW, HIGH):
            flight.autopilot.set_rc(9, pulse_us)
            actions += run_for(flight, 1.0)
        return [
            *(str(a.message) if isinstance(a, ToVehicle) else str(a) for a in actions),
            str(flight.phlosar.state),
        ]

    first, copy, untouched = begin_bent(config.default()), bent(), bent()
    state = untouched.phlosar.state
    assert flown(first) == flown(copy)
    assert untouched.phlosar.state == state


def test_a_query_changes_nothing() -> None:
    def flown(with_queries: bool) -> list[str]:
        flight = airborne()
        core, actions = flight.core, []
        for pulse_us in (HIGH, LOW):
            flight.autopilot.set_rc(9, pulse_us)
            for _ in range(50):
                actions += run_for(flight, 0.03)
                if with_queries:
                    core.snapshot(flight.world.now)
                    core._conditions(flight.world.now)
                    core._supply.reservoir.cycles_left()
        return [str(a.message) if isinstance(a, ToVehicle) else str(a) for a in actions]

    assert flown(with_queries=True) == flown(with_queries=False)


def test_the_first_setpoint_is_sent_with_the_trigger_and_is_above_zero() -> None:
    flight = airborne()
    flight.autopilot.set_rc(9, HIGH)
    actions = run_for(flight, 1.0)
    at = next(i for i, a in enumerate(actions) if isinstance(a, Decision))
    sent = [a.message for a in actions[:at] if isinstance(a, ToFirmware) and isinstance(a.message, Setpoint)]
    assert len(sent) == 1
    assert sent[0].target_kPa > 0.5


def test_a_weak_reservoir_bends_the_vine_slower() -> None:
    flight = airborne(phlosar=SimulatedPhlosar(reservoir_kPa=110.0))
    flight.autopilot.set_rc(9, HIGH)
    actions = run_for(flight, 2.0)
    (decision,) = decisions(actions)
    assert (decision.safety, decision.reason[:6]) == ("limited", "slower")
    strong = airborne()
    strong.autopilot.set_rc(9, HIGH)
    (rate,) = {s.rate_kPa_per_s for s in setpoints(run_for(strong, 2.0))}
    assert {s.rate_kPa_per_s < 0.95 * rate for s in setpoints(actions)} == {True}


def test_straight_regulates_a_bent_vine_down_and_leaves_a_venting_vine_venting() -> None:
    flight = bent()
    ground_command(flight, mavlink.MAV_CMD_USER_1, 0.0)
    targets_kPa = [setpoint.target_kPa for setpoint in setpoints(run_for(flight, 1.0))]
    assert len(targets_kPa) > 10
    assert targets_kPa[-2:] == [0.0, 0.0], "regulated until it is straight"
    assert setpoints(run_for(flight, 1.0)) == [], "then vented"
    flight = bent()
    ground_command(flight, mavlink.MAV_CMD_USER_4, 0.0)
    actions = ground_command(flight, mavlink.MAV_CMD_USER_2, 0.0)
    assert [d.safety for d in decisions(actions)] == ["accepted"]
    assert setpoints([*actions, *run_for(flight, 1.0)]) == []


def test_a_bend_whose_cost_is_unknown_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    flight = airborne()
    monkeypatch.setattr(ReservoirEstimate, "spending_kPa", lambda *_: 1 / 0)
    actions = ground_command(flight, mavlink.MAV_CMD_USER_2, 30.0)
    assert [(d.safety, d.reason) for d in decisions(actions)][-1:] == [("refused", INTERNAL_ERROR)]
    run_for(flight, 0.5)
    assert_vented(flight)


def test_rc_that_is_lost_at_arming_is_a_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only a vehicle that was armed without RC flies without RC."""
    flight = airborne()
    vehicle, t = flight.core._vehicle, flight.world.now
    monkeypatch.setattr(vehicle.state.arm_state, "armed", False)
    assert flight.core._conditions(t).rc_problem is None
    monkeypatch.setattr(vehicle.state.arm_state, "armed", True)
    assert flight.core._conditions(t + 60.0).rc_problem is not None


def test_a_vent_without_a_fault_clears_nothing() -> None:
    cleared = [
        a
        for a in ground_command(airborne(), mavlink.MAV_CMD_USER_4, 0.0)
        if isinstance(a, ToFirmware) and isinstance(a.message, ClearFaults)
    ]
    assert cleared == []


def test_setpoints_never_jump_beyond_the_rate_limit() -> None:
    flight = airborne()
    actions: list[Action] = []
    for pulse in (HIGH, LOW, MIDDLE, HIGH, MIDDLE, LOW, HIGH):
        flight.autopilot.set_rc(9, pulse)
        actions += run_for(flight, 0.33)
    sent = setpoints(actions)
    assert len(sent) > 50
    # One tick of 20 ms at 60 kPa/s, and another one if a trigger is between two ticks.
    assert max(abs(b.target_kPa - a.target_kPa) for a, b in itertools.pairwise(sent)) <= 2 * 0.02 * 60 + 0.01
    assert all(0.0 <= s.target_kPa <= 20.7 and s.rate_kPa_per_s <= 60.0 for s in sent)


def test_a_switch_left_up_bends_nothing_at_the_start() -> None:
    autopilot = FakeAutopilot("ardupilot")
    autopilot.set_rc(9, HIGH)
    flight = SimulatedFlight(config.default(), autopilot)
    flight.run(2.0)
    autopilot.takeoff(10.0)
    assert decisions(flight.run(10.0)) == []
    assert_vented(flight)


@pytest.mark.parametrize("how", ["frozen", "jump"])
def test_rc_loss_vents_and_no_bend_resumes(how: str) -> None:
    flight = bent()
    flight.autopilot.lose_rc(how)  # type: ignore[arg-type]
    lost = decisions(run_for(flight, 2.5))
    assert [(d.trigger, d.what) for d in lost] == [("failsafe", {"loss": "rc"})]
    assert_vented(flight)
    flight.autopilot.return_rc()
    back = run_for(flight, 4.0)
    assert decisions(back) == []
    assert any("RC is back" in text for text in notices(back))
    assert_vented(flight)
    flight.autopilot.set_rc(9, MIDDLE)
    assert decisions(run_for(flight, 1.0)) == [], "an override may have ended"
    flight.autopilot.set_rc(9, LOW)
    run_for(flight, 3.0)
    flight.autopilot.set_rc(9, MIDDLE)
    assert [d.safety for d in decisions(run_for(flight, 1.0))] == ["accepted"]


def test_a_move_while_rc_is_lost_is_reported() -> None:
    flight = airborne()
    flight.autopilot.lose_rc("frozen")
    run_for(flight, 2.0)
    flight.autopilot.set_rc(9, HIGH)
    flight.autopilot.return_rc()
    actions = run_for(flight, 3.0)
    assert decisions(actions) == []
    assert any("move it again" in text for text in notices(actions))


def test_a_silent_autopilot_vents() -> None:
    flight = bent()
    flight.autopilot.mute(6.0)
    lost = decisions(run_for(flight, 4.5))
    assert {d.what["loss"] for d in lost} <= {"rc", "autopilot", "altitude"}
    assert lost[0].t - 10.0 < 1.3
    assert_vented(flight)
    assert decisions(run_for(flight, 5.0)) == []
    assert_vented(flight)


def test_after_an_autopilot_reboot_the_streams_are_requested_again() -> None:
    flight = airborne()
    flight.autopilot.disarm()
    run_for(flight, 1.0)
    flight.autopilot.reboot()
    actions = run_for(flight, 12.0)
    asked = {
        int(a.message.param1)
        for a in actions
        if isinstance(a, ToVehicle) and a.message.get_type() == "COMMAND_LONG" and a.message.command == 511
    }
    assert asked == {65, 1, 33, 42, 2, 29}
    assert flight.core.snapshot(flight.world.now).rc == "good"


def test_a_second_fault_of_the_firmware_is_told_and_named_while_the_first_lasts() -> None:
    flight = airborne()
    flight.phlosar.fill(850.0)
    first = "firmware fault: over-pressure in the reservoir"
    assert f"Vine: {first}, vented" in shown(run_for(flight, 2.0))
    flight.phlosar.mishaps.cv_sensor = Open()
    told = shown(run_for(flight, 1.5))
    assert any(text.startswith(f"Vine: {first}, vine pressure sensor, vented") for text in told), told
    assert (
        flight.core.snapshot(flight.world.now).safe_state["firmware_fault"]
        == f"{first}, vine pressure sensor"
    )


def test_serial_loss_vents_by_the_dead_man_and_latches() -> None:
    flight = bent()
    gone = flight.feed(LinkChanged(flight.world.now, "firmware", False, "was unplugged"))
    assert [d.what for d in decisions(gone)] == [{"loss": "serial"}]
    start = flight.phlosar.now_s
    flight.phlosar.advance(start + 0.6)
    assert_vented(flight)
    assert flight.phlosar.firmware.faults & Fault.DEAD_MAN
    flight.world.now = flight.phlosar.now_s
    flight.feed(LinkChanged(flight.world.now, "firmware", True))
    run_for(flight, 2.0)
    assert_vented(flight)
    flight.autopilot.set_rc(9, MIDDLE)
    assert decisions(run_for(flight, 1.0)) == []
    assert "dead-man" in "".join(flight.core.snapshot(flight.world.now).safe_state.values())
    flight.autopilot.set_rc(9, LOW)
    run_for(flight, 1.0)
    assert not flight.phlosar.firmware.faults
    flight.autopilot.set_rc(9, MIDDLE)
    assert [d.safety for d in decisions(run_for(flight, 1.0))] == ["accepted"]


def test_a_firmware_reset_latches() -> None:
    flight = bent()
    flight.phlosar.reset_firmware()
    (found,) = [d for d in decisions(run_for(flight, 2.0)) if d.trigger == "failsafe"][:1]
    assert found.what == {"loss": "firmware_reset"}
    assert_vented(flight)
    refused = ground_command(flight, mavlink.MAV_CMD_USER_2, 20.0)
    assert [d.safety for d in decisions(refused)] == ["refused"]
    acknowledged = ground_command(flight, mavlink.MAV_CMD_USER_5, 1.0)
    assert answers(acknowledged) == [(mavlink.MAV_CMD_USER_5, mavlink.MAV_RESULT_ACCEPTED)]
    flight.autopilot.set_rc(9, LOW)
    run_for(flight, 1.0)
    flight.autopilot.set_rc(9, HIGH)
    assert [d.safety for d in decisions(run_for(flight, 1.0))] == ["accepted"]


def test_a_latched_loss_of_air_outlasts_a_restart_until_a_person_clears_it() -> None:
    flight = airborne()
    flight.phlosar.mishaps.evp = StuckAt(0.0)
    flight.autopilot.set_rc(9, HIGH)
    stored = [action.faults for action in run_for(flight, 3.0) if isinstance(action, KeepLatched)]
    assert [set(faults) for faults in stored] == [{"filling"}]
    flight.phlosar.mishaps.evp = None
    flight.world.core = Core(config.default(), stored=StoredState(latched=stored[-1]))
    for link in ("firmware", "vehicle"):
        flight.feed(LinkChanged(flight.world.now, link, True))
    flight.autopilot.set_rc(9, LOW)
    run_for(flight, 4.0)
    left = flight.core.snapshot(flight.world.now).cycles
    assert left is not None and left.lost and left.expected == 0.0
    flight.autopilot.set_rc(9, MIDDLE)
    (refused,) = decisions(run_for(flight, 1.0))
    assert (refused.safety, refused.reason) == ("refused", stored[-1]["filling"])
    flight.autopilot.set_rc(9, LOW)
    actions = run_for(flight, 1.0)
    assert f"Vine: cleared: {stored[-1]['filling']}" in notices(actions)
    assert [action.faults for action in actions if isinstance(action, KeepLatched)] == [{}]
    flight.autopilot.set_rc(9, MIDDLE)
    assert [d.safety for d in decisions(run_for(flight, 1.0))] == ["accepted"]


def test_an_empty_reservoir_vents_refuses_and_is_reported() -> None:
    flight = bent(conf=configured(checks=config.ChecksConfig(reservoir_loss="warn")))
    flight.phlosar.mishaps.reservoir = Hole(bore_mm=4.0)
    actions = run_for(flight, 4.0)
    assert any("kPa/s too much" in text for text in notices(actions))
    assert [d.what for d in decisions(actions)] == [{"loss": "reservoir"}]
    assert any("reservoir low" in text and "cycles left" in text for text in notices(actions))
    assert_vented(flight)
    flight.autopilot.set_rc(9, LOW)
    run_for(flight, 1.0)
    flight.autopilot.set_rc(9, MIDDLE)
    (refused,) = decisions(run_for(flight, 1.0))
    assert "reservoir at" in refused.reason


def test_a_valve_that_stays_shut_is_a_latched_fault_that_a_person_clears() -> None:
    flight = airborne()
    flight.phlosar.mishaps.evp = StuckAt(0.0)
    flight.autopilot.set_rc(9, HIGH)
    actions = run_for(flight, 3.0)
    assert [d.what.get("loss") for d in decisions(actions)] == [None, "filling"]
    assert "Vine: not filling, reservoir loses no air: valve, vented" in notices(actions)
    assert_vented(flight)
    left = flight.core.snapshot(flight.world.now).cycles
    assert left is not None
    assert (left.lost, left.expected, left.high) == (True, 0.0, 0.0)
    flight.phlosar.mishaps.evp = None
    assert decisions(run_for(flight, 3.0)) == []
    assert_vented(flight)
    (refused,) = decisions(ground_command(flight, mavlink.MAV_CMD_USER_2, 20.0))
    assert "not filling" in refused.reason
    flight.autopilot.set_rc(9, LOW)
    assert "Vine: cleared: not filling, reservoir loses no air: valve" in notices(run_for(flight, 1.0))
    flight.autopilot.set_rc(9, HIGH)
    assert [d.safety for d in decisions(run_for(flight, 2.0))] == ["accepted"]
    assert flight.phlosar.cv_kPa == pytest.approx(20.7, abs=1.0)


def test_a_vine_that_does_not_vent_cannot_be_cleared() -> None:
    flight = bent()
    flight.phlosar.mishaps.solenoid = StuckAt(0.0)
    flight.autopilot.set_rc(9, LOW)
    texts = notices(run_for(flight, 3.0))
    assert "Vine: not venting: outlet, line, valve or sensor, outlet commanded open" in texts
    ground_command(flight, mavlink.MAV_CMD_USER_5, 1.0)
    assert "venting" in flight.core.snapshot(flight.world.now).safe_state
    flight.phlosar.mishaps.solenoid = None
    run_for(flight, 2.0)
    ground_command(flight, mavlink.MAV_CMD_USER_5, 1.0)
    assert flight.core.snapshot(flight.world.now).safe_state == {}
    assert_vented(flight)


def test_a_hot_reservoir_is_reported_and_counted_and_the_vine_continues() -> None:
    flight = bent()
    flight.phlosar.fill(745.0)
    actions = run_for(flight, 2.0)
    assert decisions(actions) == []
    assert sum("hot or overfilled" in text for text in notices(actions)) == 1
    # Nobody fills the reservoir of an armed vehicle, so its sensor is in doubt, too.
    assert flight.core.snapshot(flight.world.now).findings == {"reservoir_hot": 1, "reservoir_sensor": 1}
    assert flight.phlosar.cv_kPa == pytest.approx(20.7, abs=1.0)


def test_a_check_can_be_set_to_warn() -> None:
    flight = airborne(configured(checks=config.ChecksConfig(filling="warn")))
    flight.phlosar.mishaps.evp = StuckAt(0.0)
    flight.autopilot.set_rc(9, HIGH)
    actions = run_for(flight, 3.0)
    assert [d.what.get("loss") for d in decisions(actions)] == [None]
    assert any("not filling" in text for text in notices(actions))


def test_one_reading_above_the_limit_is_a_glitch_and_two_are_not() -> None:
    flight = bent()
    telemetry = flight.core._firmware.telemetry
    assert telemetry is not None

    def read(cv_kPa: float, ms: int) -> list[Action]:
        later = dataclasses.replace(
            telemetry, cv_kPa=cv_kPa, device_time_ms=telemetry.device_time_ms + ms, number=telemetry.number
        )
        return flight.feed(FirmwareMessage(flight.world.now + ms / 1000.0, later))

    assert decisions([*read(60.0, 1), *read(20.0, 2), *read(60.0, 3)]) == []
    (decision,) = decisions(read(60.0, 4))
    assert decision.what == {"loss": "overpressure"}


def test_landing_straightens_the_vine() -> None:
    flight = bent()
    flight.autopilot.land()
    found = decisions(run_for(flight, 12.0))
    assert [d.what for d in found] == [{"loss": "altitude"}]
    assert_vented(flight)


def test_a_disarmed_vehicle_bends_only_in_bench_mode() -> None:
    for bench in (False, True):
        conf = configured(interlocks=config.InterlocksConfig(bench_mode=bench))
        autopilot = FakeAutopilot("ardupilot")
        autopilot.set_rc(9, LOW)
        flight = SimulatedFlight(conf, autopilot)
        flight.run(3.0)
        autopilot.set_rc(9, HIGH)
        (decision,) = decisions(flight.run(5.0))
        assert decision.safety == ("accepted" if bench else "refused")
        assert bool(setpoints(flight.run(6.0))) == bench


def test_a_vine_that_is_bent_too_long_is_vented() -> None:
    conf = configured(limits=config.LimitsConfig(max_bent_s=5.0))
    flight = airborne(conf)
    flight.autopilot.set_rc(9, HIGH)
    found = decisions(run_for(flight, 7.0))
    assert [d.what.get("loss") for d in found] == [None, "duration"]
    assert_vented(flight)


VINE_MISSION = [
    MissionItem(0, 16, (0, 0, 0, 0, -35.363262, 149.165237, 584.0)),
    MissionItem(1, 22, (0, 0, 0, 0, 0, 0, 10.0), frame=3),
    MissionItem(2, 16, (0, 0, 0, 0, -35.36321, 149.165237, 10.0), frame=3),
    MissionItem(3, 217, (1, 40, 0, 0, 0, 0, 0)),
    MissionItem(4, 16, (2, 0, 0, 0, -35.36315, 149.165237, 10.0), frame=3),
    MissionItem(5, 217, (0, 0, 0, 0, 0, 0, 0)),
    MissionItem(6, 16, (0, 0, 0, 0, -35.36300, 149.165237, 10.0), frame=3),
]
PX4_MISSION = [
    MissionItem(0, 22, (0, 0, 0, math.nan, 47.3977431, 8.5455944, 12.0), frame=3),
    MissionItem(1, 16, (0, 0, 0, math.nan, 47.3977800, 8.5455944, 12.0), frame=3),
    MissionItem(2, 187, (0.5, 0, 0, 0, 0, 0, 0), frame=2),
    MissionItem(3, 16, (2, 0, 0, math.nan, 47.3978200, 8.5455944, 12.0), frame=3),
    MissionItem(4, 211, (1, 1, 0, 0, 0, 0, 0), frame=2),
    MissionItem(5, 16, (0, 0, 0, math.nan, 47.3979, 8.5455944, 12.0), frame=3),
]


@pytest.mark.long
def test_ardupilot_mission_items_are_executed_once_with_their_params() -> None:
    autopilot = FakeAutopilot("ardupilot", mission=VINE_MISSION)
    flight = SimulatedFlight(config.default(), autopilot)
    flight.run(4.0)
    autopilot.start_mission()
    found = decisions(flight.run(40.0))
    assert [(d.what["seq"], d.intent, d.safety) for d in found] == [
        (3, "bend 40°", "accepted"),
        (5, "straight", "accepted"),
    ]
    assert [item.seq for _, item in autopilot.payload_log] == [3, 5]


@pytest.mark.long
def test_a_mission_changed_in_flight_is_executed_with_the_new_params() -> None:
    autopilot = FakeAutopilot("ardupilot", mission=VINE_MISSION)
    flight = SimulatedFlight(config.default(), autopilot)
    flight.run(4.0)
    autopilot.start_mission()
    flight.run(9.0)
    changed = [
        *VINE_MISSION[:3],
        MissionItem(3, 217, (1, 15, 0, 0, 0, 0, 0)),
        *VINE_MISSION[4:],
        VINE_MISSION[6],
    ]
    changed[-1] = MissionItem(7, 16, VINE_MISSION[6].params, frame=3)
    autopilot.set_mission(changed)
    found = decisions(flight.run(40.0))
    assert [d.intent for d in found if d.what["seq"] == 3] == ["bend 15°"]


@pytest.mark.long
def test_px4_mission_items_are_acknowledged_and_executed_once() -> None:
    autopilot = FakeAutopilot("px4", mission=PX4_MISSION)
    flight = SimulatedFlight(config.default(), autopilot)
    flight.run(4.0)
    autopilot.start_mission()
    actions = flight.run(40.0)
    assert [(d.what["seq"], d.intent, d.safety) for d in decisions(actions)] == [
        (2, "bend 30°", "accepted"),
        (4, "straight", "accepted"),
    ]
    assert answers(actions) == [(187, 0), (211, 0)]


def test_commands_are_answered_and_repeats_do_not_act_again() -> None:
    flight = airborne()
    first = ground_command(flight, mavlink.MAV_CMD_USER_2, 30.0)
    assert answers(first) == [(mavlink.MAV_CMD_USER_2, mavlink.MAV_RESULT_ACCEPTED)]
    assert [d.trigger for d in decisions(first)] == ["command"]
    run_for(flight, 3.0)
    again = ground_command(flight, mavlink.MAV_CMD_USER_2, 30.0, confirmation=1)
    assert answers(again) == answers(first)
    assert decisions(again) == []


@pytest.mark.parametrize(
    ("command", "params", "verdict", "result"),
    [
        (mavlink.MAV_CMD_USER_1, (1.0, 20.0), "accepted", mavlink.MAV_RESULT_ACCEPTED),
        (mavlink.MAV_CMD_USER_1, (9.0,), "refused", mavlink.MAV_RESULT_DENIED),
        (mavlink.MAV_CMD_USER_2, (61.0,), "refused", mavlink.MAV_RESULT_DENIED),
        (mavlink.MAV_CMD_USER_2, (-25.0,), "refused", mavlink.MAV_RESULT_DENIED),
        (mavlink.MAV_CMD_USER_2, (math.nan,), "refused", mavlink.MAV_RESULT_DENIED),
        (mavlink.MAV_CMD_USER_3, (10.0,), "accepted", mavlink.MAV_RESULT_ACCEPTED),
        (mavlink.MAV_CMD_USER_3, (100.0,), "limited", mavlink.MAV_RESULT_ACCEPTED),
        (mavlink.MAV_CMD_USER_3, (math.inf,), "refused", mavlink.MAV_RESULT_DENIED),
        (mavlink.MAV_CMD_USER_4, (0.0,), "accepted", mavlink.MAV_RESULT_ACCEPTED),
        (mavlink.MAV_CMD_USER_4, (1.0,), "refused", mavlink.MAV_RESULT_DENIED),
        (mavlink.MAV_CMD_USER_4, (7.0,), "refused", mavlink.MAV_RESULT_DENIED),
    ],
)
def test_each_command(command: int, params: tuple[float, ...], verdict: str, result: int) -> None:
    flight = airborne()
    actions = ground_command(flight, command, *params)
    assert [d.safety for d in decisions(actions)] == [verdict]
    assert answers(actions) == [(command, result)]
    run_for(flight, 1.0)
    assert flight.phlosar.cv_kPa < 22.0


def test_commands_for_others_and_unknown_ones_move_nothing() -> None:
    flight = airborne()
    assert ground_command(flight, mavlink.MAV_CMD_USER_2, 30.0, target=(1, 1)) == []
    assert ground_command(flight, mavlink.MAV_CMD_USER_2, 30.0, target=(2, 191)) == []
    assert ground_command(flight, mavlink.MAV_CMD_USER_2, 30.0, target=(0, 0)) == []
    unknown = ground_command(flight, mavlink.MAV_CMD_DO_SET_SERVO, 9.0, 1500.0)
    assert answers(unknown) == [(mavlink.MAV_CMD_DO_SET_SERVO, mavlink.MAV_RESULT_UNSUPPORTED)]
    assert decisions(unknown) == []


def test_hold_keeps_the_pressure_and_vent_vents() -> None:
    flight = airborne()
    flight.autopilot.set_rc(9, HIGH)
    run_for(flight, 0.4)
    ground_command(flight, mavlink.MAV_CMD_USER_4, 1.0)
    run_for(flight, 0.5)
    here = flight.phlosar.cv_kPa
    assert 2.0 < here < 19.0
    run_for(flight, 1.0)
    assert flight.phlosar.cv_kPa == pytest.approx(here, abs=0.6)
    ground_command(flight, mavlink.MAV_CMD_USER_4, 0.0)
    run_for(flight, 1.0)
    assert_vented(flight)


def test_a_vine_that_is_being_straightened_is_not_held_bent_when_rc_is_lost() -> None:
    flight = bent(conf=configured(losses=config.LossesConfig(on_rc_loss="hold")))
    flight.autopilot.set_rc(9, LOW)
    run_for(flight, 0.22)
    assert flight.phlosar.cv_kPa > 5.0
    flight.feed(LinkChanged(flight.world.now, "vehicle", False, "closed"))
    run_for(flight, 0.7)
    assert_vented(flight)


def test_stop_vents_and_nothing_moves_after_it() -> None:
    flight = bent()
    flight.feed(Stop(flight.world.now))
    run_for(flight, 1.0)
    assert_vented(flight)
    (refused,) = decisions(ground_command(flight, mavlink.MAV_CMD_USER_2, 30.0))
    assert refused.safety == "refused"
    run_for(flight, 1.0)
    assert_vented(flight)


def test_the_ground_station_gets_each_value_twice_a_second() -> None:
    flight = airborne()
    actions = run_for(flight, 10.0)
    sent = [
        a.message for a in actions if isinstance(a, ToVehicle) and a.message.get_type() == "NAMED_VALUE_FLOAT"
    ]
    names = [m.name for m in sent]
    for name in ("RES_KPA", "CYC_LEFT", "CV_KPA", "CMD_KPA", "BEND_DEG"):
        assert 19 <= names.count(name) <= 21
    assert {a.system_id for a in actions if isinstance(a, ToVehicle)} == {1}
    boot_ms = sent[-1].time_boot_ms
    # The fake autopilot starts 30 s before the flight.
    assert boot_ms == pytest.approx(1000 * (flight.world.now + 30.0), abs=300)


def test_stale_telemetry_is_not_reported_as_current() -> None:
    flight = airborne()
    flight.feed(LinkChanged(flight.world.now, "firmware", False, "was unplugged"))
    run_for(flight, 0.5)
    actions = run_for(flight, 3.0)
    assert not [
        a for a in actions if isinstance(a, ToVehicle) and a.message.get_type() == "NAMED_VALUE_FLOAT"
    ]
    assert math.isnan(flight.core.snapshot(flight.world.now).cv_kPa)


def test_a_missing_stream_is_reported() -> None:
    conf = config.default()
    flight = SimulatedFlight(conf)
    codec = MavlinkCodec(1, 1)
    beat = mavlink.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3)
    texts: list[str] = []
    for second in range(12):
        texts += notices(list(flight.world.advance(float(second))))
        for message in MavlinkCodec(1, 191).decode(codec.encode(beat, 1)):
            texts += notices(flight.feed(VehicleMessage(float(second), message)))
    assert any("does not send" in text and "GLOBAL_POSITION_INT" in text for text in texts)


@pytest.mark.long
def test_the_learned_air_is_used_in_the_next_run_of_the_same_rig() -> None:
    flight = airborne()
    stored: list[KeepLearned] = []
    for _ in range(6):
        flight.autopilot.set_rc(9, HIGH)
        stored += [action for action in run_for(flight, 3.0) if isinstance(action, KeepLearned)]
        flight.autopilot.set_rc(9, LOW)
        stored += [action for action in run_for(flight, 3.0) if isinstance(action, KeepLearned)]
    assert 1 <= len(stored) <= 4, "after new cycles, and not too often"
    for numbers, same in (
        (configured(), True),
        (configured(pneumatics=config.PneumaticsConfig(reservoir_volume_L=3.0)), False),
    ):
        again = SimulatedWorld(numbers, stored=StoredState(learned=stored[-1].text))
        actions = list(again.advance(3.0))
        left = again.core.snapshot(3.0).cycles
        assert left is not None
        assert (left.measured_cycles > 0.0) is same
        texts = " ".join(notices(actions))
        assert ("air is learned again" in texts) is not same
        assert ("as learned before: " in texts) is same


@pytest.mark.long
def test_a_new_leak_is_stored_even_without_a_bend() -> None:
    flight = airborne()
    for _ in range(4):
        for pulse_us in (HIGH, LOW):
            flight.autopilot.set_rc(9, pulse_us)
            run_for(flight, 3.0)
    run_for(flight, 15.0)
    flight.phlosar.inject("reservoir", Hole(0.1))
    actions = run_for(flight, 60.0)
    assert any("the leak has changed" in text for text in notices(actions))
    stored = [action for action in actions if isinstance(action, KeepLearned)]
    assert 1 <= len(stored) <= 6, "after the text, and not too often"
