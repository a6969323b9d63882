"""Data of the paper "phloSAR": the curves of its figures, and the numbers of its text.

The CSV files have every number of Fig. 3 and 5, unchanged, one file for each curve. `stated.toml` has the
numbers of the text, with their place. The paper does not print the time series of Fig. 4 and 6 as numbers.
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

__all__ = ["CURVES", "Condition", "PaperDataError", "PrintedCurve", "Stated", "condition", "curve", "stated"]

DISCHARGES = ("4L_highRv", "4L_lowRv", "2L_lowRv")
CURVES = (
    *(f"discharge_{series}_{kind}" for series in DISCHARGES for kind in ("measured", "model")),
    *(f"frequency_{kind}_tc{n}" for n in (4, 5) for kind in ("measured", "model")),
    "frequency_baseline1",
    "frequency_baseline2",
)
"""Names of the printed curves."""


class PaperDataError(ValueError):
    """The paper has no such curve or test condition, or a file is damaged; the text is one sentence."""


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
    """The printed curve with a name from `CURVES`. Raises PaperDataError for another name."""
    if name not in CURVES:
        raise PaperDataError(f"the paper prints no curve {name!r}; it prints {', '.join(CURVES)}.")
    return parse_curve(name, resources.files(__name__).joinpath(f"{name}.csv").read_text(encoding="utf-8"))


def parse_curve(name: str, text: str) -> PrintedCurve:
    """The curve in a CSV text: a header, then x, y and possibly the deviation upwards and downwards."""
    header, *rows = list(csv.reader(text.splitlines())) or [[]]
    try:
        table = np.array(rows, dtype=np.float64)
    except ValueError:
        raise PaperDataError(f"{name}: a row has a cell that is not a number.") from None
    if table.ndim != 2 or table.shape[1] != len(header) or len(header) < 2 or not np.isfinite(table).all():
        raise PaperDataError(f"{name}: each row needs two or more finite numbers.")
    return PrintedCurve(name, table[:, 0], table[:, 1], table[:, 2] if len(header) > 2 else None)


@cache
def stated() -> Mapping[str, Stated]:
    """The numbers of the text, by keys such as `tc4.cutoff_measured`."""
    return MappingProxyType({number.key: number for number in _numbers(_tables(), "")})


def condition(name: str) -> Condition:
    """The test condition `tc1` … `tc5`. Raises PaperDataError for another name."""
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
