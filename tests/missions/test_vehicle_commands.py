"""`mission upload`, `watch` and `download`: each error is one line."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import command_line
import pytest

from flying_vines.files.extras import install_command
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.autopilot_server import AutopilotServer
from flying_vines.vehicle.mission.item import MissionItem

VINE_MISSION = Path(__file__).parents[1] / "data" / "recordings" / "ardupilot_vine_mission.waypoints"
NOBODY = "udpin:127.0.0.1:1"
ACTIONS = pytest.mark.parametrize(
    "arguments", [("upload", VINE_MISSION), ("watch",), ("download", "got.plan")], ids=lambda a: a[0]
)


def error_line(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The only line on standard error of a failing command."""
    status, _, error = command_line.run(capsys, "mission", *arguments)
    assert status == 2
    assert error.startswith("flying-vines: ") and error.count("\n") == 1, error
    return error.removeprefix("flying-vines: ").rstrip()


@ACTIONS
def test_without_mavsdk_it_names_what_to_install(
    arguments: tuple[object, ...], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mavsdk", None)
    error = error_line(capsys, *arguments, "--link", NOBODY)
    assert error == f"mavsdk is missing: {install_command('missions')}, on 64-bit systems"


def test_if_its_library_does_not_load_the_first_line_reports_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    package = tmp_path / "mavsdk"
    package.mkdir()
    (package / "__init__.py").write_text("raise OSError('Could not load cmavsdk\\n  tried here')\n")
    for name in [name for name in sys.modules if name.split(".")[0] == "mavsdk"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(str(tmp_path))
    error = error_line(capsys, "watch", "--link", NOBODY)
    assert error == "mavsdk does not run here: Could not load cmavsdk"


@ACTIONS
def test_a_link_that_is_none(arguments: tuple[object, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert error_line(capsys, *arguments, "--link", "telepathy").startswith(
        "'telepathy' is not a link: give serial:"
    )


@pytest.mark.parametrize(
    ("arguments", "begins"),
    [
        (("upload", "none.waypoints"), "none.waypoints: cannot be read: No such file"),
        (("download", "mission.pdf"), "mission.pdf: the file must be a .plan or .waypoints"),
    ],
)
def test_files_are_looked_at_before_the_vehicle(
    arguments: tuple[str, ...], begins: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert error_line(capsys, *arguments, "--link", NOBODY).startswith(begins)


def test_a_mission_without_a_place_cannot_be_a_plan(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    class Peer:
        kind = "px4"

        async def download(self) -> list[MissionItem]:
            return [MissionItem(0, 187, (0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 2)]

    @asynccontextmanager
    async def vehicle(link: str) -> AsyncIterator[Peer]:
        yield Peer()

    monkeypatch.setattr("missions.transfer.vehicle", vehicle)
    path = tmp_path / "m.plan"
    assert error_line(capsys, "download", str(path)) == (
        f"{path}: cannot be written: the mission has no place that could be home; use a .waypoints file"
    )


@pytest.mark.long
async def test_ctrl_c_ends_a_watch_that_waits() -> None:
    if not os.environ.get("CI"):
        pytest.importorskip("mavsdk", reason="needs mavsdk: pip install 'flying-vines[missions]'")
    server = AutopilotServer(FakeAutopilot(), None, listen=[("127.0.0.1", 0)])
    running = asyncio.create_task(server.run())
    await server.ready.wait()
    command = [sys.executable, "-m", "flying_vines", "mission", "watch"]
    link = ["--link", f"tcp:127.0.0.1:{server.ports[0]}"]
    upload = [*command[:-1], "upload", str(VINE_MISSION), *link]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    sent = await asyncio.create_subprocess_exec(*upload, **pipes)  # type: ignore[arg-type]
    text, _ = await sent.communicate()
    assert sent.returncode == 0, text
    assert text.decode().splitlines() == [
        "Uploading 12 items to ArduPilot, system 1",
        "Uploaded and read back: ArduPilot stores the mission as expected.",
    ]
    process = await asyncio.create_subprocess_exec(*command, *link, **pipes)  # type: ignore[arg-type]
    assert process.stdout is not None
    first = await asyncio.wait_for(process.stdout.readline(), 20.0)
    assert first.startswith(b"Watching ArduPilot, system 1: 12 items."), first
    os.kill(process.pid, signal.SIGINT)
    rest, _ = await asyncio.wait_for(process.communicate(), 10.0)
    assert (process.returncode, rest) == (130, b"")
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
