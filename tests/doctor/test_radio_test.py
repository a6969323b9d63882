"""What the guided radio test finds in recordings of real receivers and autopilots, and in simulated cases."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import msgspec
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config
from flying_vines.config.config import Config
from flying_vines.doctor import radio
from flying_vines.doctor.finding import may_fly
from flying_vines.doctor.radio_test import (
    BACK_WITHIN_S,
    QUIET_S,
    READY_WITHIN_S,
    SIGN_WITHIN_S,
    RadioTest,
    Sign,
    TransmitterLoss,
    failsafe_of,
)
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage
from flying_vines.vehicle.mavlink.tlog import TlogReader
from flying_vines.vehicle.radio.rc import RC_BIT

RECORDINGS = Path(__file__).parents[1] / "data" / "recordings"
TICK_S = 0.05
CONFIG = config.default()
TWO = msgspec.structs.replace(
    CONFIG, switch=msgspec.structs.replace(CONFIG.switch, positions=("straight", "bend-full"))
)
SIGN = Sign("RC status", 1.0, "")
PX4_LATEST_S = 1.4
"""Measured on real autopilots: longest time until the RC status shows a loss."""


def recorded(name: str, from_s: float, until_s: float) -> Iterator[tuple[float, MavlinkMessage]]:
    """The autopilot's messages between two times, with a disarmed vehicle."""
    codec, began = MavlinkCodec(99, 191), None
    for unix_s, frame in TlogReader(RECORDINGS / f"{name}.tlog").frames():
        began = unix_s if began is None else began
        t = unix_s - began
        for message in codec.decode(frame):
            if message.get_srcComponent() != mavlink.MAV_COMP_ID_AUTOPILOT1 or not from_s <= t <= until_s:
                continue
            if message.get_type() == "HEARTBEAT":
                message.base_mode &= ~mavlink.MAV_MODE_FLAG_SAFETY_ARMED
            yield t, message


def run_on(
    name: str,
    from_s: float,
    until_s: float,
    presses: Sequence[float] = (),
    target: int = 0,
    conf: Config = CONFIG,
) -> RadioTest:
    """Run the test on a part of a recording. It begins with the switch in position `target`."""
    test, waiting, now = RadioTest(conf), sorted(presses), from_s
    test.target = target
    for t, message in recorded(name, from_s, until_s):
        while now + TICK_S < t:
            now += TICK_S
            while waiting and waiting[0] <= now:
                test.press(waiting.pop(0))
            test.advance(now)
        test.take(t, message)
    return test


def kinds(loss: TransmitterLoss) -> list[str]:
    return [sign.kind for sign in loss.signs if sign.kind != "mode"]


# Real recordings. A person presses Enter at given times.


def test_px4_with_a_crsf_receiver_that_holds() -> None:
    """README: lost at 49.5, moved meanwhile, back at 53.9; lost at 66.1 while bent, back at 76.1."""
    learned = run_on("px4_crsf_loss", 43, 80, presses=(49.5, 66.1)).learned
    first, second = learned.losses
    assert (learned.autopilot, learned.problem, radio.to_write(learned, CONFIG)) == ("px4", "", "hold")
    for loss in (first, second):
        assert loss.pressed
        assert kinds(loss) == ["rssi", "RC status"]
        assert 0.4 < loss.signs[0].after_s < 0.8
        assert 0.9 < loss.signs[-1].after_s < PX4_LATEST_S
        assert loss.told_after_jump_s is None
        assert loss.jumped == ()
    assert (first.before_us, first.lost_us, second.lost_us) == (1012, 1012, 1988)
    # RC_CHANNELS has the new position while PX4 still reports RC lost.
    assert first.back is not None
    assert first.back.switch_us == 1988
    assert first.back.good_after_s == pytest.approx(0.3, abs=0.1)
    assert may_fly(radio.check_radio_test(learned, CONFIG))


