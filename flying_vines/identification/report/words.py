"""Numbers as people read them: with their units, and no more digits than the data fix."""

from __future__ import annotations

from math import floor, isfinite, log10

from flying_vines.identification.residuals import Pattern
from flying_vines.identification.search import STRUCTURE
from flying_vines.identification.verdict import Estimate

_UNITS = {
    "_kPa_s_per_SL": "kPa·s/SL",
    "_kPa_per_s": "kPa/s",
    "_per_kPa": "1/kPa",
    "_kPa": "kPa",
    "_L": "L",
    "_s": "s",
}
"""By how a name ends, the longest first."""
_HUGE = 1e6
_RAISED = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
_CHANCE = 1.3
"""−log₁₀ of one in twenty."""


def label_and_unit(name: str) -> tuple[str, str]:
    """`volume_L` → volume, L."""
    for ending, unit in _UNITS.items():
        if f"_{name}".endswith(ending):
            return f"_{name}".removesuffix(ending).replace("_", " ").strip() or "change", unit
    return name.replace("_", " "), ""


def labelled(name: str) -> str:
    """The label with its unit, as an axis has it."""
    label, unit = label_and_unit(name)
    return f"{label}, {unit}" if unit else label


def numbers(estimate: Estimate) -> tuple[str, str, str]:
    """The estimate and the ends of its interval, to the second digit of the interval's half width."""
    half = 0.5 * (estimate.high - estimate.low)
    values = (estimate.estimate, estimate.low, estimate.high)
    if max(map(abs, values)) >= _HUGE:
        first, low, high = map(_in_powers, values)
        return first, low, high
    form = f",.{max(0, 1 - floor(log10(half)))}f" if isfinite(half) and half > 0.0 else ".4g"
    first, low, high = (signed(format(value, form)) for value in values)
    return first, low, high


def _in_powers(value: float) -> str:
    """With a power of ten, if it is huge."""
    if abs(value) < _HUGE:
        return rounded(value)
    mantissa, exponent = f"{value:.2e}".split("e+")
    return f"{signed(mantissa)} × 10{str(int(exponent)).translate(_RAISED)}"


def how_surprising(pattern: Pattern) -> str:
    """How often noise alone would do this."""
    if pattern.surprise < _CHANCE:
        return "noise alone does this"
    if pattern.surprise < STRUCTURE:
        return f"noise does this once in {10.0**pattern.surprise:,.0f} times"
    return "noise practically never does this"


def signed(number: str) -> str:
    """With a minus sign instead of a hyphen."""
    return number.replace("-", "−")


def share(value: float) -> str:
    """Percent with three digits that count."""
    return f"{100.0 * value:.3g} %"


def rounded(value: float) -> str:
    """Three digits that count, and whole numbers from a hundred on."""
    return signed(f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.3g}")
