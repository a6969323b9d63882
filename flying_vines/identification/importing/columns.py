"""Guesses the meaning of each column of a foreign table by points for the words of its name, unit and values.

Each pair of a column and a meaning has a score. Pairs are taken from the highest score down, each column and
each meaning once. A column that has no score above zero is ignored.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass

import msgspec
import numpy as np

from flying_vines.identification.importing.layout import ForeignTable
from flying_vines.identification.importing.units import (
    AMBIENT_KPA,
    STROKES,
    Quantity,
    Unit,
    as_absolute,
    guess_opening,
    guess_pressure,
    guess_time,
    parse_unit,
    rest_kPa,
    unit_in,
    words_of,
)
from flying_vines.identification.noise import is_spike, resolution
from flying_vines.identification.recording import CaseError
from flying_vines.physics.arrays import Array

IGNORED = "ignored"
_PRESSURE = {"pressure": 3, "press": 3, "p": 2, "druck": 3, "pression": 3, "presion": 3, "presión": 3,
             "pressione": 3, "pressão": 3, "pressao": 3, "druk": 3, "tryk": 3, "tryck": 3, "trykk": 3,
             "paine": 3, "tlak": 3, "ciśnienie": 3, "cisnienie": 3, "basınç": 3, "давление": 3, "压力": 3,
             "压强": 3, "圧力": 3, "압력": 3}  # fmt: skip
WORDS: Mapping[str, Mapping[str, float]] = {
    "time": {"time": 4, "timestamp": 4, "t": 3, "zeit": 4, "temps": 4, "tiempo": 4, "tempo": 4, "elapsed": 3,
             "clock": 2, "date": 1, "millis": 3, "micros": 3, "index": -3, "sample": -3, "tijd": 4, "tid": 4,
             "czas": 4, "čas": 4, "время": 4, "时间": 4, "時間": 4, "시간": 4},
    "run": {"run": 4, "trial": 4, "test": 3, "experiment": 3, "rep": 3, "repeat": 3, "cycle": 2},
    "command_kPa": {"target": 5, "setpoint": 5, "set": 2, "sp": 3, "reference": 4, "ref": 4, "desired": 5,
                    "command": 4, "cmd": 4, "goal": 4, "soll": 5, "sollwert": 5, "consigne": 5, "demand": 4,
                    "wanted": 4, "pressure": 1, "目标": 5, "目標": 5},
    "cv_pressure": {"cv": 6, "chamber": 4, "actuator": 4, "vine": 4, "feedback": 4, "bladder": 4, "muscle": 4,
                    "finger": 4, "gripper": 4, "balloon": 4, "soft": 3, "volume": 1, "output": 2, "out": 2,
                    "lp": 4, "low": 1, "downstream": 3, "measured": 2, "actual": 2, "ist": 2,
                    "istwert": 2, "p2": 2, "kammer": 4, "kammerdruck": 5, **_PRESSURE},
    "reservoir_pressure": {"reservoir": 6, "tank": 5, "bottle": 5, "supply": 5, "source": 4, "plenum": 5,
                           "accumulator": 5, "cylinder": 4, "vessel": 4, "inlet": 3, "upstream": 4, "line": 2,
                           "p1": 2, "in": 1, "hp": 4, "high": 1, "behälter": 5, "behälterdruck": 5,
                           **_PRESSURE},
    "evp_opening": {"evp": 7, "ev": 5, "inflation": 4, "inflate": 4, "fill": 4, "pump": 4, "pwm": 3,
                    "duty": 3, "valve": 3, "opening": 3, "inlet": 3, "main": 1, "ventil": 3, "vanne": 3,
                    "motor": 2, "proportional": 3, "control": 1, "u": 1, "in": 1},
    "dvp_opening": {"dvp": 7, "venturi": 6, "vacuum": 4, "ejector": 5, "suction": 4, "pwm": 1, "valve": 2,
                    "opening": 2, "duty": 1},
    "solenoid": {"solenoid": 7, "sv": 4, "outlet": 5, "vent": 5, "exhaust": 5, "release": 4, "deflate": 4,
                 "out": 2, "valve": 1, "state": 1, "open": 1},
    "ambient_pressure": {"ambient": 5, "atmospheric": 5, "atmosphere": 5, "barometric": 5, "baro": 5,
                         "barometer": 5, "atm": 3, "pressure": 1},
    "ambient_temperature": {"temperature": 5, "temp": 5, "temperatur": 5, "ambient": 1, "room": 1},
}  # fmt: skip
"""Points that a word of a column's name gives to a meaning."""
_NOT_READ = frozenset({"error", "err", "norm", "integral", "derivative", "flow", "current", "force", "kp",
                       "ki", "kd", "std", "noise", "rate", "dt", "coefficient", "dimensionless", "thrust",
                       "mass", "weight", "load", "humidity"})  # fmt: skip
