"""Waiting for another task, thread or process."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

PATIENCE_S = 60.0
"""Only what never comes takes so long: machines that stand still for seconds fail nothing."""


async def until(true: Callable[[], bool], what: str) -> None:
    """Wait for it; the test fails when it does not come."""
    try:
        async with asyncio.timeout(PATIENCE_S):
            while not true():
                await asyncio.sleep(0.01)
    except TimeoutError:
        raise AssertionError(f"never came: {what}") from None
