"""A rate limit."""

from __future__ import annotations


class TokenBucket:
    """Allows `at_once` at a time and `per_s` on average. Times are seconds of one clock."""

    def __init__(self, t: float, at_once: float, per_s: float) -> None:
        self._at_once, self._per_s = at_once, per_s
        self._left, self._at = at_once, t

    def take(self, t: float, reserved: float = 0.0) -> bool:
        """True if one more is allowed at time `t`, and `reserved` are left after it."""
        self._left = min(self._at_once, self._left + self._per_s * (t - self._at))
        self._at = t
        if self._left < 1.0 + reserved:
            return False
        self._left -= 1.0
        return True
