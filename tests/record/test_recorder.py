"""The recorder's files, and the behaviour if the disk fails."""

from __future__ import annotations

import binascii
import dataclasses
import errno
import json
import math
import os
import random
import shutil
import threading
import time
from collections import Counter, namedtuple
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from recorded_flight import BEGAN, CONFIG, LOW, fly, new_flight, one_bend

from firmware_link.protocol import Fault, Mode, Telemetry, Welcome
from flying_vines.core.core import Core
from flying_vines.core.events import (
    Asked,
    Decision,
    Event,
    FirmwareMessage,
    KeepDisarmed,
    KeepParameters,
    LinkChanged,
    Said,
    Stop,
    StoredState,
    Tick,
    ToVehicle,
    VehicleMessage,
)
from flying_vines.gateway.page.flights import listed
from flying_vines.record import folders as folders_module
from flying_vines.record import recorder as recorder_module
from flying_vines.record.reader import FlightLog, LogEntry, LogError, event_of, flights_in, start_of
from flying_vines.record.recorder import Recorder
from flying_vines.record.schema import Schema
from flying_vines.record.topics import TOPICS, encoded, entry_of_event
from flying_vines.simulation.replay import replay_flight
from flying_vines.vehicle.component.requests import ProtocolVersion
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.mavlink.tlog import TlogReader
from flying_vines.vehicle.notice import Notice, Severity
from flying_vines.vine.intent import BendTo, StartProfile, VentVine

SNAPSHOT = Core(CONFIG).snapshot(1.0)
READING = Telemetry(1234, Mode.REGULATE, Fault.DEAD_MAN | Fault.SUPPLY, 3, 10.0, 0.1, 600.0, 0.5, 0.0, True)
DECISION = Decision(1.5, "switch", {"channel": 9, "position": 2}, "bend-full", "accepted", "", 20.7)


def write_some(recorder: Recorder, times: int = 40) -> None:
    for i in range(times):
        recorder.snapshot(dataclasses.replace(SNAPSHOT, t=i * 0.05, cv_kPa=i * 0.5))
        recorder.event(FirmwareMessage(i * 0.05, READING))


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return one_bend(tmp_path_factory.mktemp("flown"))


def test_another_reader_finds_the_same(flown: Path) -> None:
    ours = [(entry.topic, entry.unix_ns, entry.data) for entry in FlightLog(flown).entries()]
    with (flown / "flight.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        theirs = [
            (channel.topic, message.log_time, message.data)
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]
        summary = reader.get_summary()
    assert theirs == ours
    assert summary is not None and summary.statistics is not None
    assert summary.statistics.message_count == len(ours)
    assert summary.statistics.channel_count == len(TOPICS)
    assert {index.compression for index in summary.chunk_indexes} == {"zstd"}
    assert summary.statistics.message_start_time == ours[0][1]


def test_every_message_fits_its_schema(flown: Path) -> None:
    schemas = {topic.name: topic.schema for topic in TOPICS}
    seen: Counter[str] = Counter()
    for entry in FlightLog(flown).entries():
        assert_fits(entry.fields, schemas[entry.topic], entry.topic)
        seen[entry.topic] += 1
    assert seen["phlosar/telemetry"] > 700
    assert seen["snapshot"] == 80
    assert seen["tick"] == 400
    assert {"mavlink/in", "mavlink/out", "phlosar/setpoint", "decision", "start"} <= seen.keys()


def assert_fits(value: Any, schema: Schema, where: str) -> None:
    kinds: dict[str, Any] = {
        "number": (int, float),
        "integer": int,
        "string": str,
        "boolean": bool,
        "object": dict,
    }
    if schema["type"] == "array":
        for item in value:
            assert_fits(item, schema["items"], where)
        return
    assert isinstance(value, kinds[schema["type"]]), f"{where}: {value!r} is no {schema['type']}"
    if schema["type"] == "object" and schema["properties"]:
        for name, item in value.items():
            assert_fits(item, schema["properties"][name], f"{where}.{name}")


