"""Flights on the terminal: a table of many, the story of one, and whether one came out the same again."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from flying_vines.core.events import (
    Decision,
    InternalError,
    KeepDisarmed,
    KeepParameters,
    LinkChanged,
)
from flying_vines.record.folders import ABOUT
from flying_vines.record.reader import FlightLog, LogEntry
from flying_vines.record.restore import restored
from flying_vines.record.summary import Summary, summarise
from flying_vines.record.topics import topic_of
from flying_vines.simulation.replay import Again, as_json
from flying_vines.terminal.screen import decision_table, event_line
from flying_vines.vehicle.notice import Notice

MOST_DIFFERENCES = 10
_DECISION, _NOTICE, _LINK = topic_of(Decision), topic_of(Notice), topic_of(LinkChanged)
_PARAMETERS, _DISARMED = topic_of(KeepParameters), topic_of(KeepDisarmed)
_ERROR = topic_of(InternalError)
TOLD = (_DECISION, _NOTICE, _LINK, _PARAMETERS, _DISARMED, _ERROR)


def summary_table(summaries: Sequence[Summary]) -> Table:
    """A line a flight, the oldest first."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("flight", no_wrap=True, overflow="fold")
    for name in ("length", "armed", "bends", "refused", "lowest, kPa"):
        table.add_column(name, justify="right")
    table.add_column("findings")
    table.add_column("MB", justify="right")
    table.add_column("")
    for s in summaries:
        table.add_row(
            s.folder.name,
            _minutes(s.length_s),
            _minutes(s.armed_s) if s.armed_s else "–",
            str(s.bends),
            str(s.refused),
            "–" if math.isnan(s.lowest_reservoir_kPa) else f"{s.lowest_reservoir_kPa:.0f}",
            ", ".join(f"{name} {count}" for name, count in s.findings.items()) or "–",
            f"{s.size_MB:.1f}",
            Text("" if not s.damage else "damaged" if s.lost else "not ended", style="yellow"),
        )
    return table


def summary_as_json(summary: Summary) -> dict[str, object]:
    said = asdict(summary)
    lowest_kPa = summary.lowest_reservoir_kPa
    return {**said, "folder": str(summary.folder), "lowest_reservoir_kPa": _or_none(lowest_kPa)}


def story(log: FlightLog, console: Console) -> None:
    """What happened, in order, and what it came to."""
    summary = summarise(log)
    began = time.strftime("%A %Y-%m-%d %H:%M:%S", time.localtime(summary.began_s))
    console.print(Text(f"{log.folder.name}: {began}", style="bold"), highlight=False)
    if about := _about(log):
        firmware = about.get("firmware")
        board = f"firmware {firmware['build']}" if firmware else "no phloSAR answered"
        console.print(f"flying-vines {about['flying_vines']} on {about['machine']}, {board}", highlight=False)
        if about["continues"]:
            console.print(f"The same service flew {about['continues']} before.", highlight=False)
    console.print()
    first: float | None = None
    for entry in log.entries(TOLD):
        t = entry.fields["t"]
        first = t if first is None else first
        for line in _lines(entry, first):
            console.print(line, soft_wrap=True)
    console.print()
    console.print(summary_table([summary]))


def story_as_json(log: FlightLog) -> dict[str, object]:
    told = [{"topic": entry.topic, **entry.fields} for entry in log.entries(TOLD)]
    return {**summary_as_json(summarise(log)), "about": _about(log), "story": told}


def show_again(again: Again, json_wanted: bool, console: Console) -> None:
    """The decisions as they come out now, and whether they and all else did so in the flight."""
    if json_wanted:
        said = [as_json(decision) for decision in again.decisions]
        print(json.dumps({"decisions": said, "same": again.compared, "differences": again.differences}))
        return
    console.print(decision_table([replace(d, t=d.t - again.began) for d in again.decisions]))
    for difference in again.differences[:MOST_DIFFERENCES]:
        console.print(difference, style="red", highlight=False, soft_wrap=True)
    same = ", ".join(f"{count} {topic}" for topic, count in sorted(again.compared.items()))
    if again.differences:
        console.print(f"{len(again.differences)} answers differ from the flight's; the same: {same}")
    else:
        console.print(f"Identical to the flight: {same}", highlight=False)


def _lines(entry: LogEntry, began: float) -> Iterator[Text]:
    said = entry.fields
    at = f"{said['t'] - began:7.2f}  "
    if entry.topic in (_DECISION, _NOTICE):
        kind: type[Decision | Notice] = Decision if entry.topic == _DECISION else Notice
        line = event_line(restored(kind, said), began)
        if line is not None:
            yield line
    elif entry.topic == _LINK:
        state = "open" if said["up"] else f"down: {said['why']}"
        yield Text(f"{at}{said['link']} link {state}", style="dim")
    elif entry.topic == _ERROR:
        yield Text(f"{at}{said['part']}: {said['trace'].rstrip()}", style="red")
    elif entry.topic == _PARAMETERS:
        values = ", ".join(f"{name} = {value:g}" for name, value in said["values"].items())
        yield Text(f"{at}parameters: {values or 'as in the profile'}")
    else:
        yield Text(f"{at}pneumatics {'disarmed' if said['disarmed'] else 'armed'}")


def _about(log: FlightLog) -> dict[str, Any] | None:
    """Of the flight; None where there is no such file."""
    try:
        about: dict[str, Any] = json.loads((log.folder / ABOUT).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return about


def _minutes(s: float) -> str:
    return f"{s // 60:.0f}:{s % 60:02.0f}"


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value
