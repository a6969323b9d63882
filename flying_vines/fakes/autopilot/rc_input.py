"""RC as the autopilot lives with it: the receiver, its losses, and what a ground station sends instead."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from flying_vines.fakes.autopilot.agenda import Agenda, Entry
from flying_vines.fakes.autopilot.receiver import RcLoss, Receiver
from flying_vines.vehicle.mission.storage import Kind

_FROZEN_FAILSAFE_S = 1.0
_JUMP_FAILSAFE_S = 0.05
_PX4_OVERRIDE_S = 0.5


class RcInput:
    """A receiver and, on ArduPilot, the failsafe that its loss brings.

    `failsafe_changed(on)` is called when the failsafe begins and ends.
    """

    def __init__(
        self, kind: Kind, present: bool, agenda: Agenda, failsafe_changed: Callable[[bool], None]
    ) -> None:
        self.receiver = Receiver(kind, present)
        self.failsafe = False
        self._kind = kind
        self._agenda = agenda
        self._failsafe_changed = failsafe_changed
        self._failsafe_due: Entry | None = None
        self._override_ends: Entry | None = None

    def lose(self, how: RcLoss | None) -> None:
        how = how or ("frozen" if self._kind == "ardupilot" else "silent")
        if how == "silent" and self._kind == "ardupilot":
            raise ValueError("ArduPilot never stops RC_CHANNELS: lose_rc takes 'frozen' or 'jump' there")
        self.receiver.lose(how)
        if self._kind == "ardupilot" and not self.failsafe:
            self._cancel_failsafe()
            delay_s = _JUMP_FAILSAFE_S if how == "jump" else _FROZEN_FAILSAFE_S
            self._failsafe_due = self._agenda.after(delay_s, self._fail)

    def restore(self) -> None:
        self.receiver.restore()
        self._recover()

    def override(self, channels_us: Sequence[int], holds_s: float) -> None:
        """Channels from a ground station, which ArduPilot keeps for so long; below 0 is for ever."""
        self.receiver.override(channels_us)
        if self._override_ends is not None:
            self._override_ends.cancel()
            self._override_ends = None
        if self._kind == "px4":
            holds_s = _PX4_OVERRIDE_S
        if holds_s >= 0.0:
            self._override_ends = self._agenda.after(holds_s, self._end_override)
        if self.receiver.overridden:
            self._recover()

    def reboot(self) -> None:
        """The agenda has been cleared, so nothing is due any more."""
        self.receiver.reboot()
        self._failsafe_due = self._override_ends = None
        self.failsafe = False

    def _end_override(self) -> None:
        self.receiver.release()
        if self._kind == "ardupilot" and self.receiver.lost:
            self._fail()

    def _fail(self) -> None:
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
