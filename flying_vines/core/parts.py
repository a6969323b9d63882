"""Parts of the core that no setpoint waits for: estimates, checks, values for displays.

One that raises is switched off for good, and what called it goes on without it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from flying_vines.core.events import Failed

_T = TypeVar("_T")


class Parts:
    """Runs parts by name. `failed` is told of each that raises, once."""

    def __init__(self, failed: Callable[[Failed], None]) -> None:
        self._failed = failed
        self._off: set[str] = set()

    def run(self, t: float, name: str, part: Callable[[], _T], otherwise: _T, needed: bool = False) -> _T:
        """What `part` returns, or `otherwise` when it is off.

        Without one that is `needed` the vine must not bend; any other is for people only.
        """
        if name in self._off:
            return otherwise
        try:
            return part()
        except Exception as error:
            self._off.add(name)
            self._failed(Failed.by(t, name, error, needed))
            return otherwise
