"""How many examples hypothesis draws: in `make test` a third of those of `make test-all`."""

from __future__ import annotations

from hypothesis import settings

ALL = 100


def examples(count: int) -> int:
    """For a test that needs longer than most, of `count` those that the present profile draws."""
    return count * settings().max_examples // ALL
