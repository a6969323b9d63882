"""Units of measured columns: the table, the unit in a column's name, and a guess if the name has none."""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import inf, log
from typing import Literal, NamedTuple

import numpy as np

from flying_vines.identification.noise import without_spikes
from flying_vines.identification.recording import CaseError
from flying_vines.physics.arrays import Array
from flying_vines.physics.gas import STANDARD_PRESSURE_KPA
from flying_vines.physics.plant.flow import Iso6358, flow_SL_per_s

Quantity = Literal["time", "pressure", "opening", "temperature", "volume", "raw"]


class Unit(NamedTuple):
    """A unit. `factor` · reading + `offset` is the value in kPa, s, 0…1, °C or L."""

    name: str
    quantity: Quantity
    factor: float
    words: tuple[str, ...] = ()
    """Other spellings, in lower case."""
    offset: float = 0.0
    absolute: bool = False
    cost: float = inf
    """-log of the probability of this unit if none is named, relative to kPa or s; inf: never guessed."""


UNITS = (
    Unit("kPa", "pressure", 1.0, ("kilopascal", "kilopascals"), cost=0.0),
    Unit("bar", "pressure", 100.0, ("bars",), cost=0.5),
    Unit("psi", "pressure", 6.894757, ("lbf/in2", "lb/in2"), cost=1.2),
    Unit("mbar", "pressure", 0.1, ("millibar", "mb", "hpa", "hectopascal"), cost=1.5),
    Unit("Pa", "pressure", 0.001, ("pascal", "pascals"), cost=1.0),
    Unit("MPa", "pressure", 1000.0, ("megapascal",), cost=1.5),
    Unit("cmH2O", "pressure", 0.0980665, ("cm h2o", "cmwc")),
    Unit("mmHg", "pressure", 0.1333224, ("mm hg", "torr")),
    Unit("inHg", "pressure", 3.386389, ("in hg",)),
    Unit("inH2O", "pressure", 0.2490889, ("in h2o", "inwc")),
    Unit("kgf/cm2", "pressure", 98.0665, ("kg/cm2", "kgf/cm²", "kg/cm²")),
    Unit("atm", "pressure", 101.325),
    Unit(
        "s", "time", 1.0, ("sec", "secs", "second", "seconds", "sek", "seg", "segundos", "sekunden"), cost=0.0
    ),
    Unit("ms", "time", 1e-3, ("msec", "millis", "millisecond", "milliseconds"), cost=1.0),
    Unit("us", "time", 1e-6, ("µs", "μs", "usec", "micros", "microsecond", "microseconds"), cost=2.0),
    Unit("ns", "time", 1e-9, ("nsec", "nanoseconds"), cost=6.0),
    Unit("min", "time", 60.0, ("mins", "minute", "minutes"), cost=3.0),
    Unit("h", "time", 3600.0, ("hr", "hour", "hours"), cost=5.0),
    Unit("clock", "time", 1.0),
    Unit("0-1", "opening", 1.0, ("frac", "fraction", "on/off")),
    Unit("%", "opening", 0.01, ("percent", "pct", "prozent")),
    Unit("0-255", "opening", 1.0 / 255.0, ("pwm", "uint8", "8bit")),
    Unit("C", "temperature", 1.0, ("°c", "degc", "celsius")),
    Unit("K", "temperature", 1.0, ("kelvin",), offset=-273.15),
    Unit("F", "temperature", 5.0 / 9.0, ("°f", "degf", "fahrenheit"), offset=-160.0 / 9.0),
    Unit("L", "volume", 1.0, ("l", "litre", "liter", "litres", "dm3")),
    Unit("mL", "volume", 1e-3, ("cm3", "cc", "cm³", "millilitre")),
    Unit("V", "raw", 1.0, ("volt", "volts", "voltage")),
    Unit("mV", "raw", 1.0, ("millivolt", "millivolts")),
    Unit("counts", "raw", 1.0, ("adc", "raw", "lsb", "count")),
)
_BY_WORD = {word: unit for unit in UNITS for word in (unit.name.casefold(), *unit.words)}
_LETTERS = frozenset({"s", "v", "h", "c", "k", "f", "l", "min", "atm", "raw", "adc", "count", "counts"})
"""Units that are also letters or words of names: they only count in brackets or at the end of a name."""
_GAUGE = re.compile(r"[ (]*(gauge|gage|rel|g)\)?$")
_ABSOLUTE = re.compile(r"[ (]*(absolute|abs|a)\)?$")
_POINTS = re.compile(
    r"\s*(\w+)\s*\(?\s*([-+.\d]+)\s*=\s*([-+.\d]+)(?: kpa)?\s*,\s*([-+.\d]+)\s*=\s*([-+.\d]+)(?: kpa)?\s*\)?"
)
_FULL_SCALE = re.compile(r"0\s*(?:-|–|…|\.\.+|to)\s*(\d+)")
STROKES = frozenset({"angle", "position", "displacement", "stroke", "speed", "rpm"})
"""Words for the motion of a valve or pump."""
FULL_SCALES = (1.0, 100.0, 255.0, 1023.0, 4095.0, 65535.0)
_TYPICAL = {"reservoir_pressure": (600.0, 1.0), "ambient_pressure": (100.0, 0.1)}
_TYPICAL_KPA = (50.0, 1.5)
"""Typical largest reading of a pressure column, and the spread of its natural logarithm."""
AMBIENT_KPA = 85.0, 106.0
"""Range of ambient pressure in laboratories, absolute."""
_RESTS = 1.5
"""Subtracted from the cost of a unit in which the lowest readings are about ambient pressure.

An absolute sensor gives such readings. The value is so small that a chamber that rests at 14 kPa is not read
as 14 psi.
"""
_SAID = 4.0
"""Subtracted from the cost of a unit that the file names for another pressure."""


