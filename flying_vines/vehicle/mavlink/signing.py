"""MAVLink 2 message signing: accepts or refuses frames, and gives our own frames their timestamps.

Sans-IO: the caller gives the time and saves `SigningMemory` (`TimestampFile`). The key comes only
from a file on this computer. SETUP_SIGNING is ignored.

Recorded frames can be replayed. So the timestamps of each stream (link, system, component) must rise, also
over our restarts. MAVLink does not define the start of a new stream. Here its first frame may be up to a
minute old.

MAVLink's clock never goes back: one frame dated 2040, from a sender with the key, would lock out all senders
with the right time. So our signing clock stays near this computer's clock. A frame too far ahead of it is
refused. A saved timestamp too far ahead is dropped. A large jump of this computer's clock is ignored.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import threading
from dataclasses import dataclass
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import on_disk
from flying_vines.files.bounded import decoded, first_line, read_bytes, read_private
from flying_vines.vehicle.mavlink.frames import SIGNATURE_SIZE, Frame

KEY_SIZE = 32
UNITS_PER_S = 100_000
"""The unit of a timestamp is 10 µs."""

UNIX_TIME_OF_ZERO_S = 1_420_070_400
"""Timestamps count from 1 January 2015."""

NEW_STREAM_MAY_LAG = 60 * UNITS_PER_S
MAX_STREAMS = 64
"""More components than any vehicle has. Only a sender with the key can add one."""

DAY = 24 * 3600 * UNITS_PER_S
MAY_BE_AHEAD = DAY
"""Allowed lead over a synchronised clock: enough for a wrong time zone, not for a wrong year."""

MAY_BE_AHEAD_UNSYNCHRONISED = 731 * DAY
"""Allowed lead over an unsynchronised clock, which may be up to two years behind."""

CLOCK_SET_UNIX_S = 1_735_689_600
"""The beginning of 2025. A clock with an earlier time was never set."""

_CLOCK_SET = (CLOCK_SET_UNIX_S - UNIX_TIME_OF_ZERO_S) * UNITS_PER_S
_MAX_TIMESTAMP = 2**47
"""In the year 2059. The field has 48 bits; this leaves a reserve."""

_MAX_REPORTED = 8

_DIGEST_SIZE = 6
_STAMP_SIZE = SIGNATURE_SIZE - _DIGEST_SIZE
"""One byte for the link, six for the timestamp."""

_RADIO = mavlink.MAV_COMP_ID_TELEMETRY_RADIO
_RADIO_MESSAGES = {mavlink.MAVLINK_MSG_ID_RADIO_STATUS, mavlink.MAVLINK_MSG_ID_RADIO}
"""A telemetry radio sends these without a signature, because it has no key. They have no effect here."""


@dataclass(slots=True)
class RefusedFrames:
    """Numbers of refused frames, by reason."""

    unsigned: int = 0
    forged: int = 0
    replayed: int = 0
    """The timestamp is not newer than the last one of its stream, or is too old for a new stream."""

    ahead: int = 0
    """The timestamp is too far ahead of this computer's clock."""

    @property
    def total(self) -> int:
        return self.unsigned + self.forged + self.replayed + self.ahead

    def __str__(self) -> str:
        text = f"{self.unsigned} unsigned, {self.forged} forged, {self.replayed} replayed"
        return f"{text}, {self.ahead} dated ahead" if self.ahead else text


SigningStream = tuple[int, int, int]
"""Link id, system and component."""


@dataclass(frozen=True, slots=True)
class SigningMemory:
    """State that must survive a restart, so that no timestamp is used or accepted twice."""

    timestamp: int = 0
    link_id: int | None = None
    """Our link id; None if none was saved."""
    streams: tuple[tuple[SigningStream, int], ...] = ()
    """The last accepted timestamp of each stream."""


