"""The autopilot's RC input: the receiver, its losses, and overrides by a ground station."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from random import Random

from flying_vines.simulation.autopilot.receiver import LOSSES, RcLoss, RcSource, Receiver
from flying_vines.simulation.autopilot.scheduler import ScheduledCallback, Scheduler
from flying_vines.vehicle.mission.storage import AutopilotKind

_JUMP_FAILSAFE_S = 0.05
_THROTTLE_FAILSAFE_US = 975
_IGNORE_OVERRIDES, _IGNORE_RECEIVER_FAILSAFE = 2, 4
"""Bits of RC_OPTIONS."""
_PX4_OVERRIDE_S = 0.5
_RSSI_GONE_S, _RSSI_BACK_S = 0.5, 0.03
REPORTS_APART_S = 2.0
"""Minimum time between two health reports of PX4."""


def _loss(receiver: Receiver, how: RcLoss | None) -> RcLoss:
    possible = LOSSES[receiver.source]
    if how is not None and how not in possible:
        raise ValueError(f"with {receiver.source!r} lose_rc accepts {' or '.join(map(repr, possible))}")
    return how or possible[0]


class ArduPilotRc:
    """RC input of ArduPilot. The failsafe reports RC loss if FS_THR_ENABLE and RC_OPTIONS allow it.

    Without pulses the failsafe starts after RC_FS_TIMEOUT. If a receiver in failsafe sends preset values,
    only a low throttle shows the loss. `failsafe_changed(on)` is called when the failsafe begins and ends.
    """

    def __init__(
        self,
        present: bool,
        scheduler: Scheduler,
        parameter: Callable[[str], float],
        failsafe_changed: Callable[[bool], None],
    ) -> None:
        self.receiver = Receiver("ardupilot", present)
        self.failsafe = False
        self._scheduler = scheduler
        self._parameter = parameter
        self._failsafe_changed = failsafe_changed
        self._failsafe_due: ScheduledCallback | None = None
        self._override_ends: ScheduledCallback | None = None

    def lose(self, how: RcLoss | None, preset: Mapping[int, int] | None) -> None:
        how = _loss(self.receiver, how)
        self.receiver.lose(how, preset)
        if self.failsafe:
            return
        self._cancel_failsafe()
        delay_s = _JUMP_FAILSAFE_S if how == "jump" else self._parameter("RC_FS_TIMEOUT")
        self._failsafe_due = self._scheduler.after(delay_s, self._fail)

    def restore(self) -> None:
        self.receiver.restore()
        self._recover()

    def override(self, channels_us: Sequence[int]) -> None:
        """Overrides hold for RC_OVERRIDE_TIME; below 0: without limit."""
        if self._option(_IGNORE_OVERRIDES):
            return
        self.receiver.override(channels_us)
        if self._override_ends is not None:
            self._override_ends.cancel()
            self._override_ends = None
        holds_s = self._parameter("RC_OVERRIDE_TIME")
        if holds_s >= 0.0:
            self._override_ends = self._scheduler.after(holds_s, self._end_override)
        if self.receiver.overridden:
            self._recover()

    def reboot(self) -> None:
        self.receiver.reboot()
        self._failsafe_due = self._override_ends = None
        self.failsafe = False

    @property
    def _detects_loss(self) -> bool:
        """True if ArduPilot's parameters let it detect this loss."""
        if not self._parameter("FS_THR_ENABLE"):
            return False
        if self.receiver.lost == "jump":
            return self.receiver.throttle_us < _THROTTLE_FAILSAFE_US
        return not self._option(_IGNORE_RECEIVER_FAILSAFE)

    def _option(self, bit: int) -> bool:
        return bool(int(self._parameter("RC_OPTIONS")) & bit)

    def _end_override(self) -> None:
        self.receiver.release()
        if self.receiver.lost:
            self._fail()

    def _fail(self) -> None:
        if self._detects_loss:
            self.failsafe = True
            self._failsafe_changed(True)

    def _recover(self) -> None:
        self._cancel_failsafe()
        if self.failsafe:
            self.failsafe = False
            self._failsafe_changed(False)

    def _cancel_failsafe(self) -> None:
        if self._failsafe_due is not None:
            self._failsafe_due.cancel()
            self._failsafe_due = None