def parse_unit(text: str) -> Unit:
    """The unit that a person wrote: `psi`, `bar abs`, `0-1023`, `V (0.5 = 0, 4.5 = 1000)`."""
    if unit := _spelled(text):
        return unit
    raise CaseError(
        f"{text!r} is not a unit; use one of {', '.join(unit.name for unit in UNITS)}, bar abs for an "
        "absolute pressure, 0-1023 for a full scale, or V (0.5=0, 4.5=1000) for two points of a calibration"
    )


def _spelled(text: str) -> Unit | None:
    plain = text.strip().casefold()
    if points := _POINTS.fullmatch(plain):
        unit = _BY_WORD.get(points[1])
        try:
            x0, y0, x1, y1 = (float(number) for number in points.groups()[1:])
        except ValueError:
            return None
        if unit is None or unit.quantity != "raw" or x0 == x1 or y0 == y1:
            return None
        factor = (y1 - y0) / (x1 - x0)
        name = f"{unit.name} ({x0:g}={y0:g}, {x1:g}={y1:g})"
        return Unit(name, "pressure", factor, offset=y0 - factor * x0)
    if plain in _BY_WORD:
        return _BY_WORD[plain]
    if (scale := _FULL_SCALE.fullmatch(plain)) and 1 < int(scale[1]) < 1 << 32:
        return Unit(f"0-{int(scale[1])}", "opening", 1.0 / int(scale[1]))
    unit = _BY_WORD.get(_GAUGE.sub("", plain).strip())
    if unit and unit.quantity == "pressure":
        return unit
    unit = _BY_WORD.get(_ABSOLUTE.sub("", plain).strip())
    return as_absolute(unit) if unit and unit.quantity == "pressure" else None


def as_absolute(unit: Unit) -> Unit:
    """The same unit for absolute readings, which become gauge pressures at standard ambient pressure."""
    if unit.absolute:
        return unit
    offset = unit.offset - STANDARD_PRESSURE_KPA
    return unit._replace(name=f"{unit.name} abs", offset=offset, absolute=True)


def words_of(name: str) -> list[str]:
    """The words of a column's name in lower case: `PWM_Main` and `pwmMain` are pwm, main."""
    apart = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[a-z]{2})(?=\d)", " ", name)
    return [word for word in re.split(r"[^\w%°µμ²³]+|_", apart.casefold()) if word]


