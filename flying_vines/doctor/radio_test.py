"""The guided radio test: the transmitter is switched off and on twice, and each sign of the loss is recorded.

Sans-IO: give it the autopilot's messages and the times of Enter; times are seconds of one clock. A receiver
that repeats its last values does not show when the transmitter goes off, so a person presses Enter at this
moment. Delays since Enter may be wrong by 1 s; delays between two signs are exact.

Two losses from two switch positions distinguish a receiver that holds its values from one with preset values.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config.config import Config, ReceiverFailsafe
from flying_vines.vehicle.autopilots import of_heartbeat
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.radio.rc import (
    CHANNELS,
    JUMP_US,
    MAX_US,
    MIN_US,
    NO_RSSI,
    NO_SIGNAL,
    RC_BIT,
    RadioLink,
    RadioParameters,
)
from flying_vines.vehicle.radio.switch import BOUNDARIES_US

RadioStep = Literal["ready", "off", "lost", "on", "done"]
"""Get ready; press Enter and switch off; record the signs of loss; switch on again; done."""
SignKind = Literal["channels", "rssi", "RC status", "text", "no RC_CHANNELS", "throttle", "mode"]
RadioProblem = Literal[
    "", "armed", "no autopilot", "no RC", "RC not good", "position", "ground station", "not back"
]
"""Why the test ended early."""

READY_WITHIN_S = 30.0
"""A transmitter takes some seconds to start."""
SIGN_WITHIN_S = 15.0
BACK_WITHIN_S = 45.0
"""A transmitter with a switch in a wrong position waits at its start until its warning is confirmed."""
REST_S = 1.0
QUIET_S = 1.5
"""No new sign for this long: all signs of the loss have been seen."""
EARLY_S = 1.6
"""A jump up to this time before a sign of loss belongs to the loss: Enter came late or not at all."""
STATUS_WITHIN_S = 3.0
"""If the autopilot has a receiver, the RC status shows it within this time."""
SAME_US = 30
"""A held channel changes by at most this."""
LOSSES = 2
LOSS_SIGNS: frozenset[SignKind] = frozenset({"rssi", "RC status", "text", "no RC_CHANNELS", "throttle"})
"""The signs by which the service detects a loss of RC."""


@dataclass(frozen=True, slots=True)
class Sign:
    """One change that was observed."""

    kind: SignKind
    after_s: float
    """Time since Enter, or since the first sign if nobody pressed Enter."""
    said: str

    @property
    def shows_loss(self) -> bool:
        """True if the service detects the loss by this sign."""
        return self.kind in LOSS_SIGNS


@dataclass(frozen=True, slots=True)
class Return:
    """The state after the transmitter was switched on again."""

    switch_us: int
    good_after_s: float | None
    """Time from the switch's move to the report that RC is good; None if it did not move."""


@dataclass(frozen=True, slots=True)
class TransmitterLoss:
    """One loss of the transmitter."""

    pressed: bool
    """True if the delays count from Enter."""
    before_us: int
    """Pulse width of the switch's channel before the loss; `lost_us`: during it."""
    lost_us: int
    signs: tuple[Sign, ...]
    jumped: tuple[int, ...]
    """Other channels that jumped and stayed there."""
    back: Return | None = None

    @property
    def seen(self) -> bool:
        """True if there was any sign of loss, or a jump."""
        return any(sign.kind != "mode" for sign in self.signs)

    @property
    def shown_after_s(self) -> float | None:
        """Time until the service detects the loss; None if it never does."""
        return min((sign.after_s for sign in self.signs if sign.shows_loss), default=None)

    @property
    def told_after_jump_s(self) -> float | None:
        """Time from the first jump of a channel until the loss is detected; None if either is missing."""
        jump = next((sign.after_s for sign in self.signs if sign.kind == "channels"), None)
        shown = self.shown_after_s
        return None if jump is None or shown is None else max(0.0, shown - jump)

    @property
    def held(self) -> bool:
        return abs(self.lost_us - self.before_us) <= SAME_US


def position_of(pulse_us: int, positions: int) -> int:
    """The position (from 0) of a switch with this number of positions."""
    return sum(pulse_us >= boundary for boundary in BOUNDARIES_US[positions])


def failsafe_of(losses: tuple[TransmitterLoss, ...]) -> ReceiverFailsafe:
    """The value for `switch.receiver_failsafe`: a pulse width, "hold" or "unknown".

    If all losses read the same pulse width, the result is this width, whether it is a held or a preset value.
    """
    seen = [loss for loss in losses if loss.seen]
    if not seen:
        return "unknown"
    read_us = [loss.lost_us for loss in seen]
    if max(read_us) - min(read_us) <= SAME_US:
        return read_us[-1] if MIN_US <= read_us[-1] <= MAX_US else "unknown"
    return "hold" if all(loss.held for loss in seen) else "unknown"


