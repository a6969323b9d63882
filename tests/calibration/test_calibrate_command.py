"""`flying-vines calibrate`: its output, files and exit status."""

from __future__ import annotations

import json
import os
import pty
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command_line import run
from ports import free_port
from real_time import real_time
from service_bench import between
from waiting import MAX_WAIT_S

from flying_vines.config import config as configuration
from flying_vines.files.extras import install_command
from flying_vines.record.reader import FlightLog, start_of
from flying_vines.record.topics import DECISION, TELEMETRY
from flying_vines.simulation.replay import replay_flight

pytestmark = real_time

COMMAND = (sys.executable, "-m", "flying_vines")
RIG = """
[cv]
volume_L = 0.4
[causes]
cv_sensor_offset = {offset_kPa = 0.4}
cv_leak = {flow_resistance_kPa_s_per_SL = 5e3}
reservoir_leak = {flow_resistance_kPa_s_per_SL = 2e5}
"""


@pytest.fixture(scope="module")
def fake(tmp_path_factory: pytest.TempPathFactory) -> tuple[subprocess.CompletedProcess[str], Path]:
    """A calibration of two stages on a simulated rig, and its folder; 15 s of CPU time."""
    folder = tmp_path_factory.mktemp("calibrated")
    config_file = folder / "vine.toml"
    config_file.write_text(configuration.default_text().replace("cv_volume_L = 0.1 ", "cv_volume_L = 0.3 "))
    (folder / "rig.toml").write_text(RIG)
    stages = ("--only", "levels", "--no-diagnosis")
    arguments = ("calibrate", "--config", config_file, "--fake", "rig.toml", *stages)
    ended = subprocess.run((*COMMAND, *arguments), cwd=folder, capture_output=True, text=True, check=False)
    return ended, folder


