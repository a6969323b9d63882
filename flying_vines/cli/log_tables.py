"""Flights on the terminal: the table of flights, and one flight's events."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

import msgspec
from rich.console import Console
from rich.table import Table
from rich.text import Text

from flying_vines.core.events import Decision, InternalError, KeepDisarmed, KeepParameters, LinkChanged
from flying_vines.files.bounded import read_bytes
from flying_vines.record.flight_metadata import ABOUT
from flying_vines.record.reader import FlightLog, LogEntry, Summary, restored, summarise
from flying_vines.record.topics import topic_of
from flying_vines.terminal.screen import event_line
from flying_vines.vehicle.notice import Notice

_DECISION, _NOTICE, _LINK = topic_of(Decision), topic_of(Notice), topic_of(LinkChanged)
_PARAMETERS, _DISARMED = topic_of(KeepParameters), topic_of(KeepDisarmed)
_ERROR = topic_of(InternalError)
SHOWN_TOPICS = (_DECISION, _NOTICE, _LINK, _PARAMETERS, _DISARMED, _ERROR)


def summary_table(summaries: Sequence[Summary]) -> Table:
    """One line per flight, the oldest first."""
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
    fields = asdict(summary)
    lowest_kPa = summary.lowest_reservoir_kPa
    return {**fields, "folder": str(summary.folder), "lowest_reservoir_kPa": _or_none(lowest_kPa)}


def show_events(log: FlightLog, console: Console) -> None:
    """The flight's events in order, and its summary."""
    summary = summarise(log)
    began = time.strftime("%A %Y-%m-%d %H:%M:%S %z", time.localtime(summary.began_s))
    console.print(Text(f"{log.folder.name}: {began}", style="bold"), highlight=False)
    if about := _about(log):
        firmware = about.get("firmware")
        board = f"firmware {firmware['build']}" if firmware else "no phloSAR answered"
        console.print(f"flying-vines {about['flying_vines']} on {about['machine']}, {board}", highlight=False)
        if about["continues"]:
            console.print(f"It continues the flight log {about['continues']}.", highlight=False)
    console.print()
    first: float | None = None
    for entry in log.entries(SHOWN_TOPICS):
        t = entry.fields["t"]
        first = t if first is None else first
        for line in _lines(entry, first):
            console.print(line, soft_wrap=True)
    console.print()
    console.print(summary_table([summary]))


def events_as_json(log: FlightLog) -> dict[str, object]:
    events = [{"topic": entry.topic, **entry.fields} for entry in log.entries(SHOWN_TOPICS)]
    return {**summary_as_json(summarise(log)), "about": _about(log), "story": events}


def _lines(entry: LogEntry, began: float) -> Iterator[Text]:
    fields = entry.fields
    at = f"{fields['t'] - began:7.2f}  "
    if entry.topic in (_DECISION, _NOTICE):
        kind: type[Decision | Notice] = Decision if entry.topic == _DECISION else Notice
        line = event_line(restored(kind, fields), began)
        if line is not None:
            yield line
    elif entry.topic == _LINK:
        state = "open" if fields["up"] else f"down: {fields['why']}"
        yield Text(f"{at}{fields['link']} link {state}", style="dim")
    elif entry.topic == _ERROR:
        yield Text(f"{at}{fields['part']}: {fields['trace'].rstrip()}", style="red")
    elif entry.topic == _PARAMETERS:
        values = ", ".join(f"{name} = {value:g}" for name, value in fields["values"].items())
        yield Text(f"{at}parameters: {values or 'as in the configuration'}")
    else:
        yield Text(f"{at}pneumatics {'disarmed' if fields['disarmed'] else 'armed'}")


def _about(log: FlightLog) -> dict[str, Any] | None:
    """The content of the flight's about file; None if it is missing."""
    try:
        about = msgspec.json.decode(read_bytes(log.folder / ABOUT), type=dict[str, Any])
    except (OSError, ValueError, RecursionError):
        return None
    return about


def _minutes(s: float) -> str:
    return f"{s // 60:.0f}:{s % 60:02.0f}"


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value