@dataclass(frozen=True, slots=True)
class RadioLearned:
    """The behaviour of receiver and autopilot when the transmitter is lost."""

    autopilot: str = "unknown"
    problem: RadioProblem = ""
    detail: str = ""
    target: int = 0
    """The last requested switch position, counted from 0."""
    losses: tuple[TransmitterLoss, ...] = ()
    parameters: dict[str, float] = field(default_factory=dict)
    hidden_by: str = ""
    """The parameter that lets the autopilot hide a loss."""
    shows_within_s: float = 0.0
    """On PX4: after a move that may be the receiver's preset, a bend waits this long for the RC status."""


@dataclass(slots=True)
class _PresentLoss:
    """The loss that is in progress."""

    pressed: bool
    off_at: float
    before_us: int
    signs: list[Sign] = field(default_factory=list)
    jumped: dict[int, int] = field(default_factory=dict)
    """Jumped channels, and their value before, µs."""
    jumped_switch: bool = False
    last_sign_at: float = 0.0


class RadioTest:
    """Call `take` for the autopilot's messages, `press` at each Enter, and `advance` often."""

    def __init__(self, config: Config) -> None:
        self._switch = config.switch
        self._silent_after_s = config.losses.rc_s
        self._parameters = RadioParameters(config.switch.channel)
        self._radio = RadioLink(config.switch, config.losses.rc_s)
        self.step: RadioStep = "ready"
        self.round = 0
        self.came_back_early = False
        """RC was good again before all signs were seen: that loss does not count."""
        self.target = 0
        """The position in which the switch should be, counted from 0."""
        self._began_at: float | None = None
        self._step_at = 0.0
        self._problem: RadioProblem = ""
        self._detail = ""
        self._losses: list[TransmitterLoss] = []
        self._loss_now: _PresentLoss | None = None
        self._autopilot = ""
        self._mode: int | None = None
        self._channels_at: float | None = None
        self._channels_us: tuple[int, ...] = ()
        self._chancount = 0
        self._rssi = NO_RSSI
        self._rssi_lost = False
        self._status: tuple[int, int, int] | None = None
        self._position: int | None = None
        self._position_at = 0.0
        self._rest_us: tuple[int, ...] = ()
        self._jump_at: float | None = None
        self._moved_at: float | None = None
        self._good_at: float | None = None

    # Input

    def take(self, t: float, message: MavlinkMessage) -> None:
        """Take in a message of our autopilot."""
        kind = message.get_type()
        self._radio.handle(t, message)
        if kind == "HEARTBEAT":
            self._heartbeat(t, message)
        elif kind == "RC_CHANNELS":
            self._rc_channels(t, message)
        elif kind == "SYS_STATUS":
            self._sys_status(t, message)
        elif kind == "STATUSTEXT" and message.text.startswith("Radio Failsafe"):
            if "Cleared" not in message.text:
                self._sign(t, "text", f"“{message.text}”")
        elif kind == "PARAM_VALUE":
            self._parameters.handle(self._radio.autopilot, message)
        self.advance(t)

    def press(self, t: float) -> None:
        """The user pressed Enter and switches the transmitter off."""
        if self.step == "off":
            jumped = self._jump_at is not None
            self._begin_loss(t if self._jump_at is None else self._jump_at, pressed=not jumped)

    def advance(self, t: float) -> None:
        """Advance the test to time `t`."""
        if self._began_at is None:
            self._began_at = self._step_at = t
        if self._silent(t):
            self._sign(t, "no RC_CHANNELS", f"no RC_CHANNELS for {self._silent_after_s:g} s", once=True)
        waited_s = t - self._step_at
        match self.step:
            case "ready":
                self._advance_ready(t, waited_s)
            case "off":
                self._advance_off(t)
            case "lost":
                self._advance_lost(t, waited_s)
            case "on":
                self._advance_on(t, waited_s)

    # Results

    @property
    def learned(self) -> RadioLearned:
        return RadioLearned(
            self._autopilot or "unknown",
            self._problem,
            self._detail,
            self.target,
            tuple(self._losses),
            dict(self._parameters.values),
            self._hides_loss,
            self._radio.autopilot.rc_loss_shows_within_s(self._parameters.values),
        )

    @property
    def _hides_loss(self) -> str:
        return self._radio.autopilot.hides_rc_loss(self._parameters.values)

    @property
    def signs(self) -> tuple[Sign, ...]:
        """The signs of the present loss, in order."""
        return tuple(self._loss_now.signs) if self._loss_now else ()

    @property
    def position(self) -> int | None:
        """The switch's present position, counted from 0."""
        return self._position

    @property
    def switch_us(self) -> int:
        return self._channels_us[self._switch.channel - 1] if self._channels_us else 0

    def trouble(self, t: float) -> str:
        """Why RC is not good now; empty if it is."""
        if not self._autopilot:
            return "no autopilot yet"
        if (problem := self._radio.problem(t)) is not None:
            return problem
        if self._rssi_lost:
            return "the receiver hears no transmitter"
        return "" if self._status else "no SYS_STATUS yet"

    # The steps

    def _advance_ready(self, t: float, waited_s: float) -> None:
        trouble = self.trouble(t)
        if self._radio.by_station:
            if waited_s >= STATUS_WITHIN_S:
                self._end("ground station")
            return
        if trouble:
            if waited_s >= READY_WITHIN_S:
                no_rc = self._channels_at is None or self._chancount == 0
                early: RadioProblem = "no RC" if no_rc else "RC not good"
                self._end("no autopilot" if not self._autopilot else early, trouble)
            return
        rests = self._position == self.target and t - self._position_at >= REST_S
        if rests and waited_s >= REST_S:
            if self._hides_loss:
                self._end()
                return
            self._rest_us, self._jump_at = self._channels_us, None
            self._go(t, "off")
        elif waited_s >= READY_WITHIN_S and self._position != self.target:
            self._end("position", f"{self.switch_us} µs")

    def _advance_off(self, t: float) -> None:
        """Wait for Enter. A loss without Enter counts as well."""
        if self.trouble(t):
            self._begin_loss(t if self._jump_at is None else self._jump_at, pressed=False)
        elif self._jump_at is not None and t - self._jump_at > EARLY_S:
            self._go(t, "ready")

    def _begin_loss(self, off_at: float, *, pressed: bool) -> None:
        loss = self._loss_now = _PresentLoss(pressed, off_at, self._rest_us[self._switch.channel - 1])
        self._go(off_at, "lost")
        self.came_back_early = False
        if self._jump_at is not None:
            number = self._switch.channel
            loss.jumped[number] = loss.before_us
            loss.jumped_switch = True
            self._note(loss, off_at, "channels", f"channel {number}: {loss.before_us} → {self.switch_us} µs")

    def _advance_lost(self, t: float, waited_s: float) -> None:
        loss = self._loss_now
        assert loss is not None
        detected = any(sign.shows_loss for sign in loss.signs)
        if detected and (not self.trouble(t) or (loss.jumped_switch and self._reads(loss.before_us))):
            # RC returned too early: the channel's value during the loss is not certain.
            self.came_back_early, self._loss_now = True, None
            self._go(t, "ready")
        elif detected and t - loss.last_sign_at >= QUIET_S:
            self._losses.append(self._loss(loss))
            self._moved_at = self._good_at = None
            self.target = self._next_target()
            self._go(t, "on")
        elif not detected and waited_s >= SIGN_WITHIN_S:
            self._losses.append(self._loss(loss))
            self._end()

    def _next_target(self) -> int:
        """The next position of the switch: if possible, not its position before or during the first loss.

        After the last loss it is the first position.
        """
        first, count = self._losses[0], len(self._switch.positions)
        taken = {position_of(us, count) for us in (first.before_us, first.lost_us)}
        free = [position for position in range(count) if position not in taken]
        return 0 if self.round or not free else free[-1]

    def _advance_on(self, t: float, waited_s: float) -> None:
        if self.trouble(t):
            self._good_at = None
            if waited_s >= BACK_WITHIN_S:
                self._end("not back", self.trouble(t))
            return
        self._good_at = t if self._good_at is None else self._good_at
        if t - max(self._good_at, self._position_at) < REST_S:
            return
        after_s = None if self._moved_at is None else self._good_at - self._moved_at
        self._losses[-1] = replace(self._losses[-1], back=Return(self.switch_us, after_s))
        self._loss_now = None
        self.round += 1
        if self.round == LOSSES:
            self._end()
        else:
            self._go(t, "ready")

    def _go(self, t: float, step: RadioStep) -> None:
        self.step, self._step_at = step, t

    def _end(self, problem: RadioProblem = "", detail: str = "") -> None:
        self.step, self._problem, self._detail = "done", problem, detail

    def _loss(self, loss: _PresentLoss) -> TransmitterLoss:
        others = tuple(
            number
            for number, before_us in sorted(loss.jumped.items())
            if number != self._switch.channel and abs(self._channels_us[number - 1] - before_us) > SAME_US
        )
        signs = tuple(sorted(loss.signs, key=lambda sign: sign.after_s))
        return TransmitterLoss(loss.pressed, loss.before_us, self.switch_us, signs, others)

    # The signs

    def _sign(self, t: float, kind: SignKind, said: str, *, once: bool = False) -> None:
        if self.step == "off" and kind in LOSS_SIGNS:
            self._begin_loss(t if self._jump_at is None else self._jump_at, pressed=False)
        loss = self._loss_now
        if self.step != "lost" or loss is None:
            return
        if not (once and any(sign.kind == kind for sign in loss.signs)):
            self._note(loss, t, kind, said)

    @staticmethod
    def _note(loss: _PresentLoss, t: float, kind: SignKind, said: str) -> None:
        loss.signs.append(Sign(kind, round(t - loss.off_at, 3), said))
        loss.last_sign_at = max(t, loss.last_sign_at)

    def _reads(self, pulse_us: int) -> bool:
        return abs(self.switch_us - pulse_us) <= SAME_US

    def _heartbeat(self, t: float, message: MavlinkMessage) -> None:
        self._radio.autopilot = of_heartbeat(message.autopilot)
        self._autopilot = self._radio.autopilot.kind
        if message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED and self.step != "done":
            self._end("armed")
        if self._mode is not None and message.custom_mode != self._mode:
            self._sign(t, "mode", "the flight mode changes")
        self._mode = message.custom_mode

    def _rc_channels(self, t: float, message: MavlinkMessage) -> None:
        before_us = self._channels_us
        self._channels_us = tuple(getattr(message, f"chan{number}_raw") for number in range(1, CHANNELS + 1))
        self._channels_at, self._chancount = t, message.chancount
        position = position_of(self.switch_us, len(self._switch.positions))
        if position != self._position:
            self._position, self._position_at = position, t
        if before_us:
            self._look_for_jump(t, before_us)
        if self._chancount == 0:
            self._sign(t, "no RC_CHANNELS", "the receiver has no channels", once=True)
        if self._throttle_low():
            self._sign(t, "throttle", "throttle below its range", once=True)
        if self._radio.autopilot.needs_rc_status:
            if message.rssi not in (NO_SIGNAL, NO_RSSI):
                self._rssi_lost = False
            elif self._rssi not in (NO_SIGNAL, NO_RSSI):
                self._rssi_lost = True
                self._sign(t, "rssi", f"rssi {self._rssi} → {message.rssi}")
        self._rssi = message.rssi

    def _look_for_jump(self, t: float, before_us: tuple[int, ...]) -> None:
        now_us, number = self._channels_us, self._switch.channel
        if self.step == "off":
            if self._reads(self._rest_us[number - 1]):
                self._jump_at = None
            elif self._jump_at is None:
                self._jump_at = t
        if self.step == "on" and self._moved_at is None and not self._reads(before_us[number - 1]):
            self._moved_at = t
        jumped = {
            channel: was_us
            for channel, (was_us, is_us) in enumerate(zip(before_us, now_us, strict=True), 1)
            if abs(is_us - was_us) >= JUMP_US and was_us
        }
        if self.step != "lost" or self._loss_now is None or not jumped:
            return
        for channel, was_us in jumped.items():
            self._loss_now.jumped.setdefault(channel, was_us)
        if number in jumped:
            self._loss_now.jumped_switch = True
            self._sign(t, "channels", f"channel {number}: {jumped[number]} → {self.switch_us} µs")
        elif len(jumped) > 1:
            self._sign(t, "channels", f"channels {', '.join(map(str, jumped))} jump")

    def _sys_status(self, t: float, message: MavlinkMessage) -> None:
        before = self._status
        self._status = (
            int(bool(message.onboard_control_sensors_present & RC_BIT)),
            int(bool(message.onboard_control_sensors_enabled & RC_BIT)),
            int(bool(message.onboard_control_sensors_health & RC_BIT)),
        )
        if before == (1, 1, 1) != self._status:
            was, now = (" ".join(map(str, bits)) for bits in (before, self._status))
            self._sign(t, "RC status", f"RC status (present, enabled, health) {was} → {now}")

    def _silent(self, t: float) -> bool:
        return self._channels_at is not None and t - self._channels_at > self._silent_after_s

    def _throttle_low(self) -> bool:
        number = self._switch.throttle_channel
        return bool(number) and 0 < self._channels_us[number - 1] < self._switch.throttle_failsafe_us
