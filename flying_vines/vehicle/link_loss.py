"""A dead link is reported to the pilot once, although several losses follow from it.

When the link fails, RC, the altitude and the autopilot are lost one after another, and they return so.
"""

from __future__ import annotations

from collections.abc import Container

from flying_vines.vehicle.vehicle import Vehicle

SILENT_S = 1.5
"""Longer than the time between two heartbeats: a link that carries only heartbeats is not dead."""
BACK_S = 1.0
"""RC may return this much later than the link, and both are reported together."""
_FOLLOW = ("rc", "altitude", "autopilot")
"""Safety's names for the losses that follow from a dead link."""


class LinkLoss:
    """The texts to the pilot about losses that safety finds."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._told = ""
        self._told_at = 0.0
        self._back_since: float | None = None

    def entered(self, t: float, name: str, reason: str, done: str) -> str | None:
        """The text for a new loss; None if it was reported already. `done` is what the vine does."""
        state = self._state(t, name) if name in _FOLLOW else ""
        if not state:
            return f"{reason}, {done}"
        if self._told == done:
            return None
        self._told, self._told_at, self._back_since = done, t, None
        return f"vehicle link {state}, {done}"

    def left(self, name: str) -> bool:
        """Whether to report the end of a loss: not if the end of the link's loss will be reported."""
        return not (self._told and name in _FOLLOW)

    def back(self, t: float, lost: Container[str]) -> str | None:
        """The text when the link is back, once; `lost` are the losses that safety still has."""
        heard_at = self._vehicle.state.heard_at
        if not self._told or self._vehicle.link_closed or heard_at is None or heard_at <= self._told_at:
            return None
        if "autopilot" in lost:
            return None  # frames arrive, but only the next HEARTBEAT says whether it is armed
        rc_lost = "rc" in lost
        self._back_since = t if self._back_since is None else self._back_since
        if rc_lost and t - self._back_since < BACK_S:
            return None
        self._told, self._back_since = "", None
        rc_problem = self._vehicle.rc.problem(t) if rc_lost else None
        rest = f"RC lost: {rc_problem}" if rc_problem else "waiting for a fresh move"
        return f"vehicle link is back, {rest}"

    def _state(self, t: float, name: str) -> str:
        if self._vehicle.link_closed:
            return "closed"
        # Half of the time after which RC is lost: no other message has come since the last RC_CHANNELS.
        silent_s = self._vehicle.config.losses.rc_s / 2 if name == "rc" else SILENT_S
        silence_s = self._vehicle.state.silence_s(t)
        return "silent" if silence_s is not None and silence_s > silent_s else ""
