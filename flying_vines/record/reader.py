"""Reads flight logs: entries, the core's events with exactly the recorded numbers, a summary.

In a damaged log it reads all intact parts, and reports the losses. A log leaves out NaN and infinities. They
are restored as NaN.
"""

from __future__ import annotations

import binascii
import math
import mmap
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from datetime import datetime
from enum import IntEnum, IntFlag
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, get_args, get_type_hints

import msgspec
from mcap.records import Channel, Message

from firmware_link import protocol
from flying_vines.core.events import (
    Asked,
    Decision,
    Event,
    Failed,
    FirmwareMessage,
    LinkChanged,
    Said,
    Stop,
    Tick,
    VehicleMessage,
)
from flying_vines.files.bounded import opened
from flying_vines.files.toml_text import one_line
from flying_vines.record.flight_metadata import number_of
from flying_vines.record.folders import MCAP
from flying_vines.record.mcap_file import MAGIC, TooLargeError, read_chunks, read_summary
from flying_vines.record.topics import DECISION, MAVLINK_IN, SNAPSHOT, START, Start, message_in, topic_of
from flying_vines.vehicle.notice import Notice
from flying_vines.vine.intent import Intent, name_of

LAST = "last"
"""The name of the latest flight, if no file or folder has this name."""
_decode = msgspec.json.Decoder(dict[str, Any]).decode
T = TypeVar("T")
_KINDS: dict[str, type] = {
    topic_of(kind): kind
    for kind in (
        *get_args(protocol.DeviceMessage),
        *(Tick, LinkChanged, Said, Stop, Failed),
        *(Decision, Notice, Start),
    )
}
_INTENTS: dict[str, type] = {name_of(kind): kind for kind in get_args(Intent)}
_NO_MOTIONS = {str(kind()) for kind in get_args(Intent) if not fields(kind)}
"""Intents without a target, such as a hold. They do not bend the vine, but a motion may run after them."""


class LogError(Exception):
    """A log cannot be read; the text is one line with the log's path and the reason."""


class LogEntry(NamedTuple):
    """One message of the log."""

    topic: str
    unix_ns: int
    data: bytes
    """JSON."""

    @property
    def fields(self) -> dict[str, Any]:
        return _decode(self.data)


@contextmanager
def refuses_foreign(log: FlightLog) -> Iterator[None]:
    """Turn errors from the content of a log's messages into a `LogError`.

    A message has a correct checksum, so only another program can have written such a content.
    """
    try:
        yield
    except RecursionError:
        raise LogError(
            f"{log.path}: has a message that this program does not write: nested too deeply"
        ) from None
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        why = one_line(f"{type(error).__name__}: {error}")
        raise LogError(f"{log.path}: has a message that this program does not write: {why}") from error


def flights_in(parent: Path) -> list[Path]:
    """The folders of flights, oldest first."""
    if not parent.is_dir():
        return []
    flights = (folder for folder in parent.iterdir() if (folder / MCAP).is_file())
    return sorted(flights, key=lambda folder: (number_of(folder), folder.name))


def is_flight(path: Path) -> bool:
    """True if the path is a flight log, the folder of one, or `last` in a folder of flights."""
    return path.suffix.casefold() == Path(MCAP).suffix or (path / MCAP).is_file() or _is_last(path)


def _is_last(path: Path) -> bool:
    return path.name == LAST and not path.exists()


