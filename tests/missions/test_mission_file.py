"""A mission's TOML file: content, and errors with file, line and key."""

from __future__ import annotations

from pathlib import Path

import pytest
from mission_building import HEAD, waypoint

from missions.mission import MissionError, load, parse, planned_home


def test_a_mission_is_read_with_its_defaults() -> None:
    mission = parse(HEAD + waypoint("{ profile = 'reach' }, { bend_deg = 30, hold_s = 2 }"), "m.toml")
    assert mission.end == "land" and mission.speed_m_s is None and mission.autopilot is None
    reach, bend = mission.waypoints[0].vine
    assert (reach.profile, reach.hold_s) == ("reach", None)
    assert (bend.bend_deg, bend.hold_s) == (30.0, 2.0)


def test_home_is_a_place_or_the_simulators() -> None:
    text = HEAD + waypoint("")
    assert planned_home(parse(text, "m"), "px4", "m").latitude_deg == pytest.approx(47.3977431)
    assert planned_home(parse(text, "m"), "ardupilot", "m").latitude_deg == pytest.approx(-35.363262)
    own = text.replace('"simulator"', "{ at = [10.5, 20.25], altitude_m = 300 }")
    home = planned_home(parse(own, "m"), "px4", "m")
    assert (home.latitude_deg, home.longitude_deg, home.altitude_amsl_m) == (10.5, 20.25, 300.0)
    with pytest.raises(MissionError, match="m: home: is missing"):
        planned_home(parse(text.replace('home = "simulator"\n', ""), "m"), "px4", "m")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("name = ", "m.toml:1: not TOML"),
        ("[takeoff]\naltitude_m = 10\n", "m.toml: the section [[waypoints]] is missing"),
        (
            HEAD + waypoint("").replace("north_m", "nort_m"),
            "m.toml:5: waypoints[0].nort_m: unknown key",
        ),
        (
            HEAD + waypoint("{ profil = 'reach' }"),
            "m.toml:6: waypoints[0].vine[0].profil: unknown key",
        ),
        (
            HEAD + waypoint("{ hold_s = 1 }"),
            "m.toml:6: waypoints[0].vine[0]: the vine needs",
        ),
        (HEAD + waypoint("{ profile = 'a', bend_deg = 1 }"), "the vine needs either profile or bend_deg"),
        (
            HEAD + waypoint("{ bend_deg = nan }"),
            "m.toml:6: waypoints[0].vine[0].bend_deg: is not a finite",
        ),
        (
            HEAD + waypoint("", "at = [95, 8]"),
            "m.toml:5: waypoints[0].at[0]: must be a number from -90 to 90, not 95",
        ),
        (
            HEAD + waypoint("", "altitude_m = 5"),
            "needs either at = [latitude, longitude]",
        ),
        (
            HEAD + waypoint("", "at = [1, 2]\neast_m = 3"),
            "needs either at = [latitude, longitude]",
        ),
        (
            HEAD + waypoint("", "north_m = 1\nstay_s = 1.5"),
            "m.toml:6: waypoints[0].stay_s: must be a whole number from 0 to 3600, not 1.5",
        ),
        (
            HEAD.replace("= 10", "= -1") + waypoint(""),
            "m.toml:3: takeoff.altitude_m: must be a number above 0, up to 1000, not -1",
        ),
        ("end = 'hover'\n" + HEAD + waypoint(""), "must be one of land, return, not 'hover'"),
        ("autopilot = 'apm'\n" + HEAD + waypoint(""), "must be one of ardupilot, px4, not 'apm'"),
        (HEAD.replace('"simulator"', '"sim"') + waypoint(""), "m.toml:1: home: "),
    ],
)
def test_an_error_is_one_line_that_names_the_place(text: str, says: str) -> None:
    with pytest.raises(MissionError) as error:
        parse(text, "m.toml")
    assert says in str(error.value)
    assert "\n" not in str(error.value)


def test_a_file_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(MissionError, match="No such file"):
        load(tmp_path / "m.toml")
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(MissionError, match="UTF-8"):
        load(tmp_path / "b.toml")
