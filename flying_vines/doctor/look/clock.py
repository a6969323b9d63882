"""Watches this computer's clock during the examination."""

from __future__ import annotations

import asyncio
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


TICK_S = 0.02
HICCUPS = 5


async def lateness_s(seconds: float) -> float:
    """Listen for `seconds`, and return by how much the fifth latest tick of our own loop was late.

    A few late ticks are hiccups, such as the first use of a module; on a busy computer there are many.
    """
    loop, late_s = asyncio.get_running_loop(), [0.0] * HICCUPS
    ends_s = loop.time() + seconds
    while (now_s := loop.time()) < ends_s:
        await asyncio.sleep(TICK_S)
        late_s.append(loop.time() - now_s - TICK_S)
    return sorted(late_s)[-HICCUPS]