def unit_in(name: str) -> Unit | None:
    """The unit that a column's name contains; None if there is none."""
    found = None
    for text in re.findall(r"[(\[{]([^)\]}]*)[)\]}]", name) + re.findall(r"/\s*([\w%°µμ]+)$", name):
        found = found or _spelled(text)
    words = re.split(r"[^\w%°µμ²³]+|_", name.casefold())
    words = [word for word in words if word]
    for at, word in enumerate(words):
        is_last = at == len(words) - 1 and at > 0
        if found is None and (is_last or word not in _LETTERS) and word not in ("a", "g"):
            found = _spelled(word) if word in _BY_WORD or len(word) > 2 else None
    if found and found.quantity == "pressure" and {"abs", "absolute"} & set(words_of(name)):
        return as_absolute(found)
    return found


class UnitGuess(NamedTuple):
    """A guessed unit, why, and the next best if it is nearly as likely."""

    unit: Unit
    why: str
    other: str = ""


def guess_pressure(
    values: Array, meaning: str, beside: Sequence[tuple[Array, str]] = (), labelled: Sequence[Unit] = ()
) -> UnitGuess:
    """The unit of a pressure column by the size of its readings.

    Args:
        values: the readings.
        meaning: of the column.
        beside: readings and meanings of other columns in the same unit.
        labelled: units that the file names for other pressures; this column probably has one of them.
    """
    said = {unit.name.removesuffix(" abs") for unit in labelled}
    costs = {
        unit: (0.0 if unit.name in said else unit.cost) - _SAID * (unit.name in said)
        for unit in UNITS
        if unit.quantity == "pressure" and (unit.cost < inf or unit.name in said)
    }
    for readings, what in ((values, meaning), *beside):
        center_kPa, width = _TYPICAL.get(what, _TYPICAL_KPA)
        in_order, top = np.sort(readings[np.isfinite(readings)]), _top(readings)
        for unit in costs:
            costs[unit] += 0.5 * (log(top * unit.factor / center_kPa) / width) ** 2
            costs[unit] -= _RESTS * (rest_kPa(in_order * unit.factor) is not None)
    best, second = sorted(costs, key=lambda unit: costs[unit])[:2]
    why = f"readings up to {_top(values):.4g} are usual in {best.name}"
    return UnitGuess(best, why, second.name if costs[second] - costs[best] < 1.5 else "")


