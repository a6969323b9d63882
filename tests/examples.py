"""The number of hypothesis examples: in `make test` a third of those of `make test-all`."""

from __future__ import annotations

from hypothesis import settings

ALL = 100


def examples(count: int) -> int:
    """The number of examples for a slow test that has `count` in `make test-all`."""
    return count * settings().max_examples // ALL
