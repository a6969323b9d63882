"""What the kernel knows of this computer's clock."""

from __future__ import annotations

import ctypes
import sys

_TIMEX_BYTES = 256
"""A `struct timex`, and some: all zeros only asks."""
_TIME_ERROR = 5
"""What `adjtimex` answers when the clock is not synchronised."""


def synchronised() -> bool | None:
    """What every daemon that keeps the clock (chrony, timesyncd, ntpd) tells the kernel; None elsewhere."""
    if not sys.platform.startswith("linux"):
        return None
    try:
        state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES))
    except (AttributeError, OSError):
        return None
    return None if state < 0 else bool(state != _TIME_ERROR)