class Signing:
    """Signs and checks with one key on one link.

    `timestamp` is the latest timestamp: of our frames, of accepted frames, or of the clock. It never falls
    while the link id stays the same. If it is far ahead and must be lowered, the link id changes, which makes
    a new stream.
    """

    def __init__(self, key: bytes, link_id: int = 0, memory: SigningMemory = SigningMemory()) -> None:
        if len(key) != KEY_SIZE:
            raise ValueError(f"a signing key has {KEY_SIZE} bytes, not {len(key)}")
        self.key = key
        self.link_id = link_id if memory.link_id is None else memory.link_id
        self.timestamp = memory.timestamp
        self.refused = RefusedFrames()
        self.news: list[str] = []
        """Texts about clocks. The reader empties the list."""
        self._streams: dict[SigningStream, int] = dict(memory.streams)
        self._host: int | None = None
        """This computer's clock, without large jumps."""
        self._followed: tuple[int, float | None] | None = None
        """The last accepted reading of this computer's clock, and its monotonic time."""
        self._synchronised = False
        self._jump_reported = False
        self._ahead_reported: set[tuple[int, int]] = set()

    @property
    def memory(self) -> SigningMemory:
        return SigningMemory(self.timestamp, self.link_id, tuple(self._streams.items()))

    def advance(self, unix_time_s: float, at_s: float | None = None, synchronised: bool = False) -> None:
        """Set the time. A clock that was set back, or never set, does not cause refused frames.

        Args:
            unix_time_s: this computer's clock.
            at_s: a monotonic clock; without it no jump is detected.
            synchronised: the kernel reports the clock as synchronised.
        """
        reading = min(_MAX_TIMESTAMP, int((unix_time_s - UNIX_TIME_OF_ZERO_S) * UNITS_PER_S))
        self._host = self._follow(reading, at_s, synchronised)
        if self.timestamp > self._latest:
            by = (self.timestamp - self._host) / DAY
            self.news.append(f"signing clock was {by:.0f} days ahead: corrected")
            self.timestamp = max(0, self._host)
            self.link_id = (self.link_id + 1) % 256
            self._streams = {known: at for known, at in self._streams.items() if at <= self._latest}
        self.timestamp = max(self.timestamp, self._host)

    def _follow(self, reading: int, at_s: float | None, synchronised: bool) -> int:
        """The clock's reading; after a large jump its expected value."""
        first = synchronised and not self._synchronised
        if self._followed is not None and at_s is not None and not first:
            followed, then_s = self._followed
            expected = followed + (0 if then_s is None else int((at_s - then_s) * UNITS_PER_S))
            jump = reading - expected
            if expected >= _CLOCK_SET and abs(jump) > self._may_be_ahead:
                if not self._jump_reported:
                    self._jump_reported = True
                    self.news.append(f"own clock jumped {jump / DAY:+.0f} days: ignored")
                return min(_MAX_TIMESTAMP, expected)
        self._followed = (reading, at_s)
        self._jump_reported = False
        self._synchronised |= synchronised
        return reading

    @property
    def _may_be_ahead(self) -> int:
        return MAY_BE_AHEAD if self._synchronised else MAY_BE_AHEAD_UNSYNCHRONISED

    @property
    def _latest(self) -> int:
        """The largest timestamp that is accepted."""
        if self._host is None or self._host < _CLOCK_SET:
            return _MAX_TIMESTAMP
        return min(_MAX_TIMESTAMP, self._host + self._may_be_ahead)

    @property
    def _oldest(self) -> int:
        """The smallest timestamp that is accepted for the start of a new stream."""
        if self._synchronised and self._host is not None:
            return self._host - NEW_STREAM_MAY_LAG
        return self.timestamp - NEW_STREAM_MAY_LAG

    def next_timestamp(self) -> int:
        """The timestamp of the next frame. Each frame has its own."""
        self.timestamp += 1
        return self.timestamp

    def admits(self, frame: Frame) -> bool:
        """True if a frame is accepted. Then its timestamp cannot be used again."""
        if not frame.signed:
            if frame.message_id in _RADIO_MESSAGES and frame.component == _RADIO:
                return True
            self.refused.unsigned += 1
            return False
        signed, signature = frame.raw[:-_DIGEST_SIZE], frame.raw[-_DIGEST_SIZE:]
        expected = hashlib.sha256(self.key + signed).digest()[:_DIGEST_SIZE]
        if not hmac.compare_digest(expected, signature):
            self.refused.forged += 1
            return False
        link_id, timestamp = signed[-_STAMP_SIZE], int.from_bytes(signed[1 - _STAMP_SIZE :], "little")
        if timestamp > self._latest:
            self.refused.ahead += 1
            self._report_ahead(frame, timestamp)
            return False
        if not self._is_new((link_id, frame.system, frame.component), timestamp):
            self.refused.replayed += 1
            return False
        self.timestamp = max(self.timestamp, timestamp)
        return True

    def _report_ahead(self, frame: Frame, timestamp: int) -> None:
        sender = (frame.system, frame.component)
        if self._host is None or sender in self._ahead_reported or len(self._ahead_reported) >= _MAX_REPORTED:
            return
        self._ahead_reported.add(sender)
        by = (timestamp - self._host) / DAY
        self.news.append(f"{sender[0]}/{sender[1]} signs {by:.0f} days ahead of our clock")

    def _is_new(self, stream: SigningStream, timestamp: int) -> bool:
        last = self._streams.get(stream)
        if last is None or last > self._latest:
            oldest = self._oldest
            if timestamp < oldest:
                return False
            if stream not in self._streams and len(self._streams) >= MAX_STREAMS:
                # Older streams are safe to forget: their replayed frames are too old for a new stream.
                self._streams = {known: at for known, at in self._streams.items() if at >= oldest}
            if stream not in self._streams and len(self._streams) >= MAX_STREAMS:
                return False
        elif timestamp <= last:
            return False
        self._streams[stream] = timestamp
        return True


