"""Reads from the kernel whether this computer's clock is synchronised."""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path

_TIMEX_BYTES = 256
"""At least the size of `struct timex`. With zeros in it, `adjtimex` only reads the state."""
_TIME_ERROR = 5
"""Result of `adjtimex` if the clock is not synchronised."""
_BY_TIMESYNCD = Path("/run/systemd/timesync/synchronized")
"""Used if `adjtimex` fails. The sandbox of our systemd service forbids calls that can set the clock."""


def synchronised() -> bool | None:
    """True if a time daemon (chrony, timesyncd, ntpd) has synchronised the clock; None if unknown."""
    if not sys.platform.startswith("linux"):
        return None
    try:
        state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES))
    except (AttributeError, OSError):
        state = -1
    if state < 0:
        return True if _BY_TIMESYNCD.exists() else None
    return bool(state != _TIME_ERROR)
