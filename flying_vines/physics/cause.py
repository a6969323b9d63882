"""A cause is a named effect that the baseline lacks. It has parameters, and a function that changes a rig.

This function is `apply`. It takes a setup (a plant with its sensors) and the parameters by name, and returns
the setup with the effect. The simulation and the fit both run this setup. To add a cause, define it in a
file of `effects`; or outside this project, exactly so, in a Python file, or in an installed package that
names its causes as entry points of the group `flying_vines.causes`.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import exp, inf, log
from typing import TYPE_CHECKING, NamedTuple

from flying_vines.physics.plant.plant import Setup
from flying_vines.physics.rig import RigError, Vessel

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from flying_vines.physics.plant.commands import Commands


import sys
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType

from flying_vines.files.bounded import read_bytes
from flying_vines.physics.plant.plant import perfect
from flying_vines.physics.rig import Pump, Rig

OFF_NEUTRAL = 0.03
"""Step from a parameter's neutral value to a value with an effect, as a share of the parameter's range."""
Values = tuple[float, ...]


class CauseError(RigError):
    """A cause from outside this project cannot be used. The text is one line: file, line if known, reason."""


class ModelReadings(NamedTuple):
    """Simulated readings, each (n,) kPa gauge."""

    cv_kPa: NDArray[np.float64]
    reservoir_kPa: NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """A fitted number of a cause."""

    name: str
    """With its unit, such as `time_constant_s`."""
    low: float
    """Lower bound of real rigs."""
    high: float
    """Upper bound of real rigs. A fit that ends on a bound is evidence against the cause, unless the
    parameter has a prior (`typical`)."""
    seeds: tuple[float, ...]
    """Starting values of fits, spread so that the fit converges from at least one of them."""
    neutral: float | None
    """The value without effect; may be infinite. None if every value has an effect."""
    source: str
    """Source of the range."""
    logarithmic: bool = False
    """True if the search scale is the logarithm."""
    typical: tuple[float, float] | None = None
    """Prior: mean and standard deviation over rigs, on the search scale."""
    of_largest: tuple[Vessel, float] | None = None
    """A vessel and a share: the bounds are also within ± this share of its sensor's largest reading.

    A vessel at low pressure has a sensor with a small span, and so with small errors.
    """

    def __post_init__(self) -> None:
        if not self.low <= self.high or (self.logarithmic and not self.low > 0.0):
            raise ValueError(f"{self.name}: low must not be above high, and must be above 0 if logarithmic")
        # A fit with a fixed parameter sets both bounds to its value and leaves the seeds unchanged.
        within = self.low == self.high or all(self.low <= seed <= self.high for seed in self.seeds)
        if not self.seeds or not within:
            raise ValueError(f"{self.name}: needs seeds between low and high")

    def within_readings(self, largest_kPa: Mapping[Vessel, float]) -> Parameter:
        """This parameter with bounds limited by the largest readings (kPa; 0: sensor not recorded)."""
        if self.of_largest is None or not largest_kPa[self.of_largest[0]]:
            return self
        most = self.of_largest[1] * largest_kPa[self.of_largest[0]]
        return replace(self, low=max(self.low, -most), high=min(self.high, most))

    def to_search(self, value: float) -> float:
        """The value on the search scale."""
        return log(value) if self.logarithmic else value

    @property
    def range(self) -> float:
        """Width of the range on the search scale."""
        return self.to_search(self.high) - self.to_search(self.low)

    @property
    def two_sided(self) -> bool:
        """True if a value may lie on either side of neutral."""
        return self.neutral is not None and self.low < self.neutral < self.high

    def within(self, searched: float) -> float:
        """The value at a point of the search scale, clipped to the bounds."""
        return self.to_model(min(max(searched, self.to_search(self.low)), self.to_search(self.high)))

    def share(self, value: float) -> float:
        """Position of a value within its range, 0…1."""
        return (self.to_search(value) - self.to_search(self.low)) / self.range if self.range > 0.0 else 0.5

    def distance(self, value: float) -> float:
        """Distance from neutral on the search scale; 1 if it would be infinite, 0 without a neutral value."""
        if self.neutral is None:
            return 0.0
        if self.logarithmic and not 0.0 < self.neutral < inf:
            return 1.0
        return abs(self.to_search(value) - self.to_search(self.neutral))

    def with_effect(self, value: float) -> float:
        """The value. A neutral value is raised by the share `OFF_NEUTRAL` of the range."""
        if value != self.neutral:
            return value
        return self.to_model(self.to_search(value) + OFF_NEUTRAL * self.range)

    def prior_penalty(self, searched: float) -> float:
        """Squared distance from the prior's mean, in standard deviations."""
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
    """The difference in the rig, in plain words."""
    parameters: tuple[Parameter, ...]
    experiment: str
    """The experiment whose recording shows the cause best."""
    apply: Callable[..., Setup] | None = None
    needs: tuple[str, ...] = ()
    """Tables of the rig file without which the cause has no effect."""
    commands: Callable[[Commands, Values], Commands] | None = None
    """A further change of the valve commands; only used in fits."""
    readings: Callable[[ModelReadings, Values], ModelReadings] | None = None
    """A further change of the readings; only used in fits."""
    law_of: str = ""
    """Name of a thing that several causes describe by different laws, such as "a leak of the reservoir". A
    set of causes has at most one of these causes. Empty if only this cause describes the thing."""
    is_flow_law: bool = False
    """True if it replaces the baseline's law of a valve's flow: no value makes it weak."""
    defined_in: str = ""
    """File or package of a cause from outside this project."""

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise ValueError(f"{self.name!r} is not a name of a cause: use letters, digits and _")

    def within_readings(self, largest_kPa: Mapping[Vessel, float]) -> Cause:
        """This cause with bounds limited by the largest readings (kPa; 0: sensor not recorded)."""
        return replace(self, parameters=tuple(p.within_readings(largest_kPa) for p in self.parameters))

    def excludes(self, other: Cause) -> bool:
        """True if both are the same cause, or laws of the same thing."""
        return self.name == other.name or (self.law_of != "" and self.law_of == other.law_of)

    def put_into(self, setup: Setup, parameters: Mapping[str, float]) -> Setup:
        """The setup with this cause. Raises CauseError for an error in a cause from outside."""
        if self.apply is None:
            return setup
        if not self.defined_in:
            return self.apply(setup, **parameters)
        try:
            made = self.apply(setup, **parameters)
        except Exception as error:
            values = ", ".join(f"{name} = {value:g}" for name, value in parameters.items())
            raise CauseError(f"{self._line(error)}: {type(error).__name__}: {error} (at {values})") from None
        if not isinstance(made, Setup):
            raise CauseError(f"{self._line()}: apply must return the changed rig, not {made!r}")
        return made

    def _line(self, error: BaseException | None = None) -> str:
        """File and line of `apply`; for an error, the last line of that file in the traceback."""
        code = getattr(self.apply, "__code__", None)
        if code is None:
            return f"{self.defined_in}: cause {self.name}"
        frames = traceback.extract_tb(error.__traceback__ if error else None)
        lines = [frame.lineno for frame in frames if frame.filename == code.co_filename]
        return f"{code.co_filename}:{lines[-1] if lines else code.co_firstlineno}"

    def seeds(self) -> list[Values]:
        """Starting values of fits: each seed of the first parameter, with the first seed of the others."""
        rest = tuple(parameter.seeds[0] for parameter in self.parameters[1:])
        return [(seed, *rest) for seed in self.parameters[0].seeds]

    def nearest_seed(self, values: Values) -> Values:
        """The starting values whose first parameter is nearest to that of these values."""
        first = self.parameters[0]
        return min(self.seeds(), key=lambda seed: abs(first.to_search(seed[0]) - first.to_search(values[0])))


