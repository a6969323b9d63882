"""Marks tests of service and stand-ins in real time, which are repeated on an overloaded computer."""

from __future__ import annotations

import os

import pytest

TRIES = 3


def overloaded() -> bool:
    """Whether the machine had hardly a core to spare in the last minute."""
    return os.getloadavg()[0] > 0.8 * (os.cpu_count() or 1)


real_time = pytest.mark.flaky(reruns=TRIES - 1, condition=overloaded)
"""Flown again where it failed on such a machine. On one that is not, a failure is a failure."""
