"""`flying-vines mission`: output, files and exit status, and the examples."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import run
from mission_building import EXAMPLES, HEAD, KINDS, waypoint

from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.vehicle.mission.item import AutopilotKind
from missions.files import load_items

Captured = pytest.CaptureFixture[str]

GOOD = 'name = "One bend"\n' + HEAD + waypoint("{ bend_deg = 30, hold_s = 3 }, { profile = 'straight' }")


@pytest.fixture
def mission(tmp_path: Path) -> Path:
    path = tmp_path / "one.toml"
    path.write_text(GOOD)
    return path


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["bridge_inspection", "canopy_sampling"])
def test_the_examples_are_what_their_missions_build(
    name: str, kind: AutopilotKind, tmp_path: Path, capsys: Captured
) -> None:
    built = ("mission", "build", EXAMPLES / f"{name}.toml", "--autopilot", kind, "--out", tmp_path)
    assert run(capsys, *built)[0] == 0
    for suffix in (".plan", ".waypoints"):
        file = f"{name}-{kind}{suffix}"
        assert (tmp_path / file).read_text() == (EXAMPLES / file).read_text(), f"build {file} anew"
        found = load_items(EXAMPLES / file, kind)
        stored = FakeAutopilot(kind, mission=found.items, home=found.home).items
        assert [item.command for item in stored] == [item.command for item in found.items]
        status, out, err = run(capsys, "mission", "check", EXAMPLES / file, "--autopilot", kind)
        assert (status, err) == (0, "") and "warning" not in out


def test_build_prints_the_budget_and_writes_both_files(mission: Path, capsys: Captured) -> None:
    status, out, err = run(capsys, "mission", "build", mission, "--autopilot", "px4")
    assert (status, err) == (0, "")
    assert out.startswith("One bend: PX4, 7 items, ")
    assert "bend 30°" in out and "cycles left" in out
    plan, waypoints = mission.parent / "one-px4.plan", mission.parent / "one-px4.waypoints"
    assert f"Written  {plan}" in out and f"Written  {waypoints}" in out
    assert load_items(plan).items[2].params[:2] == (1.0, 30.0)
    assert waypoints.read_text().startswith("QGC WPL 110\n")


@pytest.mark.parametrize("columns", [80, 120])
def test_the_table_fits_the_terminal(
    columns: int, mission: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    _, out, _ = run(capsys, "mission", "check", mission, "--autopilot", "ardupilot")
    assert max(map(len, out.splitlines())) <= columns
    bend = next(line for line in out.splitlines() if "bend 30°" in line)
    assert bend.split()[-1].isdigit()  # the cycles left are not cut off


def test_one_file_may_be_asked_for_and_another_home(mission: Path, capsys: Captured) -> None:
    out = mission.parent / "deep" / "field.plan"
    arguments = ("--autopilot", "ardupilot", "--home", "10.5,20.25,300", "--out", out)
    status, _, err = run(capsys, "mission", "build", mission, *arguments)
    assert (status, err) == (0, "")
    assert json.loads(out.read_text())["mission"]["plannedHomePosition"] == [10.5, 20.25, 300]
    assert [path.name for path in out.parent.iterdir()] == ["field.plan"]


@pytest.mark.parametrize("spaced", [True, False])
@pytest.mark.parametrize("place", ["-35.36,149.16,584", "-.5,-149.16,-3.5"])
def test_a_home_in_the_south_is_no_option(place: str, spaced: bool, mission: Path, capsys: Captured) -> None:
    out = mission.parent / "south.plan"
    home = ("--home", place) if spaced else (f"--home={place}",)
    arguments = (*home, "--autopilot", "ardupilot", "--out", out)
    status, _, err = run(capsys, "mission", "build", mission, *arguments)
    assert (status, err) == (0, "")
    planned = json.loads(out.read_text())["mission"]["plannedHomePosition"]
    assert planned == [float(number) for number in place.split(",")]


def test_json_is_one_object_with_the_same_numbers(mission: Path, capsys: Captured) -> None:
    status, out, err = run(capsys, "mission", "check", mission, "--autopilot", "px4", "--json")
    assert (status, err) == (0, "")
    found = json.loads(out)
    bend = next(step for step in found["steps"] if "vine" in step)
    assert bend["what"] == "bend 30°" and bend["for_s"] == 3.0 and bend["waypoint"] == 1
    assert bend["vine"]["peak_kPa"] == pytest.approx(11.35)
    assert bend["vine"]["before_kPa"][0] > bend["vine"]["after_kPa"][0]
    assert found["findings"] == [] and found["autopilot"] == "px4"


@pytest.mark.long
def test_a_simulated_flight_reports_differences_from_the_plan(mission: Path, capsys: Captured) -> None:
    mission.write_text(GOOD.replace("= 10", "= 4").replace("north_m = 20", "north_m = 2"))
    status, out, err = run(capsys, "mission", "check", mission, "--autopilot", "px4", "--fly")
    assert (status, err) == (0, "")
    assert "Flown in simulation: 2 vine items" in out and "As planned." in out


def test_a_configuration_changes_what_carries_an_angle(mission: Path, capsys: Captured) -> None:
    config_file = mission.parent / "vine.toml"
    run(capsys, "config", "init", config_file)
    config_file.write_text(config_file.read_text().replace("min_altitude_m = 2", "min_altitude_m = 20"))
    status, out, err = run(capsys, "mission", "build", mission, "--autopilot", "px4", "--config", config_file)
    assert status == 2
    assert "refused" in out and "Written" not in out
    assert "at 10.0 m, below 20 m" in err
    assert not list(mission.parent.glob("*.plan"))


@pytest.mark.parametrize(
    ("text", "more", "says"),
    [
        (GOOD, (), 'names no autopilot: write autopilot = "ardupilot" or "px4" in it, or give --autopilot'),
        (
            GOOD.replace("bend_deg", "bent"),
            ("--autopilot", "px4"),
            "m.toml:7: waypoints[0].vine[0].bent",
        ),
        (GOOD.replace("straight", "strait"), ("--autopilot", "px4"), "did you mean 'straight'?"),
        (GOOD, ("--autopilot", "px4", "--config", "nowhere.toml"), "nowhere.toml: no such file"),
        (GOOD, ("--autopilot", "px4", "--rig", "nowhere.toml"), "nowhere.toml"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    text: str, more: tuple[str, ...], says: str, tmp_path: Path, capsys: Captured
) -> None:
    path = tmp_path / "m.toml"
    path.write_text(text)
    for action in ("build", "check"):
        status, out, err = run(capsys, "mission", action, path, *more)
        assert (status, out, err.count("\n")) == (2, "", 1)
        assert err.startswith("flying-vines: ") and says in err
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["old.mission", "OLD.MISSION", "plan.waypoints", "plan.txt"])
@pytest.mark.parametrize("action", [("check",), ("upload", "--link", "udpin:127.0.0.1:26199")])
def test_json_under_another_name_says_what_to_do(
    name: str, action: tuple[str, ...], tmp_path: Path, capsys: Captured
) -> None:
    path = tmp_path / name
    path.write_text('{"MAV_AUTOPILOT": 3, "items": [], "version": "1.0"}')
    status, out, err = run(capsys, "mission", action[0], path, *action[1:])
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "open it in QGroundControl, and save it as .plan" in err


@pytest.mark.parametrize(
    "wrong",
    [("--home", "1,2"), ("--home", "91,0,0"), ("--reservoir-kPa", "-5"), ("--reservoir-kPa", "full")],
)
def test_a_wrong_option_is_named(wrong: tuple[str, str], mission: Path, capsys: Captured) -> None:
    status, out, err = run(capsys, "mission", "check", mission, "--autopilot", "px4", *wrong)
    assert (status, out) == (2, "")
    assert wrong[0] in err.splitlines()[-1] and "Traceback" not in err


def test_a_built_mission_is_checked_and_not_built_again(mission: Path, capsys: Captured) -> None:
    run(capsys, "mission", "build", mission, "--autopilot", "px4")
    plan = mission.parent / "one-px4.plan"
    status, _, err = run(capsys, "mission", "build", plan)
    assert status == 2 and "is already a built mission" in err
    status, _, err = run(capsys, "mission", "check", plan, "--home", "1,2,3")
    assert status == 2 and "--home" in err
    status, _, err = run(capsys, "mission", "check", plan, "--autopilot", "ardupilot")
    assert status == 2 and "ArduPilot refuses MAV_CMD 187; for 'bend 30°' use script message (1, 30)" in err


def test_the_service_does_not_import_it() -> None:
    code = "import sys, flying_vines.cli.main; sys.exit('missions.report' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_an_example_is_written_once_and_builds(tmp_path: Path, capsys: Captured) -> None:
    mission = tmp_path / "mine.toml"
    status, out, err = run(capsys, "mission", "example", "canopy_sampling", "--out", mission)
    assert (status, err) == (0, "") and out.startswith(f"{mission}: ")
    assert run(capsys, "mission", "build", mission, "--autopilot", "px4", "--out", tmp_path)[0] == 0
    mission.write_text(edited := mission.read_text().replace("Canopy", "My"))
    status, _, err = run(capsys, "mission", "example", "canopy_sampling", "--out", mission)
    assert (status, err) == (2, f"flying-vines: {mission}: File exists\n")
    assert mission.read_text() == edited


def test_the_script_for_ardupilot_is_written_as_it_is_shipped(tmp_path: Path, capsys: Captured) -> None:
    script = tmp_path / "vine.lua"
    status, out, err = run(capsys, "mission", "script", "--out", script)
    assert (status, err) == (0, "") and out.startswith(f"{script}: ")
    shipped = Path(__file__).parents[2] / "missions" / "ardupilot" / "vine_items.lua"
    assert script.read_bytes() == shipped.read_bytes()
    assert run(capsys, "mission", "script", "--out", tmp_path / "no" / "vine.lua")[0] == 2
