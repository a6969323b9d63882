"""Distinguishes new commands from repeats of an unacknowledged command and from copies of a frame."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Hashable
from dataclasses import dataclass, field

PX4_REPEAT_S = 1.0
"""PX4 repeats an unacknowledged command three times, usually 0.5 s apart. The first repeat may take 1 s."""
STATION_REPEAT_S = 5.0
"""Maximum time between two repeats of a ground station. They usually come every 0.5 to 3 s."""
MAX_DELAY_DIFFERENCE_S = 0.6
"""Maximum difference in delay between two frames."""
COPIES_WITHIN_S = 2.0
"""A frame with the same sequence number and content within this time is a copy."""
MAX_COMMANDS = 64
MAX_FRAMES = 16


@dataclass(slots=True)
class _Command:
    begun_at: float = -math.inf
    received_at: float = -math.inf
    saw_first: bool = False
    result: int | None = None
    frames: deque[tuple[float, int]] = field(default_factory=lambda: deque(maxlen=MAX_FRAMES))


class Repeats:
    """Stores the latest commands by sender and content, and their results.

    `confirmation` counts the repeats of one command. A repeat may come too late for the stored command. Then
    it belongs to a newer command with the same content, whose earlier frames were lost.
    """

    def __init__(self) -> None:
        self._commands: dict[Hashable, _Command] = {}

    def is_repeat(self, t: float, key: Hashable, confirmation: int, sequence: int, repeat_s: float) -> bool:
        """True if a command is a repeat. `repeat_s`: the maximum time between two repeats."""
        known = self._commands.pop(key, None) or _Command()
        repeat = _belongs(known, t, confirmation, sequence, repeat_s)
        if not repeat:
            known.begun_at, known.saw_first, known.result = t, False, None
        known.received_at = t
        known.saw_first = known.saw_first or confirmation == 0
        known.frames.append((t, sequence))
        self._commands[key] = known
        if len(self._commands) > MAX_COMMANDS:
            del self._commands[next(iter(self._commands))]
        return repeat

    def answer(self, key: Hashable, result: int) -> None:
        """Store the result of a command. Its repeats get the same result."""
        if key in self._commands:
            self._commands[key].result = result

    def answered(self, key: Hashable) -> int | None:
        """The MAV_RESULT of the command; None if it has none yet."""
        return self._commands[key].result if key in self._commands else None


def _belongs(known: _Command, t: float, confirmation: int, sequence: int, repeat_s: float) -> bool:
    if any(seen == sequence and t - at < COPIES_WITHIN_S for at, seen in known.frames):
        return True
    if confirmation == 0:
        # A command's first frame may arrive after its first repeat.
        return not known.saw_first and t - known.received_at < MAX_DELAY_DIFFERENCE_S
    return t - known.begun_at <= confirmation * repeat_s + MAX_DELAY_DIFFERENCE_S
