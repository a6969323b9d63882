"""What the kernel knows of this computer's clock."""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path

_TIMEX_BYTES = 256
"""A `struct timex`, and some: all zeros only asks."""
_TIME_ERROR = 5
"""What `adjtimex` answers when the clock is not synchronised."""
_BY_TIMESYNCD = Path("/run/systemd/timesync/synchronized")
"""The sandbox of our systemd service refuses `adjtimex`, because it can set clocks. It shows this file."""


def synchronised() -> bool | None:
    """What every daemon that keeps the clock (chrony, timesyncd, ntpd) tells the kernel; None elsewhere."""
    if not sys.platform.startswith("linux"):
        return None
    try:
        state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES))
    except (AttributeError, OSError):
        state = -1
    if state < 0:
        return True if _BY_TIMESYNCD.exists() else None
    return bool(state != _TIME_ERROR)
