"""The served autopilot, and its clock, height and heartbeats."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from examples import examples
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.state import (
    ALTITUDE_CONFIRMED_S,
    ALTITUDE_FRESH_S,
    LOWEST_OF_S,
    Ambiguous,
    AutopilotFound,
    OtherComponent,
    OtherHeard,
    Rebooted,
    VehicleEvent,
    VehicleState,
)

QUADROTOR, ARDUPILOT, PX4 = 2, 3, 12
ARMED = 0x80


def sent(message: MavlinkMessage, system_id: int = 1, component_id: int = 1) -> MavlinkMessage:
    """The message as the other side of a link has it."""
    frame = message.pack(mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id))
    return mavlink.MAVLink(None).parse_char(frame)


def heartbeat(
    system_id: int = 1,
    component_id: int = 1,
    vehicle_type: int = QUADROTOR,
    autopilot: int = ARDUPILOT,
    base_mode: int = 0,
    custom_mode: int = 0,
) -> MavlinkMessage:
    message = mavlink.MAVLink_heartbeat_message(vehicle_type, autopilot, base_mode, custom_mode, 4, 3)
    return sent(message, system_id, component_id)


def clock(time_boot_ms: int) -> MavlinkMessage:
    return sent(mavlink.MAVLink_system_time_message(0, time_boot_ms))


def position(time_boot_ms: int, height_m: float) -> MavlinkMessage:
    return sent(
        mavlink.MAVLink_global_position_int_message(time_boot_ms, 0, 0, 0, int(height_m * 1000), 0, 0, 0, 0)
    )


def text(words: str) -> MavlinkMessage:
    return sent(mavlink.MAVLink_statustext_message(6, words.encode(), 0, 0))


def found() -> VehicleState:
    state = VehicleState()
    assert state.handle(0.0, heartbeat()) == [AutopilotFound(1)]
    return state


OTHERS = {
    "ground station": heartbeat(255, 190, 6, 8),
    "ground station with id 1": heartbeat(255, 1, 6, 8),
    "ground station that says it is an autopilot": heartbeat(255, 1, 6, ARDUPILOT),
    "gimbal": heartbeat(1, 154, 26, 8),
    "gimbal in the autopilot's place": heartbeat(7, 1, 26, 8),
    "camera": heartbeat(1, 100, 30, 8),
    "onboard computer": heartbeat(1, 191, 18, 8),
    "onboard computer of another system": heartbeat(9, 1, 18, 8),
    "ADS-B receiver": heartbeat(3, 156, 27, 8),
    "ADS-B receiver in the autopilot's place": heartbeat(3, 1, 27, 0),
    "antenna tracker with an ArduPilot": heartbeat(2, 1, mavlink.MAV_TYPE_ANTENNA_TRACKER, ARDUPILOT),
    "autopilot's second component": heartbeat(4, 2, QUADROTOR, ARDUPILOT),
    "system 0": heartbeat(0, 1),
}


@pytest.mark.parametrize("other", OTHERS)
def test_only_an_autopilot_is_served(other: str) -> None:
    state = VehicleState()
    assert state.handle(0.0, OTHERS[other]) == []
    assert not state.found
    assert state.handle(0.5, heartbeat(5)) == [AutopilotFound(5)]
    assert state.handle(1.0, OTHERS[other]) == []
    assert state.system_id == 5
    assert state.kind == "ardupilot"


@pytest.mark.parametrize("other", OTHERS)
def test_only_the_autopilot_reports_that_the_vehicle_is_armed(other: str) -> None:
    state = VehicleState()
    state.handle(0.0, heartbeat(1, base_mode=ARMED))
    theirs = OTHERS[other]
    state.handle(1.0, theirs)
    assert state.armed
    assert state.heartbeat_at == 0.0


def test_a_heartbeat_of_another_type_with_our_autopilots_ids_changes_nothing() -> None:
    state = VehicleState()
    state.handle(0.0, heartbeat(1, base_mode=ARMED))
    state.handle(1.0, heartbeat(1, 1, 18, 8))
    assert (state.armed, state.kind, state.heartbeat_at) == (True, "ardupilot", 0.0)


def test_messages_before_the_first_heartbeat_are_ignored() -> None:
    state = VehicleState()
    assert state.handle(0.0, position(5000, 30.0)) == []
    assert state.altitude_m(0.0) is None


@pytest.mark.parametrize("later_s", [0.0, 1.0, 2.0])
def test_two_autopilots_at_once_are_both_ignored(later_s: float) -> None:
    state = VehicleState()
    state.handle(0.0, heartbeat(1, base_mode=ARMED))
    assert state.handle(later_s, heartbeat(2)) == [Ambiguous((1, 2))]
    for t in (later_s + 0.1, later_s + 1.0, later_s + 60.0):
        assert state.handle(t, heartbeat(1, base_mode=ARMED)) == []
        assert state.handle(t, heartbeat(2)) == []
        assert state.handle(t, position(9000, 20.0)) == []
        assert not state.found
        assert not state.armed
        assert not state.is_ours(heartbeat(1))


@pytest.mark.parametrize("configured", [0, 1])
def test_another_autopilot_is_not_served_but_named_once_if_ours_is_silent(configured: int) -> None:
    state = VehicleState(configured)
    state.handle(0.0, heartbeat(1))
    heard = [state.handle(t, heartbeat(2, base_mode=ARMED)) for t in (2.1, 6.0, 7.2, 8.0, 60.0)]
    assert heard == [[], [], [OtherHeard(1, 2)], [], []]
    assert (state.system_id, state.armed) == (1, False)
    state.handle(61.0, heartbeat(1))
    for t in range(62, 100):
        assert state.handle(t, heartbeat(2)) == state.handle(t + 0.5, heartbeat(1)) == []


def test_of_a_swarm_one_other_autopilot_is_named() -> None:
    state = VehicleState(1)
    state.handle(0.0, heartbeat(1))
    for again_at in (1.0, 30.0):
        ids = [i for _ in range(20) for i in range(2, 256)]
        heard = [
            event for n, i in enumerate(ids) for event in state.handle(again_at + n // 254, heartbeat(i))
        ]
        assert heard == [OtherHeard(1, 2)]
        state.handle(again_at + 20.0, heartbeat(1))


def test_an_autopilot_of_another_component_id_is_named_once_while_none_is_found() -> None:
    state = VehicleState()
    for t in range(20):
        state.handle(float(t), heartbeat(1, 154, 26, 8))  # a gimbal
    heard = [state.handle(t, heartbeat(1, 5, 2, 12)) for t in (20.0, 24.9, 25.0, 26.0)]
    assert heard == [[], [], [OtherComponent(1, 5)], []]
    state.handle(27.0, heartbeat(1))
    assert [state.handle(t, heartbeat(1, 5, 2, 12)) for t in (28.0, 40.0)] == [[], []]
    assert state.system_id == 1


def test_an_autopilot_of_another_id_than_the_configured_one_is_named() -> None:
    state = VehicleState(7)
    heard = [event for t in range(20) for event in state.handle(float(t), heartbeat(2))]
    assert heard == [OtherHeard(7, 2)]


@pytest.mark.parametrize("apart_s", [-900.0, -25.0, -5.0, 5.0, 300.0])
@pytest.mark.parametrize("rate_Hz", [1.0, 5.0, 50.0])
def test_two_autopilots_of_one_id_are_a_conflict_and_not_many_reboots(apart_s: float, rate_Hz: float) -> None:
    state, reboots = VehicleState(), 0
    state.handle(0.0, heartbeat(1))
    for n in range(round(20.0 * rate_Hz)):
        t = 1000.0 + n / rate_Hz
        for boot_s in (t, t + apart_s):
            reboots += len(state.handle(t, position(round(boot_s * 1000), 20.0)))
    assert reboots <= 1
    assert state.conflict(t) == "two autopilots with id 1"
    for n in range(round(12.0 * rate_Hz)):
        t = 1020.0 + n / rate_Hz
        reboots += len(state.handle(t, position(round(t * 1000), 20.0)))
    assert state.conflict(t) == ""
    assert reboots <= 1


@pytest.mark.parametrize("boots_s", [(500.0,), (500.0, 503.0), (500.0, 501.5, 503.0)])
def test_reboots_are_no_conflict(boots_s: tuple[float, ...]) -> None:
    state, reboots = VehicleState(), 0
    state.handle(0.0, heartbeat(1))
    for n in range(1, 2600):
        t = n / 5.0
        since = max((boot for boot in boots_s if boot <= t), default=-100.0)
        reboots += len(state.handle(t, position(round((t - since) * 1000), 20.0)))
        assert state.conflict(t) == ""
    assert reboots >= 1


def test_a_stamp_that_stands_still_beside_one_that_runs_is_no_conflict() -> None:
    state = VehicleState()
    state.handle(0.0, heartbeat(1))
    for n in range(1, 500):
        t = 100.0 + n / 5.0
        state.handle(t, position(100_000, 20.0))
        state.handle(t + 0.01, mavlink.MAVLink_system_time_message(0, round(t * 1000)))
        assert state.conflict(t) == ""


def test_the_configured_vehicle_is_served_among_others() -> None:
    state = VehicleState(system_id=7)
    assert state.handle(0.0, heartbeat(1)) == []
    assert not state.found
    assert state.handle(0.1, heartbeat(7)) == [AutopilotFound(7)]
    assert state.handle(0.2, heartbeat(1)) == []
    assert state.handle(0.3, heartbeat(7)) == []
    assert state.system_id == 7


def test_armed_and_mode_are_as_the_autopilot_reports_them() -> None:
    state = VehicleState()
    state.handle(0.0, heartbeat(base_mode=ARMED, custom_mode=3))
    assert (state.armed, state.mode) == (True, "AUTO")
    state.handle(1.0, heartbeat(custom_mode=77))
    assert (state.armed, state.mode) == (False, "MODE 77")
    px4 = VehicleState()
    px4.handle(0.0, heartbeat(autopilot=PX4, base_mode=ARMED, custom_mode=4 << 16 | 4 << 24))
    assert (px4.kind, px4.mode) == ("px4", "AUTO.MISSION")


def climbing(*heights_m: float, every_s: float = 0.2, after: VehicleState | None = None) -> VehicleState:
    """A state after reports of these heights, the last one at 10 s."""
    state = after or found()
    for number, height_m in enumerate(heights_m, start=1 - len(heights_m)):
        t = 10.0 + number * every_s
        state.handle(t, position(round(1000 * t), height_m))
    return state


def test_height_is_known_only_while_it_is_fresh() -> None:
    state = found()
    assert state.altitude_m(0.0) is None
    climbing(12.5, 12.5, every_s=1.0, after=state)
    assert state.altitude_m(10.0 + ALTITUDE_FRESH_S) == 12.5
    assert state.altitude_m(10.01 + ALTITUDE_FRESH_S) is None


def reports(state: VehicleState, height_m: float, began: float, lasts_s: float, every_s: float) -> float:
    """Sends reports of a height. Returns the time from the first one to the last one that did not count."""
    t = uncounted = began
    while t <= began + lasts_s:
        state.handle(t, position(round(1000 * t), height_m))
        if state.altitude_m(t) != height_m:
            uncounted = t
        t += every_s
    return uncounted - began


@pytest.mark.parametrize("every_s", [0.02, 0.2, 1.0])
def test_at_the_start_one_report_is_not_enough(every_s: float) -> None:
    uncounted_s = reports(found(), 30.0, 20.0, 3.0, every_s)
    assert ALTITUDE_CONFIRMED_S - every_s <= uncounted_s + 1e-6 <= ALTITUDE_CONFIRMED_S + 1e-6


@pytest.mark.parametrize("every_s", [0.02, 0.2, 1.0])
def test_after_a_pause_the_height_before_it_still_counts(every_s: float) -> None:
    uncounted_s = reports(climbing(*[0.5] * 50), 30.0, 20.0, 3.0, every_s)
    assert LOWEST_OF_S - every_s <= uncounted_s + 1e-6 <= LOWEST_OF_S + 1e-6
    state = climbing(*[30.0] * 50)
    state.handle(20.0, position(20_000, 30.0))
    assert state.altitude_m(20.0) == 30.0
    state.handle(30.0, position(30_000, 1.0))
    assert state.altitude_m(30.0) == 1.0


@pytest.mark.parametrize("wild_m", [50.0, 2_147_483.0, -2_147_483.0, 100_001.0, -1_001.0])
@pytest.mark.parametrize("every_s", [0.2, 1.0])
def test_one_wild_report_among_good_ones_changes_nothing(wild_m: float, every_s: float) -> None:
    good = [0.1] * 8
    for number in range(8):
        state = climbing(*good[:number], wild_m, *good[number:], every_s=every_s)
        assert state.altitude_m(10.0) == 0.1


@pytest.mark.parametrize("wild_m", [2_147_483.0, 100_001.0, -1_001.0])
def test_reports_that_no_vehicle_sends_are_no_reports(wild_m: float) -> None:
    assert climbing(*[wild_m] * 50).altitude_m(10.0) is None


@pytest.mark.parametrize("height_m", [-1_000.0, 100_000.0])
def test_the_widest_heights_count(height_m: float) -> None:
    assert climbing(*[height_m] * 8).altitude_m(10.0) == height_m


def test_a_landing_shows_at_once_and_a_climb_after_a_second() -> None:
    assert climbing(*[30.0] * 20, 1.0).altitude_m(10.0) == 1.0
    assert climbing(1.0, *[30.0] * 5).altitude_m(10.0) == 1.0
    assert climbing(1.0, *[30.0] * 6).altitude_m(10.0) == 30.0


@given(heights_m=st.lists(st.floats(-20.0, 50.0), min_size=8, max_size=30))
def test_the_height_is_the_lowest_of_the_last_second(heights_m: list[float]) -> None:
    told_m = [int(height_m * 1000) / 1000 for height_m in heights_m]
    assert climbing(*heights_m, every_s=0.3).altitude_m(10.0) == min(told_m[-4:])


@pytest.mark.parametrize("sign", [text("ArduPilot Ready"), clock(1200)])
def test_the_height_before_a_reboot_is_no_height_after_it(sign: MavlinkMessage) -> None:
    state = found()
    for t in (9.0, 10.0):
        state.handle(t, position(80_000 + round(1000 * t), 30.0))
    assert state.altitude_m(11.4) == 30.0
    assert state.handle(11.5, sign) == [Rebooted()]
    assert state.altitude_m(11.5) is None
    state.handle(11.6, position(1300, 30.0))
    assert state.altitude_m(11.6) is None


def test_a_reboot_is_seen_by_the_clock_once() -> None:
    state = found()
    seen: list[VehicleEvent] = []
    for i in range(20):
        seen += state.handle(i, clock(60_000 + 1000 * i))
    for i in range(20, 40):
        seen += state.handle(i, clock(1000 * (i - 17)))
    assert seen == [Rebooted()]
    assert state.time_boot_ms(40.0) == pytest.approx(23_000, abs=20)


@pytest.mark.parametrize(
    ("up_s", "silent_s"),
    [
        (3.0, 3.0),
        (3.0, 30.0),
        (8.0, 30.0),
        (30.0, 300.0),
        (100.0, 3.0),
        (100.0, 300.0),
        (1e5, 3.0),
        (1e5, 300.0),
    ],
)
def test_a_reboot_behind_a_silence_is_seen(up_s: float, silent_s: float) -> None:
    state = found()
    state.handle(0.0, clock(int(up_s * 1000)))
    assert state.handle(silent_s, clock(int((silent_s - 1.3) * 1000))) == [Rebooted()]


def test_a_silence_is_no_reboot() -> None:
    state = found()
    state.handle(0.0, clock(5000))
    assert state.handle(500.0, clock(505_000)) == []


def test_ready_is_a_reboot_of_an_autopilot_that_was_up() -> None:
    state = found()
    assert state.handle(0.1, text("ArduPilot Ready")) == []
    state.handle(0.2, clock(100_000))
    assert state.handle(5.0, text("ArduPilot Ready")) == [Rebooted()]
    # The same reboot is not reported again, neither by a second text nor by the clock when its stream
    # returns.
    assert state.handle(5.1, text("ArduPilot Ready")) == []
    assert state.time_boot_ms(6.0) == 0
    assert state.handle(15.0, clock(11_000)) == []
    assert state.time_boot_ms(16.0) == 12_000


def test_the_first_ready_after_power_up_is_no_reboot() -> None:
    state = found()
    state.handle(1.0, clock(1000))
    assert state.handle(3.0, text("ArduPilot Ready")) == []


def test_a_ready_of_another_vehicle_is_not_ours() -> None:
    state = found()
    state.handle(0.0, clock(100_000))
    words = mavlink.MAVLink_statustext_message(6, b"ArduPilot Ready", 0, 0)
    assert state.handle(1.0, sent(words, system_id=2)) == []


@given(
    delays_s=st.lists(st.floats(0.0, 1.9), min_size=2, max_size=60),
    up_s=st.floats(0.0, 4_000_000.0),
    period_s=st.floats(0.02, 1.0),
)
@settings(max_examples=examples(200), deadline=None)
def test_delays_of_a_link_are_no_reboot(delays_s: list[float], up_s: float, period_s: float) -> None:
    state = found()
    arrives_at = 0.0
    for i, delay_s in enumerate(delays_s):
        at_s = i * period_s
        arrives_at = max(arrives_at, at_s + delay_s)  # reordering is tested below
        assert state.handle(arrives_at, clock(int((up_s + at_s) * 1000))) == []
        ours_ms = state.time_boot_ms(arrives_at)
        assert (up_s + arrives_at) * 1000 - 2000 <= ours_ms <= (up_s + arrives_at) * 1000 + 1


def test_a_link_that_stalls_and_then_delivers_everything_is_no_reboot() -> None:
    state = found()
    for i in range(100):
        state.handle(i * 0.2, clock(100_000 + i * 200))
    for i in range(100, 150):
        assert state.handle(30.0 + i * 0.001, clock(100_000 + i * 200)) == []


def test_frames_that_overtook_each_other_are_no_reboot() -> None:
    state = found()
    for i in range(0, 200, 2):
        assert state.handle(i * 0.2, clock(500_000 + (i + 1) * 200)) == []
        assert state.handle(i * 0.2 + 0.01, clock(500_000 + i * 200)) == []


@pytest.mark.parametrize("pace", [1.0 - 1e-4, 1.0 + 1e-4])
def test_clocks_of_different_pace_are_no_reboot_in_a_week(pace: float) -> None:
    state = found()
    for minute in range(7 * 24 * 60):
        t = minute * 60.0
        assert state.handle(t, clock(int(t * pace * 1000))) == []
        assert state.time_boot_ms(t) == pytest.approx(t * pace * 1000, abs=100)


def test_the_clock_wraps_after_fifty_days_without_a_reboot() -> None:
    state = found()
    start_ms = 2**32 - 5000
    for i in range(100):
        time_boot_ms = (start_ms + 200 * i) % 2**32
        assert state.handle(0.2 * i, clock(time_boot_ms)) == []
        assert abs(state.time_boot_ms(0.2 * i) - time_boot_ms) <= 20


def test_a_reboot_after_forty_days_is_no_wrap() -> None:
    state = found()
    state.handle(0.0, clock(40 * 24 * 3600 * 1000))
    assert state.handle(5.0, clock(2000)) == [Rebooted()]


def test_any_frame_shows_that_the_autopilot_runs_but_only_heartbeats_that_it_is_armed() -> None:
    state = VehicleState()
    assert state.silence_s(0.0) is None
    state.handle(0.0, heartbeat(1, base_mode=ARMED))
    for t in range(1, 6):
        state.handle(float(t), position(1000 * t, 30.0))
        assert (state.silence_s(t + 0.5), state.heartbeat_missing) == (0.5, False)
    state.handle(6.0, position(6000, 30.0))
    assert state.heartbeat_missing
    state.handle(6.5, heartbeat(1, base_mode=ARMED))
    assert not state.heartbeat_missing


def test_for_a_silent_autopilot_missing_heartbeats_are_not_reported() -> None:
    state = VehicleState()
    state.handle(0.0, heartbeat(1, base_mode=ARMED))
    assert (state.silence_s(60.0), state.heartbeat_missing) == (60.0, False)
