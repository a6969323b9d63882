"""The optional packages of flying-vines."""

from __future__ import annotations


def lacks(error: ImportError) -> str:
    """The text for a missing package of an extra, with the command that installs it."""
    return f"{error.name} is missing: pip install 'flying-vines[analysis]'"
