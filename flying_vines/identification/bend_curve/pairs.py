"""Measured pairs: a CSV of pressure_kPa, angle_deg and possibly time_s, in the order of measuring."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from flying_vines.files.toml_text import one_line, read_text
from flying_vines.physics.arrays import Array, BoolArray

MIN_PAIRS = 8
MAX_PAIRS = 20_000
TURN = 0.1
"""A smaller change of direction, as a share of the pressure range, is noise."""
MAX_KPA = 300.0
"""No actuator of a vine withstands more: larger numbers are in Pa."""


class PairsError(ValueError):
    """A file of pairs cannot be used; the text is one line, `file:line: reason`."""

    def __init__(self, text: str) -> None:
        super().__init__(one_line(text))


@dataclass(frozen=True)
class Pairs:
    """Pressures and bend angles in the order in which they were measured."""

    pressure_kPa: Array
    """Gauge."""
    angle_deg: Array
    """0 is straight."""
    time_s: Array | None = None

    @cached_property
    def rising(self) -> BoolArray:
        """True for pairs on a way up: after a turn at a low pressure, up to a turn at a high pressure."""
        kPa = self.pressure_kPa
        turn_kPa = TURN * float(np.ptp(kPa))
        rising = np.ones(len(kPa), dtype=bool)
        extreme, up = 0, True
        for i in range(1, len(kPa)):
            change = kPa[i] - kPa[extreme] if up else kPa[extreme] - kPa[i]
            if change >= 0.0:
                extreme = i
            elif change < -turn_kPa:
                rising[extreme + 1 :] = up = not up
                extreme = i
        return rising

    @property
    def unloads(self) -> bool:
        """True if at least three pairs are on a way down: then the hysteresis can be determined."""
        return int(np.sum(~self.rising)) >= 3

    @property
    def rate_kPa_per_s(self) -> float | None:
        """Median rate of the pressure; None without times."""
        if self.time_s is None:
            return None
        return float(np.median(np.abs(np.diff(self.pressure_kPa)) / np.diff(self.time_s)))


def load_pairs(path: Path) -> Pairs:
    """The pairs of a CSV file.

    Raises `PairsError` if it cannot be read, or has wrong units, signs or columns.
    """
    return parse_pairs(read_text(path, PairsError), str(path))


def parse_pairs(text: str, source: str) -> Pairs:
    """The pairs in the text of a CSV; `source` is its name in errors."""
    reader = csv.reader(io.StringIO(text))
    rows: list[list[float]] = []
    try:
        header = [name.strip() for name in next(reader, [])]
        columns = _columns(header, source)
        for cells in reader:
            if not any(cell.strip() for cell in cells):
                continue
            if len(rows) == MAX_PAIRS:
                raise PairsError(f"{source}:{reader.line_num}: more than {MAX_PAIRS} pairs")
            rows.append(
                [_number(cells, name, at, f"{source}:{reader.line_num}") for name, at in columns.items()]
            )
    except csv.Error as error:
        raise PairsError(f"{source}:{reader.line_num}: not CSV: {error}") from None
    if len(rows) < MIN_PAIRS:
        raise PairsError(f"{source}: {len(rows)} pairs; a fit needs at least {MIN_PAIRS}, up and down")
    values = dict(zip(columns, np.array(rows).T, strict=True))
    pairs = Pairs(values["pressure_kPa"], values["angle_deg"], values.get("time_s"))
    problem = _problem(pairs)
    if problem:
        raise PairsError(f"{source}: {problem}")
    return pairs


def _columns(header: list[str], source: str) -> dict[str, int]:
    for name in ("pressure_kPa", "angle_deg"):
        if header.count(name) != 1:
            has = ", ".join(header) or "nothing"
            raise PairsError(f"{source}:1: the header needs one column '{name}'; it contains {has}")
    return {name: header.index(name) for name in ("pressure_kPa", "angle_deg", "time_s") if name in header}


def _number(cells: list[str], name: str, at: int, place: str) -> float:
    cell = cells[at].strip() if at < len(cells) else ""
    try:
        value = float(cell)
    except ValueError:
        raise PairsError(f"{place}: {name}: '{cell[:40]}' is not a number") from None
    if not math.isfinite(value):
        raise PairsError(f"{place}: {name}: '{cell[:40]}' is not a finite number")
    return value


def _problem(pairs: Pairs) -> str:
    """Why units, signs or columns are probably wrong; empty if they are plausible."""
    kPa, deg = pairs.pressure_kPa, pairs.angle_deg
    low, high, span = float(np.min(kPa)), float(np.max(kPa)), float(np.ptp(kPa))
    bends = float(np.ptp(deg))
    if pairs.time_s is not None and np.any(np.diff(pairs.time_s) <= 0.0):
        return "time_s does not rise from pair to pair; sort the pairs by time"
    if high > MAX_KPA:
        return f"pressure_kPa goes up to {high:.6g}: that looks like Pa; give kPa gauge"
    if low > 60.0:
        return f"pressure_kPa is {low:.4g} to {high:.4g}: that looks like absolute pressure; give kPa gauge"
    if low < -20.0:
        return f"pressure_kPa goes down to {low:.4g}: give kPa gauge, 0 at ambient pressure"
    if high < 0.5:
        return f"pressure_kPa goes up to {high:.3g} only: that looks like bar or MPa; give kPa gauge"
    if span < 1.0:
        return f"the pressures only span {span:.2g} kPa; measure from 0 up and back"
    if bends == 0.0:
        return "angle_deg is the same in every pair"
    if float(np.max(np.abs(deg))) < 3.2:
        return f"angle_deg goes up to {np.max(np.abs(deg)):.3g} only: that looks like radians; give degrees"
    if float(np.max(np.abs(deg))) > 720.0:
        return f"angle_deg goes up to {np.max(np.abs(deg)):.4g}: no vine bends that far; give degrees"
    if float(np.corrcoef(kPa, deg)[0, 1]) < 0.0:
        return "the angle falls while the pressure rises; swap the sign of angle_deg, or the columns"
    if kPa[0] < low + 0.05 * span and abs(deg[0]) > 0.25 * bends:
        return f"the first angle is {deg[0]:.3g}° at {kPa[0]:.3g} kPa; start with the straight vine, at 0°"
    return ""
