"""Other methods for the same case, by name.

Each takes a case and returns the parts of a verdict that it can give: a cause, or `unexplained` if it cannot
name one; further causes; an error on unseen data.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

from flying_vines.identification.case import Case

PEERS = {
    "pysindy": "discrepancy_pysindy",
    "Gaussian process": "discrepancy_gaussian",
    "stepwise BIC": "discrepancy_stepwise",
}
"""Modules with a function `look`. The first two need packages that `diagnose` does not need."""


def require() -> None:
    """Raises ModuleNotFoundError if a package is missing, before any worker starts."""
    for name in PEERS:
        peer(name)


def peer(name: str) -> Callable[[Case], dict[str, Any]]:
    look: Callable[[Case], dict[str, Any]] = importlib.import_module(PEERS[name]).look
    return look