def rest_kPa(kPa: Array) -> float | None:
    """The resting pressure if these sorted readings are from an absolute sensor; else None."""
    if not len(kPa):
        return None
    low = float(kPa[len(kPa) // 100])
    at_rest = float(np.mean(kPa < low + 2.0))
    rests = AMBIENT_KPA[0] < low < AMBIENT_KPA[1] and at_rest > 0.04 and kPa[-1] > low + 5.0
    return low if rests else None


def _top(readings: Array) -> float:
    return float(np.max(np.abs(without_spikes(readings)), initial=0.0)) or 1.0


def guess_time(values: Array) -> UnitGuess:
    """The unit of a time column by its step and its length; times since 1970 are recognised by their size."""
    steps = np.diff(values[np.isfinite(values)])
    step = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 1.0
    length, start = step * len(steps), float(np.nanmin(values))
    costs = {}
    for unit in UNITS:
        if unit.quantity == "time" and unit.cost < inf:
            cost = unit.cost + 0.5 * (log(step * unit.factor / 0.05) / 2.5) ** 2
            cost += 0.5 * (log(max(length, step) * unit.factor / 60.0) / 2.0) ** 2
            costs[unit] = cost - 20.0 * (1e9 < start * unit.factor < 4e9)
    best, second = sorted(costs, key=lambda unit: costs[unit])[:2]
    why = f"a step of {step * best.factor:.3g} s, {length * best.factor:.4g} s in all"
    return UnitGuess(best, why, second.name if costs[second] - costs[best] < 1.0 else "")


def guess_opening(values: Array, name: str) -> UnitGuess:
    """The full scale of a valve or pump signal by its largest value; PWM is 0 to 255 at least."""
    top = float(np.nanmax(values, initial=0.0))
    is_pwm = "pwm" in words_of(name) and bool(np.all(values[np.isfinite(values)] % 1.0 == 0.0))
    smallest = 255.0 if is_pwm and top > 1.0 else 1.0
    scale = next((scale for scale in FULL_SCALES if scale >= max(top, smallest)), max(top, 1.0))
    if scale > 100.0 and not STROKES.isdisjoint(words_of(name)):
        scale = np.ceil(top)  # steps of an encoder have no usual full scale
    unit = parse_unit("%") if scale == 100.0 else parse_unit(f"0-{scale:.0f}")
    return UnitGuess(unit, f"values up to {top:g}")


def psi_instead(time_s: Array, values: Array) -> str:
    """Why readings under a heading of kPa are probably psi; empty if they are not.

    Gas that leaves a vessel through a valve is choked above about one atmosphere of gauge pressure: the shape
    of the fall shows how high the pressure really is. Three laws compete: the flow law of ISO 6358 with
    readings in kPa and with readings in psi, and Ohm's law, which has the same shape in all units.
    """
    fit = _discharge(time_s, values)
    if fit is not None:
        in_kPa, in_psi, ohm = fit
        if in_psi < 0.012 and in_psi < 0.5 * min(in_kPa, ohm):
            return (
                f"the fall of the pressure fits a gas flow in psi (misfit {in_psi:.1%} of its duration), "
                f"not in kPa ({in_kPa:.1%})"
            )
        if in_kPa < 0.5 * in_psi:
            return ""
    readings = values[np.isfinite(values)]
    top = float(np.max(readings, initial=0.0))
    halves = np.abs(2.0 * readings - np.round(2.0 * readings)) < 1e-9
    if 60.0 <= top <= 160.0 and halves.all() and len(np.unique(readings)) > 8 and np.any(readings % 1.0):
        return f"all readings are multiples of 0.5 up to {top:g}, as a gauge of psi shows them"
    return ""


def _discharge(time_s: Array, values: Array) -> tuple[float, float, float] | None:
    """Misfit of the three laws to a fall of pressure, as a share of its duration; None without a fall."""
    there = np.isfinite(values) & np.isfinite(time_s)
    t, x = time_s[there], values[there]
    if len(x) < 12:
        return None
    top, rest = float(np.median(np.sort(x)[-3:])), float(np.median(x[-max(3, len(x) // 10) :]))
    rest = rest if abs(rest) < 0.05 * top else 0.0
    if top - rest < 20.0:
        return None
    share = (x - rest) / (top - rest)
    start = int(np.flatnonzero(share > 0.93)[-1]) + 1
    low = np.flatnonzero(share[start:] < 0.06)
    part = slice(start, start + int(low[0])) if len(low) else slice(start, start)
    t, share = t[part], share[part]
    if len(share) < 8 or np.any(share < 0.02) or share[-1] > 0.2:
        return None

    def misfit(theory: Array) -> float:
        line = np.column_stack([np.ones_like(theory), theory])
        residual = t - line @ np.linalg.lstsq(line, t, rcond=None)[0]
        return float(np.std(residual) / max(np.ptp(t), 1e-12))

    laws = [(b, n) for b in (0.3, 0.5) for n in (1.0, 1.2, 1.4)]
    kPa, psi = (
        min(misfit(_iso_6358_time(share, (top - rest) * factor, *law)) for law in laws)
        for factor in (1.0, 6.894757)
    )
    return kPa, psi, misfit(-np.log(share))


def _iso_6358_time(share: Array, start_kPa: float, critical_ratio: float, polytropic: float) -> Array:
    """Times at which the gauge pressure has fallen to these shares of its start, in an arbitrary unit."""
    grid = np.linspace(1.0, float(share.min()), 400)
    p_kPa = grid * start_kPa + STANDARD_PRESSURE_KPA
    law = Iso6358(1.0, critical_ratio, laminar_ratio=1.0, temperature_dependent=False).numbers()
    flow = np.array([flow_SL_per_s(law, p, STANDARD_PRESSURE_KPA, 1.0, 1.0) for p in p_kPa.tolist()])
    rate = flow * p_kPa ** ((polytropic - 1) / (2 * polytropic))
    steps = -np.diff(grid) * 0.5 * (1.0 / rate[1:] + 1.0 / rate[:-1])
    time: Array = np.interp(-share, -grid, np.concatenate([[0.0], np.cumsum(steps)]))
    return time
