"""Commands as a person types them: output and exit status."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import status as run

RECORDINGS = Path(__file__).parents[1] / "data" / "recordings"


def complaint(capsys: pytest.CaptureFixture[str]) -> str:
    """The line on standard error. Checks that it is only one, and that standard output is empty."""
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert "Traceback" not in err
    return err


def test_init_writes_a_configuration_that_check_likes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config_file = tmp_path / "vine.toml"
    assert run("config", "init", config_file) == 0
    assert run("config", "check", config_file) == 0
    out = capsys.readouterr().out
    assert "good" in out
    assert out.endswith("Vehicle link unsigned: every program on this computer can command the vine.\n")
    assert run("config", "init", config_file) == 2
    assert "already" in complaint(capsys)
    config_file.write_text("")
    assert run("config", "init", config_file, "--force") == 0
    assert config_file.read_text().startswith("# A Flying Vines configuration")


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.4.2", "::"])
def test_a_link_that_anybody_can_reach_is_refused(
    host: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config_file = tmp_path / "vine.toml"
    run("config", "init", config_file)
    config_file.write_text(config_file.read_text().replace("udpin:127.0.0.1", f"udpin:{host}"))
    capsys.readouterr()
    for command in (("config", "check", config_file), ("run", "--config", config_file, "--out", tmp_path)):
        assert run(*command) == 2
        assert complaint(capsys) == (
            f"flying-vines: {config_file}:6: vehicle.link: anybody on the network could command the vine: "
            f"name the sender (udpin:{host}:14540?peer=ADDRESS), listen on 127.0.0.1, "
            "or set vehicle.signing_key\n"
        )


def test_check_names_file_line_and_key(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config_file = tmp_path / "vine.toml"
    run("config", "init", config_file)
    capsys.readouterr()
    text = config_file.read_text().replace("debounce_s = 0.15", "debounce = 0.15")
    config_file.write_text(text)
    line = 1 + text[: text.index("debounce = 0.15")].count("\n")
    assert run("config", "check", config_file) == 2
    assert complaint(capsys) == (
        f"flying-vines: {config_file}:{line}: switch.debounce: unknown key; did you mean 'debounce_s'?\n"
    )


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("run", "--config", "nowhere.toml"), "no such file"),
        (("config", "check", "nowhere.toml"), "config init"),
        (("config", "check", "/"), "cannot be read"),
        (("config", "init", "/nowhere/at/all.toml"), "cannot be written"),
        (("replay", "nowhere.tlog"), "no such file"),
        (("replay", RECORDINGS / "README.md"), "is it a .tlog?"),
        (("replay", RECORDINGS / "reboot.tlog", "--pace", "-1"), "--pace"),
        (("replay", RECORDINGS / "reboot.tlog", "--mission", RECORDINGS / "README.md"), "line 1"),
        (("replay", RECORDINGS / "reboot.tlog", "--mission", "nowhere.waypoints"), "No such file"),
        (("fake", "phlosar", "--rig", "nowhere.toml"), "nowhere.toml"),
        (("fake", "autopilot", "--to", "nowhere"), "nowhere"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    arguments: tuple[object, ...], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(*arguments) == 2
    assert says in complaint(capsys)


@pytest.mark.long
def test_replay_prints_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("replay", RECORDINGS / "px4_vine_mission.tlog", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert [entry["what"]["seq"] for entry in found] == [2, 4, 6, 8]


@pytest.mark.long
def test_a_truncated_recording_is_replayed_as_far_as_it_goes_and_printed_as_a_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = (RECORDINGS / "px4_vine_mission.tlog").read_bytes()
    cut = tmp_path / "cut.tlog"
    cut.write_bytes(whole[: 9 * len(whole) // 16 - 3])
    assert run("replay", cut) == 0
    table, err = capsys.readouterr()
    assert table.count("accepted") == 3
    assert "bend-half" in table
    assert "not part of a MAVLink frame" in err