ENTRY_POINTS = "flying_vines.causes"


def read_causes(path: Path | str) -> tuple[Cause, ...]:
    """The causes that a Python file defines. The file is run.

    Raises CauseError if the file cannot be read or has an error.
    """
    path = Path(path)
    module = ModuleType(f"cause_file_{path.stem}")
    module.__file__ = str(path)
    # A dataclass looks up its module in sys.modules.
    sys.modules[module.__name__] = module
    try:
        exec(compile(read_bytes(path), str(path), "exec"), vars(module))
    except OSError as error:
        raise CauseError(f"{path}: {error.strerror}") from None
    except SyntaxError as error:
        raise CauseError(f"{path}:{error.lineno}: {error.msg}") from None
    except (Exception, SystemExit) as error:
        raise CauseError(_located(error, str(path))) from None
    found = {value.name: value for value in vars(module).values() if isinstance(value, Cause)}
    if not found:
        raise CauseError(f"{path}: defines no cause: write CAUSE = Cause(...)")
    return tuple(_checked(replace(cause, defined_in=path.name), str(path)) for cause in found.values())


def installed_causes() -> tuple[Cause, ...]:
    """The causes of installed packages. Raises CauseError if one cannot be loaded."""
    return tuple(map(_loaded, entry_points(group=ENTRY_POINTS)))


def _loaded(point: EntryPoint) -> Cause:
    package = f"package {point.dist.name}" if point.dist else point.module
    try:
        cause = point.load()
    except Exception as error:
        raise CauseError(f"{package}: cause {point.name}: {type(error).__name__}: {error}") from None
    if not isinstance(cause, Cause):
        raise CauseError(f"{package}: {point.value} is not a Cause")
    return _checked(replace(cause, defined_in=package), package)


def _checked(cause: Cause, where: str) -> Cause:
    """Returns the cause after applying it once to a default rig, so that its errors appear now."""
    if cause.apply is None:
        raise CauseError(f"{where}: cause {cause.name} needs apply=: a function that changes a rig")
    values = dict(zip([p.name for p in cause.parameters], cause.seeds()[0], strict=True))
    cause.put_into(perfect(replace(Rig(), pump=Pump()) if "pump" in cause.needs else Rig()), values)
    return cause


def _located(error: BaseException, path: str) -> str:
    """The error's text, with the last line of this file in the traceback."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == path]
    where = f"{path}:{lines[-1]}" if lines else path
    return f"{where}: {type(error).__name__}: {error}"
