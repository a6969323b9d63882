"""Watches this computer's clock during the examination."""

from __future__ import annotations

import time
from datetime import datetime

from flying_vines.doctor.checks.clock import ClockFacts
from flying_vines.service.host_clock import synchronised


class Clock:
    """Make it at the start of the examination; call `facts` at the end."""

    def __init__(self) -> None:
        self._offset_s = time.time() - time.monotonic()

    def facts(self, ahead_s: float | None, signing: bool) -> ClockFacts:
        unix_s = time.time()
        jumped_s = unix_s - time.monotonic() - self._offset_s
        return ClockFacts(unix_s, synchronised(), jumped_s, ahead_s, signing)


def when(unix_s: float) -> str:
    return datetime.fromtimestamp(unix_s).astimezone().isoformat(" ", "seconds")
