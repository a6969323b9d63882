"""Every sign of an RC loss, alone and in recordings of real autopilots."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config.config import SwitchConfig
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage
from flying_vines.vehicle.mavlink.tlog import TlogReader
from flying_vines.vehicle.radio.rc import HEALTH_CLEARS_FAILSAFE_S, RC_BIT, RadioLink

RECORDINGS = Path(__file__).parents[1] / "data" / "recordings"
SILENT_AFTER_S = 1.0


def radio(throttle_channel: int = 3) -> RadioLink:
    return RadioLink(SwitchConfig(throttle_channel=throttle_channel), SILENT_AFTER_S)


def channels(switch_us: int = 1500, throttle_us: int = 1100, count: int = 16) -> MavlinkMessage:
    pulses_us = [1500, 1500, throttle_us, 1500, 1500, 1500, 1500, 1500, switch_us, *(9 * [0])]
    return mavlink.MAVLink_rc_channels_message(0, count, *pulses_us, 255)


def health(good: bool, present: bool = True, enabled: bool = True) -> MavlinkMessage:
    bits = [RC_BIT * flag for flag in (present, enabled, good)]
    return mavlink.MAVLink_sys_status_message(*bits, 0, 12000, -1, -1, 0, 0, 0, 0, 0, 0)


def text(words: str) -> MavlinkMessage:
    return mavlink.MAVLink_statustext_message(4, words.encode(), 0, 0)


def good(at_s: float = 0.0) -> RadioLink:
    link = radio()
    link.handle(at_s, channels())
    link.handle(at_s, health(True))
    assert link.problem(at_s) is None
    return link


def test_before_any_message() -> None:
    link = radio()
    assert link.problem(0.0) == "no RC_CHANNELS yet"
    link.handle(0.0, health(True))
    assert link.problem(0.0) == "no RC_CHANNELS yet"
    link.handle(0.0, channels(1234))
    assert link.problem(0.0) is None
    assert link.switch_us == 1234


def test_silence_alone_and_its_end() -> None:
    link = good(5.0)
    assert link.problem(5.0 + SILENT_AFTER_S) is None
    assert "no RC_CHANNELS for 1 s" in str(link.problem(5.01 + SILENT_AFTER_S))
    link.handle(9.0, health(True))
    assert link.problem(9.0) is not None
    link.handle(9.0, channels())
    assert link.problem(9.0) is None


def test_health_alone_and_its_return() -> None:
    link = good()
    link.handle(0.1, health(False))
    assert "reports RC lost" in str(link.problem(0.1))
    link.handle(0.2, health(True))
    assert link.problem(0.2) is None


@pytest.mark.parametrize(("present", "enabled"), [(False, False), (True, False), (False, True)])
def test_an_autopilot_that_does_not_watch_a_receiver_shows_no_loss(present: bool, enabled: bool) -> None:
    link = radio()
    link.handle(0.0, channels())
    link.handle(0.1, health(False, present, enabled))
    assert link.problem(0.1) is None


@pytest.mark.parametrize(("present", "enabled"), [(False, False), (True, False), (False, True), (True, True)])
def test_a_receiver_that_was_good_is_lost_by_each_form_of_the_status(present: bool, enabled: bool) -> None:
    link = good()
    link.handle(0.1, health(False, present, enabled))
    assert link.problem(0.1) == "the autopilot reports RC lost"
    link.handle(0.2, health(True))
    assert link.problem(0.2) is None
    link.handle(0.1, text("Radio Failsafe"))
    link.handle(0.9, health(False, present, enabled))
    link.handle(2.5, channels())
    link.handle(2.5, health(False, present, enabled))
    assert link.problem(2.5) == "radio failsafe"


def test_the_text_alone_and_its_return() -> None:
    link = good()
    link.handle(0.1, text("Radio Failsafe"))
    assert link.problem(0.1) == "radio failsafe"
    link.handle(0.2, text("Radio Failsafe Cleared"))
    assert link.problem(0.2) is None
    link.handle(0.3, text("EKF Failsafe"))
    assert link.problem(0.3) is None


@pytest.mark.parametrize("begin_s", [0.0, 5.0])
def test_lasting_good_health_replaces_a_lost_cleared_text(begin_s: float) -> None:
    link = good(begin_s)
    link.handle(begin_s, text("Radio Failsafe"))
    # ArduPilot's health still looks good for over a second after the text.
    for tenth in range(15):
        link.handle(begin_s + tenth / 10, channels())
        link.handle(begin_s + tenth / 10, health(True))
        assert link.problem(begin_s + tenth / 10) == "radio failsafe"
    back_at = begin_s + HEALTH_CLEARS_FAILSAFE_S + 0.1
    link.handle(back_at, channels())
    link.handle(back_at, health(True))
    assert link.problem(back_at) is None


def test_no_channels_alone() -> None:
    link = radio()
    link.handle(0.0, channels(0, 0, count=0))
    assert link.problem(0.0) == "the receiver has no channels"
    link.handle(0.1, channels(2000))
    assert link.problem(0.1) is None


@pytest.mark.parametrize("pulse_us", [0, 1, 799, 2201, 65535])
def test_a_pulse_that_no_receiver_makes(pulse_us: int) -> None:
    link = good()
    link.handle(0.1, channels(pulse_us))
    assert "channel 9 has no valid pulse" in str(link.problem(0.1))
    link.handle(0.2, channels(2000))
    assert link.problem(0.2) is None


@pytest.mark.parametrize("pulse_us", [800, 874, 2134, 2200])
def test_trims_at_their_ends_are_accepted(pulse_us: int) -> None:
    link = good()
    link.handle(0.1, channels(pulse_us))
    assert link.problem(0.1) is None


@pytest.mark.parametrize("none", [0, 0xFFFF])
def test_a_throttle_whose_pulses_stop_alone_is_a_loss(none: int) -> None:
    link = radio()
    link.handle(0.0, channels(1500, throttle_us=none))
    assert link.problem(0.0) is None, "this vehicle has no throttle"
    link.handle(0.1, channels(1500))
    link.handle(0.2, channels(1500, throttle_us=none))
    assert link.problem(0.2) == "the throttle has no pulse: receiver in failsafe"


def test_throttle_below_its_range_alone() -> None:
    link = good()
    link.handle(0.1, channels(1500, throttle_us=950))
    assert "throttle at 950" in str(link.problem(0.1))
    link.handle(0.2, channels(1500, throttle_us=976))
    assert link.problem(0.2) is None
    unwatched = radio(throttle_channel=0)
    unwatched.handle(0.0, channels(1500, throttle_us=950))
    assert unwatched.problem(0.0) is None


@pytest.mark.parametrize("throttle_us", [0, 65535])
def test_an_absent_throttle_shows_no_loss(throttle_us: int) -> None:
    link = radio()
    link.handle(0.0, channels(1500, throttle_us))
    assert link.problem(0.0) is None


def test_forgetting_removes_good_and_bad_signs() -> None:
    link = good()
    link.handle(0.1, text("Radio Failsafe"))
    link.handle(0.1, health(False))
    link.forget()
    assert link.problem(0.2) == "no RC_CHANNELS yet"
    link.handle(0.3, channels())
    assert link.problem(0.3) is None


def test_one_sign_that_clears_does_not_clear_the_others() -> None:
    link = good()
    link.handle(0.1, health(False))
    link.handle(0.1, text("Radio Failsafe"))
    link.handle(0.2, text("Radio Failsafe Cleared"))
    link.handle(0.2, channels())
    assert "reports RC lost" in str(link.problem(0.2))


def recorded(name: str) -> Iterator[tuple[float, MavlinkMessage]]:
    codec, began = MavlinkCodec(1, 191), None
    for unix_s, frame in TlogReader(RECORDINGS / f"{name}.tlog").frames():
        began = unix_s if began is None else began
        for message in codec.decode(frame):
            if (message.get_srcSystem(), message.get_srcComponent()) == (1, 1):
                yield unix_s - began, message


def judged(name: str) -> list[tuple[float, str]]:
    """The times at which the judgement of a recording's radio changed, and the new judgements."""
    link, changes, last = radio(), [], "no RC_CHANNELS yet"
    now = 0.0
    for t, message in recorded(name):
        while now + 0.02 < t:
            now += 0.02
            state = link.problem(now) or "good"
            if state != last:
                changes.append((round(now, 2), state))
                last = state
        link.handle(t, message)
        state = link.problem(t) or "good"
        if state != last:
            changes.append((round(t, 2), state))
            last = state
    return changes