def test_viewers_can_read_every_schema() -> None:
    """Foxglove needs one word for a type, properties of every object, and plain items of arrays."""

    def look(schema: Schema, where: str) -> None:
        assert schema["type"] in ("number", "integer", "string", "boolean", "object", "array"), where
        if schema["type"] == "object":
            for name, field in schema["properties"].items():
                look(field, f"{where}.{name}")
        if schema["type"] == "array":
            assert schema["items"]["type"] in ("number", "integer", "string", "boolean"), where

    for topic in TOPICS:
        look(topic.schema, topic.name)
        assert topic.schema["properties"]["t"] == {"type": "number"}


EVENTS: tuple[Event, ...] = (
    LinkChanged(0.1, "firmware", False, "in use by another program"),
    Tick(0.1 + 0.2),
    Said(1 / 3, Severity.WARNING, "Ω °"),
    FirmwareMessage(0.4, READING),
    FirmwareMessage(0.5, Welcome(2, 1, 77, "1.0", 1, 30.0, 28.0, 760.0, 200.0, 300, 100)),
    Asked(0.6, "page", BendTo(40.1)),
    Asked(0.7, "broker", StartProfile("bend-half")),
    Asked(0.8, "page", VentVine()),
    Stop(0.9),
)


def test_events_come_back_as_they_were(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, BEGAN, t=0.0)
    for event in EVENTS:
        recorder.event(event)
    recorder.close()
    assert tuple(event_of(e) for e in FlightLog(recorder.folder).entries() if e.topic != "start") == EVENTS


def test_a_request_of_an_earlier_version_is_refused_in_one_line() -> None:
    asked = LogEntry(
        "asked", 0, encoded(entry_of_event(Asked(1.0, "page", VentVine()))).replace(b"Vent", b"Gone")
    )
    with pytest.raises(LogError, match="a request of an earlier version, Gone"):
        event_of(asked)


def test_answers_are_written(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, BEGAN, t=0.0)
    recorder.action(DECISION)
    recorder.action(Notice(1.7, Severity.WARNING, "Vine: refused bend-full: not armed"))
    recorder.action(KeepParameters(2.1, {"VINE_RATE_HZ": 3.0}))
    recorder.action(KeepDisarmed(2.2, True))
    recorder.snapshot(dataclasses.replace(SNAPSHOT, t=2.3))
    recorder.close()
    _, decision, notice, parameters, disarmed, snapshot = (
        entry.fields for entry in FlightLog(recorder.folder).entries()
    )
    assert decision["what"] == {"channel": 9, "position": 2}
    assert notice["severity"] == 4
    assert parameters["values"] == {"VINE_RATE_HZ": 3.0}
    assert disarmed["disarmed"] is True
    assert math.isnan(SNAPSHOT.bend_deg) and "bend_deg" not in snapshot


def test_mavlink_goes_into_a_tlog_as_well(flown: Path) -> None:
    log = [entry for entry in FlightLog(flown).entries() if entry.topic.startswith("mavlink/")]
    reader = TlogReader(flown / "flight.tlog")
    frames = list(reader.frames())
    assert reader.skipped_bytes == 0
    assert [round(unix_s * 1e6) for unix_s, _ in frames] == [entry.unix_ns // 1000 for entry in log]
    received = mavutil.mavlink_connection(str(flown / "flight.tlog"))
    kinds = [entry.fields["name"] for entry in log]
    assert [received.recv_match().get_type() for _ in kinds] == kinds
    received.close()


def test_a_message_that_the_dialect_lacks_is_kept(tmp_path: Path) -> None:
    ours = ProtocolVersion()
    raw = ours.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=191))
    recorder = Recorder(tmp_path, BEGAN, t=0.0)
    recorder.event(Tick(0.0))
    recorder.action(ToVehicle(ours, 1))
    recorder.close()
    assert not recorder.failed
    _, _, entry = FlightLog(recorder.folder).entries()
    assert entry.fields["name"] == "UNKNOWN_300"
    assert binascii.a2b_base64(entry.fields["frame"]) == raw
    assert [frame for _, frame in TlogReader(recorder.folder / "flight.tlog").frames()] == [raw]


