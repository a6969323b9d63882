"""The autopilot's RC input: sticks, the receiver and its losses, and overrides by a ground station."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from random import Random
from typing import Literal

from flying_vines.simulation.autopilot.scheduler import ScheduledCallback, Scheduler

RcLoss = Literal["frozen", "jump", "silent"]
RcSource = Literal["pulses", "sbus", "crsf", "overrides", "joystick"]
"""How the pilot's sticks reach the autopilot.

pulses: a receiver on ArduPilot. sbus, crsf: a receiver on PX4's driver of that name. overrides: PX4 gets
RC_CHANNELS_OVERRIDE from a ground station. joystick: PX4 gets MANUAL_CONTROL and has no RC_CHANNELS.
"""

LOSSES: dict[RcSource, tuple[RcLoss, ...]] = {
    "pulses": ("frozen", "jump"),
    "sbus": ("frozen", "jump"),
    "crsf": ("frozen",),
    "overrides": ("silent",),
    "joystick": ("silent",),
}
"""Possible kinds of loss; the first one is the default."""
REPORTS_APART_S = 2.0
"""Minimum time between two health reports of PX4."""

_CHANNELS = 16
_THROTTLE = 3
_AT_REST_US = (1500, 1500, 1000, 1500, 1800, 1000, 1000, 1000, 1000) + (1500,) * 7
_JUMP_US = (1500, 1500, 950) + (1500,) * 13
_UNCHANGED_US, _RELEASED_US = (0, 65535), 65534
_JUMP_FAILSAFE_S = 0.05
_THROTTLE_FAILSAFE_US = 975
_IGNORE_OVERRIDES, _IGNORE_RECEIVER_FAILSAFE = 2, 4
"""Bits of RC_OPTIONS."""
_PX4_OVERRIDE_S = 0.5
_RSSI_GONE_S, _RSSI_BACK_S = 0.5, 0.03


class RcInput:
    """Sticks, a receiver and overrides become channel values.

    `values_us` are the autopilot's channels: the sticks; during a loss the last values ("frozen") or the
    receiver's failsafe values ("jump"); empty before the first pulse and in a "silent" loss. Channels that a
    ground station overrides (RC_CHANNELS_OVERRIDE) have the values of the override.
    `failsafe_changed(on)` is called when the autopilot's failsafe begins and ends.
    """

    reported_good = False
    """PX4's last health report said that RC is good."""

    def __init__(
        self,
        source: RcSource,
        present: bool,
        scheduler: Scheduler,
        failsafe_changed: Callable[[bool], None],
    ) -> None:
        self.source: RcSource = source
        self.sticks_us = list(_AT_REST_US)
        self.lost: RcLoss | None = None
        self.failsafe = False
        self.overridden = False
        self.updates = 0
        """Number of received overrides. While overridden, PX4 sends RC_CHANNELS at most once per override."""
        self.has_rssi = True
        """CRSF reports the link quality, but not during a loss."""
        self._scheduler = scheduler
        self._failsafe_changed = failsafe_changed
        self._received_us: tuple[int, ...] = tuple(self.sticks_us)
        self._overrides_us: dict[int, int] = {}
        self._override_ends: ScheduledCallback | None = None
        if not present or source == "joystick":
            self.lost = LOSSES[source][0]
            self._received_us = ()

    @property
    def values_us(self) -> tuple[int, ...]:
        """The channels, from channel 1; empty if there are none."""
        silent = self.lost == "silent" or self.source == "joystick"
        received_us = () if silent else self._received_us
        if not self._overrides_us:
            return received_us
        values_us = list(received_us or _AT_REST_US)
        for index, us in self._overrides_us.items():
            values_us[index] = us
        return tuple(values_us)

    @property
    def throttle_us(self) -> int:
        """The received throttle; 0 if nothing was received."""
        return self._received_us[_THROTTLE - 1] if self._received_us else 0

    @property
    def reports_loss(self) -> bool:
        """True if the autopilot reports an RC loss."""
        raise NotImplementedError

    def move(self, channel: int, us: int) -> None:
        """Move a stick or switch. During a loss the autopilot gets the new value when RC returns."""
        if not 1 <= channel <= _CHANNELS:
            raise ValueError(f"RC channel must be 1 to {_CHANNELS}, not {channel}")
        if not 0 <= us <= 65535:
            raise ValueError(f"RC value must be 0 to 65535 us, not {us}")
        self.sticks_us[channel - 1] = us
        if self.lost is None:
            self._received_us = tuple(self.sticks_us)

    def lose(self, how: RcLoss | None, preset: Mapping[int, int] | None) -> None:
        """Lose the link. Raises `ValueError` if this receiver has no such loss.

        In a "jump" the channels of `preset` get its values, and the others stay. Without `preset` all
        channels get usual failsafe values.
        """
        possible = LOSSES[self.source]
        if how is not None and how not in possible:
            raise ValueError(f"with {self.source!r} lose_rc accepts {' or '.join(map(repr, possible))}")
        self.lost = how or possible[0]
        if self.lost == "jump" and preset is None:
            self._received_us = _JUMP_US
        elif self.lost == "jump" and preset is not None:
            values_us = enumerate(self._received_us, start=1)
            self._received_us = tuple(preset.get(channel, us) for channel, us in values_us)

    def restore(self) -> None:
        """The link returns."""
        self.lost = None
        self._received_us = tuple(self.sticks_us)

    def override(self, channels_us: Sequence[int]) -> None:
        """RC_CHANNELS_OVERRIDE, from channel 1."""
        raise NotImplementedError

    def report(self) -> None:
        """PX4 reports its health now, or as soon as the minimum time since the last report is over."""

    def reboot(self) -> None:
        """The autopilot reboots and forgets received values."""
        self._release()
        if self.lost != "jump":
            self._received_us = () if self.lost else tuple(self.sticks_us)
        self.failsafe = False
        self._override_ends = None

    def _override(self, channels_us: Sequence[int], holds_s: float, end: Callable[[], None]) -> None:
        for index, us in enumerate(channels_us[:_CHANNELS]):
            if us == _RELEASED_US:
                self._overrides_us.pop(index, None)
            elif us not in _UNCHANGED_US:
                self._overrides_us[index] = us
        self.overridden = bool(self._overrides_us)
        self.updates += 1
        if self._override_ends is not None:
            self._override_ends.cancel()
        self._override_ends = self._scheduler.after(holds_s, end) if holds_s >= 0.0 else None

    def _release(self) -> None:
        """End all overrides."""
        self._overrides_us.clear()
        self.overridden = False

    def _set_failsafe(self, on: bool) -> None:
        if self.failsafe != on:
            self.failsafe = on
            self._failsafe_changed(on)


