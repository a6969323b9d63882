"""Hypothesis settings of all tests."""

from __future__ import annotations

from hypothesis import settings

# Machines are shared and slow at times; a late example is no fault of what it tests.
settings.register_profile("flying_vines", deadline=None, print_blob=True)
settings.load_profile("flying_vines")