"""A column with one of these words in its name is ignored."""
_DRIVES = frozenset({"valve", "ventil", "vanne", "válvula", "valvola", "throttle", "servo", "motor", "pump",
                     "compressor"})  # fmt: skip
"""A column with a word of STROKES in its name is ignored, unless the name also has one of these."""
_OTHER_UNITS = frozenset({"g", "kg", "lb", "lbs", "mm", "cm", "lpm", "slm", "sccm", "ma"})
"""A column whose name ends with one of these units is ignored."""
QUANTITIES: Mapping[str, Quantity] = {
    "time": "time",
    "command_kPa": "pressure",
    "cv_pressure": "pressure",
    "reservoir_pressure": "pressure",
    "evp_opening": "opening",
    "dvp_opening": "opening",
    "solenoid": "opening",
    "ambient_pressure": "pressure",
    "ambient_temperature": "temperature",
}
MEANINGS = (*WORDS, IGNORED)
_ONE_UNIT = ("cv_pressure", "reservoir_pressure", "command_kPa")
"""Columns of these meanings without a unit share one unit. A barometer often has another unit."""


class ImportedColumn(msgspec.Struct, forbid_unknown_fields=True):
    """One column of a file; a part of the answers file."""

    number: int
    """From 1."""
    meaning: str
    unit: str = ""
    name: str = ""
    why: str = ""


@dataclass(frozen=True)
class _Signal:
    """A column, with the properties that the tests of `EVIDENCE` use."""

    name: str
    values: Array
    unit: Unit | None
    is_clock: bool
    number: int

    @property
    def readings(self) -> Array:
        return self.values[np.isfinite(self.values)]

    @property
    def levels(self) -> int:
        return len(np.unique(self.readings))

    def is_rising(self) -> bool:
        """True for time: nearly all steps go up, except at the start of another run."""
        steps = np.diff(self.readings)
        return (
            len(steps) > 0
            and bool(np.mean(steps > 0.0) > 0.9 or np.mean(steps >= 0.0) > 0.98)
            and (self.levels > 0.2 * len(steps))
        )

    def is_pressure(self) -> bool:
        """True if its unit is one of pressure. The pressure of a leaking vacuum rises all the time."""
        return self.unit is not None and self.unit.quantity == "pressure"

    def is_count(self) -> bool:
        """True for 0, 1, 2, …: the numbers of the rows."""
        return bool(np.all(np.diff(self.readings) == 1.0))

    def is_switched(self) -> bool:
        """True for whole numbers between 0 and a full scale that are often at one of these two."""
        x = self.readings
        top = float(np.max(x, initial=0.0))
        ends = np.mean((x == 0.0) | (x == top)) if len(x) else 0.0
        return top in (1.0, 100.0, 255.0, 1023.0, 4095.0) and bool(
            ends > 0.3 and np.all(x >= 0.0) and np.all(x % 1 == 0)
        )

    def is_on_off(self) -> bool:
        """True for a signal with two values, one of which is 0."""
        return self.levels == 2 and float(np.min(self.readings)) == 0.0

    def is_held(self) -> bool:
        """True for a signal that changes seldom, as a target does."""
        return bool(np.mean(np.diff(self.readings) == 0.0) > 0.9) if len(self.readings) > 1 else False


def _names_of(name: str) -> list[str]:
    """The words of a name. Two words that together are a known word, as in `setPoint`, count as this word."""
    words = words_of(name)
    for at in range(len(words) - 1, 0, -1):
        if (both := words[at - 1] + words[at]) in _ALL_WORDS:
            words[at - 1 : at + 1] = [both]
    return words


