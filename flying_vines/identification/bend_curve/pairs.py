"""Measured pairs: a CSV of pressure_kPa, angle_deg and possibly time_s, in the order of measuring."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flying_vines.config.toml_text import one_line, read_text
from flying_vines.physics.arrays import Array

LEAST_PAIRS = 8
MOST_PAIRS = 20_000
TURN = 0.1
"""Of the span of pressures: what is less than this back and forth is noise, and no turn."""
MOST_KPA = 300.0
"""No vine's actuator bears it; Pa are recognised by it."""


class PairsError(ValueError):
    """A file that holds no pairs to calibrate with; its text is one line, `file:line: reason`."""

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
    def rising(self) -> NDArray[np.bool_]:
        """Which pairs were measured on a way up: between a turn at a low and one at a high pressure."""
        kPa = self.pressure_kPa
        least = TURN * float(np.ptp(kPa))
        rising = np.ones(len(kPa), dtype=bool)
        extreme, up = 0, True
        for i in range(1, len(kPa)):
            change = kPa[i] - kPa[extreme] if up else kPa[extreme] - kPa[i]
            if change >= 0.0:
                extreme = i
            elif change < -least:
                rising[extreme + 1 :] = up = not up
                extreme = i
        return rising

    @property
    def unloads(self) -> bool:
        """Whether there is a way down that says anything about hysteresis: three pairs of it."""
        return int(np.sum(~self.rising)) >= 3

    @property
    def rate_kPa_per_s(self) -> float | None:
        """How fast the pressure moved, the median; not known without times."""
        if self.time_s is None:
            return None
        return float(np.median(np.abs(np.diff(self.pressure_kPa)) / np.diff(self.time_s)))


def load_pairs(path: Path) -> Pairs:
    """The pairs of a CSV file.

    Raises `PairsError` when it cannot be read, or cannot be meant.
    """
    return parse_pairs(read_text(path, PairsError), str(path))


def parse_pairs(text: str, source: str) -> Pairs:
    """Check the text of a CSV; `source` is what errors call it."""
    reader = csv.reader(io.StringIO(text))
    header = [name.strip() for name in next(reader, [])]
    for name in ("pressure_kPa", "angle_deg"):
        if header.count(name) != 1:
            has = ", ".join(header) or "nothing"
            raise PairsError(f"{source}:1: the header needs one column '{name}'; it has {has}")
    columns = {name: header.index(name) for name in ("pressure_kPa", "angle_deg", "time_s") if name in header}
    rows: list[list[float]] = []
    try:
        for cells in reader:
            if not any(cell.strip() for cell in cells):
                continue
            if len(rows) == MOST_PAIRS:
                raise PairsError(f"{source}:{reader.line_num}: more than {MOST_PAIRS} pairs")
            rows.append(
                [_number(cells, name, at, f"{source}:{reader.line_num}") for name, at in columns.items()]
            )
    except csv.Error as error:
        raise PairsError(f"{source}:{reader.line_num}: not CSV: {error}") from None
    if len(rows) < LEAST_PAIRS:
        raise PairsError(f"{source}: {len(rows)} pairs; a fit needs at least {LEAST_PAIRS}, up and down")
    values = dict(zip(columns, np.array(rows).T, strict=True))
    pairs = Pairs(values["pressure_kPa"], values["angle_deg"], values.get("time_s"))
    problem = _problem(pairs)
    if problem:
        raise PairsError(f"{source}: {problem}")
    return pairs


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
    """What tells that units, signs or columns are not what they are called; "" where nothing does."""
    kPa, deg = pairs.pressure_kPa, pairs.angle_deg
    least, most, span = float(np.min(kPa)), float(np.max(kPa)), float(np.ptp(kPa))
    bends = float(np.ptp(deg))
    if pairs.time_s is not None and np.any(np.diff(pairs.time_s) <= 0.0):
        return "time_s does not rise from pair to pair; pairs must stand in the order of measuring"
    if most > MOST_KPA:
        return f"pressure_kPa goes up to {most:.6g}: that looks like Pa; give kPa gauge"
    if least > 60.0:
        return f"pressure_kPa is {least:.4g} to {most:.4g}: that looks like absolute pressure; give kPa gauge"
    if least < -20.0:
        return f"pressure_kPa goes down to {least:.4g}: give kPa gauge, 0 at ambient pressure"
    if most < 0.5:
        return f"pressure_kPa goes up to {most:.3g} only: that looks like bar or MPa; give kPa gauge"
    if span < 1.0:
        return f"the pressures span {span:.2g} kPa only; measure from 0 up and back"
    if bends == 0.0:
        return "angle_deg is the same in every pair"
    if float(np.max(np.abs(deg))) < 3.2:
        return f"angle_deg is {np.max(np.abs(deg)):.3g} at most: that looks like radians; give degrees"
    if float(np.max(np.abs(deg))) > 720.0:
        return f"angle_deg goes up to {np.max(np.abs(deg)):.4g}: no vine bends by two turns; give degrees"
    if float(np.corrcoef(kPa, deg)[0, 1]) < 0.0:
        return "the angle falls while the pressure rises; swap the sign of angle_deg, or the columns"
    if kPa[0] < least + 0.05 * span and abs(deg[0]) > 0.25 * bends:
        return (
            f"the first angle is {deg[0]:.3g}° at {kPa[0]:.3g} kPa; begin with the straight vine, which is 0°"
        )
    return ""
