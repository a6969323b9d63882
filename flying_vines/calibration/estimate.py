"""A number that was measured, and how sure it is."""

from __future__ import annotations

from math import hypot
from typing import NamedTuple

SD_95 = 1.96


class Estimate(NamedTuple):
    """A value and its standard deviation."""

    value: float
    sd: float

    @property
    def low(self) -> float:
        """Of the 95 % interval."""
        return self.value - SD_95 * self.sd

    @property
    def high(self) -> float:
        return self.value + SD_95 * self.sd

    def times(self, factor: float, relative_sd: float = 0.0) -> Estimate:
        """Scaled by something that is itself sure to `relative_sd`."""
        return Estimate(self.value * factor, abs(factor) * hypot(self.sd, self.value * relative_sd))

    @staticmethod
    def of_interval(value: float, low: float, high: float) -> Estimate:
        """Of a value and its 95 % interval, the wider side of it."""
        return Estimate(value, max(value - low, high - value) / SD_95)
