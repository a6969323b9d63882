"""Which commands are new, and which are repeats of an unacknowledged command or copies of a frame."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Hashable
from dataclasses import dataclass, field

PX4_REPEAT_S = 1.0
"""PX4 repeats what is not acknowledged three times, mostly 0.5 s apart, the first time at times after 1 s."""
STATION_REPEAT_S = 5.0
"""Ground stations repeat every 0.5 to 3 s."""
LATE_S = 0.6
"""How much later than another a frame can arrive that was sent at the same time."""
COPIES_WITHIN_S = 2.0
MOST_REMEMBERED = 64
FRAMES_REMEMBERED = 16


@dataclass(slots=True)
class _Command:
    begun_at: float = -math.inf
    heard_at: float = -math.inf
    saw_first: bool = False
    result: int | None = None
    frames: deque[tuple[float, int]] = field(default_factory=lambda: deque(maxlen=FRAMES_REMEMBERED))


class Repeats:
    """Remembers the latest commands by sender and content, and their answers.

    `confirmation` counts the repeats of one command. So a repeat that comes too late for the remembered
    command belongs to another one with the same content, whose earlier frames were lost.
    """

    def __init__(self) -> None:
        self._commands: dict[Hashable, _Command] = {}

    def is_repeat(self, t: float, key: Hashable, confirmation: int, sequence: int, repeat_s: float) -> bool:
        """Whether a command is a repeat; `repeat_s` is the maximum time between two of its repeats."""
        known = self._commands.pop(key, None) or _Command()
        repeat = _belongs(known, t, confirmation, sequence, repeat_s)
        if not repeat:
            known.begun_at, known.saw_first, known.result = t, False, None
        known.heard_at = t
        known.saw_first = known.saw_first or confirmation == 0
        known.frames.append((t, sequence))
        self._commands[key] = known
        if len(self._commands) > MOST_REMEMBERED:
            del self._commands[next(iter(self._commands))]
        return repeat

    def answer(self, key: Hashable, result: int) -> None:
        """Remember the answer to a command, which its repeats get, too."""
        if key in self._commands:
            self._commands[key].result = result

    def answered(self, key: Hashable) -> int | None:
        """The MAV_RESULT that the command got; None if it has not got one."""
        return self._commands[key].result if key in self._commands else None


def _belongs(known: _Command, t: float, confirmation: int, sequence: int, repeat_s: float) -> bool:
    if any(seen == sequence and t - at < COPIES_WITHIN_S for at, seen in known.frames):
        return True
    if confirmation == 0:
        return not known.saw_first and t - known.heard_at < LATE_S  # overtaken by its first repeat
    return t - known.begun_at <= confirmation * repeat_s + LATE_S