def _is_read(signal: _Signal) -> bool:
    """False if the name shows that the column has none of the meanings."""
    names = set(_names_of(signal.name))
    if names & _NOT_READ or (names & STROKES and not names & _DRIVES):
        return False
    if signal.unit or names & _PRESSURE.keys():
        return True
    return "volume" not in names and words_of(signal.name)[-1:] not in [[unit] for unit in _OTHER_UNITS]


def _known(name: str) -> bool:
    """True if a word of a name is a word of a meaning."""
    return not _ALL_WORDS.isdisjoint(_names_of(name))


_ALL_WORDS = frozenset(word for words in WORDS.values() for word in words)
_Test = Callable[[_Signal], bool]
EVIDENCE: tuple[tuple[str, _Test, Mapping[str, float]], ...] = (
    ("clock times", lambda s: s.is_clock, {"time": 8}),
    ("rises all the time", lambda s: s.is_rising() and not s.is_count(), {"time": 4}),
    ("rises all the time", lambda s: s.is_rising() and s.is_count(), {"time": 1.5}),
    ("does not rise all the time", lambda s: not s.is_rising(), {"time": -20}),
    ("rises all the time", lambda s: s.is_rising() and not s.is_pressure(),
     dict.fromkeys((m for m in WORDS if m != "time"), -4.0)),
    ("the first column", lambda s: s.number == 1, {"time": 1}),
    ("changes seldom", _Signal.is_held, {"command_kPa": 1, "run": 0.5, "solenoid": 0.5}),
    ("always the same", lambda s: s.levels <= 1, {"evp_opening": -6, "dvp_opening": -12, "solenoid": -12,
                                                  "cv_pressure": -3, "reservoir_pressure": -3}),
    ("only two values", lambda s: s.levels == 2, {"solenoid": 1}),
    ("more than two values", lambda s: s.levels > 2, {"solenoid": -8, "evp_opening": 0.5}),
    ("negative values", lambda s: bool(np.any(s.readings < 0.0)),
     {"evp_opening": -8, "dvp_opening": -8, "solenoid": -8}),
    ("no known word, but on and off", lambda s: s.is_switched() and not _known(s.name),
     {"evp_opening": 3, "cv_pressure": -6, "reservoir_pressure": -6}),
    ("negative all the time", lambda s: bool(np.all(s.readings < 0.0)),
     {"reservoir_pressure": -4, "command_kPa": -2}),
    ("not a whole number", lambda s: bool(np.any(s.readings % 1.0 != 0.0)), {"run": -9}),
)  # fmt: skip
"""Evidence in the values: a text for the user, the test, and its points for meanings."""
_LONG = 5
"""Minimum letters of a word that is also recognised at either end of a longer one."""
_VACUUM = 0.003
"""Maximum ratio of lowest to highest reading of a vacuum gauge. A sensor of gauge pressure that comes so
near 0 also reads below 0."""
_VESSELS = ("cv_pressure", "reservoir_pressure")
_DRIVEN = 0.5
"""Minimum rise or fall of a pressure while a valve is open, as a share of the pressure's span."""
_SURE = 9.0
"""Points of a column whose meaning the pressure shows."""
_UNIT_FITS, _UNIT_CONTRADICTS = 3.0, -9.0
_NAMED_ONLY = ("command_kPa", "ambient_pressure")
"""A unit alone does not make a column one of these."""
_UNNAMED = {"cv_pressure": 1.0, "reservoir_pressure": 1.0}
"""Points of a column that has neither a name nor a unit."""


