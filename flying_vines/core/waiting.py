"""Who asks for a bend while nothing moves, because only a fresh request may move the vine.

The switch asks as long as it is in a bending position. If the vine was vented without a request (a failsafe,
the end of bench mode), a command, a mission item or the page that bent it asks until the next request.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

NO_MOVE_COUNTED = "no move of the switch has counted"
"""The switch is in a bending position, and no motion or refusal came from its way there."""
_BY = {"switch": "the switch", "page": "the page", "broker": "MQTT", "command": "a command"}
_FRESH = {"mission_item": "the next mission item"}


@dataclass(frozen=True, slots=True)
class Waiting:
    """Somebody asks for a bend and nothing moves: what vented the vine or refused the bend, and the request
    that would move it."""

    stopped_by: str
    awaited: str


class FreshRequest:
    """Follows motions, vents and refusals; `waiting` is the state."""

    def __init__(self) -> None:
        self._asker = ""
        """The kind of trigger of the latest motion; empty after its end or a request to vent."""
        self._stopped_by = ""
        self._done_at: int | None = None
        """The switch position whose profile ran to its end: the switch got what it asked for."""

    def began(self, kind: str) -> None:
        """A motion began by a trigger of this kind."""
        self._asker, self._stopped_by, self._done_at = kind, "", None

    def ended(self, name: str, position: int | None) -> None:
        """The motion `name` ran to its end, with the switch in `position`."""
        if self._asker == "switch":
            self._done_at = position
        self._asker, self._stopped_by = "", f"{name} is over"

    def stopped(self, why: str) -> None:
        """A running motion was vented without a request. Whoever began it still asks for it."""
        self._stopped_by = why

    def withdrawn(self, why: str, moved: bool) -> None:
        """A request vented the vine. `moved`: it ended a motion. From now on only the switch can ask."""
        self._asker = ""
        if moved:
            self._stopped_by = why

    def refused(self, kind: str, why: str) -> None:
        """A request was refused while nothing moved. The switch asks further, because its position stays."""
        if kind == "switch":
            self._asker, self._stopped_by, self._done_at = kind, f"refused: {why}", None

    def waiting(self, position: int | None, fresh_move: str) -> Waiting | None:
        """The state while nothing moves; None if nobody asks.

        `position`: of the switch; None during a loss of RC. `fresh_move`: of the switch, if it is (or was
        before the loss) in a bending position; else empty.
        """
        if position is not None:
            self._see(position, bends=bool(fresh_move))
        asks = fresh_move and self._done_at is None and (position is not None or self._asker == "switch")
        wanted = [fresh_move] if asks else []
        if self._asker not in ("", "switch"):
            wanted.append(_FRESH.get(self._asker, "a new request"))
        return Waiting(self._stopped_by or NO_MOVE_COUNTED, " or ".join(wanted)) if wanted else None

    def _see(self, position: int, bends: bool) -> None:
        if position != self._done_at:
            self._done_at = None
        if not bends and self._asker in ("", "switch"):
            self._asker = self._stopped_by = ""


def source(kind: str, what: Mapping[str, object]) -> str:
    """The source of a trigger as text, e.g. "mission item 4"."""
    if kind == "mission_item":
        return "the mission" if what.get("seq") is None else f"mission item {what['seq']}"
    if kind == "trigger":
        return f"trigger {what['name']}"
    return _BY.get(kind, kind)
