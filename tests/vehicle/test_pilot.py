"""The pilot's switch on a radio with known truth: which moves bend the vine, and after which time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from param_value import param_value
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config
from flying_vines.vehicle.autopilots import AUTOPILOTS
from flying_vines.vehicle.notice import Notice
from flying_vines.vehicle.radio.pilot import Pilot, PilotOutput, Straightened
from flying_vines.vehicle.radio.rc import NO_RSSI, OVERRIDE_RSSI, RC_BIT
from flying_vines.vehicle.triggers import Rules, Trigger
from flying_vines.vine.intent import StartProfile

PERIOD_S = 0.05
PULSES_US = (1000, 1500, 2000)
BITS_AFTER_S = 1.4
"""Maximum delay of PX4's RC status after a loss, as observed."""
BITS_BACK_S = 0.3


@dataclass
class Radio:
    """A transmitter, a receiver and an autopilot that streams RC at 20 Hz and its status at 10 Hz."""

    autopilot: Literal["ardupilot", "px4"] = "px4"
    failsafe: Literal["unknown", "hold", "hidden"] | int = "unknown"
    preset: dict[int, int] | None = None
    """The receiver's channels in a loss; None: it holds them."""
    bits_after_s: float = BITS_AFTER_S
    rssi: int = NO_RSSI
    rssi_when_lost: int = NO_RSSI
    by_station: bool = False
    debounce_s: float = 0.15
    channel: int = 9
    vented: bool = False
    outputs: list[tuple[float, PilotOutput]] = field(default_factory=list)
    steps: int = 0
    sensors: int = 0
    """Health of other sensors."""
    lost_at: float | None = None
    good_bits_at: float = 0.0
    sticks: list[int] = field(default_factory=lambda: [1500, 1500, 1400, *[1500] * 5, 1000, *[1500] * 9])

    def __post_init__(self) -> None:
        base = config.default()
        switch = msgspec.structs.replace(
            base.switch,
            channel=self.channel,
            receiver_failsafe=self.failsafe,
            debounce_s=self.debounce_s,
        )
        conf = msgspec.structs.replace(base, switch=switch)
        self.config = conf
        self.pilot = Pilot(conf, Rules(conf))
        self.move(0)
        self.received = list(self.sticks)
        self.run(2.0)
        self.texts_at_start = self.texts
        self.outputs.clear()

    @property
    def now_s(self) -> float:
        return self.steps * PERIOD_S

    def override(self, pulse_us: int) -> None:
        """A ground station overrides the switch's channel."""
        channels_us = [65535] * 18
        channels_us[self.channel - 1] = pulse_us
        self.pilot.override(self.now_s, mavlink.MAVLink_rc_channels_override_message(1, 1, *channels_us))

    def move(self, position: int, for_s: float = 0.0) -> None:
        self.sticks[self.channel - 1] = PULSES_US[position]
        self.run(for_s)

    def lose(self, for_s: float = 0.0) -> None:
        self.lost_at = self.now_s
        for number, pulse_us in (self.preset or {}).items():
            self.received[number - 1] = pulse_us
        self.run(for_s)

    def restore(self, for_s: float = 0.0) -> None:
        assert self.lost_at is not None
        if self.now_s - self.lost_at >= self.bits_after_s:
            self.good_bits_at = self.now_s + BITS_BACK_S
        self.lost_at = None
        self.run(for_s)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD_S)):
            self.steps += 1
            if self.lost_at is None:
                self.received = list(self.sticks)
            lost_s = 0.0 if self.lost_at is None else self.now_s - self.lost_at
            good = lost_s < self.bits_after_s and self.now_s >= self.good_bits_at and not self.by_station
            rssi = self.rssi if lost_s < 0.6 else self.rssi_when_lost
            if self.by_station:
                rssi = OVERRIDE_RSSI
            if not (self.by_station and self.lost_at is not None):
                stamp_ms = round(1000 * self.now_s) + 60_000
                self.receive(mavlink.MAVLink_rc_channels_message(stamp_ms, 18, *self.received, rssi))
            if self.steps % 2 == 0:
                bits = [RC_BIT * flag | self.sensors for flag in (good, True, good)]
                self.receive(mavlink.MAVLink_sys_status_message(*bits, 0, 12000, -1, -1, 0, 0, 0, 0, 0, 0))
            self.outputs.extend((self.now_s, output) for output in self.pilot.tick(self.now_s))

    def run_without_status(self, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD_S)):
            self.steps += 1
            self.receive_channels()
            self.outputs.extend((self.now_s, output) for output in self.pilot.tick(self.now_s))

    def receive_channels(self) -> None:
        stamp_ms = round(1000 * self.now_s) + 60_000
        self.receive(mavlink.MAVLink_rc_channels_message(stamp_ms, 18, *self.sticks, NO_RSSI))

    def receive(self, message: object) -> None:
        outputs = self.pilot.handle(self.now_s, message, AUTOPILOTS[self.autopilot], self.vented)
        self.outputs.extend((self.now_s, output) for output in outputs)

    def run_on_two_paths(self, seconds: float, slower_s: float) -> None:
        """The channels also arrive on a slower path, with the switch in bending position 2."""
        for _ in range(round(seconds / PERIOD_S)):
            self.run(PERIOD_S)
            self.receive_old(slower_s)

    def receive_old(self, slower_s: float) -> None:
        stamp_ms = round(1000 * (self.now_s - slower_s)) + 60_000
        before = [*self.sticks[: self.channel - 1], PULSES_US[2], *self.sticks[self.channel :]]
        self.receive(mavlink.MAVLink_rc_channels_message(stamp_ms, 18, *before, NO_RSSI))

    @property
    def asked(self) -> list[tuple[float, str, bool]]:
        return [
            (t, output.intent.name if isinstance(output.intent, StartProfile) else "", output.by_person)
            for t, output in self.outputs
            if isinstance(output, Trigger)
        ]

    @property
    def bends(self) -> list[float]:
        return [t for t, name, _ in self.asked if name.startswith("bend")]

    @property
    def texts(self) -> list[str]:
        return [output.text for _, output in self.outputs if isinstance(output, Notice)]


