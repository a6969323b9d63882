"""What the evidence says, for people and machines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from flying_vines.discrepancy.held_out import HeldOut

NONE = "none"
UNEXPLAINED = "unexplained"


@dataclass(frozen=True)
class Estimate:
    """A parameter and its 95 % interval, in the unit of its name."""

    estimate: float
    low: float
    high: float


@dataclass(frozen=True)
class Named:
    """A cause and what it measures."""

    cause: str
    parameters: dict[str, Estimate]


@dataclass(frozen=True)
class Ranked:
    """A candidate that was tried: its causes, and how much worse than the best its evidence is."""

    causes: tuple[str, ...]
    score: float
    """−2 ln of the evidence, above the best candidate's."""


@dataclass(frozen=True)
class Verdict:
    """The answer to: what does the baseline simulation get wrong about this rig?"""

    cause: str
    """A name from the catalogue, `none` or `unexplained`."""
    confidence: float
    """Probability that `cause` and `indistinguishable` hold the cause."""
    indistinguishable: tuple[str, ...]
    """Others that these data cannot tell apart from it."""
    parameters: dict[str, Estimate]
    also: tuple[Named, ...]
    """Further causes that still improve held-out data."""
    numbers: dict[str, float]
    """Believed numbers that the data move within their tolerances, by their keys; all of them, or none."""
    held_out: HeldOut
    ranking: tuple[Ranked, ...]
    next_experiment: str
    """What to record to settle what is open; empty when nothing is."""
    remainder: str
    """What is left depends most on this; empty when nothing but noise is left."""
    remarks: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """As the rig-data format fixes it."""
        return {
            "cause": self.cause,
            "confidence": round(self.confidence, 4),
            "indistinguishable": list(self.indistinguishable),
            "also": [
                {"cause": named.cause, "parameters": _parameters(named.parameters)} for named in self.also
            ],
            "parameters": _parameters(self.parameters),
            "numbers": self.numbers,
            "held_out": {
                "nrmse_before": self.held_out.nrmse_before,
                "nrmse_after": self.held_out.nrmse_after,
                "noise_floor": self.held_out.noise_floor,
            },
            "ranking": [
                {"cause": "+".join(r.causes) or NONE, "score": round(r.score, 2)} for r in self.ranking
            ],
            "next_experiment": self.next_experiment,
            "remainder": self.remainder,
            "remarks": list(self.remarks),
        }


def _parameters(parameters: dict[str, Estimate]) -> dict[str, dict[str, float]]:
    return {name: {"estimate": e.estimate, "low": e.low, "high": e.high} for name, e in parameters.items()}
