"""The signing key's file, and the file that saves the signing timestamps over restarts."""

from __future__ import annotations

import hashlib
import re
import threading
from pathlib import Path

from flying_vines.config import on_disk
from flying_vines.files.bounded import decoded, first_line, read_bytes, read_private
from flying_vines.vehicle.mavlink.signing import KEY_SIZE, UNITS_PER_S, SigningMemory

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
_MAX_TIMESTAMP = 2**48 - 1 - AHEAD_AFTER_RESTART


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
        if max(timestamp, *(at for _, at in streams), 0) > _MAX_TIMESTAMP:
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
