"""Work on all cores: most of the time is spent in compiled code, which lets other threads work meanwhile."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from contextvars import ContextVar
from typing import TypeVar

from flying_vines.physics.plant.compiled import batch

T = TypeVar("T")
R = TypeVar("R")

THREADS: ContextVar[int] = ContextVar("THREADS", default=0)
"""Threads of one case; 0 is one a core. Many cases at once have a process each, and share the cores."""


def cores() -> int:
    """That this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def mapped(function: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """The function of each item, in their order."""
    return batch(function, items, threads=THREADS.get() or cores())
