"""The optional packages of flying-vines."""

from __future__ import annotations


def lacks(error: ImportError) -> str:
    """Which package of the extra is not installed, and what brings it."""
    return f"{error.name} is missing; pip install 'flying-vines[analysis]' brings it"
