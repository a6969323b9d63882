"""Parts of the core that may fail alone: estimates, checks, values for displays.

A part that raises is switched off until the service restarts. Its caller continues without it. If the vine
needs the part, the vine is vented and does not bend.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from flying_vines.core.events import Failed

_T = TypeVar("_T")


class IsolatedParts:
    """Runs parts by name. `failed` is called once for each part that raises."""

    def __init__(self, failed: Callable[[Failed], None]) -> None:
        self._failed = failed
        self._off: set[str] = set()

    def run(self, t: float, name: str, part: Callable[[], _T], otherwise: _T, needed: bool = False) -> _T:
        """Returns the result of `part`, or `otherwise` if the part fails or is off.

        `needed`: without this part the vine must not bend.
        """
        if name in self._off:
            return otherwise
        try:
            return part()
        except (Exception, SystemExit) as error:  # a part of a lab may call `exit`
            self._off.add(name)
            self._failed(Failed.by(t, name, error, needed))
            return otherwise
