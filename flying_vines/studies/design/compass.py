"""The paper's comparison of pressure supplies and regulators (Fig. 2), rated from its text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from flying_vines.config.config import ConfigError
from flying_vines.files.toml_text import converted
from flying_vines.studies.design.evaluate import Evaluation

METRICS = ("cost", "weight", "size", "speed", "range", "air_supply", "renewability")
"""A higher rating is better: a high rating for cost means a low cost."""


class Rating(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """1 (worst) to 5 (best), with the paper's sentence that supports it, or the reason of a judgement."""

    value: Annotated[float, Meta(ge=1, le=5)]
    says: Annotated[str, Meta(min_length=1)]
    place: str = ""
    judgement: bool = False

    def __post_init__(self) -> None:
        if self.judgement == bool(self.place):
            raise ValueError("a rating needs either the place of its quotation, or judgement = true")


class Solution(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A way to supply or regulate pressure. None: no value, as for the air supply of a regulator."""

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
    """The paper's six solutions, and the ratings of a design."""

    solutions: Mapping[str, Solution]
    design: Mapping[str, float]


def solutions() -> dict[str, Solution]:
    """The six solutions that the paper compares, from `compass.toml`."""
    text = resources.files("flying_vines.studies.design").joinpath("compass.toml").read_text(encoding="utf-8")
    found: Any = converted(text, "compass.toml", dict[str, Solution], ConfigError)
    return {name: solution for name, solution in found.items() if isinstance(solution, Solution)}


def compass(design: Evaluation, prototype: Evaluation) -> Compass:
    """The ratings of a design, beside those of the paper's solutions.

    A design gets the phloSAR's ratings. Each factor of two between it and the prototype moves a rating by one
    step: weight, size (reservoir volume), speed (inflation) and air supply (air in the reservoir). Cost,
    range and renewability stay, because a choice of parts does not determine them.

    Args:
        design: the evaluated design.
        prototype: the paper's parts, for the same robot.
    """
    all_six = solutions()
    phlosar = all_six["phlosar"]

    def moved(metric: str, factor: float) -> float:
        rating = phlosar.rating(metric)
        assert rating is not None
        return min(max(rating.value + math.log2(factor), 1.0), 5.0) if factor > 0.0 else 1.0

    volume_L, prototype_L = design.parts.reservoir_volume_L, prototype.parts.reservoir_volume_L
    factors = {
        "weight": prototype.mass_kg / design.mass_kg,
        "size": prototype_L / volume_L,
        "speed": design.inflation_kPa_per_s / prototype.inflation_kPa_per_s,
        "air_supply": (volume_L * design.fill_kPa) / (prototype_L * prototype.fill_kPa),
    }
    return Compass(all_six, {metric: moved(metric, factors.get(metric, 1.0)) for metric in METRICS})
