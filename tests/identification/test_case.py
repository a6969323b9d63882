"""Case folders and their files: content, remarks, and errors."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pytest

from flying_vines.files import bounded
from flying_vines.identification.case import CaseError, RecordedRun, read_case
from flying_vines.physics.rig import Rig, load_rig
from flying_vines.simulation.scenario import csv_text, load_scenario, simulate, write_case
from flying_vines.simulation.scenario.scenario import BendsRun, DischargeRun, OpeningsRun, Valves

RIG = "[reservoir]\nvolume_L = 2.0\n[cv]\nvolume_L = 0.5\n"
HEADER = "time_s,command_kPa,evp_opening,dvp_opening,solenoid,cv_pressure_kPa,reservoir_pressure_kPa"
ROWS = [
    f"{0.05 * i:.2f},{'20,0.5' if i < 20 else ',0'},0,{int(i >= 40)},{min(i, 20) + 0.25},{600 - 0.5 * i}"
    for i in range(60)
]
RECORDED = Path(__file__).parents[1] / "data" / "cases"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "rig.toml").write_text(RIG)
    return tmp_path


def text(rows: list[str] = ROWS, header: str = HEADER) -> str:
    return "\n".join([header, *rows, ""])


def changed(row: int, column: str, cell: str) -> str:
    cells = ROWS[row].split(",")
    cells[HEADER.split(",").index(column)] = cell
    return text([*ROWS[:row], ",".join(cells), *ROWS[row + 1 :]])


def only(*columns: str, rows: list[str] = ROWS) -> str:
    kept = [HEADER.split(",").index(column) for column in columns]
    return text([",".join(row.split(",")[i] for i in kept) for row in rows], ",".join(columns))


def read(folder: Path, content: str | bytes) -> RecordedRun:
    data = content if isinstance(content, bytes) else content.encode()
    (folder / "run.csv").write_bytes(data)
    (run,) = read_case(folder).runs
    return run


def refused(path: Path, rig: Path | None = None) -> str:
    with pytest.raises(CaseError) as caught:
        read_case(path, rig)
    line = str(caught.value)
    assert line.isprintable()
    assert str(path) in line
    return line


def complaint(folder: Path, content: str | bytes) -> str:
    data = content if isinstance(content, bytes) else content.encode()
    (folder / "run.csv").write_bytes(data)
    return refused(folder).removeprefix(str(folder / "run.csv"))


def assert_same(one: RecordedRun, other: RecordedRun) -> None:
    for name, values in vars(one).items():
        if isinstance(values, np.ndarray):
            assert np.array_equal(values, getattr(other, name), equal_nan=True)
        else:
            assert values == getattr(other, name)


def test_a_case_as_it_is_meant(folder: Path) -> None:
    (folder / "run_10.csv").write_text(text())
    (folder / "run_2.CSV").write_text(text())
    (folder / "notes.txt").write_text("not a run")
    (folder / ".~lock.run.csv").write_bytes(b"\0")
    (folder / "older.csv").mkdir()
    (folder / "older.csv" / "run.csv").write_text("not read")
    case = read_case(str(folder))
    assert case.path == folder
    assert case.rig == load_rig(folder / "rig.toml")
    assert case.remarks == ()
    assert [run.name for run in case.runs] == ["run_2", "run_10"]
    run = case.runs[0]
    assert run.time_s == pytest.approx(np.arange(60) * 0.05)
    assert run.command_kPa is not None and np.isnan(run.command_kPa).sum() == 40
    assert (run.evp_opening[[0, 19, 20]] == [0.5, 0.5, 0.0]).all()
    assert (run.solenoid[[39, 40]] == [0.0, 1.0]).all()
    assert (run.cv_kPa[-1], run.reservoir_kPa[-1]) == (20.25, 570.5)
    assert (run.ambient_kPa, run.ambient_C, run.to_atmosphere) == (None, None, False)
    with pytest.raises(ValueError, match="read-only"):
        run.cv_kPa[0] = 1.0


def _worded(found: re.Match[str]) -> str:
    return f",0,{('FALSE', 'True')[int(found[1])]},"


WRITTEN: dict[str, Callable[[str], str | bytes]] = {
    "byte order mark": lambda x: b"\xef\xbb\xbf" + x.encode(),
    "Windows": lambda x: x.replace("\n", "\r\n"),
    "old Mac": lambda x: x.replace("\n", "\r"),
    "no end": lambda x: x.rstrip("\n"),
    "blank lines": lambda x: x.replace("\n0.1", "\n\n0.1") + "\n\n  \n",
    "spreadsheet's end": lambda x: x + ",,,,,,\n,,,,,,\n",
    "comments": lambda x: "# recorded by hand\n" + x.replace("\n0.1", "\n  # at noon, 21 °C\n0.1"),
    "commented names": lambda x: "# " + x,
    "semicolons": lambda x: x.replace(",", ";"),
    "tabs": lambda x: x.replace(",", "\t"),
    "spaces": lambda x: x.replace(",", " , "),
    "quoted": lambda x: "\n".join(",".join(f'"{c}"' for c in row.split(",")) for row in x.split("\n")[:-1]),
    "trailing comma": lambda x: x.replace("\n", ",\n"),
    "words": lambda x: re.sub(r",0,(0|1),(?=[^,]*,[^,]*\n)", _worded, x),
}


@pytest.mark.parametrize("how", WRITTEN)
def test_however_it_was_written(folder: Path, how: str) -> None:
    assert_same(read(folder, WRITTEN[how](text())), read(folder, text()))
    assert read_case(folder).remarks == ()


def test_columns_in_any_order(folder: Path) -> None:
    columns = HEADER.split(",")[::-1]
    assert_same(read(folder, only(*columns)), read(folder, text()))


def test_empty_cells_and_missing_rows(folder: Path) -> None:
    rows = ROWS[:10] + ROWS[30:]
    rows[3] = rows[3].rsplit(",", 1)[0] + ","
    rows[5] = rows[5].rsplit(",", 2)[0] + ",NaN,n/a"
    run = read(folder, text(rows))
    assert len(run.time_s) == 40
    assert np.flatnonzero(np.isnan(run.cv_kPa)).tolist() == [5]
    assert np.flatnonzero(np.isnan(run.reservoir_kPa)).tolist() == [3, 5]
    assert read_case(folder).remarks == ()


REMARKED = {
    "input": (changed(45, "solenoid", ""), "solenoid: 1 empty cell, filled with the value before"),
    "first": (changed(0, "dvp_opening", ""), "dvp_opening: 1 empty cell, filled with the value before"),
    "column": (text([row + ",7" for row in ROWS], HEADER + ",motor_rpm"), "column 'motor_rpm' is ignored"),
    "index": (text([f"{i},{row}" for i, row in enumerate(ROWS)], "," + HEADER), "without a name is ignored"),
    "above": ("logger 7;started\n" + text(), "the lines above the column names are ignored"),
    "time": (changed(7, "time_s", ""), "left out 1 row without a time"),
    "again": (text([*ROWS[:7], ROWS[6], *ROWS[7:]]), "left out 1 row with the time of the next row"),
    "cut": (text()[:-40], "the last line is incomplete and left out"),
    "cut number": (text()[:-3], "the last line is incomplete and left out"),
    "dvp": (only(*HEADER.replace(",dvp_opening", "").split(",")), "dvp_opening was not recorded"),
    "reservoir": (only(*HEADER.split(",")[:-1]), "the reservoir's pressure was not recorded"),
    "discharge": (
        only("time_s", "reservoir_pressure_kPa"),
        "assumed to be a discharge of the reservoir to atmosphere",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", REMARKED)
def test_a_remark_names_what_was_assumed(folder: Path, what: str) -> None:
    content, expected = REMARKED[what]
    read(folder, content)
    (remark,) = read_case(folder).remarks
    assert remark.startswith("run.csv: ")
    assert expected in remark
    assert remark.isprintable()


def test_an_input_holds_where_its_cell_is_empty(folder: Path) -> None:
    assert_same(read(folder, changed(45, "solenoid", "")), read(folder, text()))
    assert read(folder, changed(0, "evp_opening", "")).evp_opening[:2].tolist() == [0.0, 0.5]


def test_of_one_time_the_last_row_counts(folder: Path) -> None:
    again = ROWS[6].rsplit(",", 1)[0] + ",999"
    assert_same(read(folder, text([*ROWS[:6], again, *ROWS[6:]])), read(folder, text()))


def test_holes_in_what_was_read_of_the_air(folder: Path) -> None:
    rows = [f"{row},{'' if i == 1 else 90 + i / 100},{15 if i else ''}" for i, row in enumerate(ROWS)]
    run = read(folder, text(rows, HEADER + ",ambient_pressure_kPa,ambient_temperature_C"))
    assert run.ambient_kPa is not None and run.ambient_C is not None
    assert run.ambient_kPa[:3] == pytest.approx([90.0, 90.01, 90.02])
    assert (run.ambient_C == 15.0).all()


REFUSED: dict[str, tuple[str | bytes, str]] = {
    "text": (changed(4, "cv_pressure_kPa", "full"), ":6: cv_pressure_kPa: 'full' is not a number"),
    "infinite": (changed(4, "reservoir_pressure_kPa", "-inf"), "'-inf' is not a finite number"),
    "huge": (changed(4, "reservoir_pressure_kPa", "1e999"), "'1e999' is not a finite number"),
    "underscore": (changed(4, "cv_pressure_kPa", "1_0"), ":6: cv_pressure_kPa: '1_0' is not a number"),
    "comma": (text().replace(",", ";").replace(".", ","), ":2: time_s: '0,00' has a decimal comma"),
    "commas": (text([row.replace(".", ",") for row in ROWS]), ":2: has 11 cells, but there are 7 columns"),
    "short": (text([*ROWS[:9], "0.45,20,0.5", *ROWS[10:]]), ":11: has 3 cells, but there are 7 columns"),
    "percent": (text().replace(",0.5,0,", ",50,0,"), ":2: evp_opening: '50' is outside 0…1"),
    "negative": (changed(9, "dvp_opening", "-0.1"), ":11: dvp_opening: '-0.1' is outside 0…1"),
    "solenoid": (changed(9, "solenoid", "0.5"), ":11: solenoid: '0.5' is neither 0 (shut) nor 1 (open)"),
    "backwards": (text([*ROWS, *ROWS]), ":62: time_s: time runs backwards, from 2.95 to 0 s"),
    "still": (text(["1" + row[row.index(",") :] for row in ROWS]), ": time_s: 59 of 60 rows"),
    "three": (text(ROWS[:3]), ": 3 samples in 0.1 s are too few; a run"),
    "one second": (text(["0.0" + row.replace(".", "", 1) for row in ROWS]), ": 60 samples in 0.0295 s are"),
    "no rows": (text([]), ": 0 samples in 0 s are too few"),
    "no times": (text(["" + row[row.index(",") :] for row in ROWS]), ": 0 samples in 0 s are too few"),
    "empty": ("", ": is empty"),
    "names": (text(header=HEADER.replace("time_s", "time")), ":1: there is no column time_s among "),
    "no names": ("\n".join(ROWS), ":1: the columns have no names"),
    "twice": (text(header=HEADER.replace("command_kPa", "solenoid")), ":1: two columns are named solenoid"),
    "unit": (text(header=HEADER.replace("cv_pressure_kPa", "cv_pressure_psi")), "did you mean cv_pressure_"),
    "case": (text(header=HEADER.replace("evp_opening", "EVP_Opening")), "did you mean evp_opening?"),
    "spelling": (text(header=HEADER.replace("reservoir_pr", "resevoir_pr")), "did you mean reservoir_"),
    "no pressure": (only(*HEADER.split(",")[:5]), ":1: no pressure was recorded"),
    "no openings": (only("time_s", "cv_pressure_kPa", "reservoir_pressure_kPa"), "valve commands were not"),
    "quotation": (text([*ROWS[:9], '"' + ROWS[9], *ROWS[10:]]), ":11: a quotation mark is not closed"),
    "latin": (text().replace("time_s", "time_s,°").encode("latin-1"), "(line 1): save it as UTF-8"),
    "binary": (b"time_s,\0\0\0", ": is not a text file"),
    "field": (text([*ROWS, "9,,0,0,0,0," + "9" * 200_000]), ":62: is not a CSV line: field larger"),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_an_unreadable_input_gives_one_line(folder: Path, what: str) -> None:
    content, expected = REFUSED[what]
    assert expected in complaint(folder, content)


def test_folders_that_are_no_case(folder: Path) -> None:
    assert "contains no recorded run" in refused(folder)
    assert "no such folder or file" in refused(folder / "C:\\cases\\one")
    with pytest.raises(CaseError, match=r"two\\nlines: no such folder"):
        read_case(folder / "two\nlines")
    assert "give the folder" in refused(folder / "rig.toml")
    (folder / "run.csv").write_text(text())
    (folder / "rig.toml").write_text("[cv]\nvolume = 1\n")
    assert "cv.volume" in refused(folder)
    (folder / "rig.toml").unlink()
    assert "rig.toml: no such file" in refused(folder)


def test_inputs_without_read_permission(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = bounded.opened

    def denied(path: Path) -> BinaryIO:
        if path.suffix == ".toml":
            return opened(path)
        raise PermissionError(13, "Permission denied", str(path))

    (folder / "run.csv").write_text(text())
    monkeypatch.setattr(bounded, "opened", denied)
    assert "run.csv: cannot be read: Permission denied" in refused(folder)
    monkeypatch.setattr(Path, "iterdir", denied)
    assert "cannot be read: Permission denied" in refused(folder)


def test_a_single_file(folder: Path, tmp_path: Path) -> None:
    run = read(folder, text())
    assert_same(read_case(folder / "run.csv").runs[0], run)
    other = tmp_path / "other.toml"
    other.write_text(RIG.replace("0.5", "0.25"))
    case = read_case(folder / "run.csv", other)
    assert case.rig == load_rig(other)
    assert_same(case.runs[0], run)
    assert read_case(folder, str(other)).rig == load_rig(other)
    (folder / "rig.toml").unlink()
    assert "no such file; it must describe the nominal rig" in refused_beside(folder / "run.csv")


def refused_beside(path: Path) -> str:
    with pytest.raises(CaseError) as caught:
        read_case(path)
    return str(caught.value)


def test_a_rig_without_a_control_volume_has_none_to_read(folder: Path) -> None:
    (folder / "rig.toml").write_text("[reservoir]\nvolume_L = 2.0\n")
    assert "cv_pressure_kPa: the rig has no control volume; add [cv]" in complaint(folder, text())


def test_files_of_the_simulation(tmp_path: Path) -> None:
    kinds = (
        BendsRun(cycles=1),
        OpeningsRun(valves=(Valves(for_s=1.0, evp=1.0), Valves(for_s=1.0)), name="hold"),
    )
    runs = [simulate(Rig(), kind) for kind in kinds]
    write_case(runs, b"[cv]\nvolume_L = 0.1\n", tmp_path)
    (tmp_path / "picture.png").write_bytes(b"\x89PNG")
    case = read_case(tmp_path)
    assert case.rig == Rig()
    assert case.remarks == ()
    assert [run.name for run in case.runs] == ["run_1_bends", "run_2_hold"]
    for written, run in zip(runs, case.runs, strict=True):
        assert run.evp_opening == pytest.approx(written.evp_opening, abs=1e-9)
        assert (run.solenoid == written.solenoid).all()
        assert run.cv_kPa == pytest.approx(written.cv_pressure_kPa, abs=6e-4)
        assert run.reservoir_kPa == pytest.approx(written.reservoir_pressure_kPa, abs=6e-3)


def test_the_discharge_that_the_simulation_writes(tmp_path: Path) -> None:
    (kind,) = load_scenario("discharge").runs
    assert isinstance(kind, DischargeRun)
    rig = Rig(cv=None)
    (tmp_path / "rig.toml").write_text("")
    (tmp_path / "run.csv").write_text(csv_text(simulate(rig, DischargeRun(duration_s=5.0))))
    case = read_case(tmp_path)
    assert case.remarks == ()
    assert case.runs[0].to_atmosphere


def test_recorded_cases_are_read_without_a_remark() -> None:
    folders = sorted(path for path in RECORDED.iterdir() if path.is_dir())
    assert len(folders) == 4
    for path in folders:
        case = read_case(path)
        assert case.remarks == ()
        assert [len(run.time_s) for run in case.runs] == [2250] * 4
        assert all(np.isfinite((run.cv_kPa, run.reservoir_kPa)).all() for run in case.runs)