def test_a_bend_on_px4_waits_until_the_status_would_have_reported_a_loss() -> None:
    radio = Radio()
    moved_s = radio.now_s
    radio.move(2, 5.0)
    (bent_s,) = radio.bends
    assert 1.6 <= bent_s - moved_s <= 1.85


def test_a_bend_waits_longer_where_px4_has_just_reported_its_health() -> None:
    """PX4 reports its health at most every 2 s, so a loss in between is reported later."""
    radio = Radio(preset={9: 2000}, bits_after_s=2.6)
    radio.sensors = 0x20
    radio.run(0.3)
    radio.lose(6.0)
    assert radio.bends == []
    radio.restore(4.0)
    radio.sensors = 0
    moved_s = radio.now_s
    radio.move(2, 5.0)
    (bent_s,) = radio.bends
    assert 3.6 <= bent_s - moved_s <= 3.85


def test_straightening_on_px4_does_not_wait() -> None:
    radio = Radio()
    radio.move(2, 3.0)
    moved_s = radio.now_s
    radio.move(0, 0.3)
    assert radio.asked[-1][1:] == ("straight", False)
    assert radio.asked[-1][0] - moved_s <= 0.25
    assert not any(isinstance(output, Straightened) for _, output in radio.outputs)
    radio.run(2.0)
    assert isinstance(radio.outputs[-1][1], Straightened), "only then it is certain that the pilot moved it"


@pytest.mark.parametrize("failsafe", ["hold", 1000, 1500])
def test_a_receiver_known_to_be_safe_bends_at_once(
    failsafe: Literal["hold"] | int,
) -> None:
    radio = Radio(failsafe=failsafe)
    moved_s = radio.now_s
    radio.move(2, 5.0)
    (bent_s,) = radio.bends
    assert bent_s - moved_s <= 0.25


