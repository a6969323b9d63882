"""Recorded MAVLink streams (.tlog): each frame follows its time, in microseconds as 8 bytes, big-endian.

This is the computer's time at the arrival of each frame. A computer without a battery for its clock begins in
1970, and its clock steps when the network tells the time. The vehicle's clock (`time_boot_ms`) shows such a
step: the offset between the two clocks changes, and stays changed. After a stall of the link the offset
changes, too, but the delayed frames bring it back.
"""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, Self

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.files.bounded import RECORDING_BYTES, read_bytes
from flying_vines.vehicle.mavlink.frames import MARKERS, fits, frame_at
from flying_vines.vehicle.mavlink.payloads import message_of

MAX_SKIPPED_BYTES = 4_000_000
"""A file with more bytes outside of frames is no recording: to search it takes hours."""
_MARKER = re.compile(b"[" + re.escape(bytes(MARKERS)) + b"]")
_MARKERS = tuple(bytes((marker,)) for marker in MARKERS)
_TIME = struct.Struct(">Q")
_EARLIEST_US = 946_684_800_000_000
"""The year 2000, before MAVLink existed. A computer without a clock begins in 1970."""
_LATEST_US = 4_102_444_800_000_000
_LOOKED_AT_BYTES = 100_000
_STREAM = "no MAVLink frame in the file has a time: it is a raw stream; record a .tlog, as MAVProxy does"
_NO_TLOG = {
    b"\xa3\x95\x80\x80": "an ArduPilot DataFlash log (.bin): give the ground station's .tlog",
    b"FMT, 128": "an ArduPilot DataFlash log as text: give the ground station's .tlog",
    b"ULog": "a PX4 log (.ulg): give the ground station's .tlog",
    b"\x89MCAP": "an MCAP file: name it .mcap",
    b"PK\x03\x04": "a zip file: unpack it first",
    b"\x1f\x8b": "a gzip file: unpack it first",
    b"\xd4\xc3\xb2\xa1": "a capture of network packets (.pcap)",
    b"\x0a\x0d\x0d\x0a": "a capture of network packets (.pcapng)",
    b"QGC WPL": "a mission (.waypoints)",
    b'{\n    "': "a .plan of QGroundControl",
}
"""Files that people take for a .tlog, by their first bytes."""


class TlogError(Exception):
    """The file is not a recording; the text is the reason."""


class TlogWriter:
    """Writes frames. They stay in memory until `sync`. Leaving the context closes the file."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb")
        self._waiting: list[bytes] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()

    def write(self, time_us: int, frame: bytes) -> None:
        """Add a frame of this unix time."""
        self._waiting.append(_TIME.pack(time_us) + frame)

    def sync(self) -> None:
        """Write all frames to the disk (fsync)."""
        self._file.write(b"".join(self._waiting))
        self._waiting.clear()
        self._file.flush()
        os.fsync(self._file.fileno())


class TlogReader:
    """Reads the frames of a .tlog in order, and skips damaged parts.

    `skipped_bytes` counts the bytes that are not part of a frame, including a truncated end.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._data = read_bytes(path, RECORDING_BYTES)
        except FileNotFoundError:
            raise TlogError(f"{path}: no such file") from None
        except OSError as error:
            raise TlogError(f"{path}: cannot be read: {error.strerror}") from None
        self._path = path
        self.skipped_bytes = 0

    def frames(self) -> Iterator[tuple[float, bytes]]:
        """(unix time in s, raw frame). Raises `TlogError` if there is no frame."""
        if self._is_stream():
            raise TlogError(f"{self._path}: {_STREAM}")
        data, at, found = self._data, 0, False
        while at < len(data):
            frame = self._frame_at(at)
            if frame is None:
                next_at = self._next_marker(at + 1)
                self.skipped_bytes += next_at - at
                at = next_at
                if self.skipped_bytes > MAX_SKIPPED_BYTES:
                    raise TlogError(
                        f"{self._path}: {self.skipped_bytes} bytes are no frames: {self._guess()}"
                    )
                continue
            (time_us,) = _TIME.unpack_from(data, at)
            found = True
            yield time_us / 1e6, frame
            at += _TIME.size + len(frame)
        if not found:
            raise TlogError(f"{self._path}: no MAVLink frame in the file: {self._guess()}")

    def _guess(self) -> str:
        """What the file is instead of a .tlog."""
        if not self._data.strip(b"\0"):
            return (
                "it is all zeros: its disk was full, or its computer lost power"
                if self._data
                else "it is empty"
            )
        return next(
            (f"it is {what}" for head, what in _NO_TLOG.items() if self._data.startswith(head)),
            "is it a .tlog?",
        )

    def _is_stream(self) -> bool:
        """True if frames follow one another without a time between them."""
        data = self._data[:_LOOKED_AT_BYTES]
        at = directly = with_time = 0
        while (marker := _MARKER.search(data, at)) is not None:
            frame = frame_at(data, marker.start())
            if frame is None or not frame.known or not fits(frame):
                at = marker.start() + 1
                continue
            at = marker.start() + len(frame.raw)
            directly += data[at : at + 1] in _MARKERS
            with_time += data[at + _TIME.size : at + _TIME.size + 1] in _MARKERS
        return directly > with_time

    def _next_marker(self, at: int) -> int:
        """The next place where a record could start; the end of the data if there is none."""
        found = _MARKER.search(self._data, at + _TIME.size)
        return found.start() - _TIME.size if found else len(self._data)

    def _frame_at(self, at: int) -> bytes | None:
        """The frame of the record that starts at `at`; None if no record starts there."""
        data, begin = self._data, at + _TIME.size
        if begin >= len(data) or data[begin] not in MARKERS:
            return None
        (time_us,) = _TIME.unpack_from(data, at)
        if time_us >= _LATEST_US:
            return None
        frame = frame_at(data, begin)
        if frame is None:
            return None
        follows = begin + len(frame.raw) + _TIME.size
        is_doubtful = time_us < _EARLIEST_US or (follows < len(data) and data[follows] not in MARKERS)
        if is_doubtful and not (frame.known and fits(frame)):
            return None
        return frame.raw


