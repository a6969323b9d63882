"""The files that `install-service` writes, removes and refuses; systemd itself reads the unit."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from command_line import run
from required_programs import need

from firmware_link.find import UsbBoard
from flying_vines.config import config
from flying_vines.install import files, program
from flying_vines.install.program import FileReader, InstalledProgram, InstallError, check_reachable
from flying_vines.record import recorder
from flying_vines.service import service
from flying_vines.terminal import screen

MOST_EXPOSED = 2.0
"""Of 10, as systemd-analyze counts; up to 2 is safe."""


def installed(capsys: pytest.CaptureFixture[str], root: Path, *more: object) -> str:
    """The output if all goes well."""
    status, said, wrong = run(capsys, "install-service", "--root", root, "--yes", *more)
    assert status == 0, wrong
    return said


def text(root: Path, path: Path) -> str:
    return (root / path.relative_to("/")).read_text(encoding="utf-8")


def there(root: Path) -> set[Path]:
    return {"/" / path.relative_to(root) for path in root.rglob("*") if path.is_file()}


def test_everything_is_shown_and_then_written(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    said = installed(capsys, tmp_path)
    assert there(tmp_path) == {files.UNIT, files.RULE, files.USERS, files.CONFIGURATION}
    for path in there(tmp_path):
        assert f"{tmp_path}{path}: new" in said
        for line in text(tmp_path, path).splitlines():
            assert f"    {line}\n" in said
    assert "systemctl enable --now flying-vines.service" in said


def test_the_configuration_is_the_built_in_one_with_the_board_and_the_state_where_the_service_has_them() -> (
    None
):
    wanted = config.parse(files.built_in_configuration().text, "installed")
    assert wanted.firmware.link == "serial:/dev/phlosar"
    assert wanted.state.folder == "/var/lib/flying-vines"
    changed = [
        (was, now)
        for was, now in zip(
            config.default_text().splitlines(), files.built_in_configuration().text.splitlines(), strict=True
        )
        if was != now
    ]
    assert len(changed) == 2
    for was, now in changed:
        assert was.partition("#")[2] == now.partition("#")[2]


@pytest.mark.parametrize("more", [(), ("--user", "pi", "--port-id", "usb:16c0:0483:1234560")])
def test_systemd_reads_the_unit_without_a_complaint(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, more: tuple[str, ...]
) -> None:
    analyze = need("systemd-analyze", "sudo apt install systemd")
    installed(capsys, tmp_path, *more)
    unit = tmp_path / files.UNIT.relative_to("/")
    # systemd looks for the program, which is in the image, on this machine.
    here = unit.read_text(encoding="utf-8").replace("/opt/flying-vines/bin/flying-vines", "/bin/true")
    unit.write_text(here, encoding="utf-8")
    read = subprocess.run((analyze, "verify", str(unit)), capture_output=True, text=True, check=False)
    assert (read.returncode, read.stdout, read.stderr) == (0, "", "")
    security = (analyze, "security", "--offline=true", "--no-pager", str(unit))
    judged = subprocess.run(security, capture_output=True, text=True, check=True)
    exposed = re.search(r"exposure level for flying-vines.service: ([\d.]+)", judged.stdout)
    assert exposed is not None
    assert float(exposed[1]) <= MOST_EXPOSED


@pytest.mark.parametrize("program", ["/opt/flying-vines/bin/flying-vines", "/usr/local/bin/flying-vines"])
def test_the_units_of_an_image_have_no_path_of_this_machine(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, program: str
) -> None:
    if "local" in program:
        link = tmp_path / program.removeprefix("/")
        link.parent.mkdir(parents=True)
        link.symlink_to("/opt/pipx/only/there")
    said = installed(capsys, tmp_path)
    assert ("The image has no flying-vines yet" in said) == ("local" not in program)
    written = "".join(text(tmp_path, path) for path in there(tmp_path))
    assert f"ExecStart={program} run --config {files.CONFIGURATION} " in written
    for path in (tmp_path, sys.prefix, Path(files.__file__).parents[2], Path.home()):
        assert str(path) not in written


def test_the_unit_runs_the_flying_vines_that_wrote_it() -> None:
    command = InstalledProgram.here().command
    unit = files.unit(command, files.USER, files.CONFIGURATION, [], files.STATE).text
    (start,) = re.findall(r"^ExecStart=(.*)$", unit, re.MULTILINE)
    program, *arguments = shlex.split(start)
    assert Path(program).is_absolute()
    told = subprocess.run((program, "--version"), capture_output=True, text=True, check=True).stdout
    here = subprocess.run(
        (sys.executable, "-m", "flying_vines", "--version"), capture_output=True, text=True, check=True
    ).stdout
    assert told == here
    assert arguments[:3] == ["run", "--config", str(files.CONFIGURATION)]


def test_systemd_waits_at_a_stop_as_long_as_a_disk_and_a_screen_that_hang_are_waited_for(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    installed(capsys, tmp_path)
    timeout = re.search(r"^TimeoutStopSec=(\d+)$", text(tmp_path, files.UNIT), re.MULTILINE)
    assert timeout
    assert float(timeout[1]) >= service.FLUSH_S + recorder.LAST_WRITES_S + screen.CLOSING_S + 2.0


def test_a_second_time_changes_nothing(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    installed(capsys, tmp_path)
    before = {path: (tmp_path / path.relative_to("/")).stat().st_mtime_ns for path in there(tmp_path)}
    said = installed(capsys, tmp_path)
    assert said.count(": unchanged (") == len(before)
    assert before == {path: (tmp_path / path.relative_to("/")).stat().st_mtime_ns for path in there(tmp_path)}


def test_a_change_is_shown_as_what_differs(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    installed(capsys, tmp_path)
    said = installed(capsys, tmp_path, "--user", "pi")
    assert "    -User=flying-vines\n    +User=pi\n" in said
    assert "Restart=" not in said
    assert "old settings until it is restarted" in said


def test_a_configuration_is_never_written_over_nor_taken_away_once_it_was_changed(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    installed(capsys, tmp_path)
    config_file = tmp_path / files.CONFIGURATION.relative_to("/")
    mine = config_file.read_text(encoding="utf-8").replace("channel = 9", "channel = 7")
    config_file.write_text(mine, encoding="utf-8")
    installed(capsys, tmp_path)
    assert config_file.read_text(encoding="utf-8") == mine
    installed(capsys, tmp_path, "--remove")
    assert there(tmp_path) == {files.CONFIGURATION}
    assert config_file.read_text(encoding="utf-8") == mine


def test_removing_leaves_nothing_but_flights(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    installed(capsys, tmp_path)
    said = installed(capsys, tmp_path, "--remove")
    assert there(tmp_path) == set()
    assert not (tmp_path / "etc/flying-vines").exists()
    assert "userdel flying-vines" in said

    installed(capsys, tmp_path)
    flight = tmp_path / "var/lib/flying-vines/flights/log"
    flight.parent.mkdir(parents=True)
    flight.write_text("flown", encoding="utf-8")
    said = installed(capsys, tmp_path, "--remove")
    assert there(tmp_path) == {Path("/var/lib/flying-vines/flights/log")}
    assert "/var/lib/flying-vines stays" in said
    assert "Their owner flying-vines also stays" in said
    assert "nothing to remove" not in said


def test_removing_what_is_not_there_is_no_fault(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert "nothing to remove" in installed(capsys, tmp_path, "--remove")


def test_files_of_others_are_not_changed(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    installed(capsys, tmp_path)
    unit = tmp_path / files.UNIT.relative_to("/")
    unit.write_text("[Service]\nExecStart=/usr/bin/true\n", encoding="utf-8")
    said = installed(capsys, tmp_path, "--remove")
    assert f"{unit}: unchanged (install-service did not write it)" in said
    assert there(tmp_path) == {files.UNIT}


@pytest.mark.parametrize(("answer", "status", "written"), [("y", 0, 4), ("n", 1, 0), ("", 1, 0)])
def test_it_asks(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    answer: str,
    status: int,
    written: int,
) -> None:
    monkeypatch.setattr("builtins.input", lambda question: answer)
    assert run(capsys, "install-service", "--root", tmp_path)[0] == status
    assert len(there(tmp_path)) == written


def test_without_an_answer_nothing_is_written(tmp_path: Path) -> None:
    command = (sys.executable, "-m", "flying_vines", "install-service", "--root", str(tmp_path))
    ran = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (
        2,
        "flying-vines: no answer on standard input; --yes runs it without a question\n",
    )
    assert there(tmp_path) == set()


def test_without_root_it_reports_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    status, _, wrong = run(capsys, "install-service")
    assert status == 2
    assert re.fullmatch(r"flying-vines: only root may install a service: sudo \S+.* install-service\n", wrong)


@pytest.mark.parametrize(
    ("more", "wrong"),
    [
        (("--port-id", "16c0:0483"), "'16c0:0483' is not a USB board"),
        (("--port-id", 'usb:16c0:0483:1",RUN="x'), "udev cannot match this serial number"),
        (("--user", "pi\nExecStartPre=/bin/sh"), "is not a valid user name"),
        (("--config", "none.toml"), "none.toml is not in the image"),
    ],
)
def test_an_impossible_installation_gives_one_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, more: tuple[str, ...], wrong: str
) -> None:
    status, _, said = run(capsys, "install-service", "--root", tmp_path, "--yes", *more)
    assert status == 2
    assert wrong in said
    assert said.count("\n") == 1
    assert there(tmp_path) == set()


def test_an_image_that_cannot_be_written_is_one_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "etc").write_text("no folder", encoding="utf-8")
    status, _, said = run(capsys, "install-service", "--root", tmp_path, "--yes")
    assert status == 2
    assert re.fullmatch(rf"flying-vines: {tmp_path}/etc\S*: \w[\w ]+\n", said)


def test_a_configuration_with_a_fault_is_not_installed(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    config_file = tmp_path / "root/vine.toml"
    config_file.parent.mkdir()
    config_file.write_text("[limits]\nmax_kPa = -1\n", encoding="utf-8")
    status, _, said = run(
        capsys, "install-service", "--root", tmp_path / "root", "--config", config_file, "--yes"
    )
    assert status == 2
    assert "limits.max_kPa" in said


def test_a_configuration_of_ones_own_is_flown_with_where_it_is(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    root = tmp_path / "root"
    folder = root / "100% mine"
    folder.mkdir(parents=True)
    config_file = folder / "vine.toml"
    config_file.write_text(config.default_text(), encoding="utf-8")
    installed(capsys, root, "--config", config_file)
    assert files.CONFIGURATION not in there(root)
    unit = text(root, files.UNIT)
    named = "/100%% mine"
    assert f'--config "{named}/vine.toml" --out' in unit
    assert f'ReadWritePaths="{named}"\n' in unit, "parameters are kept beside it"


def test_files_of_the_configuration_in_a_home_make_homes_readable(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    config_file = tmp_path / "root/vine.toml"
    config_file.parent.mkdir()
    there = config.default_text().replace('signing_key = ""', 'signing_key = "/home/pi/keys/mavlink"')
    config_file.write_text(there.replace('folder = ""', 'folder = "/var/lib/flying-vines"'), encoding="utf-8")
    installed(capsys, tmp_path / "root", "--config", config_file)
    unit = text(tmp_path / "root", files.UNIT)
    assert "\nProtectHome=read-only\n" in unit
    assert "ReadWritePaths" not in unit


@pytest.mark.parametrize(
    ("place", "home"),
    [("/opt/flying-vines/bin/flying-vines", "yes"), ("/home/pi/bin/flying-vines", "read-only")],
)
def test_homes_are_open_only_for_a_program_in_one(place: str, home: str) -> None:
    unit = files.unit((place,), "pi", files.CONFIGURATION, (Path(place),), files.STATE).text
    assert f"\nProtectHome={home}\n" in unit
    assert "ReadWritePaths" not in unit


def test_the_rule_names_the_board_as_udev_writes_it() -> None:
    rule = files.rule(UsbBoard(0x16C0, 0x0483, "1234560")).text.splitlines()
    which = 'ATTRS{idVendor}=="16c0", ATTRS{idProduct}=="0483", ATTRS{serial}=="1234560"'
    assert (
        rule[-1]
        == f'SUBSYSTEM=="tty", {which}, GROUP="dialout", MODE="0660", SYMLINK+="phlosar", TAG+="systemd"'
    )
    assert rule[-2] == f'{which}, ENV{{ID_MM_DEVICE_IGNORE}}="1", ENV{{ID_MM_PORT_IGNORE}}="1"'


class TestReachable:
    """Files of root below /usr stand for an installation that everybody may read."""

    def test_a_program_of_the_system_is(self) -> None:
        check_reachable((Path("/usr/bin/env"),), FileReader("flying-vines"))

    @pytest.mark.parametrize(
        ("place", "why"),
        [
            (
                "/tmp/venv/bin/flying-vines",
                "/tmp/venv/bin/flying-vines is in a temporary folder, which can be emptied at any time",
            ),
            ("/opt/x/.cache/uv/bin/flying-vines", "is in a cache, which can be emptied"),
            ("/usr/bin/no-such-program", "/usr/bin/no-such-program: No such file"),
        ],
    )
    def test_these_are_not(self, place: str, why: str) -> None:
        with pytest.raises(InstallError, match=why):
            check_reachable((Path(place),), FileReader("flying-vines"))

    def test_a_closed_home_is_open_to_its_owner(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(program, "VOLATILE_FOLDERS", ())
        with TemporaryDirectory(dir="/var/tmp") as folder:
            home = Path(folder)
            command = home / "flying-vines"
            command.write_text("", encoding="utf-8")
            home.chmod(0o700)
            check_reachable((command,), FileReader("pi", home.stat().st_uid))
            with pytest.raises(
                InstallError, match=f"flying-vines, the user of the service, cannot read {home}"
            ):
                check_reachable((command,), FileReader("flying-vines"))
            home.chmod(0o755)
            check_reachable((command,), FileReader("flying-vines"))


def test_the_program_is_where_its_python_is() -> None:
    program = InstalledProgram.here()
    assert Path(program.command[0]).parent == Path(sys.executable).parent
    assert Path(sys.executable) in program.places


def test_the_machine_itself_is_changed_only_with_what_it_can_reach(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Root on a real computer, with a program that the service could not start."""
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    lost = InstalledProgram(("/tmp/venv/bin/flying-vines",), (Path("/tmp/venv/bin/flying-vines"),))
    monkeypatch.setattr(InstalledProgram, "here", lambda: lost)
    status, _, said = run(capsys, "install-service", "--yes")
    assert (status, "is in a temporary folder" in said) == (2, True)
