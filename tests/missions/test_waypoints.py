"""QGC WPL 110 files: content, errors, and writing without loss."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink import mavwp

from flying_vines.vehicle.mission.item import MAX_NUMBER, MissionItem
from missions.waypoints import WaypointsError, read_waypoints, write_waypoints

RECORDINGS = Path(__file__).parents[1] / "data" / "recordings"

HEADER = "QGC WPL 110\n"
ITEM = "0\t1\t0\t16\t0\t0\t0\t0\t-35.36\t149.16\t584\t1\n"


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "plan.waypoints"
    path.write_text(text)
    return path


def test_reads_what_an_autopilot_gave_back() -> None:
    items = read_waypoints(RECORDINGS / "ardupilot_vine_mission.waypoints")
    assert [item.seq for item in items] == list(range(12))
    assert items[3] == MissionItem(3, 217, (1.0, 40.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert items[2].params[4:] == (-35.3629925, 149.165237, 12.0)
    assert items[2].frame == 3 and items[2].autocontinue and not items[2].current


def test_nan_is_a_number() -> None:
    items = read_waypoints(RECORDINGS / "px4_vine_mission.waypoints")
    assert math.isnan(items[0].params[3])
    assert items[0].current
    assert items[6].params[:4] == (1.0, 1.0, 2.0, 0.5)


def test_windows_line_ends_byte_order_mark_and_blank_lines_are_no_trouble(tmp_path: Path) -> None:
    text = "\ufeff" + (HEADER + "\n" + ITEM + "\n\n").replace("\n", "\r\n")
    path = tmp_path / "plan.waypoints"
    path.write_bytes(text.encode("utf-8"))
    assert len(read_waypoints(path)) == 1


@pytest.mark.parametrize(
    ("text", "line", "says"),
    [
        ("", 1, "header"),
        ("QGC WPL 100\n" + ITEM, 1, "header"),
        (ITEM, 1, "header"),
        (HEADER + "0 1 0 16 0 0 0 0 1 2 3\n", 2, "12 columns, this line has 11"),
        (HEADER + ITEM + ITEM.replace("0\t1", "1\t0", 1).replace("584", "high"), 3, "z must be a number"),
        (HEADER + ITEM.replace("\t16\t", "\tsixteen\t"), 2, "command must be a whole number, not 'sixteen'"),
        (HEADER + ITEM.replace("\t16\t", "\t1.5\t"), 2, "command must be a whole number"),
        (HEADER + ITEM.replace("\t16\t", "\t70000\t"), 2, "command must be 0 to 65535, not 70000"),
        (HEADER + ITEM + ITEM, 3, "seq must be 1, not 0"),
        (HEADER + "\n" + ITEM.replace("0\t1", "1\t1", 1), 3, "seq must be 0, not 1"),
    ],
)
def test_an_error_names_file_line_and_what_is_wrong(tmp_path: Path, text: str, line: int, says: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(WaypointsError) as error:
        read_waypoints(path)
    message = str(error.value)
    assert message.startswith(f"{path}, line {line}: ")
    assert says in message
    assert "\n" not in message


def test_a_binary_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "plan.waypoints"
    path.write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(WaypointsError, match="not a UTF-8 text file"):
        read_waypoints(path)


def test_only_items_in_order_are_written(tmp_path: Path) -> None:
    with pytest.raises(WaypointsError, match="line 2: seq must be 0, not 3"):
        write_waypoints(tmp_path / "plan.waypoints", [MissionItem(3, 16, (0.0,) * 7)])


numbers = st.floats(-MAX_NUMBER, MAX_NUMBER) | st.sampled_from((-math.inf, math.inf))
items_strategy = st.lists(
    st.builds(
        MissionItem,
        seq=st.just(0),
        command=st.integers(0, 65535),
        params=st.tuples(numbers, numbers, numbers, numbers, numbers, numbers, numbers),
        frame=st.integers(0, 255),
        current=st.booleans(),
        autocontinue=st.booleans(),
    ),
    max_size=5,
)


@settings(deadline=None)
@given(items_strategy)
def test_written_items_are_read_back_equal(items: list[MissionItem]) -> None:
    numbered = [
        MissionItem(seq, item.command, item.params, item.frame, item.current, item.autocontinue)
        for seq, item in enumerate(items)
    ]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plan.waypoints"
        write_waypoints(path, numbered)
        assert read_waypoints(path) == numbered


def test_a_file_of_qgroundcontrol_without_home_is_read_too(tmp_path: Path) -> None:
    items = [MissionItem(0, 22, (0.0,) * 7, 3)]
    path = tmp_path / "plan.waypoints"
    write_waypoints(path, items)
    path.write_text(path.read_text().replace("QGC WPL 110", "QGC WPL 120"))
    assert read_waypoints(path) == items


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_pymavlink_reads_what_is_written(kind: str) -> None:
    example = Path(__file__).parents[2] / "missions" / "examples" / f"bridge_inspection-{kind}.waypoints"
    loader = mavwp.MAVWPLoader()
    assert loader.load(str(example)) == len(read_waypoints(example))
    for theirs, ours in zip(loader.wpoints, read_waypoints(example), strict=True):
        numbers = (theirs.param1, theirs.param2, theirs.param3, theirs.param4, theirs.x, theirs.y, theirs.z)
        assert (theirs.seq, theirs.frame, theirs.command) == (ours.seq, ours.frame, ours.command)
        assert numbers == pytest.approx(ours.params, rel=0, abs=0, nan_ok=True)