@given(
    lasts_s=st.floats(0.05, 6.0),
    bits_after_s=st.floats(0.8, BITS_AFTER_S),
    preset=st.sampled_from([{9: 2000}, {9: 1500}, {9: 2000, 3: 1000, 1: 1100}, {9: 2000, 3: 1000}]),
    failsafe=st.sampled_from(["unknown", 2000]),
    rssi=st.sampled_from([NO_RSSI, 61]),
    repeats=st.integers(1, 3),
    pause_s=st.floats(0.05, 1.0),
)
def test_no_preset_bends_the_vine_however_long_it_lasts(
    lasts_s: float,
    bits_after_s: float,
    preset: dict[int, int],
    failsafe: Literal["unknown"] | int,
    rssi: int,
    repeats: int,
    pause_s: float,
) -> None:
    if failsafe == 2000 and preset[9] != 2000:
        failsafe = "unknown"
    radio = Radio(failsafe=failsafe, preset=preset, bits_after_s=bits_after_s, rssi=rssi)
    for _ in range(repeats):
        radio.lose(lasts_s)
        radio.restore(pause_s)
    radio.run(4.0)
    assert radio.bends == []


@given(
    lasts_s=st.floats(1.5, 6.0),
    moved_after_s=st.floats(0.0, 6.0),
    failsafe=st.sampled_from(["unknown", "hold"]),
    rssi=st.sampled_from([NO_RSSI, 61]),
)
def test_a_switch_that_moved_while_rc_was_lost_bends_nothing(
    lasts_s: float, moved_after_s: float, failsafe: Literal["unknown", "hold"], rssi: int
) -> None:
    radio = Radio(failsafe=failsafe, rssi=rssi)
    radio.lose()
    radio.run(min(moved_after_s, lasts_s))
    radio.move(2)
    radio.run(lasts_s - min(moved_after_s, lasts_s))
    radio.restore(4.0)
    assert radio.bends == []
    assert any("moved while RC was lost, move it again" in text for text in radio.texts)


@given(dwells=st.lists(st.tuples(st.sampled_from([0, 1, 2]), st.floats(0.05, 1.4)), max_size=8))
def test_a_position_that_is_left_too_soon_does_not_bend(dwells: list[tuple[int, float]]) -> None:
    radio = Radio()
    for position, for_s in dwells:
        radio.move(position, for_s)
        radio.move(0, 0.1)
    radio.run(3.0)
    assert radio.bends == []


@given(positions=st.lists(st.sampled_from([0, 1, 2]), min_size=1, max_size=8))
def test_every_move_of_the_pilot_counts_once(positions: list[int]) -> None:
    radio = Radio()
    wanted, before = [], 0
    for position in positions:
        radio.move(position, 2.5)
        if position != before:
            wanted.append(("straight", "bend-half", "bend-full")[position])
        before = position
    assert [name for _, name, _ in radio.asked] == wanted


def test_rc_by_a_ground_station_needs_no_receiver_and_is_reported() -> None:
    radio = Radio(by_station=True)
    radio.move(2, 0.3)
    assert len(radio.bends) == 1
    assert radio.texts_at_start == ["Vine: RC comes from a ground station"]


def test_a_receiver_with_a_signal_value_shows_a_loss_before_the_status() -> None:
    radio = Radio(rssi=61)
    radio.lose(0.75)
    assert radio.pilot.radio.problem(radio.now_s) == "the receiver hears no transmitter"


def test_a_receiver_that_reports_no_signal_is_lost_with_any_status() -> None:
    """CRSF frames continue with a link quality of 0, and PX4's status stays good."""
    radio = Radio(rssi=53, rssi_when_lost=0, bits_after_s=100.0, preset={9: 2000})
    radio.lose(10.0)
    assert radio.pilot.radio.problem(radio.now_s) == "the receiver hears no transmitter"
    radio.restore(4.0)
    assert radio.bends == []


def test_a_receiver_without_a_failsafe_flag_must_not_bend_the_vine() -> None:
    """PX4 then shows no loss at all; `flying-vines doctor --radio` finds this."""
    radio = Radio(failsafe="hidden", preset={9: 2000}, bits_after_s=100.0)
    radio.lose(5.0)
    assert radio.bends == []
    (refused,) = [output for _, output in radio.outputs if isinstance(output, Trigger)]
    assert "receiver_failsafe" in refused.problem


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_several_channels_that_jump_with_the_switch_are_no_pilot(
    autopilot: Literal["ardupilot", "px4"],
) -> None:
    radio = Radio(autopilot, failsafe="hold")
    radio.sticks[:4] = [1100, 1900, 1000, 1500]
    radio.move(2, 4.0)
    assert radio.bends == []
    assert radio.texts == ["Vine: switch ch9 moved with other channels, move it again"]


