"""What the kernel knows of this computer's clock."""

from __future__ import annotations

import ctypes
import sys
import time
from datetime import datetime

from flying_vines.doctor.checks.clock import ClockFacts

_TIMEX_BYTES = 256
"""A `struct timex`, and some: all zeros only asks."""
_TIME_ERROR = 5
"""What `adjtimex` answers when the clock is not synchronised."""


class Clock:
    """Begun when the doctor begins to look, asked when he has done."""

    def __init__(self) -> None:
        self._offset_s = time.time() - time.monotonic()

    def facts(self, ahead_s: float | None, signing: bool) -> ClockFacts:
        unix_s = time.time()
        jumped_s = unix_s - time.monotonic() - self._offset_s
        return ClockFacts(unix_s, synchronised(), jumped_s, ahead_s, signing)


def when(unix_s: float) -> str:
    return datetime.fromtimestamp(unix_s).astimezone().isoformat(" ", "seconds")


def synchronised() -> bool | None:
    """What every daemon that keeps the clock (chrony, timesyncd, ntpd) tells the kernel; None elsewhere."""
    if not sys.platform.startswith("linux"):
        return None
    try:
        state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES))
    except (AttributeError, OSError):
        return None
    return None if state < 0 else bool(state != _TIME_ERROR)