class FlightLog:
    """The log of a flight. `path` is its folder, the file itself, or `last` in a folder of flights.

    `lost` and `cut_off` are valid once `entries` has been read to the end.
    """

    def __init__(self, path: Path) -> None:
        if _is_last(path):
            flights = flights_in(path.parent)
            if not flights:
                raise LogError(f"{path.parent}: contains no flight")
            path = flights[-1]
        self.path = path / MCAP if path.is_dir() else path
        self.lost = 0
        """The number of missing messages."""
        self.cut_off = False
        """The log's end is missing, for example after a power cut."""
        self._last_ns = 0

    @property
    def folder(self) -> Path:
        return self.path.parent

    @property
    def damage(self) -> str:
        """A sentence for people; empty for an intact log."""
        damages = []
        if self.lost:
            damages.append(f"{self.lost} damaged messages are left out")
        if self.cut_off:
            last = datetime.fromtimestamp(self._last_ns / 1e9).strftime("%H:%M:%S")
            damages.append(f"it is incomplete and ends at {last}")
        return f"{self.path.name}: {'; '.join(damages)}" if damages else ""

    def entries(self, topics: Collection[str] | None = None) -> Iterator[LogEntry]:
        """All entries, or those of some topics, in the order in which they were recorded.

        Raises `LogError` if there is nothing to read.
        """
        try:
            with opened(self.path) as file:
                if not file.read(1):
                    raise LogError(f"{self.path}: is empty")
                with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                    yield from self._entries(data, topics)
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read: {error.strerror}") from None
        except TooLargeError as error:
            raise LogError(f"{self.path}: {error}") from None

    def _entries(self, data: mmap.mmap, topics: Collection[str] | None) -> Iterator[LogEntry]:
        self.lost, self.cut_off, self._last_ns = 0, data[-len(MAGIC) :] != MAGIC, 0
        names: dict[int, str] = {}
        expected = count = 0
        for summed in read_summary(data):
            if isinstance(summed, Channel):
                names[summed.id] = summed.topic
            else:
                count = summed.message_count
        for records in read_chunks(data):
            for record in records:
                if isinstance(record, Message):
                    self.lost += (record.sequence - expected) & 0xFFFFFFFF
                    expected = (record.sequence + 1) & 0xFFFFFFFF
                    self._last_ns = record.log_time
                    name = names.get(record.channel_id, "")
                    if name and (topics is None or name in topics):
                        yield LogEntry(name, record.log_time, record.data)
                elif isinstance(record, Channel):
                    names[record.id] = record.topic
        if not names:
            raise LogError(f"{self.path}: is not a flight log, or no part of it can be read")
        self.lost += max(0, count - expected)


def start_of(log: FlightLog) -> Start:
    """The state with which the service started. Raises `LogError` if this part is damaged."""
    for entry in log.entries((START,)):
        return restored(Start, entry.fields)
    raise LogError(f"{log.path}: its beginning is damaged")


def event_of(entry: LogEntry) -> Event:
    """The event of an entry from one of the `EVENT_TOPICS`."""
    message = entry.fields
    if entry.topic == MAVLINK_IN:
        return VehicleMessage(message["t"], message_in(binascii.a2b_base64(message["frame"])))
    if entry.topic == topic_of(Asked):
        kind = _INTENTS.get(message["intent"]["kind"])
        if kind is None:
            raise LogError(f"the log has a request of an earlier version, {message['intent']['kind']}")
        intent: Intent = restored(kind, message["intent"])
        return Asked(message["t"], message["by"], intent, message.get("made_at"), message.get("seen_at"))
    event: Any = restored(_KINDS[entry.topic], message)
    if isinstance(event, Tick | LinkChanged | Said | Stop | Failed):
        return event
    return FirmwareMessage(message["t"], event)


def restored(kind: type[T], values: Mapping[str, Any]) -> T:
    """A dataclass from its fields; a missing field becomes NaN (float) or None."""
    return kind(**{
        name: hint(values[name]) if name in values and _is_enum(hint) else values.get(name, unknown)
        for name, (hint, unknown) in _hints(kind).items()  # type: ignore[arg-type]  # mypy: a type is hashable
    })  # fmt: skip


@cache
def _hints(kind: type) -> dict[str, tuple[Any, float | None]]:
    """The type of each field, and the value that it gets if the log has none."""
    hints = get_type_hints(kind)
    names = [field.name for field in fields(kind)]
    return {name: (hints[name], math.nan if hints[name] is float else None) for name in names}


def _is_enum(hint: Any) -> bool:
    return isinstance(hint, type) and issubclass(hint, IntEnum | IntFlag)


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