Record = tuple[float, bytes]
"""Unix time in s, and the frame."""

FORWARD_S, BACKWARD_S = 1.0, 0.1
"""A larger difference between the times of two records is examined. Records of a busy computer may be a few
milliseconds out of order."""
WINDOW_S = 30.0
"""After a stall the delayed frames arrive within this time."""
MAX_DRIFT = 0.15
"""A simulated vehicle's clock is up to this much slower than ours."""
STANDS_S = 20.0
"""While a computer's clock stands still, the vehicle's clock goes on for longer than this. It also goes on
after a stall of the link, but not for longer than the stall."""
STEP_IN_SILENCE_S = 60.0
"""A step backwards within a silence must be larger than this."""
MAX_SILENCE_S = 600.0
"""A longer silence is left out, except `KEPT_SILENCE_S`, after which nothing new can happen."""
KEPT_SILENCE_S = 60.0
REORDERED_S = 1.0
"""If the vehicle's clock is further behind than this, the vehicle has rebooted."""


class _Stamp(NamedTuple):
    """A frame with the vehicle's time. `offset_s`: the computer's time less the vehicle's."""

    sender: int
    """The autopilot's system id."""
    boot_s: float
    offset_s: float


def recorded_times(records: Sequence[Record], say: Callable[[str], None]) -> list[float]:
    """The time of each record in s since the first. It never runs backwards.

    `say` gets a sentence for what was wrong with the times.
    """
    return _RecordedTimes(records).times(say) if records else []


