from __future__ import annotations

import dataclasses
import errno
import math
import os
import threading
from pathlib import Path

import pytest

from flying_vines import config
from flying_vines.core import Core
from flying_vines.events import Decision
from flying_vines.notice import Notice, Severity
from flying_vines.record import flight_log
from flying_vines.record.flight_log import FlightLog, read_log
from flying_vines.record.picture import draw_flight

DECISION = Decision(1.5, "switch", {"channel": 9, "position": 2}, "bend-full", "accepted", "", 20.7)
SNAPSHOT = Core(config.default()).snapshot(1.0)


def write_some(log: FlightLog) -> None:
    for i in range(40):
        log.snapshot(dataclasses.replace(SNAPSHOT, t=i * 0.05, cv_kPa=i * 0.5, reservoir_kPa=600.0 - i))
    log.action(DECISION)
    log.action(dataclasses.replace(DECISION, t=1.6, safety="refused", reason="not armed"))
    log.action(Notice(1.7, Severity.WARNING, "Vine: refused bend-full: not armed"))


def test_what_was_written_is_read(tmp_path: Path) -> None:
    log = FlightLog(tmp_path)
    write_some(log)
    log.close()
    entries = list(read_log(log.path))
    assert [e["kind"] for e in entries] == ["snapshot"] * 40 + ["decision", "decision", "notice"]
    assert entries[40]["what"] == {"channel": 9, "position": 2}
    assert math.isnan(SNAPSHOT.bend_deg)
    assert entries[0]["bend_deg"] is None


def test_two_flights_in_a_second_have_two_folders(tmp_path: Path) -> None:
    logs = [FlightLog(tmp_path, began=1e9) for _ in range(3)]
    assert len({log.folder for log in logs}) == 3
    for log in logs:
        log.close()


def test_a_torn_last_line_costs_only_itself(tmp_path: Path) -> None:
    log = FlightLog(tmp_path)
    write_some(log)
    log.close()
    data = log.path.read_bytes()
    log.path.write_bytes(data[:-15])
    assert len(list(read_log(log.path))) == 42


def test_a_full_disk_ends_the_log_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    log = FlightLog(tmp_path)
    write_some(log)
    log.close()
    assert log.failed == "the flight log ends here: No space left on device"


def test_a_disk_that_hangs_holds_up_nobody_and_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    goes_on = threading.Event()
    monkeypatch.setattr(os, "fsync", lambda descriptor: goes_on.wait(10.0))
    log = FlightLog(tmp_path)
    for _ in range(3):
        write_some(log)
    assert len(list(read_log(log.path))) < 3 * 43
    goes_on.set()
    log.close()
    assert not log.failed
    assert len(list(read_log(log.path))) == 3 * 43


def test_a_disk_that_never_returns_ends_the_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    goes_on = threading.Event()
    monkeypatch.setattr(os, "fsync", lambda descriptor: goes_on.wait(10.0))
    monkeypatch.setattr(flight_log, "MOST_BEHIND", 5000)
    monkeypatch.setattr(flight_log, "LAST_WRITES_S", 0.05)
    log = FlightLog(tmp_path)
    for i in range(10):
        log.action(dataclasses.replace(DECISION, t=float(i), reason="x" * 1000))
    assert log.failed == "the flight log ends here: the disk does not keep up"
    log.close()
    assert log.failed == "the end of the flight log is lost: the disk hangs"
    goes_on.set()
    log.close()


def test_the_picture_is_drawn(tmp_path: Path) -> None:
    log = FlightLog(tmp_path)
    write_some(log)
    log.close()
    picture = tmp_path / "flight.png"
    draw_flight(read_log(log.path), picture, "A flight")
    assert picture.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ValueError, match="no snapshot"):
        draw_flight([], picture, "Nothing")
