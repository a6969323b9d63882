"""What holds for all tests."""

from __future__ import annotations

import pytest
from hypothesis import settings

# Machines are shared and slow at times; a late example is no fault of what it tests.
settings.register_profile("flying_vines", deadline=None, print_blob=True)
settings.register_profile("quick", settings.get_profile("flying_vines"), max_examples=25)
settings.load_profile("flying_vines")


def pytest_configure(config: pytest.Config) -> None:
    """`make test` draws fewer examples; `make test-all` draws all."""
    if config.option.markexpr == "not long":
        settings.load_profile("quick")
