"""What the evidence says, for people and machines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from flying_vines.identification.evidence import Evidence
from flying_vines.identification.held_out import HeldOut

NONE = "none"
UNEXPLAINED = "unexplained"


@dataclass(frozen=True)
class ParameterEstimate:
    """A parameter and its 95 % interval, in the unit of its name."""

    estimate: float
    low: float
    high: float


@dataclass(frozen=True)
class Named:
    """A cause and what it measures."""

    cause: str
    parameters: dict[str, ParameterEstimate]


@dataclass(frozen=True)
class Tried:
    """A candidate that was fitted: what its causes measure, and how well it explains the data."""

    named: tuple[Named, ...]
    """Empty for the baseline alone; intervals by the curvature at the fit."""
    on_bound: tuple[str, ...]
    """Parameters that would be where no rig is: evidence against."""
    chi2_per_reading: float
    score: float
    """−2 ln of the evidence, above the best candidate's."""
    unseen_nrmse: float | None
    """As in `HeldOut`; of the best candidates only."""

    @property
    def causes(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(named.cause for named in self.named)


@dataclass(frozen=True)
class Verdict:
    """The answer to: what does the baseline simulation get wrong about this rig?"""

    cause: str
    """A name from the catalogue, `none` or `unexplained`."""
    confidence: float
    """Probability that `cause` and `indistinguishable` hold the cause."""
    indistinguishable: tuple[str, ...]
    """Others that these data cannot tell apart from it, or from one that is in `also`."""
    parameters: dict[str, ParameterEstimate]
    also: tuple[Named, ...]
    """Further causes that still improve held-out data."""
    numbers: dict[str, float]
    """Believed numbers that the data move within their tolerances, by their keys; all of them, or none."""
    held_out: HeldOut
    ranking: tuple[Tried, ...]
    """All that was tried, the best evidence first."""
    next_experiment: str
    """What to record to settle what is open; empty when nothing is."""
    remainder: str
    """What is left depends most on this; empty when nothing but noise is left."""
    remarks: tuple[str, ...]
    evidence: Evidence
    """The arrays behind it."""

    @property
    def named(self) -> tuple[Named, ...]:
        """The main cause and the further ones; empty where there is none to name."""
        if self.cause in (NONE, UNEXPLAINED):
            return ()
        return (Named(self.cause, self.parameters), *self.also)

    def as_json(self) -> dict[str, Any]:
        """As the rig-data format fixes it."""
        return {
            "cause": self.cause,
            "confidence": round(self.confidence, 4),
            "indistinguishable": list(self.indistinguishable),
            "also": [_named(named) for named in self.also],
            "parameters": parameters_json(self.parameters),
            "numbers": self.numbers,
            "held_out": {
                "nrmse_before": self.held_out.nrmse_before,
                "nrmse_after": self.held_out.nrmse_after,
                "noise_floor": self.held_out.noise_floor,
                "gain": list(self.held_out.gain),
            },
            "ranking": [_tried(tried) for tried in self.ranking],
            "next_experiment": self.next_experiment,
            "remainder": self.remainder,
            "remarks": list(self.remarks),
        }


def parameters_json(parameters: Mapping[str, ParameterEstimate]) -> dict[str, dict[str, float]]:
    """Each with the ends of its interval."""
    return {name: {"estimate": e.estimate, "low": e.low, "high": e.high} for name, e in parameters.items()}


def _named(named: Named) -> dict[str, Any]:
    return {"cause": named.cause, "parameters": parameters_json(named.parameters)}


def _tried(tried: Tried) -> dict[str, Any]:
    return {
        "cause": "+".join(tried.causes) or NONE,
        "score": round(tried.score, 2),
        "chi2_per_reading": round(tried.chi2_per_reading, 4),
        "unseen_nrmse": tried.unseen_nrmse,
        "parameters": {named.cause: parameters_json(named.parameters) for named in tried.named},
        "on_bound": list(tried.on_bound),
    }
