"""Bad input: one line on standard error, and exit status 2."""

from __future__ import annotations

import sys

BAD_INPUT = 2


def bad_input(sentence: str) -> int:
    """Print the sentence; returns the exit status."""
    sys.stdout.flush()
    print(f"flying-vines: {sentence}", file=sys.stderr)
    return BAD_INPUT
