"""All that a calibration found, and what it proposes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from flying_vines.calibration.charts import Chart
from flying_vines.calibration.estimate import Estimate


@dataclass(frozen=True)
class MeasuredQuantity:
    """A quantity: what it was believed to be, and what was measured, with its 95 % interval."""

    name: str
    what: str
    unit: str
    value: float | None = None
    low: float | None = None
    high: float | None = None
    believed: float | None = None
    note: str = ""
    """What qualifies it, or why it was not measured."""
    key: str | None = None
    """Where it belongs in the profile."""

    def measured(self, estimate: Estimate, note: str = "", least: float | None = None) -> MeasuredQuantity:
        """With a value; an interval does not reach below `least`."""
        low = estimate.low if least is None else max(least, estimate.low)
        value = estimate.value if least is None else max(least, estimate.value)
        return replace(self, value=value, low=low, high=max(value, estimate.high), note=note)

    def unknown(self, why: str) -> MeasuredQuantity:
        return replace(self, value=None, low=None, high=None, note=why)


@dataclass(frozen=True)
class SettingProposal:
    """A setting of the firmware that would suit this rig better."""

    setting: str
    value: float
    relative: bool
    """To be added to what is set, rather than in its place."""
    why: str


@dataclass(frozen=True)
class Result:
    """What one stage gave."""

    findings: tuple[MeasuredQuantity, ...] = ()
    proposals: tuple[SettingProposal, ...] = ()
    remarks: tuple[str, ...] = ()
    charts: tuple[Chart, ...] = ()
    curve: tuple[tuple[float, float], ...] = ()
    hysteresis_kPa: float | None = None


@dataclass(frozen=True)
class Findings:
    """What all stages gave so far. Pairs and curve: gauge kPa, degrees."""

    findings: tuple[MeasuredQuantity, ...] = ()
    proposals: tuple[SettingProposal, ...] = ()
    remarks: tuple[str, ...] = ()
    pairs: tuple[tuple[float, float], ...] = ()
    curve: tuple[tuple[float, float], ...] = ()
    """Empty: not measured."""
    hysteresis_kPa: float | None = None

    def get(self, name: str) -> MeasuredQuantity | None:
        """What is known of a quantity; None when no stage looked for it."""
        return next((finding for finding in self.findings if finding.name == name), None)

    def estimate(self, name: str) -> Estimate | None:
        """The value and standard deviation of a quantity; None when it was not measured."""
        found = self.get(name)
        if found is None or found.value is None or found.low is None or found.high is None:
            return None
        return Estimate.of_interval(found.value, found.low, found.high)

    def with_result(self, result: Result) -> Findings:
        """With what another stage gave: what it measured anew takes the place of what was there."""
        return replace(
            self,
            findings=_renewed(self.findings, result.findings, "name"),
            proposals=_renewed(self.proposals, result.proposals, "setting"),
            remarks=(*self.remarks, *(remark for remark in result.remarks if remark not in self.remarks)),
            curve=result.curve or self.curve,
            hysteresis_kPa=self.hysteresis_kPa if result.hysteresis_kPa is None else result.hysteresis_kPa,
        )

    def as_json(self) -> dict[str, Any]:
        """As plain lists, numbers and texts."""
        return asdict(self)


def _renewed(before: Iterable[Any], now: Iterable[Any], name: str) -> tuple[Any, ...]:
    """By this attribute, in the order in which they first came."""
    return tuple(({getattr(x, name): x for x in before} | {getattr(x, name): x for x in now}).values())


def from_json(content: Mapping[str, Any]) -> Findings:
    """What `as_json` made."""
    return Findings(
        tuple(MeasuredQuantity(**finding) for finding in content["findings"]),
        tuple(SettingProposal(**proposal) for proposal in content["proposals"]),
        tuple(content["remarks"]),
        _pairs(content["pairs"]),
        _pairs(content["curve"]),
        content["hysteresis_kPa"],
    )


def _pairs(content: Iterable[Iterable[float]]) -> tuple[tuple[float, float], ...]:
    return tuple((kPa, deg) for kPa, deg in content)
