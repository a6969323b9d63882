"""Runs the gateway's process, or one of its parts, and restarts it when it ends."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine

FIRST_WAIT_S, MAX_WAIT_S = 0.2, 1.5
"""Wait before the next start. Short, because a pilot may need the page for a vent."""
STABLE_S = 5.0
"""After this run time the part counts as running again."""


async def supervise(
    name: str, run: Callable[[], Coroutine[None, None, str]], report: Callable[[str], None]
) -> None:
    """Runs until cancelled. `run` returns why it ended, or raises.

    `report` is called when the part ends and when it runs again, not for attempts in between.
    """
    wait_s, reported = FIRST_WAIT_S, False
    while True:
        running = asyncio.create_task(run())
        try:
            await asyncio.wait({running}, timeout=STABLE_S)
            if not running.done():
                wait_s = FIRST_WAIT_S
                if reported:
                    reported = False
                    report(f"{name} running again")
                await asyncio.wait({running})
        finally:
            running.cancel()
            await asyncio.wait({running})
        if not reported:
            reported = True
            report(f"{name} stopped ({_why(running)}), starting again")
        await asyncio.sleep(wait_s)
        wait_s = min(2.0 * wait_s, MAX_WAIT_S)


def _why(ended: asyncio.Task[str]) -> str:
    if ended.cancelled():
        return "it was cancelled"
    error = ended.exception()
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    if error is None:
        return ended.result()
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return f"{type(error).__name__}: {error}"
