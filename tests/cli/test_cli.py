"""Commands as a person types them: output and exit status."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import status as run

from flying_vines.cli.main import main
from flying_vines.config import config

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


def test_a_dash_prints_the_configuration_and_writes_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("config", "init", "-") == 0
    assert capsys.readouterr().out == config.default_text()
    assert not list(tmp_path.iterdir())


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


@pytest.mark.parametrize(
    ("command", "says"),
    [
        ("doctor --seconds abc", "--seconds must be a number, not 'abc'"),
        ("doctor --seconds -3", "argument --seconds: must be from 5 to 3600"),
        (
            "simulate --rig r.toml --scenario case --out x --seed 1.5",
            "--seed must be a whole number, not '1.5'",
        ),
        ("simulate --scenario case", "the following arguments are required: --rig"),
        ("watch --prot 3", "unrecognized arguments: --prot 3"),
    ],
)
def test_a_wrong_option_is_one_line_that_names_the_help(
    command: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(command.split())
    assert stopped.value.code == 2
    said = capsys.readouterr().err
    assert says in said and "--help" in said
    assert said.count("\n") == 1


SIGNED = ('signing_key = ""', 'signing_key = "key"')


@pytest.mark.parametrize(
    ("changes", "files", "where"),
    [
        ((), {}, ""),
        ((SIGNED,), {}, "vine.toml:LINE: vehicle.signing_key: "),
        ((SIGNED,), {"key": "short"}, "vine.toml:LINE: vehicle.signing_key: "),
        ((('rig = ""', 'rig = "rig.toml"'),), {}, "vine.toml:LINE: pneumatics.rig: "),
        ((('rig = ""', 'rig = "rig.toml"'),), {"rig.toml": "[cv\n"}, "vine.toml:LINE: pneumatics.rig: "),
        ((('kind = "phlosar"', 'kind = "phlosarr"'),), {}, "vine.toml:LINE: firmware.kind: "),
        ((("own = {}", 'own = { stuck = "fault" }'),), {}, "vine.toml:LINE: checks.own.stuck: "),
        ((('folder = ""', 'folder = "file"'),), {"file": ""}, "vine.toml:LINE: state.folder: "),
        ((), {"vine.parameters.toml": "VINE_MAX_KPA = 3000"}, "vine.parameters.toml:1: VINE_MAX_KPA: "),
        ((), {"vine.parameters.toml": "VINE_FUEL_STATUS = 1"}, ""),
        ((("max_kPa = 20.7", "max_kPa = 20.7 kPa"),), {}, "vine.toml:LINE: not TOML: "),
    ],
)
def test_check_refuses_what_run_refuses_with_the_same_words(
    changes: tuple[tuple[str, str], ...],
    files: dict[str, str],
    where: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    async def served(*inputs: object, **how: object) -> None:
        pass

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("flying_vines.service.runner.serve", served)
    text = config.default_text()
    for before, after in changes:
        assert before in text
        text = text.replace(before, after, 1)
    Path("vine.toml").write_text(text, encoding="utf-8")
    for name, content in files.items():
        Path(name).write_text(content, encoding="utf-8")
        Path(name).chmod(0o600)
    checked = run("config", "check", "vine.toml")
    wrong = capsys.readouterr().err
    ran = run("run", "--config", "vine.toml", "--plain")
    assert (checked, wrong) == (ran, capsys.readouterr().err)
    if changes:
        where = where.replace("LINE", str(text[: text.index(changes[-1][1])].count("\n") + 1))
    assert wrong.startswith(f"flying-vines: {where}") if where else wrong == ""


@pytest.mark.parametrize(
    ("key", "file"), [("ca_file", "/nonexistent/ca.pem"), ("password_file", "/nonexistent/password")]
)
def test_check_reads_the_files_for_the_broker(
    key: str, file: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = config.default_text().replace('broker = ""', 'broker = "mqtts://127.0.0.1"')
    text = text.replace('username = ""', 'username = "vine"').replace(f'{key} = ""', f'{key} = "{file}"')
    (tmp_path / "vine.toml").write_text(text, encoding="utf-8")
    assert run("config", "check", str(tmp_path / "vine.toml")) == 2
    assert f": mqtt.{key}: {file}: " in capsys.readouterr().err