def test_channels_that_jump_still_straighten_but_clear_nothing() -> None:
    radio = Radio("ardupilot")
    radio.move(2, 1.0)
    radio.sticks[:4] = [1100, 1900, 1000, 1500]
    radio.move(0, 1.0)
    assert radio.asked[-1][1:] == ("straight", False)


def test_a_slow_stick_beside_the_switch_is_the_pilot() -> None:
    radio = Radio("ardupilot")
    radio.move(2)
    for _ in range(5):
        radio.sticks[0] += 80
        radio.sticks[1] -= 80
        radio.run(PERIOD_S)
    radio.run(0.5)
    assert len(radio.bends) == 1


def test_if_ardupilot_hides_losses_the_switch_only_straightens() -> None:
    radio = Radio("ardupilot")
    radio.receive(param_value("FS_THR_ENABLE", 0.0))
    assert radio.texts == ["Vine: FS_THR_ENABLE 0 hides RC loss: switch cannot bend"]
    radio.move(2, 1.0)
    (refused,) = [output for _, output in radio.outputs if isinstance(output, Trigger)]
    assert refused.intent is None
    assert "FS_THR_ENABLE 0" in refused.problem
    radio.move(0, 1.0)
    assert radio.asked[-1][1] == "straight"
    radio.receive(param_value("FS_THR_ENABLE", 1.0))
    assert "can bend" in radio.texts[-1]
    radio.move(2, 1.0)
    assert len(radio.bends) == 1


@pytest.mark.parametrize(("kind", "name"), [("ardupilot", "FLTMODE_CH"), ("px4", "RC_MAP_FLTMODE")])
def test_on_the_flight_modes_channel_the_switch_only_straightens(
    kind: Literal["ardupilot", "px4"], name: str
) -> None:
    radio = Radio(kind)
    radio.receive(param_value(name, 9.0))
    radio.move(2, 4.0)
    (refused,) = [output for _, output in radio.outputs if isinstance(output, Trigger)]
    assert (refused.intent, refused.problem) == (None, "channel 9 is the flight mode's")
    radio.move(0, 1.0)
    assert radio.asked[-1][1] == "straight"
    radio.receive(param_value(name, 5.0))
    radio.move(2, 4.0)
    assert len(radio.bends) == 1


OVERRULED = "Vine: switch ch9 was overruled, to bend: switch down, then up within 2 s"


def overridden(radio: Radio, ends_after_s: float) -> None:
    """The pilot bends, a ground station vents; then it overrides the switch, and the override ends."""
    radio.move(2, 1.0)
    radio.pilot.vented("other")
    radio.move(0, ends_after_s)
    radio.move(2, 1.0)


def test_an_override_that_ends_bends_nothing_again() -> None:
    radio = Radio("ardupilot")
    overridden(radio, 7.0)
    assert len(radio.bends) == 1
    assert radio.texts[-1] == OVERRULED
    radio.move(0, 2.5)
    radio.move(2, 1.0)
    assert len(radio.bends) == 1, "an override may have ended again"
    radio.move(0, 1.0)
    radio.move(2, 1.0)
    assert len(radio.bends) == 2, "a fresh move counts"
    radio.move(0, 10.0)
    radio.move(2, 1.0)
    assert len(radio.bends) == 3, "and after it any move"


@given(
    transmitter=st.sampled_from([1, 2]),
    overridden=st.sampled_from([0, 1, 2]),
    vent_at_s=st.floats(0.0, 4.0),
    lasts_s=st.floats(3.0, 8.0),
    repeats=st.integers(1, 3),
)
def test_after_a_vent_by_others_no_end_of_an_override_bends_the_vine(
    transmitter: int, overridden: int, vent_at_s: float, lasts_s: float, repeats: int
) -> None:
    """The ground station vents before or during its first override."""
    radio = Radio("ardupilot")
    radio.move(transmitter, 1.0)
    radio.move(overridden, min(vent_at_s, lasts_s))
    radio.pilot.vented("other")
    bent = len(radio.bends)
    radio.run(max(0.0, lasts_s - vent_at_s))
    for _ in range(repeats):
        radio.move(transmitter, 1.0)
        radio.move(0, lasts_s)
    radio.move(transmitter, 2.0)
    assert len(radio.bends) == bent
    assert radio.texts[-1] == OVERRULED


