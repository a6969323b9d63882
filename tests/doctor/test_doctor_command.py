"""`flying-vines doctor`: output on a terminal, in a pipe and as JSON, and exit status."""

from __future__ import annotations

import asyncio
import io
import json
import re
import sys
from pathlib import Path

import pytest
from command_line import run
from real_time import real_time
from rich.console import Console
from service_bench import on_bench
from waiting import until

from flying_vines.config import config as configuration
from flying_vines.doctor.finding import DoctorFinding, last_line, show, summary
from flying_vines.doctor.radio import asking
from flying_vines.doctor.vehicle_probe import SwitchFacts
from flying_vines.simulation.autopilot import FakeAutopilot

pytestmark = real_time

FOUND = [
    DoctorFinding("memory", "good", "900 MB free"),
    DoctorFinding("broker", "skipped", "the configuration has none"),
    DoctorFinding("clock", "warning", "not synchronised " + "and so on " * 20, "wait"),
    DoctorFinding("phloSAR port", "bad", "/dev/ttyACM0 is not there", "plug it in"),
]


def shown(*, terminal: bool) -> str:
    console = Console(file=io.StringIO(), force_terminal=terminal, width=80)
    show(FOUND, console)
    console.print(last_line(FOUND, summary(FOUND)))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_in_a_pipe_findings_and_remedies_have_a_line_each() -> None:
    text = shown(terminal=False)
    lines = text.splitlines()
    assert "\x1b" not in text
    assert lines[0].split() == ["ok", "memory:", "900", "MB", "free"]
    assert lines[1].startswith("-    broker:")
    assert lines[2].startswith("look clock:")
    assert lines[3] == "     → wait"
    assert lines[4].startswith("BAD  phloSAR port:")
    assert lines[-1] == "Do not fly: 1 thing to correct, and 1 thing to check."
    assert len(lines) == 8


def test_on_a_terminal_lines_fit_its_width_and_begin_with_signs() -> None:
    lines = [re.sub(r"\x1b\[[0-9;]*m", "", line) for line in shown(terminal=True).splitlines()]
    assert max(map(len, lines)) <= 80
    assert [line[0] for line in lines if line and line[0] != " "] == ["✓", "–", "!", "✗", "D"]
    assert shown(terminal=True).count("\x1b[") > 10


def test_the_seen_positions_are_shown() -> None:
    seen = SwitchFacts(None, 1504, 1, frozenset({0, 1}))
    text = asking(seen, 9, ("straight", "bend-half", "bend-full"))
    assert "channel 9" in text
    assert "1 ✓ 2 ✓ 3 …" in text
    assert "1504 µs, position 2" in text
    assert "radio failsafe" in asking(SwitchFacts("radio failsafe"), 9, ("", ""))


@pytest.mark.long
def test_with_fakes_it_finds_no_error_and_leaves_no_file(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    status, out, err = run(capsys, "doctor", "--fakes", "--seconds", "5", "--json", "--out", tmp_path)
    assert (status, err) == (0, "")
    told = json.loads(out)
    assert told["may_fly"]
    assert told["summary"].startswith("You may fly")
    assert {"check", "verdict", "what", "do"} == set(told["findings"][0])
    assert "RC_CHANNELS" in {finding["check"] for finding in told["findings"]}
    assert list(tmp_path.iterdir()) == []


def test_an_error_makes_the_exit_status_one(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    config_file = tmp_path / "vine.toml"
    text = configuration.default_text().replace("udpin:127.0.0.1:14540", "serial:/dev/none-a")
    config_file.write_text(text.replace("serial:/dev/ttyACM0", "serial:/dev/none-b"))
    status, out, err = run(capsys, "doctor", "--config", config_file, "--out", tmp_path)
    assert (status, err) == (1, "")
    assert "BAD  phloSAR port:         /dev/none-b does not exist" in out
    assert "BAD  vehicle port:         /dev/none-a does not exist" in out
    assert out.splitlines()[-1].startswith("Do not fly: 2 things to correct")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--config", "none.toml"), "none.toml"),
        (("--config", "bad.toml"), "bad.toml:1: not TOML"),
        (("--seconds", "1"), "from 5 to 3600"),
        (("--seconds", "x"), "--seconds"),
    ],
)
def test_bad_usage_prints_one_line_and_exits_with_2(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    says: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.toml").write_text("vehicle = [\n")
    status, out, err = run(capsys, "doctor", *arguments)
    assert (status, out) == (2, "")
    assert says in err.splitlines()[-1]
    assert "Traceback" not in err


async def test_a_running_service_is_reported_with_its_ports(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    async with on_bench(FakeAutopilot("ardupilot")) as bench:
        config_file = tmp_path / "vine.toml"
        config_file.write_text(bench.configuration.replace("port = 8017", "port = 0"))
        arguments = ("--config", str(config_file), "--out", str(tmp_path / "flights"))
        service = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "flying_vines", "run", "--plain", *arguments, stdout=asyncio.subprocess.PIPE
        )
        await until(lambda: "RES_KPA" in bench.ground.values, "the service runs")
        status, out, _ = await asyncio.to_thread(run, capsys, "doctor", *arguments)
        still_runs = service.returncode is None
        service.terminate()
        await service.communicate()
    assert status == 1
    for port in ("phloSAR", "vehicle"):
        (held,) = [line for line in out.splitlines() if f" {port} port:" in line]
        assert held.startswith("- ") and held.endswith("is used by the running service")
    (runs,) = [line for line in out.splitlines() if line.startswith("BAD  service:")]
    assert f"flying-vines run (process {service.pid}) already runs and uses" in runs
    assert "-    phloSAR:" in out
    assert still_runs
