"""A link that died is told to the pilot as one thing, however many losses follow from it.

When a link dies RC, the altitude and the autopilot are lost one after another, and come back so.
"""

from __future__ import annotations

from collections.abc import Container

from flying_vines.vehicle.vehicle import Vehicle

SILENT_S = 1.5
"""Longer than between two heartbeats: where nothing else comes, the link is not dead."""
BACK_S = 1.0
"""RC may come back this much later than the link, and is told with it."""
_FOLLOW = ("rc", "altitude", "autopilot")
"""Safety's names for what is lost with the link."""


class LinkLoss:
    """Given what safety finds, says what the pilot is told of it."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._told = ""
        self._told_at = 0.0
        self._back_since: float | None = None

    def entered(self, t: float, name: str, reason: str, done: str) -> str | None:
        """What is told of a loss that began; None where it was told already. `done` is what the vine does."""
        state = self._state(t, name) if name in _FOLLOW else ""
        if not state:
            return f"{reason}, {done}"
        if self._told == done:
            return None
        self._told, self._told_at, self._back_since = done, t, None
        return f"vehicle link {state}, {done}"

    def left(self, name: str) -> bool:
        """Whether the end of a loss is to be told: not where the link's own is."""
        return not (self._told and name in _FOLLOW)

    def back(self, t: float, lost: Container[str]) -> str | None:
        """What is told when the link is back, once; `lost` is what safety still has as lost."""
        heard_at = self._vehicle.state.heard_at
        if not self._told or self._vehicle.link_closed or heard_at is None or heard_at <= self._told_at:
            return None
        if "autopilot" in lost:
            return None  # it speaks, but only its next HEARTBEAT says whether it is armed
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
        # Half of what makes RC lost: then no other message has come either since the last RC_CHANNELS.
        silent_s = self._vehicle.config.losses.rc_s / 2 if name == "rc" else SILENT_S
        silence_s = self._vehicle.state.silence_s(t)
        return "silent" if silence_s is not None and silence_s > silent_s else ""