def test_a_write_error_ends_only_the_log(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, BEGAN, t=0.0)
    recorder.action(dataclasses.replace(DECISION, what={"no JSON": object()}))
    recorder.close()
    assert "the flight log ends here: TypeError" in recorder.failed
    assert len(list(FlightLog(recorder.folder).entries())) == 1


def test_the_folder_has_the_versions_and_files_of_the_flight(tmp_path: Path) -> None:
    began = dataclasses.replace(
        BEGAN, rig="[cv]\nvolume_L = 0.1\n", stored=StoredState({"VINE_RATE_HZ": 3.0})
    )
    recorder = Recorder(tmp_path, began, t=0.0)
    for event in EVENTS:
        recorder.event(event)
    recorder.close()
    names = sorted(path.name for path in recorder.folder.iterdir())
    assert names == ["about.json", "flight.mcap", "flight.tlog", "profile.toml", "rig.toml"]
    assert (recorder.folder / "profile.toml").read_text() == BEGAN.configuration
    about = json.loads((recorder.folder / "about.json").read_text())
    assert about["firmware"] == {"build": "1.0", "protocol_version": 2, "boot_id": 77}
    assert about["continues"] == ""
    assert {"flying_vines", "python", "packages", "kernel", "machine"} <= about.keys()
    start = start_of(FlightLog(recorder.folder))
    assert (start.rig, start.parameters, start.profile) == (
        began.rig,
        began.stored.parameters,
        began.configuration,
    )
    assert start.believed["cv"]["volume_L"] == 0.1


def test_a_second_flight_has_a_folder_of_its_own(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, BEGAN, t=0.0)
    for i, armed in enumerate((False, True, False, True, True, False, True)):
        recorder.event(FirmwareMessage(float(i), EVENTS[4].message))  # type: ignore[union-attr]
        recorder.snapshot(dataclasses.replace(SNAPSHOT, t=float(i), armed=armed))
    recorder.close()
    folders = sorted(tmp_path.iterdir())
    assert len(folders) == 3 and recorder.folder == folders[-1]
    armings = [
        [entry.fields["armed"] for entry in FlightLog(folder).entries(("snapshot",))] for folder in folders
    ]
    assert armings == [[False, True, False], [True, True, False], [True]]
    for before, after in pairwise(folders):
        assert start_of(FlightLog(after)).continues == before.name
        about = json.loads((after / "about.json").read_text())
        assert about["continues"] == before.name and about["firmware"]["boot_id"] == 77
    assert not any(FlightLog(folder).damage for folder in folders)


def test_a_long_service_does_not_fill_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folders_module, "MAX_CHUNKS", 5)
    recorder = Recorder(tmp_path, BEGAN, t=0.0)
    for i in range(1000):
        recorder.event(Tick(i * 0.02))
    recorder.close()
    logs = [FlightLog(folder) for folder in sorted(tmp_path.iterdir())]
    ticks = [entry.fields["t"] for log in logs for entry in log.entries(("tick",))]
    assert ticks == [i * 0.02 for i in range(1000)]
    assert len(logs) > 2 and not any(log.damage for log in logs)
    assert [start_of(log).continues for log in logs[1:]] == [log.folder.name for log in logs[:-1]]


def test_the_clock_may_jump(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = Recorder(tmp_path, BEGAN, t=0.0)
    recorder.event(Tick(1.0))
    monkeypatch.setattr(time, "time_ns", lambda: 0)
    monkeypatch.setattr(time, "time", lambda: 0.0)
    recorder.event(Tick(2.0))
    recorder.close()
    first, second = (entry.unix_ns for entry in FlightLog(recorder.folder).entries(("tick",)))
    assert second - first == 1_000_000_000


def test_flights_of_one_second_have_folders_of_their_own_in_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time, "strftime", lambda *args: "2026-07-26_14-03-05")
    recorders = [Recorder(tmp_path, BEGAN, t=0.0) for _ in range(12)]
    for recorder in recorders:
        recorder.close()
    folders = [recorder.folder for recorder in recorders]
    assert len(set(folders)) == 12
    assert flights_in(tmp_path) == folders
    assert [file.flight for file in listed(tmp_path)][::-2] == [folder.name for folder in folders]


