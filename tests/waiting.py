"""Waiting for another task, thread or process."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

MAX_WAIT_S = 60.0
"""Long enough for computers that stop for seconds."""


async def until(true: Callable[[], bool], what: str) -> None:
    """Wait until `true` returns true. The test fails after `MAX_WAIT_S`."""
    try:
        async with asyncio.timeout(MAX_WAIT_S):
            while not true():
                await asyncio.sleep(0.01)
    except TimeoutError:
        raise AssertionError(f"never came: {what}") from None
