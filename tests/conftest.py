"""Settings of all tests."""

from __future__ import annotations

import gc

import pytest
from hypothesis import settings

from examples import ALL

# No deadline, because machines are shared and sometimes slow.
settings.register_profile("all", deadline=None, print_blob=True, max_examples=ALL)
settings.register_profile("quick", settings.get_profile("all"), max_examples=ALL // 3)


def pytest_configure(config: pytest.Config) -> None:
    settings.load_profile("quick" if config.option.markexpr == "not long" else "all")


def pytest_collection_finish() -> None:
    # Imported modules and thousands of tests live until the end: garbage collection need not look at them.
    gc.collect()
    gc.freeze()
