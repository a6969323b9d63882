"""What a cause is: a named effect that the baseline lacks, its parameters, and what it does to a rig.

`apply` takes a plant with its sensors, and the parameters by their names, and gives the plant with the
effect in it. The simulation and the fit both run that plant. To add a cause, add a file to `effects` with one
`CAUSE` in it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import exp, log
from typing import TYPE_CHECKING, NamedTuple

from flying_vines.physics.plant.setup import Setup

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from flying_vines.physics.plant.commands import Commands

Values = tuple[float, ...]


class ModelReadings(NamedTuple):
    """(n,) kPa gauge."""

    cv_kPa: NDArray[np.float64]
    reservoir_kPa: NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """A number that a fit may choose."""

    name: str
    """With its unit."""
    low: float
    high: float
    """Beyond these no rig is; a fit that ends here is evidence against the cause."""
    seeds: tuple[float, ...]
    """Where fits begin: far enough apart that one of them finds the way."""
    neutral: float | None
    """Where the cause does nothing; may be infinite. None where it always does something."""
    source: str
    """Of the range."""
    logarithmic: bool = False
    """Whether the fit moves along its logarithm."""
    typical: tuple[float, float] | None = None
    """Mean and standard deviation over rigs (of the logarithm, if that is moved): what stands where the data
    say nothing."""

    def to_search(self, value: float) -> float:
        """What the fit moves."""
        return log(value) if self.logarithmic else value

    @property
    def range(self) -> float:
        """Of what the fit moves."""
        return self.to_search(self.high) - self.to_search(self.low)

    def within(self, searched: float) -> float:
        """The value there, or the bound if that is nearer."""
        return self.to_model(min(max(searched, self.to_search(self.low)), self.to_search(self.high)))

    def share(self, value: float) -> float:
        """How far along its range a value is, 0…1."""
        return (self.to_search(value) - self.to_search(self.low)) / self.range if self.range > 0.0 else 0.5

    def prior_penalty(self, searched: float) -> float:
        """How far from typical a value is: squared, in standard deviations."""
        if self.typical is None:
            return 0.0
        mean, sd = self.typical
        return ((searched - mean) / sd) ** 2

    def to_model(self, searched: float) -> float:
        return exp(searched) if self.logarithmic else searched


@dataclass(frozen=True)
class Cause:
    """A physical or measuring effect."""

    name: str
    what: str
    """In plain words, what is different in the rig."""
    parameters: tuple[Parameter, ...]
    experiment: str
    """A minute's recording that shows it best."""
    apply: Callable[..., Setup] | None = None
    commands: Callable[[Commands, Values], Commands] | None = None
    """What a bench's valves do beside: only a fit knows it, as the next."""
    readings: Callable[[ModelReadings, Values], ModelReadings] | None = None

    def put_into(self, setup: Setup, parameters: Mapping[str, float]) -> Setup:
        """The setup with this cause."""
        return self.apply(setup, **parameters) if self.apply else setup

    def seeds(self) -> list[Values]:
        """Where fits begin: the first parameter's seeds, the others where they begin first."""
        rest = tuple(parameter.seeds[0] for parameter in self.parameters[1:])
        return [(seed, *rest) for seed in self.parameters[0].seeds]