def test_px4_with_an_sbus_receiver_that_has_a_preset_in_the_bent_position() -> None:
    """README: preset losses at 50.40 … 56.4 and 97.9 … 103.9, ch9 2000."""
    test = run_on("px4_sbus_failsafe", 44, 108, presses=(50.4, 97.9), conf=TWO)
    learned = test.learned
    assert (learned.problem, radio.to_write(learned, CONFIG)) == ("", 1999)
    for loss in learned.losses:
        assert kinds(loss) == ["channels", "RC status"]
        assert (loss.before_us, loss.lost_us, loss.jumped) == (999, 1999, ())
        assert loss.told_after_jump_s == pytest.approx(0.86, abs=0.04)
        assert loss.back is not None
        assert loss.back.switch_us == 999
    (line,) = [finding for finding in radio.check_radio_test(learned, TWO) if finding.check == "receiver"]
    assert line.verdict == "warning"
    assert "position 2" in line.what
    assert "waits 1.6 s" in line.what
    assert "channel 9 to hold, or to position 1" in line.do


def test_one_held_loss_may_be_a_preset_at_the_same_position() -> None:
    """README: held loss at 32.25, ch9 stays 2000. A receiver with this preset sends the same."""
    (loss,) = run_on("px4_sbus_failsafe", 28, 47, presses=(32.25,), target=2).learned.losses
    assert (loss.held, loss.lost_us, kinds(loss)) == (True, 1999, ["RC status"])
    assert loss.shown_after_s == pytest.approx(1.02, abs=0.1)
    assert loss.back is not None
    assert loss.back.switch_us == 999
    assert failsafe_of((loss,)) == 1999


def test_losses_that_end_too_early_do_not_count() -> None:
    """README: blips of 0.2, 0.4 and 1.0 s at 63.59, 66.27 and 69.21; the first two are never reported."""
    test = run_on("px4_sbus_failsafe", 57, 73, presses=(63.5, 66.2))
    assert test.learned.losses == ()
    blip = run_on("px4_sbus_failsafe", 66.9, 72.0, presses=(69.21,))
    assert blip.came_back_early
    assert (blip.step, blip.learned.losses) == ("ready", ())


def test_ardupilot_with_a_frozen_receiver_and_one_that_jumps() -> None:
    """README: frozen loss 39.02 … 49.03 at 2000; 62.04 … 67.05 ch9 jumps to 1500, throttle to 950."""
    (frozen,) = run_on("rc_switch", 36.5, 52, presses=(39.02,), target=2).learned.losses
    assert kinds(frozen) == ["text", "RC status"]
    assert frozen.shown_after_s == pytest.approx(1.0, abs=0.1)
    assert frozen.signs[-1].after_s == pytest.approx(1.5, abs=0.1)
    assert (frozen.lost_us, frozen.held) == (2000, True)
    (jump,) = run_on("rc_switch", 57, 70, presses=(62.0,), target=2).learned.losses
    assert kinds(jump) == ["channels", "throttle", "text", "RC status"]
    assert jump.lost_us == 1500
    assert jump.jumped == (5, 6, 7, 8)
    assert jump.told_after_jump_s == 0.0, "the throttle shows the loss in the same message"
    assert failsafe_of((frozen, jump)) == "unknown", "once held, once preset"


def test_ardupilot_that_hides_losses() -> None:
    """README: FS_THR_ENABLE = 0; 54.6 … 74.8 LOSS, frozen at 1000."""
    unseen = run_on("ardupilot_hidden_rc_loss", 53, 74, presses=(54.6,)).learned
    (loss,) = unseen.losses
    assert (loss.signs, loss.seen) == ((), False)
    assert radio.to_write(unseen, CONFIG) == "hidden"
    (finding,) = [f for f in radio.check_radio_test(unseen, CONFIG) if f.verdict == "bad"]
    assert "no sign of RC loss" in finding.what
    assert "FS_THR_ENABLE = 1" in finding.do
    # At 41.59 the stream has the parameter. Then nobody needs to switch the transmitter off.
    test = run_on("ardupilot_hidden_rc_loss", 41, 44)
    known = test.learned
    assert test.step == "done"
    assert (known.hidden_by, known.losses) == ("FS_THR_ENABLE 0", ())
    assert "set FS_THR_ENABLE = 1" in radio.check_radio_test(known, CONFIG)[0].do


