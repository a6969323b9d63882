"""`flying-vines log`: output, files and errors."""

from __future__ import annotations

import csv
import json
import re
import shutil
import zipfile
from pathlib import Path

import command_line
import pytest
from recorded_flight import BEGAN, HIGH, LOW, fly, new_flight, one_bend

from flying_vines.core.events import Asked
from flying_vines.record.reader import FlightLog, summarise
from flying_vines.record.recorder import Recorder
from flying_vines.vine.intent import ArmPneumatics, BendTo, ClearLatchedFaults, Hold, StartBench, VentVine


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    parent = tmp_path_factory.mktemp("flights")
    one_bend(parent)
    return parent


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Runner:
    return Runner(capsys)


class Runner:
    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *arguments: object, status: int = 0) -> tuple[str, str]:
        ended, out, err = command_line.run(self._capsys, "log", *arguments)
        assert ended == status, err
        return out, err


def test_list_has_a_line_a_flight(flights: Path, run: Runner, tmp_path: Path) -> None:
    (folder,) = flights.iterdir()
    out, _ = run("list", flights)
    (header, line) = (part for part in out.splitlines() if part.strip())
    assert header.split()[:4] == ["flight", "length", "armed", "bends"]
    assert folder.name in line and " 0:08 " in line
    (said,) = json.loads(run("list", flights, "--json")[0])
    assert (said["bends"], said["refused"], said["armed_s"]) == (1, 0, 0.0)
    assert 500.0 < said["lowest_reservoir_kPa"] < 690.0 and 0.1 < said["size_MB"] < 1.0
    assert "no flights yet" in run("list", tmp_path)[0]


def test_only_a_bend_counts_as_a_bend(tmp_path: Path) -> None:
    recorder, flight = Recorder(tmp_path, BEGAN, t=0.0), new_flight()
    fly(flight, recorder, ((3.0, LOW), (5.0, HIGH)))
    requests = (ArmPneumatics(), StartBench(), ClearLatchedFaults(), Hold(), BendTo(20.0), VentVine())
    for intent in requests:
        flight.core.handle(Asked(5.0, "page", intent, seen_at=5.0))
    recorder.close()
    log = FlightLog(recorder.folder)
    said = [entry.fields for entry in log.entries(("decision",))]
    assert [one["safety"] for one in said] == 7 * ["accepted"]
    assert sum(one["setpoint_kPa"] > 0.0 for one in said) == 6
    assert summarise(log).bends == 2


def test_list_goes_on_over_what_cannot_be_read(flights: Path, run: Runner, tmp_path: Path) -> None:
    shutil.copytree(flights, tmp_path, dirs_exist_ok=True)
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "flight.mcap").write_bytes(b"nonsense")
    out, err = run("list", tmp_path)
    assert len([line for line in out.splitlines() if line.strip()]) == 2
    assert "broken" in err and "is not a flight log" in err


def test_show_prints_the_events(flights: Path, run: Runner) -> None:
    (folder,) = flights.iterdir()
    out, _ = run("show", "last", "--in", flights)
    assert out == run("show", flights / "last")[0]
    assert "switch ch9 position 2 → bend-full: accepted" in out
    assert "phloSAR ready" in out and "firmware 1.1 host" in out
    said = json.loads(run("show", folder.name, "--in", flights, "--json")[0])
    assert [entry["intent"] for entry in said["story"] if entry["topic"] == "decision"] == [
        "bend-full",
        "straight",
    ]
    assert said["about"]["firmware"]["build"] == "1.1 host"
    assert re.search(r"\d\d:\d\d:\d\d [+-]\d{4}\n", out), "the time zone"


@pytest.mark.long
def test_plot_draws_for_screens_and_papers(flights: Path, run: Runner, tmp_path: Path) -> None:
    begins = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}
    for ending, begin in begins.items():
        path = tmp_path / f"flight.{ending}"
        run("plot", "last", "--in", flights, "-o", path)
        assert path.read_bytes().startswith(begin)
    assert "bend-full" in (tmp_path / "flight.svg").read_text()
    assert ".pdf" in run("plot", "last", "--in", flights, "-o", tmp_path / "flight.jpeg", status=2)[1]


def test_export_writes_what_was_recorded(flights: Path, run: Runner, tmp_path: Path) -> None:
    (folder,) = flights.iterdir()
    run("export", folder, "-o", tmp_path / "tables")
    with (tmp_path / "tables" / "phlosar_telemetry.csv").open() as file:
        rows = list(csv.DictReader(file))
    said = [entry.fields for entry in FlightLog(folder).entries(("phlosar/telemetry",))]
    assert [float(row["cv_kPa"]) for row in rows] == [one["cv_kPa"] for one in said]
    assert [float(row["t_s"]) for row in rows] == [one["t"] for one in said]
    rc = (tmp_path / "tables" / "mavlink_in_RC_CHANNELS.csv").read_text().splitlines()
    assert "RC_CHANNELS.chan9_raw [us]" in rc[0].split(",")
    assert not any("ATTITUDE" in column for column in rc[0].split(","))
    assert len((tmp_path / "tables" / "tick.csv").read_text().splitlines()) == 1 + 400


def test_a_bundle_holds_the_flight_and_no_key(flights: Path, run: Runner, tmp_path: Path) -> None:
    (folder,) = flights.iterdir()
    there = tmp_path / folder.name
    shutil.copytree(folder, there)
    (there / "signing.key").write_text("a secret")
    path = tmp_path / "report.zip"
    run("bundle", there, "-o", path)
    with zipfile.ZipFile(path) as file:
        assert file.testzip() is None
        names = {Path(name).name for name in file.namelist()}
        assert file.read(f"{folder.name}/flight.mcap") == (folder / "flight.mcap").read_bytes()
        assert b"bend-full" in file.read(f"{folder.name}/story.txt")
        machine = json.loads(file.read(f"{folder.name}/this-machine.json"))
    assert names == {
        *("flight.mcap", "flight.tlog", "profile.toml", "about.json"),
        *("story.txt", "this-machine.json"),
    }
    assert machine["disk_free_MB"] > 0 and machine["packages"]["pymavlink"][0].isdigit()


def test_a_damaged_log_is_shown_and_marked_as_damaged(flights: Path, run: Runner, tmp_path: Path) -> None:
    (folder,) = flights.iterdir()
    path = tmp_path / "cut.mcap"
    data = (folder / "flight.mcap").read_bytes()
    path.write_bytes(data[: int(0.8 * len(data))])
    out, err = run("show", path)
    assert "bend-full: accepted" in out and "is incomplete" in err


def test_a_missing_flight_gives_one_line_and_status_2(run: Runner, tmp_path: Path) -> None:
    for arguments, why in (
        (("show", "nowhere"), "nowhere: is not a flight"),
        (("plot", "last", "--in", tmp_path), "contains no flight"),
        (("list", tmp_path / "nowhere"), "is not a folder"),
        (("export", tmp_path, "--csv"), "is not a flight"),
    ):
        out, err = run(*arguments, status=2)
        assert out == "" and err.count("\n") == 1 and why in err
