""".plan files are written and read like by QGroundControl."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mission_building import HEAD, KINDS, built, items, waypoint

from flying_vines.vehicle.mission.item import AutopilotKind
from missions.files import load_items
from missions.home import SIMULATOR_HOME
from missions.mission import MissionError
from missions.plan_file import PlanFileError, plan_text, read_plan, write_plan

TEXT = "speed_m_s = 4\n" + HEAD + waypoint("{ profile = 'reach' }, { bend_deg = 30.3 }") + waypoint("")


def content(kind: AutopilotKind) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(plan_text(built(TEXT, kind), kind, SIMULATOR_HOME[kind]))
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_a_plan_has_what_qgroundcontrol_requires(kind: AutopilotKind) -> None:
    plan = content(kind)
    assert (plan["fileType"], plan["version"], plan["groundStation"]) == ("Plan", 1, "QGroundControl")
    assert plan["geoFence"] == {"circles": [], "polygons": [], "version": 2}
    assert plan["rallyPoints"] == {"points": [], "version": 2}
    mission = plan["mission"]
    assert mission["version"] == 2 and mission["vehicleType"] == 2
    assert mission["firmwareType"] == {"ardupilot": 3, "px4": 12}[kind]
    home = SIMULATOR_HOME[kind]
    assert mission["plannedHomePosition"] == [home.latitude_deg, home.longitude_deg, home.altitude_amsl_m]
    for key in ("cruiseSpeed", "hoverSpeed", "globalPlanAltitudeMode"):
        assert mission[key] > 0


@pytest.mark.parametrize("kind", KINDS)
def test_its_items_are_simple_ones_numbered_from_1(kind: AutopilotKind) -> None:
    entries = content(kind)["mission"]["items"]
    assert [entry["doJumpId"] for entry in entries] == list(range(1, len(entries) + 1))
    assert entries[0]["command"] == 22  # home is not an item there, for either autopilot
    for entry in entries:
        assert entry["type"] == "SimpleItem" and entry["autoContinue"] is True
        assert len(entry["params"]) == 7
        assert all(isinstance(value, int | float | None) for value in entry["params"])
        flown = entry["command"] in (16, 21, 22)
        assert entry["frame"] == (3 if flown else 2)
        if flown:
            assert entry["AltitudeMode"] == 1 and entry["Altitude"] == entry["params"][6]
            assert entry["AMSLAltAboveTerrain"] is None
            assert (entry["params"][3] is None) == (kind == "px4")
        else:
            assert not {"AltitudeMode", "Altitude", "AMSLAltAboveTerrain"} & set(entry)


@pytest.mark.parametrize("kind", KINDS)
def test_written_items_are_read_back_equal(kind: AutopilotKind, tmp_path: Path) -> None:
    made = built(TEXT, kind)
    path = tmp_path / "m.plan"
    write_plan(path, made, kind, SIMULATOR_HOME[kind])
    plan = read_plan(path)
    assert plan.kind == kind and plan.home == SIMULATOR_HOME[kind]
    # As texts, because NaN is not equal to itself.
    assert [repr(item) for item in plan.items] == [repr(item) for item in made]
    assert load_items(path).items == plan.items or kind == "px4"


@pytest.mark.parametrize("kind", KINDS)
def test_a_jump_keeps_its_target(kind: AutopilotKind, tmp_path: Path) -> None:
    made = items((16,), (22,), (16,), (177, 2, 3), (21,))
    path = tmp_path / "m.plan"
    write_plan(path, made, kind)
    entries = json.loads(path.read_text())["mission"]["items"]
    jump = next(entry for entry in entries if entry["command"] == 177)
    target = next(entry for entry in entries if entry["doJumpId"] == jump["params"][0])
    assert target["params"][4:6] == list(made[2].params[4:6])
    assert read_plan(path).items[3].params[:2] == (2.0, 3.0)


def test_another_autopilot_may_be_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "m.plan"
    write_plan(path, built(TEXT, "px4"), "px4", SIMULATOR_HOME["px4"])
    plan = read_plan(path, "ardupilot")
    assert plan.items[0].command == 16 and plan.items[1].command == 22
    assert plan.items[0].params[4] == SIMULATOR_HOME["px4"].latitude_deg


def test_a_survey_is_flown_by_the_items_that_it_holds(tmp_path: Path) -> None:
    plan = content("px4")
    simple = plan["mission"]["items"]
    survey = {
        "type": "ComplexItem",
        "complexItemType": "survey",
        "version": 5,
        "TransectStyleComplexItem": {"Items": simple[1:3]},
    }
    plan["mission"]["items"] = [simple[0], survey, simple[-1]]
    path = tmp_path / "m.plan"
    path.write_text(json.dumps(plan))
    assert [item.command for item in read_plan(path).items] == [22, 178, 16, 21]
    del survey["TransectStyleComplexItem"]
    path.write_text(json.dumps(plan))
    with pytest.raises(
        PlanFileError, match=r"mission.items\[1\]: only the ground station can convert a 'survey'"
    ):
        read_plan(path)


@pytest.mark.parametrize("kind", KINDS)
def test_a_plan_whose_only_survey_holds_no_items_is_refused(kind: AutopilotKind, tmp_path: Path) -> None:
    plan = content(kind)
    survey = {"type": "ComplexItem", "complexItemType": "survey", "TransectStyleComplexItem": {"Items": []}}
    plan["mission"]["items"] = [survey]
    path = tmp_path / "m.plan"
    path.write_text(json.dumps(plan))
    with pytest.raises(MissionError) as error:
        load_items(path)
    assert str(error.value) == f"{path}: it contains no items"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda plan: plan.update(fileType="Params"), "its fileType is 'Params'"),
        (lambda plan: plan.update(version=2), "version"),
        (lambda plan: plan.pop("mission"), "mission"),
        (lambda plan: plan["mission"].update(items=[]), "mission.items"),
        (lambda plan: plan["mission"]["items"][2].update(params=[1, 2]), "mission.items[2].params"),
        (lambda plan: plan["mission"]["items"][2].update(params=["a"] * 7), "mission.items[2].params[0]"),
        (lambda plan: plan["mission"].update(plannedHomePosition=[1]), "mission.plannedHomePosition"),
        (lambda plan: plan["mission"]["items"][2].update(command=177), "jumps to doJumpId"),
    ],
)
def test_a_broken_plan_is_one_line_that_names_the_place(change: Any, says: str, tmp_path: Path) -> None:
    plan = content("px4")
    change(plan)
    path = tmp_path / "m.plan"
    path.write_text(json.dumps(plan))
    with pytest.raises(MissionError) as error:
        load_items(path)
    assert str(error.value).startswith(str(path)) and says in str(error.value)
    assert "\n" not in str(error.value)


@given(st.text(max_size=200))
def test_any_text_is_a_plan_or_an_error(text: str) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "m.plan"
        path.write_text(text, encoding="utf-8")
        with pytest.raises(PlanFileError):
            read_plan(path)


def test_without_a_home_the_first_place_is_used() -> None:
    plan = json.loads(plan_text(built(TEXT, "px4"), "px4"))
    assert plan["mission"]["plannedHomePosition"] == [
        SIMULATOR_HOME["px4"].latitude_deg,
        SIMULATOR_HOME["px4"].longitude_deg,
        0,
    ]
    anywhere = items((22, 0, 0, 0, 0, math.nan, math.nan, 10.0), (16,))  # a take-off where the vehicle stands
    assert json.loads(plan_text(anywhere, "px4"))["mission"]["plannedHomePosition"] == [
        *anywhere[1].params[4:6],
        0,
    ]
    with pytest.raises(ValueError, match="no place"):
        plan_text(items((187, 1)), "px4")


def test_waypoints_files_need_an_autopilot_and_know_home(tmp_path: Path) -> None:
    from missions.waypoints import write_waypoints

    path = tmp_path / "m.waypoints"
    write_waypoints(path, built(TEXT, "ardupilot"))
    with pytest.raises(MissionError, match="--autopilot"):
        load_items(path)
    assert load_items(path, "ardupilot").home == SIMULATOR_HOME["ardupilot"]
    write_waypoints(path, built(TEXT, "px4"))
    found = load_items(path, "px4")
    assert found.home.latitude_deg == SIMULATOR_HOME["px4"].latitude_deg and math.isnan(
        found.items[0].params[3]
    )
    path.write_text("QGC WPL 110\n")
    with pytest.raises(MissionError, match="no item"):
        load_items(path, "px4")