@pytest.mark.long
def test_it_shows_stages_and_results(
    fake: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    ended, _ = fake
    assert (ended.returncode, ended.stderr) == (0, "")
    for text in ("It takes", "1/2  Zero", "2/2  Vine's volume", "Done", "95 % interval", "calibrated.toml"):
        assert text in ended.stdout


@pytest.mark.long
def test_the_written_configuration_is_valid(
    fake: tuple[subprocess.CompletedProcess[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    _, folder = fake
    (written,) = folder.glob("flights/*/calibration/calibrated.toml")
    status, out, err = run(capsys, "config", "check", written)
    assert (status, err) == (0, "")
    assert "good" in out
    numbers = configuration.load(written).pneumatics
    assert numbers.cv_volume_L == pytest.approx(findings_in(folder)["cv_volume_L"]["value"], rel=0.02)
    assert "was 0.3, measured" in written.read_text()
    assert configuration.load(folder / "vine.toml").pneumatics.cv_volume_L == 0.3
    assert (written.parent / "profile-before.toml").read_text() == (folder / "vine.toml").read_text()


def findings_in(folder: Path) -> dict[str, dict[str, Any]]:
    (path,) = folder.glob("flights/*/calibration/findings.json")
    return {finding["name"]: finding for finding in json.loads(path.read_text())["findings"]}


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "true", "relative"),
    [
        ("cv_zero_kPa", 0.4, 0.02),
        ("cv_volume_L", 0.4, 0.05),
        ("pouch_air_SL", 0.0, 0.0),
        ("vine_leak_kPa_s_per_SL", 5e3, 0.05),
        ("reservoir_leak_kPa_s_per_SL", 2e5, 0.1),
    ],
)
def test_the_hidden_values_are_found(
    fake: tuple[subprocess.CompletedProcess[str], Path], name: str, true: float, relative: float
) -> None:
    found = findings_in(fake[1])[name]
    assert found["value"] == pytest.approx(true, rel=relative)
    assert found["low"] <= true <= found["high"]


@pytest.mark.long
def test_it_writes_a_flight(
    fake: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    _, folder = fake
    (flight,) = (folder / "flights").iterdir()
    log = FlightLog(flight)
    asked = [entry.fields["trigger"] for entry in log.entries((DECISION,))]
    assert set(asked) == {"calibration"}
    assert start_of(log).profile == (flight / "profile.toml").read_text()
    *_, last = log.entries((TELEMETRY,))
    assert last.fields["cv_kPa"] < 1.0
    assert last.fields["solenoid"]


@pytest.mark.long
def test_it_writes_a_page_with_pictures(fake: tuple[subprocess.CompletedProcess[str], Path]) -> None:
    _, folder = fake
    (page,) = folder.glob("flights/*/calibration/calibration.html")
    pictures = {path.stem for path in page.parent.glob("*.png")}
    assert pictures
    assert pictures == {path.stem for path in page.parent.glob("*.svg")}
    assert page.read_text().count("<figure>") == len(pictures)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((), "--config FILE"),
        (("--config", "nowhere.toml"), "no such file"),
        (("--fake", "nowhere.toml"), "nowhere.toml"),
        (("--fake", "--only", "level"), "did you mean 'levels'"),
        (("--fake", "--vessel-L", "0.5"), "--vessel-L"),
        (("--fake", "--reservoir-volume-L", "-2"), "litres"),
        (("--fake", "--set-firmware"), "--set-firmware"),
        (("--fake", "--in-place"), "--config FILE"),
        (("--fake", "--angles", "nowhere.csv"), "nowhere.csv"),
        (("--fake", "--only", "vessel"), "vessel"),
        (("--fake", "--only", "zero", "--out", "/proc/nowhere"), "/proc/nowhere"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    arguments: tuple[str, ...], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    status, _, err = run(capsys, "calibrate", *arguments)
    assert status == 2
    assert err.count("\n") == 1
    assert err.startswith("flying-vines: ")
    assert says in err


def test_without_a_terminal_nothing_moves(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(sys.stdin, "isatty", lambda: False, raising=False)
    config_file = tmp_path / "vine.toml"
    config_file.write_text(configuration.default_text())
    status, _, err = run(capsys, "calibrate", "--config", config_file)
    assert status == 2
    assert "--yes" in err


def without(tmp_path: Path, *packages: str) -> subprocess.CompletedProcess[str]:
    """The shortest calibration without these packages."""
    program = (
        f"import sys; sys.modules.update(dict.fromkeys({packages})); from flying_vines.cli.main import main;"
        "main(['calibrate', '--fake', '--only', 'zero'])"
    )
    return subprocess.run(
        (sys.executable, "-c", program), cwd=tmp_path, capture_output=True, text=True, check=False
    )


@pytest.mark.long
def test_without_numba_and_matplotlib_it_measures_and_reports_what_is_missing(tmp_path: Path) -> None:
    ended = without(tmp_path, "matplotlib", "numba", "threadpoolctl")
    assert (ended.returncode, ended.stderr) == (0, "")
    assert "No pictures: " in ended.stdout
    assert f"is missing: {install_command('analysis')}" in ended.stdout
    assert "Then: flying-vines diagnose --from-log flights/" in ended.stdout
    (findings,) = tmp_path.glob("flights/*/calibration/findings.json")
    flight = findings.parent.parent
    asked = {entry.fields["trigger"] for entry in FlightLog(flight).entries((DECISION,))}
    assert asked == {"calibration"}


def test_without_numpy_it_is_one_line(tmp_path: Path) -> None:
    ended = without(tmp_path, "numpy", "numba")
    assert ended.returncode == 2
    assert ended.stderr == f"flying-vines: numpy is missing: {install_command('analysis')}\n"


# On a terminal, in real time.


class Terminal:
    """A command on its own pseudo-terminal, with typed input."""

    def __init__(self, *arguments: object, cwd: Path) -> None:
        self.seen = ""
        self._pid, self._screen = pty.fork()
        if self._pid == 0:
            os.chdir(cwd)
            os.execv(COMMAND[0], [str(argument) for argument in (*COMMAND, *arguments)])

    def shows(self, text: str) -> None:
        """Wait for this text."""
        until = time.monotonic() + MAX_WAIT_S
        while text not in self.seen:
            assert time.monotonic() < until, self.seen
            if not self._read(0.1):
                break
        assert text in self.seen, self.seen

    def types(self, text: str) -> None:
        os.write(self._screen, text.encode())

    def ends(self) -> int:
        """Wait for the end. Returns the exit status."""
        until = time.monotonic() + MAX_WAIT_S
        while self._read(0.1):
            assert time.monotonic() < until, self.seen
        os.close(self._screen)
        return os.waitstatus_to_exitcode(os.waitpid(self._pid, 0)[1])

    def _read(self, timeout_s: float) -> bool:
        """True if there may be more output."""
        try:
            if select.select([self._screen], [], [], timeout_s)[0]:
                self.seen += os.read(self._screen, 65536).decode(errors="replace")
        except OSError:
            return False
        return True


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Path]:
    """A folder with a configuration for a simulated phloSAR in its own process."""
    port = tmp_path / "port"
    arguments = (*COMMAND, "fake", "phlosar", "--link", port)
    with subprocess.Popen(arguments, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE) as phlosar:
        assert phlosar.stdout is not None
        phlosar.stdout.readline()
        config_file = tmp_path / "vine.toml"
        config_file.write_text(between(free_port(), str(port)))
        yield tmp_path
        phlosar.send_signal(signal.SIGTERM)


@pytest.mark.long
def test_ctrl_c_ends_it_vented_and_sets_the_telemetry_back(
    bench: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    terminal = Terminal("calibrate", "--config", "vine.toml", "--only", "levels", cwd=bench)
    terminal.shows("Press Enter")
    terminal.types("\n")
    terminal.shows("Vine's volume")
    _wait_for_pressure(bench, 5.0)
    terminal.types("\x03")
    assert terminal.ends() == 130
    assert "Stopped, and vented: Vine's volume: interrupted" in terminal.seen
    status, out, _ = run(capsys, "link", f"serial:{bench / 'port'}", "--settings", "--json")
    assert status == 0
    settings = {entry["name"]: entry["value"] for entry in map(json.loads, out.splitlines())}
    assert settings["telemetry_Hz"] == 100.0
    (flight,) = (bench / "flights").iterdir()
    assert replay_flight(FlightLog(flight)).differences == []
    *_, last = FlightLog(flight).entries((TELEMETRY,))
    assert last.fields["cv_kPa"] < 1.5
    assert last.fields["setpoint_kPa"] == 0.0
    assert (flight / "calibration" / "findings.json").is_file()


def _wait_for_pressure(bench: Path, kPa: float) -> None:
    """Wait until the pressure is in the flight's log, which is on the disk within a second."""
    until = time.monotonic() + MAX_WAIT_S
    while time.monotonic() < until:
        for flight in (bench / "flights").glob("*"):
            if any(entry.fields["cv_kPa"] > kPa for entry in FlightLog(flight).entries((TELEMETRY,))):
                return
    pytest.fail("the vine never bent")


@pytest.mark.long
def test_ctrl_c_before_it_begins_moves_nothing(bench: Path) -> None:
    terminal = Terminal("calibrate", "--config", "vine.toml", cwd=bench)
    terminal.shows("Press Enter")
    terminal.types("\x03")
    assert terminal.ends() == 130
    assert not (bench / "flights").exists()
