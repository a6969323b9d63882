"""What a picture shows, as plain data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from flying_vines.physics.arrays import Array

MOST_POINTS = 2000


@dataclass(frozen=True)
class Series:
    """Points, a line, or a band between `y` and `y2`, all (n,)."""

    label: str
    kind: Literal["points", "line", "band"]
    x: Array
    y: Array
    y2: Array | None = None


@dataclass(frozen=True)
class Chart:
    """One picture; `name` is a file's stem."""

    name: str
    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    note: str = ""


def thinned(column: Array) -> Array:
    """At most `MOST_POINTS` of it, evenly."""
    return column[:: max(1, -(-len(column) // MOST_POINTS))]
