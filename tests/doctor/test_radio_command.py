"""`flying-vines doctor --radio`: output, changes of the configuration, and exit status."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path
from typing import Any

import pytest
from command_line import run
from real_time import real_time

from flying_vines.cli import doctor_radio as radio_command
from flying_vines.cli.doctor_radio import with_learned
from flying_vines.config import config as configuration
from flying_vines.config.config import ConfigError
from flying_vines.doctor.radio_guide import NobodyThereError
from flying_vines.doctor.radio_test import RadioLearned, Sign, TransmitterLoss

SIGN = Sign("RC status", 1.1, "RC status (present, enabled, health) 1 1 1 → 0 1 0")
HELD = TransmitterLoss(True, 1000, 1000, (SIGN,), ()), TransmitterLoss(True, 2000, 2000, (SIGN,), ())
HOLDING = RadioLearned("px4", losses=HELD, shows_within_s=1.6)
STRAIGHT = '[profiles.straight]\nsegments = [{ kind = "step", to_deg = 0 }]\n'
LINE = 'receiver_failsafe = "hold"'


@pytest.fixture
def config_file(tmp_path: Path) -> Path:
    path = tmp_path / "vine.toml"
    path.write_text(configuration.default_text())
    return path


def replace_test(monkeypatch: pytest.MonkeyPatch, learned: RadioLearned) -> None:
    async def test(*arguments: Any) -> RadioLearned:
        return learned

    monkeypatch.setattr(radio_command, "_test", test)


@pytest.mark.long
@real_time
def test_with_fakes_it_needs_no_person(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = run(capsys, "doctor", "--radio", "--fakes", "--json")
    printed = json.loads(out)
    assert status == 0
    assert (printed["safe"], printed["receiver_failsafe"], printed["written_to"]) == (True, "hold", None)
    assert printed["autopilot"] == "ardupilot"
    for loss, lost_us in zip(printed["losses"], (1000, 2000), strict=True):
        assert loss["lost_us"] == lost_us
        assert [sign["kind"] for sign in loss["signs"]] == ["text", "RC status"]
        assert 0.8 < loss["shown_after_s"] < 1.6
    assert printed["parameters"]["RC_OVERRIDE_TIME"] == 3.0
    # The instructions for a person are on standard error.
    steps = [line for line in err.splitlines() if line[:1].isdigit()]
    assert [line[:3] for line in steps] == ["1/5", "2/5", "3/5", "4/5", "5/5"]
    assert "position 3 (bend-full)" in steps[2]
    assert "\x1b" not in err


def test_without_a_terminal_it_prints_one_line_and_exits_with_2(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def test(*arguments: Any) -> RadioLearned:
        raise NobodyThereError

    monkeypatch.setattr(radio_command, "_test", test)
    status, out, err = run(capsys, "doctor", "--radio")
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert "press Enter" in err


@pytest.mark.parametrize(
    ("arguments", "answer", "written"),
    [((), "y\n", True), ((), "\n", False), ((), "", False), (("--yes",), "", True)],
)
def test_the_configuration_is_changed_only_after_a_yes(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    config_file: Path,
    arguments: tuple[str, ...],
    answer: str,
    written: bool,
) -> None:
    replace_test(monkeypatch, HOLDING)
    stdin = io.StringIO(answer)
    monkeypatch.setattr(stdin, "isatty", lambda: bool(answer))
    monkeypatch.setattr(sys, "stdin", stdin)
    status, out, err = run(capsys, "doctor", "--radio", "--config", config_file, *arguments)
    assert (status, err) == (0, "")
    assert radio_command.SAFE in out
    assert (configuration.load(config_file).switch.receiver_failsafe == "hold") is written
    assert (f"Written to {config_file}: {LINE}" in out) is written
    assert ("Not written" in out) is not written
    assert LINE in out


def test_a_configuration_with_the_same_value_is_not_written(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, config_file: Path
) -> None:
    replace_test(monkeypatch, HOLDING)
    config_file.write_text(config_file.read_text().replace('receiver_failsafe = "unknown"', LINE))
    before = config_file.read_text()
    _, out, _ = run(capsys, "doctor", "--radio", "--config", config_file, "--yes")
    assert f"{config_file} already has this line" in out
    assert config_file.read_text() == before


def test_for_the_built_in_configuration_the_line_is_printed(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    replace_test(monkeypatch, HOLDING)
    status, out, _ = run(capsys, "doctor", "--radio", "--yes")
    assert status == 0
    assert f"[switch]\n{LINE}" in out


def test_a_hidden_loss_exits_with_1_and_is_written_to_the_configuration(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, config_file: Path
) -> None:
    replace_test(monkeypatch, RadioLearned("ardupilot", losses=(TransmitterLoss(True, 1000, 1000, (), ()),)))
    status, out, _ = run(capsys, "doctor", "--radio", "--config", config_file, "--yes")
    assert status == 1
    assert "BAD  RC loss:" in out
    assert radio_command.UNSAFE in out
    assert configuration.load(config_file).switch.receiver_failsafe == "hidden"


def test_contradictory_losses_write_unknown(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, config_file: Path
) -> None:
    config_file.write_text(config_file.read_text().replace('receiver_failsafe = "unknown"', LINE))
    losses = HELD[0], TransmitterLoss(True, 2000, 1500, (SIGN,), ())
    replace_test(monkeypatch, RadioLearned("px4", losses=losses, shows_within_s=1.6))
    run(capsys, "doctor", "--radio", "--config", config_file, "--yes")
    assert configuration.load(config_file).switch.receiver_failsafe == "unknown"


def test_with_a_missing_port_nothing_is_asked(capsys: pytest.CaptureFixture[str], config_file: Path) -> None:
    config_file.write_text(config_file.read_text().replace("udpin:127.0.0.1:14540", "serial:/dev/none-a"))
    status, out, err = run(capsys, "doctor", "--radio", "--config", config_file)
    assert (status, err) == (1, "")
    assert "BAD  vehicle port:         /dev/none-a does not exist" in out
    assert "1/5" not in out


def test_only_one_line_changes_and_its_comment_stays() -> None:
    text = configuration.default_text()
    edited = with_learned(text, "vine.toml", 1999, "2026-11-22")
    changed = [
        pair for pair in zip(text.splitlines(), edited.splitlines(), strict=True) if len(set(pair)) > 1
    ]
    ((_, line),) = changed
    assert line.startswith("receiver_failsafe = 1999 ")
    assert 'was "unknown", measured 2026-11-22' in line
    assert "result of `doctor --radio`" in line
    again = with_learned(edited, "vine.toml", "hold", "2026-11-23")
    assert "2026-11-22" not in again
    assert "was 1999, measured 2026-11-23" in again


def test_a_configuration_without_the_key_gets_it() -> None:
    text = f'{STRAIGHT}\n[switch]\npositions = ["straight", ""]\n'
    edited = with_learned(text, "vine.toml", "hold", "2026-11-22")
    assert configuration.parse(edited, "vine.toml").switch.receiver_failsafe == "hold"


def test_a_switch_table_in_one_line_is_refused() -> None:
    text = f'switch = {{ positions = ["straight", ""] }}\n{STRAIGHT}'
    with pytest.raises(ConfigError, match="by hand"):
        with_learned(text, "vine.toml", "hold", "2026-11-22")
