"""Reads flight logs. In a damaged log it reads all intact parts, and reports the losses."""

from __future__ import annotations

import mmap
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from mcap.records import Channel, Message

from flying_vines.files.bounded import opened
from flying_vines.files.toml_text import one_line
from flying_vines.record.flight_metadata import number_of
from flying_vines.record.folders import MCAP
from flying_vines.record.mcap_file import MAGIC, TooLargeError, read_chunks, read_summary

LAST = "last"
"""The name of the latest flight, if no file or folder has this name."""
_decode = msgspec.json.Decoder(dict[str, Any]).decode


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