def test_a_vent_by_others_is_not_forgotten_in_a_loss_of_rc() -> None:
    radio = Radio("ardupilot")
    radio.pilot.vented("other")
    radio.steps += 120  # our process paused
    radio.run(3.0)
    radio.move(2, 1.0)
    assert radio.bends == []


def test_an_override_that_never_expires_may_still_be_released() -> None:
    radio = Radio("ardupilot")
    radio.receive(param_value("RC_OVERRIDE_TIME", -1.0))
    radio.pilot.vented("other")
    radio.move(2, 1.0)
    assert radio.bends == []
    assert radio.texts[-1] == OVERRULED.removesuffix(" within 2 s")
    radio.move(0, 5.0)
    radio.move(2, 1.0)
    assert len(radio.bends) == 1


@pytest.mark.parametrize("lasts_s", [0.3, 0.5, 1.0, 1.5])
def test_an_override_that_expires_sooner_than_a_pilot_can_move_bends_nothing(lasts_s: float) -> None:
    radio = Radio("ardupilot")
    radio.receive(param_value("RC_OVERRIDE_TIME", lasts_s))
    overridden(radio, lasts_s)
    assert len(radio.bends) == 1
    assert radio.texts[-1] == "Vine: switch ch9 was overruled, to bend: RC_OVERRIDE_TIME of 1.7 s or more"
    radio.receive(param_value("RC_OVERRIDE_TIME", 3.0))
    radio.move(0, 1.0)
    radio.move(2, 1.0)
    assert len(radio.bends) == 2


def test_the_text_promises_no_more_time_than_there_is() -> None:
    radio = Radio("ardupilot")
    radio.receive(param_value("RC_OVERRIDE_TIME", 2.4))
    overridden(radio, 2.4)
    assert radio.texts[-1].endswith("within 1 s")


@pytest.mark.parametrize("unseen_s", [0.5, 0.9, 1.5, 2.5])
@pytest.mark.parametrize("late", [False, True])
def test_an_override_that_begins_unseen_bends_nothing_when_it_ends(unseen_s: float, late: bool) -> None:
    """RC_CHANNELS are lost, or come late, as the override begins: it seems to begin later."""
    radio = Radio("ardupilot")
    radio.move(2, 1.0)
    radio.pilot.vented("other")
    radio.run(0.5)
    sent_from = radio.steps
    radio.steps += round(unseen_s / PERIOD_S)
    if late:
        for step in range(sent_from, radio.steps):
            channels_us = list(radio.sticks)
            channels_us[8] = PULSES_US[0]
            stamp_ms = round(1000 * step * PERIOD_S) + 60_000
            radio.receive(mavlink.MAVLink_rc_channels_message(stamp_ms, 18, *channels_us, NO_RSSI))
    radio.move(0, 3.0 - unseen_s)
    radio.move(2, 2.0)
    assert len(radio.bends) == 1


def test_after_a_reboot_no_move_from_before_it_counts() -> None:
    """The autopilot's clock begins again."""
    radio = Radio("ardupilot")
    radio.pilot.vented("other")
    radio.move(2, 1.0)
    radio.move(0, 1.0)
    radio.pilot.restarted()
    radio.steps -= 100
    radio.run(2.0)
    radio.move(2, 1.0)
    assert radio.bends == []


@pytest.mark.parametrize("parameter", [("RC_OPTIONS", 2.0), ("RC_OVERRIDE_TIME", 0.0)])
def test_without_overrides_a_switch_that_comes_back_was_moved(
    parameter: tuple[str, float],
) -> None:
    radio = Radio("ardupilot")
    radio.receive(param_value(*parameter))
    overridden(radio, 7.0)
    assert len(radio.bends) == 2


@pytest.mark.parametrize("by", ["other", "safety"])
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_after_a_vent_a_move_from_one_bend_to_another_bends_nothing(
    autopilot: Literal["px4", "ardupilot"], by: Literal["other", "safety"]
) -> None:
    """Also where no override can end: the pilot reads that the switch must first be straight."""
    radio = Radio(autopilot)
    radio.receive(param_value("RC_OPTIONS", 2.0))
    radio.move(1, 3.0)
    radio.pilot.vented(by)
    radio.move(2, 4.0)
    assert len(radio.bends) == 1
    assert radio.texts[-1] == f"Vine: switch ch9 was overruled, to bend: {radio.pilot.fresh_move}"
    radio.move(0, 4.0)
    radio.move(2, 4.0)
    assert len(radio.bends) == 2


