"""The bend that is requested but not carried out, because only a fresh request may move the vine.

The switch requests a bend as long as it is in a bending position. A command, a mission item, the page or MQTT
requests a bend once. If the vine was then vented without a request (a failsafe, the end of bench mode), this
bend stays requested until the next request.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

NO_MOVE_COUNTED = "no move of the switch has counted"
"""The switch is in a bending position, but its move there caused no motion and no refusal."""
_BY = {"switch": "the switch", "page": "the page", "broker": "MQTT", "command": "a command"}
_FRESH = {"mission_item": "the next mission item"}


@dataclass(frozen=True, slots=True)
class PendingBend:
    """A bend is requested and nothing moves: what stopped it, and which request would move the vine."""

    stopped_by: str
    awaited: str


class PendingBendTracker:
    """Follows motions, vents and refusals; `waiting` is the state."""

    def __init__(self) -> None:
        self._asker = ""
        """The kind of trigger of the latest motion; empty after its end or a request to vent."""
        self._stopped_by = ""
        self._done_at: int | None = None
        """The switch position whose profile ran to its end, so that the switch requests nothing more."""

    def began(self, kind: str) -> None:
        """A trigger of this kind began a motion."""
        self._asker, self._stopped_by, self._done_at = kind, "", None

    def ended(self, name: str, position: int | None) -> None:
        """The motion `name` ran to its end, with the switch in `position`."""
        if self._asker == "switch":
            self._done_at = position
        self._asker, self._stopped_by = "", f"{name} is over"

    def stopped(self, why: str) -> None:
        """A running motion was vented without a request. Its bend stays requested."""
        self._stopped_by = f"stopped earlier: {why}"  # the cause may be over

    def withdrawn(self, why: str, moved: bool) -> None:
        """A request vented the vine. Now only the switch requests a bend. `moved`: a motion was running."""
        self._asker = ""
        if moved:
            self.stopped(why)

    def refused(self, kind: str, why: str) -> None:
        """A request was refused while nothing moved. Only a bend of the switch stays requested."""
        if kind == "switch":
            self._asker, self._stopped_by, self._done_at = kind, f"refused: {why}", None

    def waiting(self, position: int | None, fresh_move: str) -> PendingBend | None:
        """The state while nothing moves; None if no bend is requested.

        `position`: the position of the switch; None during a loss of RC. `fresh_move`: the move of the switch
        that would bend the vine. It is empty if the switch is not in a bending position. During a loss, the
        position before the loss counts.
        """
        if position is not None:
            self._see(position, bends=bool(fresh_move))
        asks = fresh_move and self._done_at is None and (position is not None or self._asker == "switch")
        wanted = [fresh_move] if asks else []
        if self._asker not in ("", "switch"):
            wanted.append(_FRESH.get(self._asker, "a new request"))
        return PendingBend(self._stopped_by or NO_MOVE_COUNTED, " or ".join(wanted)) if wanted else None

    def _see(self, position: int, bends: bool) -> None:
        if position != self._done_at:
            self._done_at = None
        if not bends and self._asker in ("", "switch"):
            self._asker = self._stopped_by = ""


def source(kind: str, what: Mapping[str, object]) -> str:
    """Who or what sent a trigger, e.g. "mission item 4"."""
    if kind == "mission_item":
        return "the mission" if what.get("seq") is None else f"mission item {what['seq']}"
    if kind == "trigger":
        return f"trigger {what['name']}"
    return _BY.get(kind, kind)
