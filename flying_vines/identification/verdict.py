"""The verdict of a diagnosis, its JSON, and the rig that it describes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from flying_vines.identification.evidence import Evidence
from flying_vines.identification.held_out import HeldOut
from flying_vines.physics.plant.true_rig import TrueRig
from flying_vines.physics.rig import Rig, with_numbers

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

    def as_json(self) -> dict[str, Any]:
        share = None if self.share is None else round(self.share, 4)
        return {"cause": self.cause, "parameters": parameters_json(self.parameters), "share": share}


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

    def as_json(self) -> dict[str, Any]:
        return {
            "cause": "+".join(self.causes) or NONE,
            "score": round(self.score, 2),
            "chi2_per_reading": round(self.chi2_per_reading, 4),
            "unseen_nrmse": self.unseen_nrmse,
            "parameters": {named.cause: parameters_json(named.parameters) for named in self.named},
            "on_bound": list(self.on_bound),
        }


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
            "also": [named.as_json() for named in self.also],
            "parameters": parameters_json(self.parameters),
            "share": round(self.share, 4),
            "numbers": self.numbers,
            "held_out": {**vars(self.held_out), "gain": list(self.held_out.gain)},
            "ranking": [tried.as_json() for tried in self.ranking],
            "next_experiment": self.next_experiment,
            "remainder": None if self.remainder is None else vars(self.remainder),
            "remarks": list(self.remarks),
        }


def parameters_json(parameters: Mapping[str, ParameterEstimate]) -> dict[str, dict[str, float]]:
    """Estimate and interval of each parameter."""
    return {name: dict(vars(estimate)) for name, estimate in parameters.items()}


def extended_rig(rig: Rig, verdict: Verdict) -> TrueRig:
    """The nominal rig with the fitted numbers and the named causes of the verdict.

    `simulate` and the fakes read it as a rig file. An `unexplained` verdict leaves the rig
    nominal. `none_found` records a verdict of `none`.
    """
    return TrueRig(
        nominal=with_numbers(rig, verdict.numbers),
        causes={
            named.cause: {name: estimate.estimate for name, estimate in named.parameters.items()}
            for named in verdict.named
        },
        none_found=verdict.cause == NONE,
    )