def test_a_full_disk_ends_the_log_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    recorder = Recorder(tmp_path, BEGAN, t=0.0)
    monkeypatch.setattr(os, "fsync", full)
    write_some(recorder)
    recorder.close()
    assert recorder.failed == "the flight log ends here: No space left on device"


def write_until(recorder: Recorder, t: float, condition: Callable[[], bool]) -> float:
    """Tick until the condition is true. Returns the time."""
    for _ in range(60):
        for _ in range(50):
            t += 0.02
            recorder.event(Tick(t))
        ends = time.monotonic() + 0.2
        while time.monotonic() < ends:
            if condition():
                return t
            time.sleep(0.001)
    raise AssertionError("it never came")


def ticks(folder: Path) -> list[float]:
    return [entry.fields["t"] for entry in FlightLog(folder).entries(("tick",))]


@pytest.mark.parametrize(
    "what",
    [
        "the folder",
        pytest.param("all folders", marks=pytest.mark.long),
        pytest.param("the file", marks=pytest.mark.long),
    ],
)
def test_a_folder_that_vanishes_is_reported_and_the_log_continues_in_another(
    tmp_path: Path, what: str
) -> None:
    flights = tmp_path / "flights"
    recorder = Recorder(flights, BEGAN, t=0.0)
    first = recorder.folder
    recorder.event(FirmwareMessage(0.0, EVENTS[4].message))  # type: ignore[union-attr]
    t = write_until(recorder, 0.0, lambda: (first / "flight.mcap").stat().st_size > 20_000)
    if what == "the file":
        (first / "flight.mcap").unlink()
    else:
        shutil.rmtree(flights if what == "all folders" else first)
    t = write_until(recorder, t, lambda: bool(recorder.news))
    assert recorder.news == recorder.failed == "the flight log ends here: its folder was deleted"
    t = write_until(recorder, t, lambda: not recorder.failed)
    assert recorder.news == f"the flight log continues in {recorder.folder.name}"
    for i in range(1, 101):
        recorder.event(Tick(t + 0.02 * i))
    recorder.close()
    assert not recorder.failed
    log = FlightLog(recorder.folder)
    assert ticks(recorder.folder)[-1] == t + 2.0 and not log.damage
    assert start_of(log).continues == first.name
    assert json.loads((recorder.folder / "about.json").read_text())["firmware"]["boot_id"] == 77


def test_a_disk_that_is_read_only_for_a_while_is_reported_once_and_leaves_no_litter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tries = [0]

    def read_only(descriptor: int) -> None:
        tries[0] += 1
        raise OSError(errno.EROFS, "Read-only file system")

    told = []
    recorder = Recorder(tmp_path, BEGAN, t=0.0)
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", read_only)

        def several_tries() -> bool:
            if recorder.news not in told:
                told.append(recorder.news)
            return tries[0] > 3

        t = write_until(recorder, 0.0, several_tries)
    assert told == ["", "the flight log ends here: Read-only file system"]
    assert len(list(tmp_path.iterdir())) <= 2
    write_until(recorder, t, lambda: not recorder.failed)
    recorder.close()
    assert len(list(tmp_path.iterdir())) == 2
    assert ticks(recorder.folder)


