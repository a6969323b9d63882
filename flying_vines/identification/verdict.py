"""The verdict of a diagnosis, and its JSON."""

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
    """A cause and its fitted parameters."""

    cause: str
    parameters: dict[str, ParameterEstimate]
    share: float | None = None
    """See `Verdict.share`; None if it was not computed."""


@dataclass(frozen=True)
class Remainder:
    """The misfit that the named causes leave."""

    share: float
    """Share of the null model's squared misfit above noise, 0…1."""
    depends_on: str
    """Channel, and the feature on which its residuals depend most."""


@dataclass(frozen=True)
class Tried:
    """A fitted candidate: the parameters of its causes, and how well it explains the data."""

    named: tuple[Named, ...]
    """Empty for the baseline alone. Intervals are from the curvature at the fit."""
    on_bound: tuple[str, ...]
    """Parameters on the bound of their physical range, which is evidence against the cause."""
    chi2_per_reading: float
    score: float
    """−2 ln of the evidence, relative to the best candidate."""
    unseen_nrmse: float | None
    """See `HeldOut`; only for the best candidates."""

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the causes."""
        return tuple(named.cause for named in self.named)


@dataclass(frozen=True)
class Verdict:
    """The cause of the difference between a rig and its baseline simulation."""

    cause: str
    """A name from the catalogue, `none` or `unexplained`."""
    confidence: float
    """Probability that the true cause is `cause` or one of `indistinguishable`."""
    indistinguishable: tuple[str, ...]
    """Other causes that these data cannot tell apart from `cause`, or from one in `also`."""
    parameters: dict[str, ParameterEstimate]
    share: float
    """Rise of the squared misfit if `cause` is left out and the rest refitted, divided by the part of the
    squared misfit that all causes together remove. Shares do not add up to 1."""
    also: tuple[Named, ...]
    """Further causes, the largest share first."""
    numbers: dict[str, float]
    """Fitted rig numbers within their tolerances, by key. Empty if nominal numbers explain the data, or if
    the verdict is `unexplained`."""
    held_out: HeldOut
    ranking: tuple[Tried, ...]
    """All candidates, the best evidence first."""
    next_experiment: str
    """The recording that answers the open question; empty if there is none."""
    remainder: Remainder | None
    """None if the residuals are noise."""
    remarks: tuple[str, ...]
    evidence: Evidence

    @property
    def named(self) -> tuple[Named, ...]:
        """The main cause and the further ones; empty if no cause is named."""
        if self.cause in (NONE, UNEXPLAINED):
            return ()
        return (Named(self.cause, self.parameters, self.share), *self.also)

    def as_json(self) -> dict[str, Any]:
        """The verdict in the rig-data format."""
        return {
            "cause": self.cause,
            "confidence": round(self.confidence, 4),
            "indistinguishable": list(self.indistinguishable),
            "also": [_named(named) for named in self.also],
            "parameters": parameters_json(self.parameters),
            "share": round(self.share, 4),
            "numbers": self.numbers,
            "held_out": {
                "nrmse_before": self.held_out.nrmse_before,
                "nrmse_after": self.held_out.nrmse_after,
                "noise_floor": self.held_out.noise_floor,
                "gain": list(self.held_out.gain),
            },
            "ranking": [_tried(tried) for tried in self.ranking],
            "next_experiment": self.next_experiment,
            "remainder": None if self.remainder is None else vars(self.remainder),
            "remarks": list(self.remarks),
        }


def parameters_json(parameters: Mapping[str, ParameterEstimate]) -> dict[str, dict[str, float]]:
    """Estimate and interval of each parameter."""
    return {name: {"estimate": e.estimate, "low": e.low, "high": e.high} for name, e in parameters.items()}


def _named(named: Named) -> dict[str, Any]:
    share = None if named.share is None else round(named.share, 4)
    return {"cause": named.cause, "parameters": parameters_json(named.parameters), "share": share}


def _tried(tried: Tried) -> dict[str, Any]:
    return {
        "cause": "+".join(tried.causes) or NONE,
        "score": round(tried.score, 2),
        "chi2_per_reading": round(tried.chi2_per_reading, 4),
        "unseen_nrmse": tried.unseen_nrmse,
        "parameters": {named.cause: parameters_json(named.parameters) for named in tried.named},
        "on_bound": list(tried.on_bound),
    }
