"""Formats numbers with units, and with the digits that the data determine."""

from __future__ import annotations

from math import floor, isfinite, log10

from flying_vines.identification.candidate import STRUCTURE
from flying_vines.identification.residuals import Pattern
from flying_vines.identification.verdict import ParameterEstimate

_UNITS = {
    "_kPa2_s_per_SL": "kPa²·s/SL",
    "_SL_per_s_kPa": "SL/(s·kPa)",
    "_kPa_per_min": "kPa/min",
    "_SL_per_s": "SL/s",
    "_kPa_s_per_SL": "kPa·s/SL",
    "_kPa_per_s": "kPa/s",
    "_per_kPa": "1/kPa",
    "_kPa": "kPa",
    "_L": "L",
    "_s": "s",
}
"""Unit by the ending of a name. The first that fits counts, so `_kPa_per_s` stands before `_s`."""
_HUGE = 1e6
_RAISED = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
_CHANCE = 1.3
"""−log₁₀ of 1 in 20."""


def label_and_unit(name: str) -> tuple[str, str]:
    """Label and unit of a name: `volume_L` gives (volume, L)."""
    for ending, unit in _UNITS.items():
        if f"_{name}".endswith(ending):
            return f"_{name}".removesuffix(ending).replace("_", " ").strip() or "change", unit
    return name.replace("_", " "), ""


def labelled(name: str) -> str:
    """The label with its unit, for an axis."""
    label, unit = label_and_unit(name)
    return f"{label}, {unit}" if unit else label


def numbers(estimate: ParameterEstimate) -> tuple[str, str, str]:
    """The estimate and the ends of its interval, rounded to two digits of the interval's half width."""
    half = 0.5 * (estimate.high - estimate.low)
    values = (estimate.estimate, estimate.low, estimate.high)
    if max(map(abs, values)) >= _HUGE:
        first, low, high = map(_in_powers, values)
        return first, low, high
    form = f",.{max(0, 1 - floor(log10(half)))}f" if isfinite(half) and half > 0.0 else ".4g"
    first, low, high = (signed(format(value, form)) for value in values)
    return first, low, high


def _in_powers(value: float) -> str:
    """The number, with a power of ten if it is large."""
    if abs(value) < _HUGE:
        return rounded(value)
    mantissa, exponent = f"{value:.2e}".split("e+")
    return f"{signed(mantissa)}\N{NO-BREAK SPACE}×\N{NO-BREAK SPACE}10{str(int(exponent)).translate(_RAISED)}"


def chance(pattern: Pattern) -> str:
    """How often noise alone gives such a pattern, in words."""
    if pattern.log_p < _CHANCE:
        return "noise alone gives this"
    if pattern.log_p < STRUCTURE:
        return f"noise gives this once in {10.0**pattern.log_p:,.0f} cases"
    return "noise practically never gives this"


def signed(number: str) -> str:
    """The number with a minus sign instead of a hyphen."""
    return number.replace("-", "−")


def share(value: float) -> str:
    """Percent with three significant digits."""
    return f"{100.0 * value:.3g} %"


def rounded(value: float) -> str:
    """Three significant digits, and whole numbers from 100."""
    return signed(f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.3g}")