def guess_columns(table: ForeignTable, given: Sequence[ImportedColumn] = ()) -> list[ImportedColumn]:
    """Meaning and unit of each column; those of `given` columns stay."""
    fixed = {column.number: column for column in given}
    if unknown := sorted(n for n in fixed if not 1 <= n <= len(table.cells)):
        raise CaseError(f"{table.path}: there is no column {unknown[0]}; it has {len(table.cells)} columns")
    signals = [_signal(table, number) for number in range(1, len(table.cells) + 1)]
    copies = _copies(signals)
    guessed = _guess_meanings([signal for signal in signals if signal.number not in copies], given)
    meanings = {number: meaning for number, (meaning, _) in guessed.items()}
    one_unit = [signal for signal in signals if meanings.get(signal.number) in _ONE_UNIT]
    unlabelled = [(signal, meanings[signal.number]) for signal in one_unit if not signal.unit]
    labelled = [signal.unit for signal in one_unit if signal.unit]
    labelled += [parse_unit(column.unit) for column in given if column.unit and column.meaning in _ONE_UNIT]
    found = []
    for signal in signals:
        known = fixed.get(signal.number) or ImportedColumn(signal.number, "")
        meaning, why = guessed.get(signal.number, (IGNORED, ""))
        if known.meaning:
            meaning, why = known.meaning, known.why or "as answered"
        elif signal.number in copies:
            why = f"the same signal as column {copies[signal.number]}"
        unit, reason = (known.unit, "") if known.unit else _unit(signal, meaning, unlabelled, labelled)
        if unit:
            parse_unit(unit)
        why = "; ".join(part for part in (why, reason) if part)
        found.append(ImportedColumn(signal.number, meaning, unit, signal.name, why))
    return found


def _guess_meanings(
    signals: Sequence[_Signal], given: Sequence[ImportedColumn]
) -> dict[int, tuple[str, str]]:
    """Number, meaning and reason of each column that is neither given nor ignored."""
    answered = {column.number: column.meaning for column in given if column.meaning}
    scores: dict[tuple[int, str], float] = {}
    reasons: dict[tuple[int, str], str] = {}
    for signal in signals:
        for meaning in WORDS:
            if signal.number not in answered and meaning not in answered.values():
                scores[signal.number, meaning], reasons[signal.number, meaning] = _score(signal, meaning)
    _compare_valves(signals, scores, reasons)
    _compare_pressures(signals, scores, set(answered.values()))
    guessed = {}
    while scores and scores[best := max(scores, key=lambda pair: scores[pair])] > 0.0:
        number, meaning = best
        guessed[number] = meaning, reasons[best]
        scores = {pair: points for pair, points in scores.items() if pair[0] != number and pair[1] != meaning}
    return guessed


def _signal(table: ForeignTable, number: int) -> _Signal:
    name, at = table.names[number - 1], number - 1
    unit = unit_in(name) or unit_in(f"({table.unit_text(at)})")
    return _Signal(name, table.numbers(at), unit, table.is_clock(at), number)


def _score(signal: _Signal, meaning: str) -> tuple[float, str]:
    """Points of a column for a meaning, and the strongest reasons."""
    if len(signal.readings) == 0:
        return -1.0, ""
    names = _names_of(signal.name)
    points = {f"“{word}”": gives for word in names if (gives := _points(word, meaning))}
    if not _is_read(signal):
        points["not read"] = -20.0
    elif signal.unit and meaning in _NAMED_ONLY and not points:
        return -1.0, ""
    elif signal.unit and meaning in QUANTITIES:
        fits = signal.unit.quantity == QUANTITIES[meaning]
        fits |= signal.unit.quantity == "raw" and QUANTITIES[meaning] == "pressure"
        points[f"in {signal.unit.name}"] = _UNIT_FITS if fits else _UNIT_CONTRADICTS
    elif signal.unit:
        points[f"in {signal.unit.name}"] = _UNIT_CONTRADICTS
    elif not signal.name:
        points["no name"] = _UNNAMED.get(meaning, 0.0)
    named = any(value > 0.0 for value in points.values())
    for text, test, worth in EVIDENCE:
        # Without a known word or unit, only strong evidence counts.
        if (
            meaning in worth
            and (named or meaning == "time" or not -3.0 < worth[meaning] < 3.0)
            and test(signal)
        ):
            points[text] = points.get(text, 0.0) + worth[meaning]
    reasons = sorted((text for text in points if points[text] > 0.0), key=lambda text: -points[text])
    return sum(points.values()), ", ".join(reasons[:3])


def _points(word: str, meaning: str) -> float:
    """Points of a word of a name, or of a long known word at its beginning or end, as in “tankpressure”."""
    points = WORDS[meaning]
    parts = (part for part in points if len(part) >= _LONG and (word.startswith(part) or word.endswith(part)))
    return points[word] if word in points else max((points[part] for part in parts), default=0.0)


