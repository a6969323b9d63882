"""Runs work in threads on all cores: compiled code takes most of the time, and it releases the GIL."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from contextvars import ContextVar
from typing import TypeVar

from flying_vines.physics.plant.compiled import batch

T = TypeVar("T")
R = TypeVar("R")

THREADS: ContextVar[int] = ContextVar("THREADS", default=0)
"""Threads for one case; 0 means one for each core. With many cases, each process gets its share of cores."""


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def mapped(function: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """The function of each item, in the order of the items."""
    return batch(function, items, threads=THREADS.get() or cores())
