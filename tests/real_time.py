"""Marks tests of service and stand-ins in real time, which are repeated on an overloaded computer."""

from __future__ import annotations

import os

import pytest

TRIES = 3


def overloaded() -> bool:
    """True if the machine had hardly a free core in the last minute."""
    return os.getloadavg()[0] > 0.8 * (os.cpu_count() or 1)


real_time = pytest.mark.flaky(reruns=TRIES - 1, condition=overloaded)
"""Repeats a failed test on an overloaded machine. On any other machine a failure counts."""