def _copies(signals: Sequence[_Signal]) -> dict[int, int]:
    """Columns that repeat another column in another unit, and the column that each repeats.

    An example is a sensor's voltage beside its pressure.
    """
    copies = {}
    for at, one in enumerate(signals):
        for other in signals[at + 1 :]:
            if not _is_read(one) or not _is_read(other):
                continue  # a control error looks like a copy of the reading while the target is constant
            both = np.isfinite(one.values) & np.isfinite(other.values)
            x, y = one.values[both], other.values[both]
            if len(x) < 8 or one.levels < 8 or one.is_rising() or np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
                continue
            slope, offset = np.polyfit(x, y, 1)
            step = max(abs(slope) * resolution(x), resolution(y))
            if np.max(np.abs(y - slope * x - offset)) <= 1.1 * step and np.corrcoef(x, y)[0, 1] > 0.98:
                first_is_pressure = one.unit is not None and one.unit.quantity == "pressure"
                if first_is_pressure and (other.unit is None or other.unit.quantity != "pressure"):
                    copies[other.number] = one.number
                else:
                    copies[one.number] = other.number
    return copies


def _best_meanings(signals: Sequence[_Signal], scores: Mapping[tuple[int, str], float]) -> dict[int, str]:
    """For each column with points: its number, and its meaning with most points."""
    best = {s.number: max(WORDS, key=lambda meaning: scores.get((s.number, meaning), -1.0)) for s in signals}
    return {number: meaning for number, meaning in best.items() if scores.get((number, meaning), 0.0) > 0.0}


def _compare_valves(
    signals: Sequence[_Signal], scores: dict[tuple[int, str], float], reasons: dict[tuple[int, str], str]
) -> None:
    """Adds points if the only pressure rises with one on/off signal, and falls with another.

    The pressure is then that of a chamber, the first signal its inflation valve, and the second its outlet.
    """
    best = _best_meanings(signals, scores)
    pressures = [signal for signal in signals if best.get(signal.number) in _VESSELS]
    if len(pressures) != 1:
        return
    rises = {s.number: _rises(pressures[0].values, s.values)[0] for s in signals if s.is_on_off()}
    if not rises or not min(rises.values()) < -_DRIVEN < _DRIVEN < max(rises.values()):
        return
    found = [(pressures[0].number, "cv_pressure", "two valves move it")]
    for number, rise in rises.items():
        if abs(rise) > _DRIVEN:
            meaning, verb = ("evp_opening", "rises") if rise > 0.0 else ("solenoid", "falls")
            found.append((number, meaning, f"the pressure {verb} with it"))
    for number, meaning, why in found:
        if (pair := (number, meaning)) in scores:
            scores[pair], reasons[pair] = scores[pair] + _SURE, why


def _rises(pressure: Array, opening: Array) -> tuple[float, float]:
    """Rise of a pressure while a valve is open, and while it is shut, as shares of the pressure's span."""
    there = np.isfinite(pressure) & ~is_spike(pressure)
    pressure, opening = pressure[there], opening[there]
    span = float(np.ptp(pressure)) if len(pressure) else 0.0
    if span == 0.0:
        return 0.0, 0.0
    change = np.diff(pressure, append=pressure[-1:]) / span
    is_open = opening > 0.02 * np.nanmax(opening, initial=0.0)
    return float(change[is_open].sum()), float(change[~is_open].sum())