def test_a_frozen_and_a_jumping_receiver_as_recorded() -> None:
    changes = judged("rc_switch")
    lost = [t for t, state in changes if state != "good"]
    back = [t for t, state in changes if state == "good"][1:]
    assert changes[0][1] == "good"
    # No pulses from 39.02 on: the text of the failsafe comes a second later, and the channels do not change.
    assert lost[0] == pytest.approx(40.05, abs=0.05)
    assert dict(changes)[lost[0]] == "radio failsafe"
    first_back = min(back)
    assert first_back == pytest.approx(49.2, abs=0.5)
    assert not [t for t in back if 40.1 < t < 49.0]
    # A receiver with false channels from 62.04 on: its throttle shows the loss before any text.
    second = min(t for t in lost if t > 55)
    assert second == pytest.approx(62.1, abs=0.06)
    assert "throttle at 950" in dict(changes)[second]
    assert max(back) == pytest.approx(67.2, abs=0.5)
    assert changes[-1][1] == "good"


def test_a_receiver_that_falls_silent_as_recorded() -> None:
    changes = judged("px4_mission")
    assert [state for _, state in changes] == [
        "good",
        "no RC_CHANNELS for 1 s",
        "good",
        "no RC_CHANNELS for 1 s",
    ]
    assert changes[1][0] == pytest.approx(10.0, abs=0.15)
    assert changes[2][0] == pytest.approx(13.0, abs=0.1)
    assert changes[3][0] == pytest.approx(17.1, abs=0.15)