def test_px4_whose_rc_comes_from_a_ground_station() -> None:
    learned = run_on("px4_mission", 0, 8).learned
    assert learned.problem == "ground station"
    (finding,) = radio.check_radio_test(learned, CONFIG)
    assert finding.verdict == "skipped"
    assert may_fly([finding])


# Cases that no recording has.


class Person:
    """A radio test with simulated messages of an autopilot, twenty times a second."""

    def __init__(self, kind: int = mavlink.MAV_AUTOPILOT_PX4) -> None:
        self.test = RadioTest(CONFIG)
        self.t = 0.0
        self.kind = kind
        self.armed = False
        self.switch_us = 1000
        self.channels_us = [1500] * 18
        self.rssi = 255
        self.status = (1, 1, 1)
        self.rc = True

    def wait(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        ends_s = self.t + seconds
        while self.t < ends_s - 1e-9 and not until():
            self.t = round(self.t + 0.05, 3)
            for message in self._messages():
                self.test.take(self.t, message)
            self.test.advance(self.t)

    def _messages(self) -> list[MavlinkMessage]:
        armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0
        bits = [RC_BIT * bit for bit in self.status]
        messages = [
            mavlink.MAVLink_heartbeat_message(2, self.kind, armed, 0, 3, 3),
            mavlink.MAVLink_sys_status_message(*bits, 0, 12000, -1, -1, 0, 0, 0, 0, 0, 0),
        ]
        if self.rc:
            channels_us = [*self.channels_us[:8], self.switch_us, *self.channels_us[9:]]
            messages.append(mavlink.MAVLink_rc_channels_message(0, 16, *channels_us, self.rssi))
        return messages

    def lose(self, **signs: object) -> None:
        self.wait(2.0, lambda: self.test.step == "off")
        self.test.press(self.t)
        for name, value in (signs or {"status": (0, 1, 0)}).items():
            setattr(self, name, value)
        self.wait(SIGN_WITHIN_S, lambda: self.test.step != "lost")

    def come_back(self, **signs: object) -> None:
        self.status, self.rc = (1, 1, 1), True
        for name, value in signs.items():
            setattr(self, name, value)
        self.wait(2.0, lambda: self.test.step != "on")


def test_a_preset_in_the_straight_position_is_distinguished_from_a_hold_by_the_second_loss() -> None:
    person = Person()
    person.lose()
    assert person.test.target == 2
    person.come_back(switch_us=2000)
    person.lose(status=(0, 1, 0), switch_us=1000)
    person.come_back(switch_us=2000)
    assert (person.test.step, failsafe_of(person.test.learned.losses)) == ("done", 1000)
    assert may_fly(radio.check_radio_test(person.test.learned, CONFIG))


def test_after_a_preset_the_second_loss_is_from_a_third_position() -> None:
    person = Person()
    person.lose(status=(0, 1, 0), switch_us=2000, channels_us=[1100] * 18)
    (loss,) = person.test.learned.losses
    assert loss.jumped == tuple(n for n in range(1, 19) if n != 9)
    assert person.test.target == 1
    person.come_back(switch_us=1500)
    person.lose(status=(0, 1, 0))
    person.come_back()
    assert failsafe_of(person.test.learned.losses) == "unknown", "preset, then held"


def test_missing_rc_channels_are_a_sign_after_the_timeout_of_the_service() -> None:
    person = Person(mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA)
    person.lose(rc=False)
    (loss,) = person.test.learned.losses
    assert kinds(loss) == ["no RC_CHANNELS"]
    assert loss.shown_after_s == pytest.approx(CONFIG.losses.rc_s, abs=0.1)


def test_a_late_or_missing_enter_is_not_timed() -> None:
    person = Person()
    person.wait(3.0)
    person.switch_us = 2000
    person.wait(0.5)
    person.test.press(person.t)
    person.status = (0, 1, 0)
    person.wait(QUIET_S + 0.2)
    (loss,) = person.test.learned.losses
    assert (loss.pressed, loss.lost_us) == (False, 2000)
    assert loss.told_after_jump_s == pytest.approx(0.55, abs=0.1)


def test_a_switch_that_moves_before_enter_must_be_moved_back() -> None:
    person = Person()
    person.wait(3.0)
    assert person.test.step == "off"
    person.switch_us = 1500
    person.wait(3.0)
    assert (person.test.step, person.test.learned.losses) == ("ready", ())


def test_arming_ends_it_at_once() -> None:
    person = Person()
    person.wait(3.0)
    person.armed = True
    person.wait(0.1)
    assert (person.test.step, person.test.learned.problem) == ("done", "armed")


@pytest.mark.parametrize(
    ("wrong", "problem"),
    [
        ({"kind": mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, "rc": False}, "no RC"),
        ({"status": (0, 1, 0)}, "RC not good"),
        ({"switch_us": 1500}, "position"),
        ({"switch_us": 65535}, "RC not good"),
    ],
)
def test_the_first_step_has_a_time_limit(wrong: dict[str, object], problem: str) -> None:
    person = Person()
    for name, value in wrong.items():
        setattr(person, name, value)
    person.wait(READY_WITHIN_S - 0.5)
    assert person.test.step == "ready"
    person.wait(1.0)
    assert (person.test.step, person.test.learned.problem) == ("done", problem)


def test_overrides_are_recognised_before_the_test_asks_to_switch_off() -> None:
    person = Person()
    person.status, person.rssi = (0, 1, 0), 100
    asked = False

    def looked() -> bool:
        nonlocal asked
        asked |= person.test.step == "off"
        return person.test.step == "done"

    person.wait(10.0, looked)
    assert (person.test.learned.problem, asked) == ("ground station", False)
    assert person.t < 5.0


def test_without_an_autopilot_it_ends() -> None:
    test = RadioTest(CONFIG)
    test.advance(0.0)
    test.advance(READY_WITHIN_S)
    assert test.learned.problem == "no autopilot"


def test_a_transmitter_that_is_not_switched_on_again_ends_it() -> None:
    person = Person()
    person.lose()
    person.wait(BACK_WITHIN_S + 0.1)
    assert person.test.learned.problem == "not back"
    assert not may_fly(radio.check_radio_test(person.test.learned, CONFIG))


@pytest.mark.parametrize(
    ("losses", "failsafe"),
    [
        ((), "unknown"),
        (
            (TransmitterLoss(True, 1000, 1000, (SIGN,), ()), TransmitterLoss(True, 2000, 2000, (SIGN,), ())),
            "hold",
        ),
        (
            (TransmitterLoss(True, 1000, 1510, (SIGN,), ()), TransmitterLoss(True, 2000, 1500, (SIGN,), ())),
            1500,
        ),
        (
            (TransmitterLoss(True, 1000, 1000, (SIGN,), ()), TransmitterLoss(True, 2000, 1500, (SIGN,), ())),
            "unknown",
        ),
        ((TransmitterLoss(True, 1000, 0, (SIGN,), ()),), "unknown"),
        ((TransmitterLoss(True, 1000, 1000, (), ()),), "unknown"),
    ],
)
def test_the_channel_during_a_loss(losses: tuple[TransmitterLoss, ...], failsafe: int | str) -> None:
    assert failsafe_of(losses) == failsafe