class Px4Rc:
    """RC input of PX4. PX4 reports RC loss in its health report: late, and at most every 2 s.

    `reported_good`: True if the last report said that RC is good. It is always False without a receiver on
    PX4's own driver.
    `failsafe_changed(on)` is called when the failsafe begins and ends.
    """

    _DETECTS_S = (0.85, 1.1)
    _REPORTS_S = (0.0, 0.3)
    _RETURNS_S = (0.08, 0.22)
    _ACTS_UNTIL_S = 3.8

    def __init__(
        self,
        present: bool,
        source: RcSource | None,
        scheduler: Scheduler,
        random: Random,
        failsafe_changed: Callable[[bool], None],
    ) -> None:
        self.receiver = Receiver("px4", present, source)
        self.failsafe = False
        self._scheduler = scheduler
        self._random = random
        self._failsafe_changed = failsafe_changed
        self.has_driver = self.receiver.source in ("sbus", "crsf")
        self._good = self.reported_good = self.has_driver and present
        self._reported_s = -math.inf
        self._due: list[ScheduledCallback] = []
        self._report_due: ScheduledCallback | None = None
        self._override_ends: ScheduledCallback | None = None

    def lose(self, how: RcLoss | None, preset: Mapping[int, int] | None) -> None:
        self.receiver.lose(_loss(self.receiver, how), preset)
        if self.has_driver:
            detects_s = self._random.uniform(*self._DETECTS_S)
            self._then((_RSSI_GONE_S, self._lose_rssi), (detects_s, self._detect))

    def restore(self) -> None:
        self.receiver.restore()
        if self.has_driver:
            returns_s = self._random.uniform(*self._RETURNS_S)
            self._then(
                (_RSSI_BACK_S, self._find_rssi),
                (returns_s, self._recover),
                (self._ACTS_UNTIL_S, lambda: self._act(False)),
            )

    def override(self, channels_us: Sequence[int]) -> None:
        if self.has_driver:
            return
        self.receiver.override(channels_us)
        if self._override_ends is not None:
            self._override_ends.cancel()
        self._override_ends = self._scheduler.after(_PX4_OVERRIDE_S, self.receiver.release)

    def reboot(self) -> None:
        self.receiver.reboot()
        self._due, self._report_due, self._override_ends = [], None, None
        self.failsafe = False
        self._good = self.reported_good = self.has_driver and self.receiver.lost is None
        if self.has_driver:
            self.receiver.has_rssi = self._good

    def report(self) -> None:
        """Report the health now, or as soon as the minimum time since the last report is over."""
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

    def _lose_rssi(self) -> None:
        self.receiver.has_rssi = False

    def _find_rssi(self) -> None:
        self.receiver.has_rssi = True

    def _detect(self) -> None:
        self._good = False
        self._due.append(self._scheduler.after(self._random.uniform(*self._REPORTS_S), self.report))
        self._act(True)

    def _recover(self) -> None:
        if not self._good:
            self._good = True
            self.report()

    def _act(self, on: bool) -> None:
        if self.failsafe != on:
            self.failsafe = on
            self._failsafe_changed(on)


RcInput = ArduPilotRc | Px4Rc


def rc_input(
    kind: AutopilotKind,
    present: bool,
    source: RcSource | None,
    scheduler: Scheduler,
    random: Random,
    parameter: Callable[[str], float],
    failsafe_changed: Callable[[bool], None],
) -> RcInput:
    """The RC input of this kind of autopilot."""
    if kind == "ardupilot":
        if source not in (None, "pulses"):
            raise ValueError(f"the simulated ardupilot has no receiver {source!r}")
        return ArduPilotRc(present, scheduler, parameter, failsafe_changed)
    return Px4Rc(present, source, scheduler, random, failsafe_changed)
