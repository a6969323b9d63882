"""One text to the pilot for a dead link, instead of a text for each loss that the dead link causes.

When the link fails, RC, the altitude and the autopilot are lost one after another. They also return one after
another.
"""

from __future__ import annotations

from collections.abc import Container

from flying_vines.vehicle.vehicle import Vehicle

SILENT_S = 1.5
"""Longer than the heartbeat period: a link that carries only heartbeats is not dead."""
BACK_S = 1.0
"""If RC returns at most this much later than the link, one text reports both."""
_FOLLOW = ("rc", "altitude", "autopilot")
"""Safety's names for the losses that follow from a dead link."""
_END_TOGETHER = (*_FOLLOW, "late")
"""After a dead link, what was queued on the way comes late. The link is back only after that."""


class LinkLoss:
    """The texts to the pilot about losses that safety finds."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._reported = ""
        """The vine's response in the latest text about a dead link; empty once the link is back."""
        self._reported_at = 0.0
        self._back_since: float | None = None

    def entered(self, t: float, name: str, reason: str, response: str) -> str | None:
        """The text for a new loss; None if it was reported already. `response`: what the vine does."""
        state = self.dead(t, name)
        if not state:
            return f"{reason}, {response}"
        if self._reported == response:
            return None
        self._reported, self._reported_at, self._back_since = response, t, None
        return f"vehicle link {state}, {response}"

    def covers(self, name: str) -> bool:
        """True if the texts about the dead link stand for this loss, too: `back` reports its end."""
        return bool(self._reported) and name in _END_TOGETHER

    def back(self, t: float, lost: Container[str]) -> str | None:
        """The text when the link is back, once; `lost` are the losses that have not ended."""
        received_at = self._vehicle.state.received_at
        if (
            not self._reported
            or self._vehicle.link_closed
            or received_at is None
            or received_at <= self._reported_at
        ):
            return None
        if "autopilot" in lost or "late" in lost:
            return None  # frames arrive, but `armed` is unknown until the next HEARTBEAT, or all are late
        rc_lost = "rc" in lost
        self._back_since = t if self._back_since is None else self._back_since
        if rc_lost and t - self._back_since < BACK_S:
            return None
        self._reported, self._back_since = "", None
        rc_problem = self._vehicle.rc.problem(t) if rc_lost else None
        return "vehicle link is back" + (f", RC lost: {rc_problem}" if rc_problem else "")

    def dead(self, t: float, name: str) -> str:
        """The state of the link if it is dead and this may have caused the loss `name`; otherwise empty."""
        if name not in _FOLLOW:
            return ""
        if self._vehicle.link_closed:
            return "closed"
        # RC is lost after `rc_s` without RC_CHANNELS. No frame for half of this time: the link is silent.
        silent_s = self._vehicle.config.losses.rc_s / 2 if name == "rc" else SILENT_S
        return "silent" if self._vehicle.state.recent_silence_s(t) > silent_s else ""
