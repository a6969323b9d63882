"""Runs something, and restarts it whenever it ends."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine

FIRST_WAIT_S, LONGEST_WAIT_S = 0.2, 1.5
"""Before the next start. Short, as a pilot may need the page for a vent."""
WELL_S = 5.0
"""After this run time it counts as running again."""


async def keep_alive(
    name: str, run: Callable[[], Coroutine[None, None, str]], tell: Callable[[str], None]
) -> None:
    """Until cancelled. `run` returns why it ended, or raises.

    `tell` is called when it ends and when it runs again, not for the attempts in between.
    """
    wait_s, told = FIRST_WAIT_S, False
    while True:
        running = asyncio.create_task(run())
        try:
            await asyncio.wait({running}, timeout=WELL_S)
            if not running.done():
                wait_s = FIRST_WAIT_S
                if told:
                    told = False
                    tell(f"{name} running again")
                await asyncio.wait({running})
        finally:
            running.cancel()
            await asyncio.wait({running})
        if not told:
            told = True
            tell(f"{name} stopped ({_why(running)}), starting again")
        await asyncio.sleep(wait_s)
        wait_s = min(2.0 * wait_s, LONGEST_WAIT_S)


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