def test_a_replay_reports_gaps_of_the_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Usage = namedtuple("Usage", "total used free")
    free_MB = [500.0]
    monkeypatch.setattr(shutil, "disk_usage", lambda path: Usage(1e9, 5e8, free_MB[0] * 1e6))
    recorder = Recorder(tmp_path, BEGAN, least_free_MB=200.0, t=0.0)
    flight = new_flight()
    fly(flight, recorder, ((3.0, LOW),))
    free_MB[0] = 150.0
    t = write_until(recorder, 3.0, lambda: bool(recorder.failed))
    free_MB[0] = 205.0
    t = write_until(recorder, t + 5.0, lambda: True)
    assert recorder.failed, "it would soon be full again"
    free_MB[0] = 500.0
    write_until(recorder, t + 5.0, lambda: not recorder.failed)
    recorder.close()
    again = replay_flight(FlightLog(recorder.folder))
    assert not again.differences
    assert again.damage.startswith("nothing was recorded for ")
    assert again.damage.endswith(f" s before {recorder.folder.name}")


def test_little_room_ends_the_log_before_the_disk_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Usage = namedtuple("Usage", "total used free")
    free_MB = [500.0]
    monkeypatch.setattr(shutil, "disk_usage", lambda path: Usage(1e9, 5e8, free_MB[0] * 1e6))
    recorder = Recorder(tmp_path, BEGAN, least_free_MB=200.0, t=0.0)
    fly(new_flight(), recorder, ((3.0, LOW),))
    t = write_until(recorder, 3.0, lambda: (recorder.folder / "flight.mcap").stat().st_size > 20_000)
    free_MB[0] = 150.0
    write_until(recorder, t + 2.0, lambda: bool(recorder.failed))
    recorder.close()
    assert recorder.failed == (
        "the flight log ends here: the disk has 150 MB left, and log.least_free_MB is 200"
    )
    log = FlightLog(recorder.folder)
    assert len(list(log.entries())) > 100  # 20 kB hold at least this
    assert not log.damage, "it was brought to its end"


def test_a_disk_that_hangs_delays_nothing_and_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    goes_on = threading.Event()
    recorder = Recorder(tmp_path, BEGAN, t=0.0)
    monkeypatch.setattr(os, "fsync", lambda descriptor: goes_on.wait(10.0))
    for _ in range(3):
        write_some(recorder)
    assert len(list(FlightLog(recorder.folder).entries())) < 3 * 80
    goes_on.set()
    recorder.close()
    assert not recorder.failed
    assert len(list(FlightLog(recorder.folder).entries())) == 1 + 3 * 80


def test_a_disk_that_never_returns_ends_the_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    goes_on = threading.Event()
    monkeypatch.setattr(recorder_module, "MAX_WAITING", 100)
    monkeypatch.setattr(recorder_module, "LAST_WRITES_S", 0.05)
    recorder = Recorder(tmp_path, BEGAN, t=0.0)
    monkeypatch.setattr(os, "fsync", lambda descriptor: goes_on.wait(10.0))
    for i in range(300):
        recorder.event(Tick(i * 0.02))
    assert recorder.failed == "the flight log ends here: the disk does not keep up"
    recorder.close()
    assert recorder.failed == "the end of the flight log is lost: the disk hangs"
    goes_on.set()
    recorder.close()


def test_any_mavlink_message_comes_back_whatever_is_in_it() -> None:
    chance = random.Random(4)
    (number,) = (n for n, topic in enumerate(TOPICS, start=1) if topic.name == "mavlink/in")
    schema = TOPICS[number - 1].schema
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    for kind in mavlink.mavlink_map.values():
        payload = bytes(chance.randrange(1, 256) for _ in range(kind.unpacker.size))
        blank = mavlink.MAVLink_message(kind.id, kind.msgname)
        blank._pack(sender, kind.crc_extra, payload)
        raw = blank.get_msgbuf()
        if kind.msgname == "SETUP_SIGNING":
            (received,) = MavlinkCodec(0, 191).decode(raw)
            assert not any(received.secret_key), "a key is in no log"
            continue
        (received,) = MavlinkCodec(0, 191).decode(raw)
        data = encoded(entry_of_event(VehicleMessage(1.0, received)))
        assert_fits(json.loads(data), schema, kind.msgname)
        again = event_of(LogEntry("mavlink/in", 0, data))
        assert isinstance(again, VehicleMessage)
        assert again.message.get_msgbuf() == raw
        assert str(again.message) == str(received)