class _RecordedTimes:
    def __init__(self, records: Sequence[Record]) -> None:
        self._unix_s = [unix_s for unix_s, _ in records]
        self._stamps: list[_Stamp | None] = []
        for unix_s, frame in records:
            found = _boot_time(frame)
            self._stamps.append(_Stamp(*found, unix_s - found[1]) if found else None)
        self._steps: list[tuple[float, float]] = []
        self._silences: list[tuple[float, float]] = []
        self._stood_s = 0.0

    def times(self, say: Callable[[str], None]) -> list[float]:
        unix_s = self._unix_s
        for index in self._examined():
            if index + 1 < len(unix_s) and _goes_on(unix_s[index - 1], unix_s[index + 1]):
                # One record alone has another time.
                self._steps.append((unix_s[index - 1] - unix_s[0], unix_s[index] - unix_s[index - 1]))
                unix_s[index] = unix_s[index - 1]
        # The vehicle's clock goes through a time in which the computer's stands still.
        begin = 0
        for end in [*self._examined(), len(unix_s)]:
            self._stretch(begin, end)
            begin = end
        times = [0.0]
        step_s = unix_s[0]
        known: dict[int, _Stamp] = {}
        """The last stamp of each sender, with the smallest offset, less the steps."""
        for index, (before_s, now_s) in enumerate(pairwise(unix_s), start=1):
            self._note(known, index - 1, step_s)
            passed_s = now_s - before_s
            if not _goes_on(before_s, now_s):
                error_s = self._error(known, index, step_s)
                if error_s is None:
                    # A reboot, or no clock of a vehicle.
                    error_s = min(0.0, passed_s)
                if error_s:
                    self._steps.append((times[-1], error_s))
                silence_s = passed_s - error_s
                if silence_s > MAX_SILENCE_S:
                    self._silences.append((times[-1], silence_s))
                    left_out_s = silence_s - KEPT_SILENCE_S
                    known = {
                        sender: stamp._replace(offset_s=stamp.offset_s - left_out_s)
                        for sender, stamp in known.items()
                    }
                    error_s += left_out_s
                step_s += error_s
            times.append(max(times[-1], now_s - step_s))
        self._tell(say)
        return times

    def _examined(self) -> list[int]:
        """The records before which the computer's time differs."""
        pairs = enumerate(pairwise(self._unix_s), start=1)
        return [index for index, (one, two) in pairs if not _goes_on(one, two)]

    def _stretch(self, begin: int, end: int) -> None:
        """Use the vehicle's clock between two records if the computer's stands still."""
        stamps = [stamp for stamp in self._stamps[begin:end] if stamp is not None]
        if not stamps:
            return
        sender = stamps[0].sender
        passed_s = max(stamp.boot_s for stamp in stamps if stamp.sender == sender) - stamps[0].boot_s
        first_s = self._unix_s[begin]
        stalled_s = max(0.0, first_s - self._unix_s[begin - 1]) if begin else 0.0
        if passed_s < stalled_s + STANDS_S or self._unix_s[end - 1] - first_s > passed_s / 100.0:
            return
        self._stood_s += passed_s
        now_s = first_s
        for index in range(begin, end):
            if (stamp := self._stamps[index]) is not None:
                if stamp.sender == sender:
                    now_s = max(now_s, first_s + stamp.boot_s - stamps[0].boot_s)
                self._stamps[index] = stamp._replace(offset_s=now_s - stamp.boot_s)
            self._unix_s[index] = now_s

    def _note(self, known: dict[int, _Stamp], index: int, step_s: float) -> None:
        if (stamp := self._stamps[index]) is None:
            return
        offset_s = stamp.offset_s - step_s
        before = known.get(stamp.sender)
        if before is not None and before.boot_s - REORDERED_S < stamp.boot_s:
            # The smallest delay of the last time; the two clocks may drift apart.
            offset_s = min(offset_s, before.offset_s + MAX_DRIFT * abs(stamp.boot_s - before.boot_s))
        known[stamp.sender] = stamp._replace(offset_s=offset_s)

    def _error(self, known: dict[int, _Stamp], index: int, step_s: float) -> float | None:
        """How far the computer's clock steps before a record; None if no vehicle's clock tells it."""
        passed_s = self._unix_s[index] - self._unix_s[index - 1]
        after = self._after(index) if known else []
        for sender, before in known.items():
            stamps = [stamp for stamp in after if stamp.sender == sender]
            if not stamps or min(stamp.boot_s for stamp in stamps) < before.boot_s - REORDERED_S:
                continue
            error_s = min(stamp.offset_s for stamp in stamps) - step_s - before.offset_s
            if error_s > passed_s + FORWARD_S:
                continue  # no time can have passed backwards: the vehicle has rebooted, and was up for longer
            if passed_s < 0.0:
                return min(0.0, error_s)
            is_step = (
                error_s > FORWARD_S + MAX_DRIFT * passed_s
                or error_s < -STEP_IN_SILENCE_S - MAX_DRIFT * passed_s
            )
            return error_s if is_step else 0.0
        return None

    def _after(self, index: int) -> list[_Stamp]:
        """The stamps soon after a record, until the computer's clock steps backwards."""
        found: list[_Stamp] = []
        first_s = last_s = self._unix_s[index]
        for at in range(index, len(self._unix_s)):
            now_s = self._unix_s[at]
            if not last_s - BACKWARD_S <= now_s <= first_s + WINDOW_S:
                break
            if (stamp := self._stamps[at]) is not None:
                found.append(stamp)
            last_s = now_s
        return found

    def _tell(self, say: Callable[[str], None]) -> None:
        if self._stood_s:
            say(
                f"the file's clock stands still for {_readable(self._stood_s)}: "
                "times follow the vehicle's clock"
            )
        if self._steps:
            shown = ", ".join(f"{_signed(step_s)} at {at_s:.1f} s" for at_s, step_s in self._steps[:3])
            more = f", and {len(self._steps) - 3} times more" if len(self._steps) > 3 else ""
            say(f"the file's clock steps by {shown}{more}: times follow the vehicle's clock")
        for at_s, silence_s in self._silences[:3]:
            say(
                f"nothing is recorded for {_readable(silence_s)} after {at_s:.1f} s: "
                f"replayed as a silence of {KEPT_SILENCE_S:.0f} s"
            )


def _goes_on(before_s: float, now_s: float) -> bool:
    return -BACKWARD_S <= now_s - before_s <= FORWARD_S


def _signed(step_s: float) -> str:
    return f"{step_s:+,.0f} s" if abs(step_s) >= 10.0 else f"{step_s:+.1f} s"


def _readable(seconds: float) -> str:
    for unit_s, name in ((86_400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2.0 * unit_s:
            return f"{seconds / unit_s:,.1f} {name}"
    return f"{seconds:.0f} s"


_TIMED = {number for number, kind in mavlink.mavlink_map.items() if "time_boot_ms" in kind.fieldnames}


def _boot_time(raw: bytes) -> tuple[int, float] | None:
    """The autopilot that sent a frame, and its time in s; None if the frame has no such time."""
    frame = frame_at(raw, 0) if raw and raw[0] in MARKERS else None
    if frame is None or frame.component != mavlink.MAV_COMP_ID_AUTOPILOT1:
        return None
    if frame.message_id not in _TIMED or not frame.known or not fits(frame):
        return None
    boot_ms = message_of(frame).time_boot_ms
    return (frame.system, boot_ms / 1000.0) if boot_ms else None