class ArduPilotRc(RcInput):
    """RC input of ArduPilot. The failsafe reports RC loss if FS_THR_ENABLE and RC_OPTIONS allow it.

    Without pulses the failsafe starts after RC_FS_TIMEOUT. If a receiver in failsafe sends preset values,
    only a low throttle shows the loss.
    """

    def __init__(
        self,
        source: RcSource,
        present: bool,
        scheduler: Scheduler,
        failsafe_changed: Callable[[bool], None],
        parameter: Callable[[str], float],
    ) -> None:
        super().__init__(source, present, scheduler, failsafe_changed)
        self._parameter = parameter
        self._failsafe_due: ScheduledCallback | None = None

    @property
    def reports_loss(self) -> bool:
        return self.failsafe

    def lose(self, how: RcLoss | None, preset: Mapping[int, int] | None) -> None:
        super().lose(how, preset)
        if not self.failsafe:
            self._cancel_failsafe()
            delay_s = _JUMP_FAILSAFE_S if self.lost == "jump" else self._parameter("RC_FS_TIMEOUT")
            self._failsafe_due = self._scheduler.after(delay_s, self._fail)

    def restore(self) -> None:
        super().restore()
        self._recover()

    def override(self, channels_us: Sequence[int]) -> None:
        """Overrides hold for RC_OVERRIDE_TIME; below 0: without limit."""
        if self._option(_IGNORE_OVERRIDES):
            return
        self._override(channels_us, self._parameter("RC_OVERRIDE_TIME"), self._end_override)
        if self.overridden:
            self._recover()

    def reboot(self) -> None:
        super().reboot()
        self._failsafe_due = None

    @property
    def _detects_loss(self) -> bool:
        """True if ArduPilot's parameters let it detect this loss."""
        if not self._parameter("FS_THR_ENABLE"):
            return False
        if self.lost == "jump":
            return self.throttle_us < _THROTTLE_FAILSAFE_US
        return not self._option(_IGNORE_RECEIVER_FAILSAFE)

    def _option(self, bit: int) -> bool:
        return bool(int(self._parameter("RC_OPTIONS")) & bit)

    def _end_override(self) -> None:
        self._release()
        if self.lost:
            self._fail()

    def _fail(self) -> None:
        if self._detects_loss:
            self._set_failsafe(True)

    def _recover(self) -> None:
        self._cancel_failsafe()
        self._set_failsafe(False)

    def _cancel_failsafe(self) -> None:
        if self._failsafe_due is not None:
            self._failsafe_due.cancel()