def test_a_move_before_an_override_can_end_is_the_pilots() -> None:
    radio = Radio("ardupilot")
    overridden(radio, 1.5)
    assert len(radio.bends) == 2


def test_an_override_whose_end_is_reported_is_no_move() -> None:
    radio = Radio("ardupilot")
    radio.override(1000)
    radio.run(3.0)
    radio.move(2, 1.0)
    assert radio.bends == []
    assert radio.texts[-1] == "Vine: switch ch9 moved as an override ended, move it again"


def test_a_waiting_bend_is_cancelled_by_another_request() -> None:
    radio = Radio()
    radio.move(2, 1.0)
    radio.pilot.vented("other")
    radio.run(4.0)
    assert radio.bends == []


@given(
    preset=st.sampled_from([1000, 1500]),
    lasts_s=st.floats(0.1, 1.3),
    failsafe=st.sampled_from(["unknown", 1000]),
    vented=st.booleans(),
)
def test_a_switch_that_comes_back_from_a_preset_bends_nothing_again(
    preset: int, lasts_s: float, failsafe: Literal["unknown"] | int, vented: bool
) -> None:
    radio = Radio(preset={9: preset}, failsafe=failsafe if preset == 1000 else "unknown")
    radio.move(2, 3.0)
    assert len(radio.bends) == 1
    if vented:
        radio.pilot.vented("other")
    radio.lose(lasts_s)
    radio.restore(5.0)
    assert len(radio.bends) == 1
    radio.move(0, 2.5)
    radio.move(2, 3.0)
    assert len(radio.bends) == 2, "a new move counts"


def test_a_straightening_clears_only_faults_up_to_its_move() -> None:
    radio = Radio()
    radio.move(2, 3.0)
    radio.move(0)
    moved_s = radio.now_s
    radio.run(3.0)
    (seen_at,) = [output.seen_at for _, output in radio.outputs if isinstance(output, Straightened)]
    assert seen_at - moved_s < 0.3


def test_a_loss_cancels_a_waiting_bend() -> None:
    radio = Radio()
    radio.move(2, 1.0)
    radio.pilot.drop_waiting()
    radio.run(3.0)
    assert radio.bends == []


def test_without_a_status_a_bend_is_refused_and_reported() -> None:
    radio = Radio()
    radio.move(2, 0.5)
    radio.run_without_status(10.0)
    (refused,) = [output for _, output in radio.outputs if isinstance(output, Trigger)]
    assert refused.problem == "the autopilot does not confirm RC, move it again"


def test_an_unnoticed_gap_is_a_loss() -> None:
    radio = Radio("ardupilot")
    radio.steps += 120  # our process paused
    radio.move(2, 3.0)
    assert radio.bends == []
    assert "moved while RC was lost" in radio.texts[-1]


@pytest.mark.parametrize(("channel", "pulse_us"), [(9, 65534), (8, 65534), (8, 0)])
def test_a_switch_that_moves_as_its_override_is_released_was_not_moved(channel: int, pulse_us: int) -> None:
    radio = Radio("ardupilot", channel=channel)
    radio.override(pulse_us)
    radio.move(2, 1.0)
    assert radio.bends == []
    assert radio.texts[-1] == f"Vine: switch ch{channel} moved as an override ended, move it again"


@pytest.mark.parametrize(("channel", "pulse_us"), [(9, 0), (9, 65535), (8, 65535), (8, 1000)])
def test_values_that_release_no_override_do_not_affect_the_pilots_moves(channel: int, pulse_us: int) -> None:
    """0 releases only the first eight channels, and an override that continues ends later."""
    radio = Radio("ardupilot", channel=channel)
    radio.override(pulse_us)
    radio.move(2, 1.0)
    assert len(radio.bends) == 1


def test_after_a_bend_by_another_source_the_switch_counts_as_before() -> None:
    radio = Radio("ardupilot")
    radio.move(2, 1.0)
    radio.pilot.bent_by_other()
    radio.move(0, 7.0)
    radio.move(2, 1.0)
    assert len(radio.bends) == 2