MIN_PASSPHRASE_LENGTH = 8
_PASSPHRASE = b"passphrase:"
_HEX = re.compile(rb"[0-9a-fA-F]+")
_FORMS = '64 hexadecimal digits, 32 raw bytes, or a line "passphrase: ..."'

SAVE_AFTER = 30 * UNITS_PER_S
AHEAD_AFTER_RESTART = 60 * UNITS_PER_S
"""Longer than the time between two saves, so that no timestamp is used twice. ArduPilot does the same."""
_FILE = re.compile(r"\d{15}(?: \d{3})?\n(?:\d{3} \d{3} \d{3} \d{15}\n)*")
"""First line: our timestamp and link id. Then each stream's link id, system, component and last timestamp.
Earlier versions saved only the first number. All numbers have a fixed length, so that a cut file is
detected."""
_MAX_SAVED = 2**48 - 1 - AHEAD_AFTER_RESTART


class SigningKeyError(Exception):
    """The file of the key or of the timestamps cannot be used. The text has path, reason and what to do."""


def read_key(path: Path) -> bytes:
    """The key in a file that only its owner may read: hexadecimal, raw, or a passphrase.

    A passphrase becomes a key by SHA-256, as in Mission Planner and MAVProxy. QGroundControl differs.
    """
    content = read_private(path, "the signing key", SigningKeyError, f"; put it there: {_FORMS}")
    try:
        text = first_line(decoded(content)).encode()
    except UnicodeDecodeError:
        text = b""
    if text.startswith(_PASSPHRASE):
        passphrase = text.removeprefix(_PASSPHRASE).strip()
        if len(passphrase) < MIN_PASSPHRASE_LENGTH:
            raise SigningKeyError(f"{path}: the passphrase has less than {MIN_PASSPHRASE_LENGTH} characters")
        return hashlib.sha256(passphrase).digest()
    if _HEX.fullmatch(text) and len(text) == 2 * KEY_SIZE:
        key = bytes.fromhex(text.decode("ascii"))
    elif len(content) == KEY_SIZE and not (content.isascii() and content.strip().decode().isprintable()):
        key = content
    else:
        raise SigningKeyError(f"{path}: no signing key in the file: write {_FORMS}")
    if not any(key):
        raise SigningKeyError(f"{path}: the key is all zeros: write {_FORMS}")
    return key


class TimestampFile:
    """Saves the signing timestamps, so that they increase even if the clock is behind after a restart."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._saved: int | None = None
        self._writing = threading.Lock()

    def load(self) -> tuple[SigningMemory, str]:
        """The saved memory, and a sentence if the file cannot be used."""
        try:
            text = read_bytes(self._path).decode("ascii")
        except FileNotFoundError:
            return SigningMemory(), ""
        except (OSError, UnicodeDecodeError) as error:
            return SigningMemory(), self._clock_alone(getattr(error, "strerror", None) or "damaged")
        if not _FILE.fullmatch(text):
            return SigningMemory(), self._clock_alone("damaged")
        (timestamp, *link_id), *lines = (tuple(map(int, line.split())) for line in text.splitlines())
        streams = tuple(((link, system, component), at) for link, system, component, at in lines)
        if max(timestamp, *(at for _, at in streams), 0) > _MAX_SAVED:
            return SigningMemory(), self._clock_alone("damaged")
        return SigningMemory(timestamp + AHEAD_AFTER_RESTART, link_id[0] if link_id else None, streams), ""

    def _clock_alone(self, why: str) -> str:
        return f"{self._path}: {why}; the signing timestamp continues from the clock alone"

    def due(self, timestamp: int) -> bool:
        """True if it is time to save: at the start, every 30 s, and after a jump of the clock."""
        return self._saved is None or not 0 <= timestamp - self._saved < SAVE_AFTER

    def save(self, memory: SigningMemory) -> None:
        """Write the file atomically. Blocks on a slow disk."""
        self._saved = memory.timestamp
        lines = [f"{memory.timestamp:015d} {memory.link_id or 0:03d}\n"]
        for (link_id, system, component), timestamp in memory.streams:
            lines.append(f"{link_id:03d} {system:03d} {component:03d} {timestamp:015d}\n")
        try:
            with self._writing:
                on_disk.put(self._path, "".join(lines))
        except OSError as error:
            raise SigningKeyError(
                f"{self._path}: the signing timestamp cannot be written: {error.strerror}"
            ) from None
