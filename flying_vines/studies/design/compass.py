"""The paper's comparison of pressure supplies and regulators (Fig. 2), rated from its text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from flying_vines.studies.design.evaluate import Evaluation
from flying_vines.studies.design.reading import decode

METRICS = ("cost", "weight", "size", "speed", "range", "air_supply", "renewability")
"""Worth more the further out: a high rating for cost is a low cost."""


class Rating(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """1 (worst) to 5 (best), with the sentence of the paper that it rests on, or why it is judged so."""

    value: Annotated[float, Meta(ge=1, le=5)]
    says: Annotated[str, Meta(min_length=1)]
    place: str = ""
    judgement: bool = False

    def __post_init__(self) -> None:
        if self.judgement == bool(self.place):
            raise ValueError("a rating has the place of what it quotes, or is a judgement")


class Solution(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A way to supply or regulate pressure. None: it has no value, as the paper says of regulators."""

    label: str
    cost: Rating
    weight: Rating
    size: Rating
    speed: Rating
    range: Rating
    air_supply: Rating | None = None
    renewability: Rating | None = None

    def rating(self, metric: str) -> Rating | None:
        """The rating by one of `METRICS`."""
        found: Rating | None = getattr(self, metric)
        return found


@dataclass(frozen=True)
class Compass:
    """The paper's six solutions, and the ratings of a design beside them."""

    solutions: Mapping[str, Solution]
    design: Mapping[str, float]


def solutions() -> dict[str, Solution]:
    """The six that the paper compares, from `compass.toml`."""
    text = resources.files("flying_vines.studies.design").joinpath("compass.toml").read_text(encoding="utf-8")
    found: Any = decode(text, "compass.toml", dict[str, Solution])
    return {name: solution for name, solution in found.items() if isinstance(solution, Solution)}


def compass(design: Evaluation, prototype: Evaluation) -> Compass:
    """A design among the paper's solutions.

    It has the phloSAR's ratings, one step up or down for each factor of two that it is lighter, smaller
    (bottle volume), faster (flow into the control volume) or works longer on one filling (air held, for
    air supply) than the prototype. Cost, range and renewability stay: nothing in a choice of parts says more.

    Args:
        design: what is to be placed.
        prototype: the paper's parts, for the same robot.
    """
    all_six = solutions()
    phlosar = all_six["phlosar"]

    def moved(metric: str, factor: float) -> float:
        rating = phlosar.rating(metric)
        assert rating is not None
        return min(max(rating.value + math.log2(factor), 1.0), 5.0) if factor > 0.0 else 1.0

    ours, theirs = design.parts, prototype.parts
    air = (ours.reservoir_volume_L * design.fill_kPa) / (theirs.reservoir_volume_L * prototype.fill_kPa)
    factors = {
        "weight": prototype.mass_kg / design.mass_kg,
        "size": theirs.reservoir_volume_L / ours.reservoir_volume_L,
        "speed": design.inflation_kPa_per_s / prototype.inflation_kPa_per_s,
        "air_supply": air,
    }
    return Compass(all_six, {metric: moved(metric, factors.get(metric, 1.0)) for metric in METRICS})
