"""Which ground stations are there, and which of them has yet to be shown our parameters.

QGroundControl reads an ArduPilot's parameters as a file and then asks no other component for its own; but it
takes them when they come unasked. So each station is shown them once, when it has had time to read the
autopilot's.
"""

from __future__ import annotations

SETTLED_S = 7.0
GONE_S = 60.0


class Stations:
    """Ground stations by system id. All times are seconds of one clock."""

    def __init__(self) -> None:
        self._heard_at: dict[int, float] = {}
        self._show_at: dict[int, float] = {}

    def heard(self, t: float, system_id: int) -> None:
        """A heartbeat of a ground station."""
        if t - self._heard_at.get(system_id, float("-inf")) > GONE_S:
            self._show_at[system_id] = t + SETTLED_S
        self._heard_at[system_id] = t

    def due(self, t: float) -> bool:
        """Whether a station waits for our parameters; once for each."""
        waiting = [system_id for system_id, show_at in self._show_at.items() if t >= show_at]
        for system_id in waiting:
            del self._show_at[system_id]
        return bool(waiting)