def _compare_pressures(
    signals: Sequence[_Signal], scores: dict[tuple[int, str], float], taken: Set[str]
) -> None:
    """Adds points: the higher of two pressures is the reservoir's. A single pressure may be of either vessel.

    It is the chamber's if there is a target or an inflation signal, it does not end far below its start, and
    it does not fall while the valve is open. Otherwise it is the reservoir's. If a target would be the only
    pressure of a file, it is read as one of these two instead.
    """
    best = _best_meanings(signals, scores)
    if not {*taken, *best.values()} & {*_VESSELS}:
        for signal in signals:
            scores.pop((signal.number, "command_kPa"), None)
        best = _best_meanings(signals, scores)
    driven = not {"command_kPa", "evp_opening"}.isdisjoint({*taken, *best.values()})
    opening = next((s for s in signals if best.get(s.number) == "evp_opening"), None)
    pressures = [signal for signal in signals if best.get(signal.number) in _VESSELS]
    levels = [float(np.median(s.readings)) * (s.unit.factor if s.unit else 1.0) for s in pressures]
    for signal, level in zip(pressures, levels, strict=True):
        p = signal.readings
        first, last = float(np.median(p[: len(p) // 10 + 1])), float(np.median(p[-len(p) // 10 :]))
        falls = -0.1 * first < last < 0.5 * first  # an evacuated vessel does not supply air
        falls |= opening is not None and _empties(signal.values, opening.values)
        reservoir = level == max(levels) if len(levels) > 1 else falls or not driven
        # Another column may have been answered as this pressure.
        if (pair := (signal.number, _VESSELS[int(reservoir)])) in scores:
            scores[pair] += 1.5


def _empties(pressure: Array, opening: Array) -> bool:
    """True if a pressure falls towards ambient pressure while the valve is open, and only then."""
    good = pressure[np.isfinite(pressure) & ~is_spike(pressure)]
    if np.min(good, initial=0.0) < -0.1 * np.max(good, initial=0.0):
        return False
    fall, rest = _rises(pressure, opening)
    return fall < -0.3 and rest > 0.2 * fall


def _unit(
    signal: _Signal, meaning: str, unlabelled: Sequence[tuple[_Signal, str]], labelled: Sequence[Unit]
) -> tuple[str, str]:
    """The unit of a column and why; empty if its meaning has none.

    The pressures without a unit (`unlabelled`, with their meanings) share one unit: probably a unit that the
    file names for another pressure (`labelled`).
    """
    quantity = QUANTITIES.get(meaning)
    if quantity is None or len(signal.readings) == 0:
        return "", ""
    if signal.is_clock:
        return "clock", ""
    named = signal.unit if signal.unit and signal.unit.quantity in (quantity, "raw") else None
    if quantity == "temperature":
        return (named.name if named else "C"), ""
    if quantity == "opening":
        if named and named.name not in ("0-255",):
            return named.name, ""
        doubt = guess_opening(signal.values, signal.name)
    elif named:
        return _gauge_or_absolute(signal, named, meaning)
    else:
        others = [(other, what) for other, what in unlabelled if other is not signal and meaning in _ONE_UNIT]
        doubt = (
            guess_time(signal.values)
            if quantity == "time"
            else guess_pressure(
                signal.values,
                meaning,
                [(other.values, what) for other, what in others],
                labelled if meaning in _ONE_UNIT else (),
            )
        )
        if quantity == "pressure":
            name, why = _gauge_or_absolute(signal, doubt.unit, meaning)
            absolute = (other for other, what in others if _gauge_or_absolute(other, doubt.unit, what)[1])
            beside = next(absolute, None)
            if not why and beside and np.min(signal.readings) * doubt.unit.factor > AMBIENT_KPA[0]:
                name, why = as_absolute(doubt.unit).name, f"absolute like column {beside.number}"
            doubt = doubt._replace(unit=parse_unit(name), why="; ".join(filter(None, (doubt.why, why))))
    return doubt.unit.name, doubt.why + (f"; or {doubt.other}" if doubt.other else "")


def _gauge_or_absolute(signal: _Signal, unit: Unit, meaning: str) -> tuple[str, str]:
    """The unit, made absolute if the readings rest at ambient pressure or are those of a vacuum; and why."""
    if unit.quantity != "pressure" or unit.absolute or meaning not in ("cv_pressure", "reservoir_pressure"):
        return unit.name, ""
    low = rest_kPa(np.sort(signal.readings) * unit.factor + unit.offset)
    if low is not None:
        return as_absolute(unit).name, f"rests at {low:.4g} kPa, as an absolute sensor does"
    least, most = (float(end(signal.readings)) * unit.factor for end in (np.min, np.max))
    if AMBIENT_KPA[0] < most < AMBIENT_KPA[1] and 0.0 < least < _VACUUM * most:
        return as_absolute(unit).name, f"from ambient pressure to {least:.2g} kPa, as a vacuum gauge reads"
    return unit.name, ""