def test_a_second_straightening_does_not_hide_an_override_that_ends() -> None:
    radio = Radio("ardupilot")
    radio.move(2, 1.0)
    radio.pilot.vented("other")
    radio.move(0, 1.0)
    radio.pilot.vented("other")
    radio.run(6.0)
    radio.move(2, 1.0)
    assert len(radio.bends) == 1


def test_another_setting_of_the_switch_cancels_a_waiting_bend() -> None:
    radio = Radio()
    radio.move(2, 1.0)
    switch = msgspec.structs.replace(radio.config.switch, debounce_s=0.3)
    radio.pilot.configure(msgspec.structs.replace(radio.config, switch=switch))
    radio.run(5.0)
    assert radio.bends == []


def test_another_parameter_keeps_a_waiting_bend() -> None:
    radio = Radio()
    radio.move(2, 1.0)
    radio.pilot.configure(msgspec.structs.replace(radio.config, limits=config.LimitsConfig(max_bent_s=5.0)))
    radio.run(3.0)
    assert len(radio.bends) == 1


def test_a_preset_does_not_bring_back_a_bend_that_was_cancelled() -> None:
    radio = Radio(preset={9: 1000})
    radio.move(2, 1.0)
    radio.pilot.drop_waiting()
    radio.lose(0.9)
    radio.restore(5.0)
    assert radio.bends == []


def test_without_messages_the_switch_has_no_position_and_no_bend_waits() -> None:
    radio = Radio()
    radio.move(2, 1.0)
    for _ in range(200):
        radio.steps += 1
        radio.outputs.extend((radio.now_s, output) for output in radio.pilot.tick(radio.now_s))
    assert radio.pilot.switch.position is None
    assert radio.outputs == []


def test_without_a_status_a_straightening_is_not_refused_afterwards() -> None:
    radio = Radio()
    radio.move(2, 3.0)
    radio.move(0)
    radio.run_without_status(10.0)
    assert [name for _, name, _ in radio.asked] == ["bend-full", "straight"]


def test_on_ardupilot_the_status_does_not_show_what_its_parameters_hide() -> None:
    radio = Radio("ardupilot", by_station=True)
    radio.receive(param_value("FS_THR_ENABLE", 0.0))
    radio.move(2, 1.0)
    assert radio.bends == []


def test_a_receiver_that_px4_does_not_use_is_refused_and_a_ground_station_is_not() -> None:
    for by_station, bends in ((False, 0), (True, 1)):
        radio = Radio(by_station=by_station)
        radio.receive(param_value("COM_RC_IN_MODE", 1.0))
        radio.move(2, 3.0)
        assert len(radio.bends) == bends


def test_a_parameter_that_hides_losses_is_reported_once() -> None:
    radio = Radio("ardupilot")
    radio.receive(param_value("RC_OVERRIDE_TIME", 4.0))
    assert radio.texts == []
    radio.receive(param_value("FS_THR_ENABLE", 0.0))
    radio.receive(param_value("RC_OVERRIDE_TIME", 5.0))
    assert len(radio.texts) == 1


def test_a_single_message_with_the_throttle_in_failsafe_is_a_loss() -> None:
    """The switch's value in this message does not count."""
    radio = Radio("ardupilot")
    radio.move(2)
    radio.sticks[2] = 900
    radio.steps += 1
    radio.receive_channels()
    radio.sticks[2] = 1400
    good_from_s = radio.now_s + PERIOD_S
    while radio.pilot.switch.position is None or not radio.outputs:
        radio.steps += 1
        radio.receive_channels()
        assert radio.now_s < good_from_s + 2.0
    assert radio.now_s - good_from_s == pytest.approx(radio.config.switch.settle_s, abs=PERIOD_S / 2)
    assert radio.texts == ["Vine: switch ch9 moved while RC was lost, move it again"]


def test_after_a_loss_the_switch_may_go_where_it_stood_before() -> None:
    radio = Radio("ardupilot")
    radio.move(2, 1.0)
    radio.lose(2.0)
    radio.move(0)
    radio.restore(3.0)
    radio.move(2, 1.0)
    assert len(radio.bends) == 2


