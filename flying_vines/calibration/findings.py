"""The results of a calibration: measured quantities, proposals for the firmware, and charts as plain data."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, NamedTuple

from flying_vines.config.config import PneumaticsConfig
from flying_vines.physics.arrays import Array

SD_95 = 1.96
MAX_POINTS = 2000
"""Maximum for one series of a chart."""


class Estimate(NamedTuple):
    """A value and its standard deviation."""

    value: float
    sd: float

    @property
    def low(self) -> float:
        """Lower end of the 95 % interval."""
        return self.value - SD_95 * self.sd

    @property
    def high(self) -> float:
        """Upper end of the 95 % interval."""
        return self.value + SD_95 * self.sd

    def times(self, factor: float, relative_sd: float = 0.0) -> Estimate:
        """The product with a factor that has its own relative standard deviation."""
        return Estimate(self.value * factor, abs(factor) * math.hypot(self.sd, self.value * relative_sd))

    @staticmethod
    def of_interval(value: float, low: float, high: float) -> Estimate:
        """From a 95 % interval; the wider side counts."""
        return Estimate(value, max(value - low, high - value) / SD_95)


@dataclass(frozen=True)
class Series:
    """Points, a line, or a band between `y` and `y2`, all (n,)."""

    label: str
    kind: Literal["points", "line", "band"]
    x: Array
    y: Array
    y2: Array | None = None


@dataclass(frozen=True)
class Chart:
    """One picture. `name` is the stem of its file names."""

    name: str
    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    note: str = ""


def thinned(column: Array) -> Array:
    """At most `MAX_POINTS` evenly spaced elements."""
    return column[:: max(1, -(-len(column) // MAX_POINTS))]


@dataclass(frozen=True)
class MeasuredQuantity:
    """A quantity: the assumed value, and the measured value with its 95 % interval."""

    name: str
    what: str
    unit: str
    value: float | None = None
    low: float | None = None
    high: float | None = None
    assumed: float | None = None
    note: str = ""
    """A qualification, or the reason why it was not measured."""
    key: str | None = None
    """Key of the configuration, for example `pneumatics.cv_volume_L`."""

    def measured(self, estimate: Estimate, note: str = "", minimum: float | None = None) -> MeasuredQuantity:
        """The quantity with a measured value. Value and interval do not go below `minimum`."""
        low = estimate.low if minimum is None else max(minimum, estimate.low)
        value = estimate.value if minimum is None else max(minimum, estimate.value)
        return replace(self, value=value, low=low, high=max(value, estimate.high), note=note)

    def unknown(self, why: str) -> MeasuredQuantity:
        return replace(self, value=None, low=None, high=None, note=why)

    @property
    def interval(self) -> tuple[float, float, float] | None:
        """Value, lower and upper end of the 95 % interval; None if it was not measured."""
        if self.value is None or self.low is None or self.high is None:
            return None
        return self.value, self.low, self.high

    @property
    def estimate(self) -> Estimate | None:
        """Value and standard deviation; None if it was not measured."""
        return Estimate.of_interval(*self.interval) if self.interval else None

    def texts(self) -> tuple[str, str]:
        """Value and interval. The width of the interval decides how many digits are shown."""
        if self.interval is None:
            return "–", ""
        value, low, high = self.interval
        half_width = 0.5 * (high - low)
        known = 0.0 < half_width < math.inf
        digits = min(9, max(0, 1 - math.floor(math.log10(half_width)))) if known else 3
        return f"{value:.{digits}f}", f"{low:.{digits}f} … {high:.{digits}f}"

    def change(self) -> str:
        """The difference between measured and assumed value, as text."""
        if self.interval is None or self.assumed is None:
            return ""
        value, low, high = self.interval
        if low <= self.assumed <= high:
            return "as assumed"
        if self.assumed == 0.0:
            return f"{value:+.3g}"
        return f"{value / self.assumed - 1.0:+.1%}"


def configured(name: str, what: str, unit: str, pneumatics: PneumaticsConfig) -> MeasuredQuantity:
    """A quantity that replaces a number of `[pneumatics]`, which is assumed until then."""
    return MeasuredQuantity(name, what, unit, assumed=getattr(pneumatics, name), key=f"pneumatics.{name}")


@dataclass(frozen=True)
class SettingProposal:
    """A better value for a firmware setting."""

    setting: str
    value: float
    relative: bool
    """True if the value is added to the present setting."""
    why: str


@dataclass(frozen=True)
class Findings:
    """The results of one stage, or of all stages so far. Pairs and curve: gauge kPa, degrees."""

    findings: tuple[MeasuredQuantity, ...] = ()
    proposals: tuple[SettingProposal, ...] = ()
    remarks: tuple[str, ...] = ()
    charts: tuple[Chart, ...] = ()
    pairs: tuple[tuple[float, float], ...] = ()
    curve: tuple[tuple[float, float], ...] = ()
    """Empty if it was not measured."""
    hysteresis_kPa: float | None = None

    def get(self, name: str) -> MeasuredQuantity | None:
        """The quantity; None if no stage has evaluated it."""
        return next((finding for finding in self.findings if finding.name == name), None)

    def estimate(self, name: str) -> Estimate | None:
        """Value and standard deviation; None if the quantity was not measured."""
        found = self.get(name)
        return found.estimate if found else None

    def notes(self) -> Sequence[str]:
        """All notes and remarks, one line each."""
        return (*(f"{f.what}: {f.note}" for f in self.findings if f.note), *self.remarks)

    def renewed_by(self, newer: Findings) -> Findings:
        """Both together. A newer result replaces an older one of the same name."""
        return Findings(
            _renewed(self.findings, newer.findings, "name"),
            _renewed(self.proposals, newer.proposals, "setting"),
            tuple(dict.fromkeys((*self.remarks, *newer.remarks))),
            _renewed(self.charts, newer.charts, "name"),
            newer.pairs or self.pairs,
            newer.curve or self.curve,
            self.hysteresis_kPa if newer.hysteresis_kPa is None else newer.hysteresis_kPa,
        )

    def as_json(self) -> dict[str, Any]:
        """The findings without the charts, as plain lists, numbers and texts."""
        return {name: value for name, value in asdict(self).items() if name != "charts"}


def _renewed(before: Iterable[Any], now: Iterable[Any], name: str) -> tuple[Any, ...]:
    """The newest item of each name, in the order in which the names first appeared."""
    return tuple(({getattr(x, name): x for x in before} | {getattr(x, name): x for x in now}).values())
