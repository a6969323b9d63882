"""A flight in a few numbers, from its log."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import get_args

from flying_vines.record.folders import MCAP
from flying_vines.record.reader import LAST, FlightLog, LogError
from flying_vines.record.topics import DECISION, SNAPSHOT
from flying_vines.vine.intent import Intent

_NO_MOTIONS = {str(kind()) for kind in get_args(Intent) if not fields(kind)}
"""Intents without a target, such as a hold. They do not bend the vine, but a motion may run after them."""


@dataclass(frozen=True)
class Summary:
    """The data of a flight for `log list`."""

    folder: Path
    began_s: float
    """Unix time."""
    length_s: float
    armed_s: float
    bends: int
    """The number of triggers that bent the vine."""
    refused: int
    lowest_reservoir_kPa: float
    """Gauge; NaN if no phloSAR answered."""
    findings: dict[str, int]
    """The number of findings of each physics check."""
    size_MB: float
    """Total size of the files in the folder."""
    lost: int
    """The number of missing messages."""
    damage: str
    """A sentence; empty for a complete log. A log that is still being written is incomplete."""


def summarise(log: FlightLog) -> Summary:
    """Raises `LogError` if there is nothing to read."""
    began_ns = ended_ns = 0
    armed_s = 0.0
    before_t: float | None = None
    lowest_kPa = math.inf
    findings: dict[str, int] = {}
    bends = refused = 0
    for entry in log.entries((SNAPSHOT, DECISION)):
        began_ns, ended_ns = began_ns or entry.unix_ns, entry.unix_ns
        f = entry.fields
        if entry.topic == DECISION:
            refused += f["safety"] == "refused"
            moves = f["safety"] != "refused" and f.get("intent") not in _NO_MOTIONS
            bends += moves and f["setpoint_kPa"] > 0.0
            continue
        if f["armed"] and before_t is not None:
            armed_s += f["t"] - before_t
        before_t = f["t"]
        lowest_kPa = min(lowest_kPa, f.get("reservoir_kPa", math.inf))
        findings = f["findings"]
    return Summary(
        folder=log.folder,
        began_s=began_ns / 1e9,
        length_s=(ended_ns - began_ns) / 1e9,
        armed_s=armed_s,
        bends=bends,
        refused=refused,
        lowest_reservoir_kPa=lowest_kPa if math.isfinite(lowest_kPa) else math.nan,
        findings={name: count for name, count in findings.items() if count},
        size_MB=sum(path.stat().st_size for path in log.folder.iterdir() if path.is_file()) / 1e6,
        lost=log.lost,
        damage=log.damage,
    )


def find_flight(name: str, parent: Path) -> FlightLog:
    """`name` is "last", a folder's name in `parent`, or the path of a folder or file. Raises `LogError`."""
    if name == LAST:
        return FlightLog(parent / LAST)
    for path in (Path(name), parent / name):
        if path.is_file() or (path / MCAP).is_file() or path.name == LAST:
            return FlightLog(path)
    raise LogError(f"{name}: is not a flight: give a flight's folder, its {MCAP}, or last")
