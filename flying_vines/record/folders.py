"""The folders and files of flights. The recorder's thread writes them.

    flight.mcap     everything: see `topics`
    flight.tlog     MAVLink of both directions, for ground stations
    profile.toml    the text of the configuration
    rig.toml        the text of the rig file, if there was one
    about.json      versions, machine, firmware

The files are synced to the disk twice a second. So a power cut loses less than a second.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import msgspec

from firmware_link import protocol
from flying_vines.config import on_disk
from flying_vines.config.config import PneumaticsConfig
from flying_vines.core.events import StoredState
from flying_vines.record.flight_metadata import ABOUT, FlightMetadata, number_of, version_of
from flying_vines.record.mcap_file import McapFile
from flying_vines.record.topics import (
    MAVLINK_IN,
    MAVLINK_OUT,
    NUMBERS,
    TOPICS,
    RawEntry,
    Start,
    encoded,
    entry_of_state,
)
from flying_vines.supply import nominal_rig
from flying_vines.vehicle.mavlink.tlog import TlogWriter

MCAP, TLOG = "flight.mcap", "flight.tlog"
CONFIGURATION, RIG = "profile.toml", "rig.toml"
SYNC_S = 0.5
CHECK_DISK_S = 1.0
TRY_AGAIN_S = 2.0
MORE_ROOM_MB = 10.0
"""A log that has stopped continues only with this much free space above `least_free_MB` (hysteresis)."""
MAX_CHUNKS = 36_000
"""Maximum number of chunks in a log: about five hours, and 50 MB of memory for the summary. Then a new
folder starts, even in flight."""
_MAVLINK = (NUMBERS[MAVLINK_IN], NUMBERS[MAVLINK_OUT])


@dataclass(frozen=True, slots=True)
class FlightStart:
    """The state with which the service started its core. It is the first entry of every log."""

    configuration: str
    """The configuration's text."""
    pneumatics: PneumaticsConfig
    """The rig's numbers in the configuration."""
    rig: str = ""
    """The rig file's text, if there is one."""
    stored: StoredState = field(default_factory=StoredState)


class LogEnded(OSError):
    """An entry cannot be written, and a retry would not help: the program has an error."""

    def __init__(self, why: str) -> None:
        super().__init__(0, why)


class Folders:
    """Writes one folder after another: the first in `__init__`, the others in the recorder's thread."""

    def __init__(self, parent: Path, began: FlightStart, least_free_MB: float, t: float) -> None:
        """Writes the first folder and the start of its log to the disk. `t`: the present time."""
        self._parent = parent
        self._began = began
        self._least_free_MB = least_free_MB
        self._zero_unix_ns = time.time_ns() - round(t * 1e9)
        self._firmware: protocol.Welcome | None = None
        self._checked_at = self._synced_at = t - CHECK_DISK_S
        self.problem = ""
        """Why nothing can be written now; empty if there is no problem."""
        self.continued_in = ""
        """The folder in which the log continued after the last problem."""
        self._try_again_at = 0.0
        self._number = max(map(number_of, parent.iterdir()), default=0) if parent.is_dir() else 0
        self.folder = self._make_folder()
        self._files: Files | None = self._begin(t, "")

    def write(self, batches: Sequence[Sequence[RawEntry | None]]) -> None:
        """Write entries. An entry None starts a new folder.

        After a disk error, `problem` is its text, and later entries are written as soon as the disk allows
        it. Raises `LogEnded` after any other error.
        """
        for batch in batches:
            for entry in batch:
                try:
                    if entry is None:
                        self._next_folder()
                    else:
                        self._write_entry(entry)
                except OSError as error:
                    self._fail(error, self._checked_at if entry is None else entry[1])
                except Exception as error:
                    raise LogEnded(f"{type(error).__name__}: {error}") from error

    def _fail(self, error: OSError, t: float) -> None:
        self._try_again_at = t + TRY_AGAIN_S
        with contextlib.suppress(OSError):
            self.close(whole=False)
        self.problem = error.strerror or str(error)

    def close(self, whole: bool) -> None:
        """Close the files. Write the summary if the log is `whole`."""
        files, self._files = self._files, None
        if files is None:
            return
        with files:
            if whole:
                files.finish()

    def _write_entry(self, entry: RawEntry) -> None:
        t = entry[1]
        if isinstance(entry[2], protocol.Welcome):
            self._firmware = entry[2]
        if self._files is None:
            if t < self._try_again_at:
                return
            self._files = self._continue(t)
        self._files.add(entry)
        if isinstance(entry[2], protocol.Welcome):
            self._files.add_firmware(entry[2])
        if t - self._synced_at >= SYNC_S:
            self._synced_at = t
            self._files.sync()
            if self._files.chunks > MAX_CHUNKS:
                self._next_folder()
        if t - self._checked_at >= CHECK_DISK_S:
            self._checked_at = t
            if not self._files.exist:
                raise OSError(errno.ENOENT, "its folder was deleted")
            self._check_room(self.folder)

    def _check_room(self, folder: Path, more_MB: float = 0.0) -> None:
        free_MB = shutil.disk_usage(folder).free / 1e6
        if free_MB < self._least_free_MB + more_MB:
            self.close(whole=True)
            raise OSError(
                errno.ENOSPC,
                f"the disk has {free_MB:.0f} MB left, and log.least_free_MB is {self._least_free_MB:g}",
            )

    def _continue(self, t: float) -> Files:
        """Continue in a new folder. Raises `OSError` while that is not possible."""
        with contextlib.suppress(FileNotFoundError):
            self._check_room(self._parent, MORE_ROOM_MB)
        files = self._open_next(t)
        self.continued_in, self.problem = self.folder.name, ""
        return files

    def _next_folder(self) -> None:
        if self._files is None:
            return
        t = self._files.latest
        self.close(whole=True)
        self._files = self._open_next(t)

    def _open_next(self, t: float) -> Files:
        before, folder = self.folder, self._make_folder()
        try:
            self.folder = folder
            return self._begin(t, before.name)
        except OSError:
            self.folder = before
            shutil.rmtree(folder, ignore_errors=True)
            raise

    def _begin(self, t: float, continues: str) -> Files:
        self._number += 1
        files = Files(self.folder, self._number, self._zero_unix_ns, self._began, t, continues)
        if self._firmware is not None:
            files.add_firmware(self._firmware)
        return files

    def _make_folder(self) -> Path:
        """Make a folder named by the present local time. Folders of the same second sort in order of time."""
        stamp = time.strftime("%Y-%m-%d_%H-%M-%S")
        for suffix in ("", *(f"_{n:03}" for n in range(2, 1000))):
            folder = self._parent / (stamp + suffix)
            try:
                folder.mkdir(parents=True)
            except FileExistsError:
                continue
            try:
                on_disk.sync_folder(self._parent)
            except OSError:
                folder.rmdir()
                raise
            return folder
        raise FileExistsError(f"{self._parent}: a thousand flights in one second")