def test_a_glitch_only_delays_a_waiting_bend() -> None:
    radio = Radio()
    radio.move(2, 1.0)
    radio.move(0, PERIOD_S)
    radio.move(2)
    glitched_s = radio.now_s
    radio.run(4.0)
    (bent_s,) = radio.bends
    assert bent_s - glitched_s > 1.3


def test_after_a_preset_the_pilot_must_move_the_switch_again() -> None:
    radio = Radio(preset={9: 1000})
    radio.move(2, 3.0)
    radio.lose(0.9)
    radio.restore(5.0)
    assert radio.texts == [BACK_WHERE_IT_WAS]


def test_a_quick_move_down_and_up_is_refused_and_the_text_says_which_move_bends() -> None:
    radio = Radio()
    radio.move(2, 3.0)
    radio.pilot.vented("other")
    assert radio.pilot.fresh_move == "switch down for 4 s, then up"
    radio.move(0, 1.0)
    radio.move(2, 3.0)
    assert radio.texts == [BACK_WHERE_IT_WAS]
    radio.sensors ^= 2  # the longest wait: a report of health came just before
    radio.move(0, 4.0)
    radio.move(2, 4.0)
    assert len(radio.bends) == 2


def test_with_a_receiver_that_holds_the_channel_no_position_must_be_held() -> None:
    radio = Radio(failsafe="hold")
    radio.move(2, 3.0)
    assert radio.pilot.fresh_move == "switch down, then up"


BACK_WHERE_IT_WAS = "Vine: switch ch9 is back where it was, to bend: switch down for 4 s, then up"
HOLD_ON = "Vine: hold switch ch9 for 1.6 s to bend"


def test_a_position_that_is_left_too_soon_requests_nothing_and_the_reason_is_reported() -> None:
    radio = Radio(vented=True)
    radio.move(2, 0.5)
    radio.move(0, 3.0)
    assert radio.texts == [HOLD_ON]
    assert radio.asked == []


def test_from_a_bend_to_another_and_back_too_soon_requests_nothing() -> None:
    radio = Radio()
    radio.move(1, 3.0)
    radio.move(2, 0.5)
    radio.move(1, 3.0)
    assert radio.texts == [HOLD_ON]
    assert [name for _, name, _ in radio.asked] == ["bend-half"]


def test_while_another_bends_the_vine_a_position_that_is_left_too_soon_straightens_it() -> None:
    radio = Radio()
    radio.move(2, 0.5)
    radio.move(0, 3.0)
    assert [name for _, name, _ in radio.asked] == ["straight"]


def test_a_waiting_bend_is_replaced_by_another_position() -> None:
    radio = Radio()
    radio.move(1, 0.5)
    radio.move(2, 3.0)
    assert [name for _, name, _ in radio.asked] == ["bend-full"]


@pytest.mark.parametrize("steps", range(8))
def test_a_status_that_reports_a_loss_confirms_no_bend(steps: int) -> None:
    radio = Radio()
    radio.move(2, steps * PERIOD_S)
    radio.lose()
    lost_s = radio.now_s
    radio.run(4.0)
    assert all(t < lost_s + BITS_AFTER_S for t in radio.bends)


def test_a_vent_before_the_switch_is_accepted_blocks_no_fresh_move() -> None:
    radio = Radio("ardupilot")
    radio.pilot.forget()
    radio.pilot.vented("other")
    radio.run(3.0)
    radio.move(2, 1.0)
    radio.move(0, 1.0)
    radio.move(2, 1.0)
    assert len(radio.bends) == 1


@pytest.mark.parametrize("slower_s", [0.1, 0.8, 1.5])
def test_channels_on_a_slower_path_delay_no_straightening_and_bend_nothing(slower_s: float) -> None:
    radio = Radio("ardupilot")
    radio.move(2, 1.0)
    radio.outputs.clear()
    moved_at = radio.now_s
    radio.move(0)
    radio.run_on_two_paths(0.5, slower_s)
    ((straight_at, profile, _),) = radio.asked
    assert (profile, straight_at - moved_at < 0.3) == ("straight", True)
    # The faster path dies, and the slower one still has the old position.
    begin = radio.steps
    for step in range(round(slower_s / PERIOD_S) - 1):
        radio.steps = begin + step + 1
        radio.receive_old(slower_s)
        radio.outputs.extend((radio.now_s, output) for output in radio.pilot.tick(radio.now_s))
    assert len(radio.asked) == 1
