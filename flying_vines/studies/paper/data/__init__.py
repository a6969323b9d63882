"""What the paper "phloSAR" prints: the curves of its figures, and the numbers that its text states.

The CSV files hold every number of Fig. 3 and 5, unchanged, one curve each; `stated.toml` the numbers of the
text, with their place in the paper. The time series of Fig. 4 and 6 are not printed as numbers.
"""

from __future__ import annotations

import csv
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

__all__ = ["CURVES", "Condition", "Curve", "PaperDataError", "Stated", "condition", "curve", "stated"]

DISCHARGES = ("4L_highRv", "4L_lowRv", "2L_lowRv")
CURVES = (
    *(f"discharge_{series}_{kind}" for series in DISCHARGES for kind in ("measured", "model")),
    *(f"frequency_{kind}_tc{n}" for n in (4, 5) for kind in ("measured", "model")),
    "frequency_baseline1",
    "frequency_baseline2",
)
"""Names of the printed curves."""


class PaperDataError(ValueError):
    """Something that the paper does not print, or a file that is damaged; one sentence."""


@dataclass(frozen=True)
class Curve:
    """One printed curve, in the order of the paper's rows.

    `x` is time in s (discharge) or command frequency in Hz; `y` reservoir pressure in kPa gauge, or gain.
    """

    name: str
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    std: NDArray[np.float64] | None = None
    """One standard deviation of `y`, where the paper draws error bars."""


@dataclass(frozen=True)
class Stated:
    """A number that the text states."""

    key: str
    value: float
    """In `unit`; NaN where the paper names the quantity without a number."""
    unit: str
    place: str
    """Section or figure."""
    half_digit: float
    """Half of the last printed digit: what rounding may hide."""
    says: str


@dataclass(frozen=True)
class Condition:
    """TC1 to TC5, as stated (Sec. V-B, V-C)."""

    name: str
    swing_kPa: float
    """ΔP_cv of a step, A of a sine."""
    cv_volume_L: float
    reservoir_kPa: float


def curve(name: str) -> Curve:
    """A printed curve by its name, one of `CURVES`. PaperDataError for any other."""
    if name not in CURVES:
        raise PaperDataError(f"the paper prints no curve {name!r}; it prints {', '.join(CURVES)}.")
    return parse_curve(name, resources.files(__name__).joinpath(f"{name}.csv").read_text(encoding="utf-8"))


def parse_curve(name: str, text: str) -> Curve:
    """The curve in a CSV text: a header, then x, y and possibly the deviation upwards and downwards."""
    header, *rows = list(csv.reader(text.splitlines())) or [[]]
    try:
        table = np.array(rows, dtype=np.float64)
    except ValueError:
        raise PaperDataError(f"{name}: a row that is no row of numbers.") from None
    if table.ndim != 2 or table.shape[1] != len(header) or len(header) < 2 or not np.isfinite(table).all():
        raise PaperDataError(f"{name}: rows of two numbers or more are needed, all finite.")
    return Curve(name, table[:, 0], table[:, 1], table[:, 2] if len(header) > 2 else None)


@cache
def stated() -> Mapping[str, Stated]:
    """The numbers that the text states, by key such as `tc4.cutoff_measured`."""
    return MappingProxyType({number.key: number for number in _numbers(_tables(), "")})


def condition(name: str) -> Condition:
    """One of `tc1` … `tc5`. PaperDataError for any other."""
    table = _tables().get(name, {})
    if "swing_kPa" not in table:
        raise PaperDataError(f"the paper has no test condition {name!r}; it has tc1 to tc5.")
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
