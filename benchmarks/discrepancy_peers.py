"""Other methods on the same case, by name.

Each takes a case and gives as much of a verdict as it has: a cause, or `unexplained` where it can only say
that something is there, further causes, an error on unseen data.
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
"""Each a module with `look`; they need packages of their own."""


def require() -> None:
    """ModuleNotFoundError, now and not in every worker, where a package is missing."""
    for name in PEERS:
        peer(name)


def peer(name: str) -> Callable[[Case], dict[str, Any]]:
    look: Callable[[Case], dict[str, Any]] = importlib.import_module(PEERS[name]).look
    return look