class Files:
    def __init__(
        self, folder: Path, number: int, zero_unix_ns: int, began: FlightStart, t: float, continues: str
    ) -> None:
        self.latest = t
        self._folder = folder
        self._zero_unix_ns = zero_unix_ns
        self._metadata = FlightMetadata.of_this_machine(number, self._unix_ns(t) / 1e9, continues)
        self._opened = contextlib.ExitStack()
        self._file = self._opened.enter_context((folder / MCAP).open("wb"))
        try:
            self._begin(began, t, continues)
        except OSError:
            # Without this the garbage collector flushes the buffers, which fails again and prints a warning.
            with contextlib.suppress(OSError):
                self._opened.close()
            raise

    def _begin(self, began: FlightStart, t: float, continues: str) -> None:
        self._tlog = self._opened.enter_context(TlogWriter(self._folder / TLOG))
        on_disk.put(self._folder / CONFIGURATION, began.configuration)
        if began.rig:
            on_disk.put(self._folder / RIG, began.rig)
        self._write_about()
        self._mcap = McapFile(self._file, TOPICS, f"flying-vines {version_of('flying-vines')}")
        start = Start(
            t=t,
            profile=began.configuration,
            rig=began.rig,
            parameters=began.stored.parameters,
            disarmed=began.stored.disarmed,
            learned=began.stored.learned,
            believed=msgspec.to_builtins(nominal_rig(began.pneumatics)),
            continues=continues,
            latched=began.stored.latched,
            board_settings=began.stored.board_settings,
        )
        self.add(entry_of_state(start))
        self.sync()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._opened.close()

    @property
    def chunks(self) -> int:
        return self._mcap.chunks

    def add(self, entry: RawEntry) -> None:
        number, self.latest, content = entry
        time_ns = self._unix_ns(self.latest)
        self._mcap.add(number, time_ns, encoded(entry))
        if number in _MAVLINK:
            self._tlog.write(time_ns // 1000, bytes(content))

    def sync(self) -> None:
        self._mcap.flush()
        os.fsync(self._file.fileno())
        self._tlog.sync()

    @property
    def exist(self) -> bool:
        """True if the files are still in the folder. Writing to a deleted file gives no error."""
        try:
            return os.path.samestat((self._folder / MCAP).stat(), os.fstat(self._file.fileno()))
        except FileNotFoundError:
            return False

    def finish(self) -> None:
        self._mcap.finish()
        os.fsync(self._file.fileno())
        self._tlog.sync()

    def add_firmware(self, firmware: protocol.Welcome) -> None:
        self._metadata = self._metadata.with_firmware(firmware)
        self._write_about()

    def _write_about(self) -> None:
        on_disk.put(
            self._folder / ABOUT, msgspec.json.format(msgspec.json.encode(self._metadata)).decode() + "\n"
        )

    def _unix_ns(self, t: float) -> int:
        return self._zero_unix_ns + round(t * 1e9)