class Px4Rc(RcInput):
    """RC input of PX4. PX4 reports RC loss in its health report: late, and at most every 2 s.

    `reported_good` is always False without a receiver on PX4's own driver. With such a receiver, overrides
    are ignored.
    """

    _DETECTS_S = (0.85, 1.1)
    _REPORTS_S = (0.0, 0.3)
    _RETURNS_S = (0.08, 0.22)
    _ACTS_UNTIL_S = 3.8

    def __init__(
        self,
        source: RcSource,
        present: bool,
        scheduler: Scheduler,
        failsafe_changed: Callable[[bool], None],
        random: Random,
    ) -> None:
        super().__init__(source, present, scheduler, failsafe_changed)
        self._random = random
        self._has_driver = source in ("sbus", "crsf")
        self._good = self.reported_good = self._has_driver and self.lost is None
        self._reported_s = -math.inf
        self._due: list[ScheduledCallback] = []
        self._report_due: ScheduledCallback | None = None

    @property
    def reports_loss(self) -> bool:
        return self._has_driver and not self.reported_good

    def lose(self, how: RcLoss | None, preset: Mapping[int, int] | None) -> None:
        super().lose(how, preset)
        if self._has_driver:
            detects_s = self._random.uniform(*self._DETECTS_S)
            self._then((_RSSI_GONE_S, partial(self._set_rssi, False)), (detects_s, self._detect))

    def restore(self) -> None:
        super().restore()
        if self._has_driver:
            returns_s = self._random.uniform(*self._RETURNS_S)
            self._then(
                (_RSSI_BACK_S, partial(self._set_rssi, True)),
                (returns_s, self._recover),
                (self._ACTS_UNTIL_S, partial(self._set_failsafe, False)),
            )

    def override(self, channels_us: Sequence[int]) -> None:
        if not self._has_driver:
            self._override(channels_us, _PX4_OVERRIDE_S, self._release)

    def reboot(self) -> None:
        super().reboot()
        self._due, self._report_due = [], None
        self._good = self.reported_good = self._has_driver and self.lost is None
        if self._has_driver:
            self.has_rssi = self._good

    def report(self) -> None:
        if self._report_due is not None:
            return
        wait_s = self._reported_s + REPORTS_APART_S - self._scheduler.now_s
        if wait_s > 0.0:
            self._report_due = self._scheduler.after(wait_s, self._report)
        else:
            self._report()

    def _report(self) -> None:
        self._report_due = None
        self._reported_s = self._scheduler.now_s
        self.reported_good = self._good

    def _then(self, *steps: tuple[float, Callable[[], None]]) -> None:
        """Schedule these steps, and cancel pending ones of an earlier loss or return."""
        for entry in self._due:
            entry.cancel()
        self._due = [self._scheduler.after(delay_s, step) for delay_s, step in steps]

    def _set_rssi(self, on: bool) -> None:
        self.has_rssi = on

    def _detect(self) -> None:
        self._good = False
        self._due.append(self._scheduler.after(self._random.uniform(*self._REPORTS_S), self.report))
        self._set_failsafe(True)

    def _recover(self) -> None:
        if not self._good:
            self._good = True
            self.report()
