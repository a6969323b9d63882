"""Data of the paper "phloSAR": the curves of its figures, and the numbers of its text.

The CSV files have every number of Fig. 3 and 5, unchanged, one file for each curve. `stated.toml` has the
numbers of the text, with their place. The paper does not print the time series of Fig. 4 and 6 as numbers.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

DISCHARGES = ("4L_highRv", "4L_lowRv", "2L_lowRv")


@dataclass(frozen=True)
class PrintedCurve:
    """One printed curve, in the order of the paper's rows.

    `x` is time in s (discharge) or command frequency in Hz; `y` reservoir pressure in kPa gauge, or gain.
    """

    name: str
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    std: NDArray[np.float64] | None = None
    """One standard deviation of `y`, if the paper draws error bars."""


@dataclass(frozen=True)
class Stated:
    """A number in the paper's text."""

    key: str
    value: float
    """In `unit`; NaN if the paper names the quantity without a number."""
    unit: str
    place: str
    """Section or figure."""
    half_digit: float
    """Half of the last printed digit: the rounding error."""
    says: str


@dataclass(frozen=True)
class Condition:
    """One of the test conditions TC1 to TC5, as stated (Sec. V-B, V-C)."""

    name: str
    swing_kPa: float
    """ΔP_cv of a step, A of a sine."""
    cv_volume_L: float
    reservoir_kPa: float


def curve(name: str) -> PrintedCurve:
    """The printed curve in the file `name`.csv: x, y, and possibly the deviation of y up and down."""
    text = resources.files(__name__).joinpath(f"{name}.csv").read_text(encoding="utf-8")
    x, y, *deviations = np.loadtxt(text.splitlines()[1:], delimiter=",", unpack=True)
    return PrintedCurve(name, x, y, deviations[0] if deviations else None)


@cache
def stated() -> Mapping[str, Stated]:
    """The numbers of the text, by keys such as `tc4.cutoff_measured`."""
    return MappingProxyType({number.key: number for number in _numbers(_tables(), "")})


def condition(name: str) -> Condition:
    """The test condition `tc1` … `tc5`."""
    table = _tables()[name]
    return Condition(name, table["swing_kPa"], table["cv_volume_L"], table["reservoir_kPa"])


@cache
def _tables() -> dict[str, Any]:
    return tomllib.loads(resources.files(__name__).joinpath("stated.toml").read_text(encoding="utf-8"))


def _numbers(table: Mapping[str, Any], prefix: str) -> Iterator[Stated]:
    for key, value in table.items():
        if not isinstance(value, Mapping):
            continue
        if "unit" in value:
            yield Stated(
                key=prefix + key,
                value=value.get("value", math.nan),
                unit=value["unit"],
                place=value["place"],
                half_digit=value.get("half_digit", 0.0),
                says=value["says"],
            )
        yield from _numbers(value, f"{prefix}{key}.")
