"""`flying-vines link`: output and exit status."""

from __future__ import annotations

import asyncio
import io
import json
import os
import threading
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from command_line import run
from real_time import real_time
from rich.console import Console
from waiting import MAX_WAIT_S

from firmware_link.host import HostSession, Incompatible, Ready, SessionState
from firmware_link.monitor import SeenFrame
from firmware_link.protocol import (
    PROTOCOL_VERSION,
    Codec,
    Fault,
    GetSetting,
    Hello,
    Mode,
    Refusal,
    RefusalReason,
    Setpoint,
    Telemetry,
    Units,
    Welcome,
    fault_names,
)
from firmware_link.statistics import Traffic
from flying_vines.cli import link as link_command
from flying_vines.cli.link import LinkView, as_json, line, verdict
from flying_vines.config.address import SerialAddress
from flying_vines.config.config import default_text
from flying_vines.physics.plant.effects import Effects
from flying_vines.service import link_settings
from flying_vines.service.link_watch import LinkNote, LinkWatch
from flying_vines.simulation.phlosar.phlosar import PtyPhlosar, SimulatedPhlosar

pytestmark = real_time

TELEMETRY = Telemetry(1500, Mode.FAULT, Fault.DEAD_MAN, 7, 0.0, 1.25, 688.0, 0.5, 0.0, True)


@pytest.fixture
def board(tmp_path: Path) -> Iterator[str]:
    """A simulated phloSAR on a pseudo-terminal, in a thread. Yields its address."""
    link = tmp_path / "port"
    stop = threading.Event()

    async def live() -> None:
        with PtyPhlosar(SimulatedPhlosar(effects=Effects()), link) as port:
            living = asyncio.create_task(port.run())
            started.set()
            while not stop.is_set():
                await asyncio.sleep(0.02)
            living.cancel()
            await asyncio.wait([living])

    started = threading.Event()
    thread = threading.Thread(target=lambda: asyncio.run(live()))
    thread.start()
    started.wait(5.0)
    yield f"serial:{link}"
    stop.set()
    thread.join()


def test_in_a_pipe_it_is_a_line_a_frame(board: str, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = run(capsys, "link", board, "--seconds", "1")
    assert (status, err) == (0, "")
    assert "→ Hello" in out
    assert "← Welcome" in out
    assert out.count("← Telemetry") > 10
    assert "answers" in out
    assert "Vent" not in out
    assert " 0 corrupt" in out.splitlines()[-1]


def test_as_objects_with_the_bytes(board: str, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "link", board, "--seconds", "1", "--json", "--raw")
    assert status == 0
    *entries, last = map(json.loads, out.splitlines())
    frames = [entry for entry in entries if "told" not in entry]
    assert {frame["message"] for frame in frames if frame["to"] == "device"} == {"Hello", "Ping"}
    telemetry = next(frame for frame in frames if frame["message"] == "Telemetry")
    assert telemetry["mode"] == "VENT"
    assert bytes.fromhex(telemetry["wire"])
    came = sum(frame["to"] == "host" for frame in frames)
    assert last["statistics"]["good_frames"] == came
    assert last["statistics"]["round_trip_s"] < 1.0


def test_settings_are_shown_and_changed(board: str, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "link", board, "--set", "cv_limit_kPa=25", "--set", "dead_man_ms=200")
    assert status == 0
    status, out, _ = run(capsys, "link", board, "--settings", "--json")
    values = {entry["name"]: entry["value"] for entry in map(json.loads, out.splitlines())}
    assert (values["cv_limit_kPa"], values["dead_man_ms"]) == (25.0, 200.0)
    status, out, _ = run(capsys, "link", board, "--settings")
    assert out.split()[:5] == ["setting", "value", "least", "most", "standard"]
    status, _, err = run(capsys, "link", board, "--set", "dead_man_ms=900")
    assert (status, err) == (2, "flying-vines: dead_man_ms must be from 50 to 300, not 900\n")


async def test_a_board_that_is_unplugged_half_way_ends_the_exchange_of_settings(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(link_settings, "ANSWERS_WITHIN_S", 0.5)
    loop, codec = asyncio.get_running_loop(), Codec()
    board, port = os.openpty()
    tty.setraw(port)
    # A name of its own, as from udev, because a terminal's number is reused as soon as it is free.
    name = tmp_path / "phlosar"
    name.symlink_to(os.ttyname(port))
    address = SerialAddress(str(name))

    def receive() -> None:
        for message in codec.decode(os.read(board, 4096)):
            if isinstance(message, Hello):
                limits = (30.0, 28.0, 760.0, 200.0, 300, 100)
                welcome = Welcome(PROTOCOL_VERSION, message.nonce, 1, "x", Units.KPA_GAUGE, *limits)
                os.write(board, codec.encode(welcome))
            elif isinstance(message, GetSetting):
                loop.remove_reader(board)
                name.unlink()
                os.close(board)
                os.close(port)
                break

    loop.add_reader(board, receive)
    with pytest.raises(link_settings.SettingsError, match="is not there"):
        async with asyncio.timeout(MAX_WAIT_S):
            await link_command.settings(address, {}, objects=True)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("nonsense",), "is not a link"),
        (("usb:nonsense",), "is not a USB board"),
        (("serial:/nowhere", "--seconds", "0"), "--seconds"),
        (("serial:/nowhere", "--set", "x"), "NAME=VALUE"),
        (("serial:/nowhere", "--set", "x=y"), "NAME=VALUE"),
        (("--config", "nowhere.toml"), "no such file"),
    ],
)
def test_bad_input(arguments: tuple[str, ...], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = run(capsys, "link", *arguments)
    assert (status, out) == (2, "")
    assert says in err
    assert err.count("\n") == 1


def test_no_answer_is_status_1_with_a_reason(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "link", "usb:ffff:ffff", "--seconds", "0.2")
    assert status == 1
    assert "usb:ffff:ffff is not there" in out


def test_the_configuration_says_where(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config_file = tmp_path / "vine.toml"
    config_file.write_text(default_text().replace("serial:/dev/ttyACM0", "serial:/nowhere/at/all"))
    status, out, _ = run(capsys, "link", "--config", config_file, "--seconds", "0.2")
    assert status == 1
    assert "/nowhere/at/all is not there" in out


async def screen_of(address: str, over: Callable[[LinkWatch], bool]) -> tuple[str, LinkWatch]:
    watch = LinkWatch(SerialAddress(address))
    view = LinkView("test")
    async with asyncio.timeout(MAX_WAIT_S):
        await watch.run(view.take, lambda: over(watch))
    console = Console(file=io.StringIO(), width=120)
    console.print(view.render(watch))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue(), watch


async def test_the_screen_shows_the_state_at_a_glance(tmp_path: Path) -> None:
    phlosar = SimulatedPhlosar(effects=Effects())
    phlosar.firmware.reset(watchdog=True)
    with PtyPhlosar(phlosar, tmp_path / "port") as port:
        living = asyncio.create_task(port.run())
        screen, watch = await screen_of(port.path, lambda watch: watch.statistics.good_frames > 50)
        living.cancel()
        await asyncio.wait([living])
    assert watch.monitor.session.state is SessionState.READY
    for said in (
        "is open",
        "ready",
        "1.1 host",
        "setpoints to 28",
        "FAULT",
        "WATCHDOG_RESET",
        "kPa",
        "clean",
    ):
        assert said in screen
    assert screen.count("Telemetry ") == 1, "steady telemetry is in the rows, not in the list"


async def test_the_screen_without_a_board() -> None:
    screen, watch = await screen_of("/nowhere", lambda watch: "not there" in watch.port.text)
    assert "/nowhere is not there" in screen
    assert "no telemetry" in screen
    assert not watch.answered


async def test_a_firmware_that_is_flashed_while_the_port_is_open_ends_the_complaint() -> None:
    watch = LinkWatch(SerialAddress("/nowhere"))
    watch._state(True, "/nowhere is open")
    watch._take(Incompatible("The firmware speaks protocol version 1."))
    assert not watch.port.good
    watch._take(Ready(Welcome(PROTOCOL_VERSION, 1, 1, "new", 1, 30.0, 28.0, 760.0, 200.0, 300, 100)))
    assert watch.port.good
    assert watch.port.text == "/nowhere is open"


def test_lines_and_objects_of_what_is_rare() -> None:
    spoilt = SeenFrame(1.0, False, b"\x05abc", None, "no frame")
    assert str(line(spoilt)) == "    1.000 ← 4 bytes: no frame  [05 61 62 63]"
    assert as_json(spoilt)["wire"] == "05616263"
    assert "DEAD_MAN" in str(line(SeenFrame(1.0, False, b"", TELEMETRY)))
    assert as_json(SeenFrame(1.0, False, b"", TELEMETRY))["faults"] == 1
    refused = SeenFrame(2.0, False, b"", Refusal(3, RefusalReason.FAULT_LATCHED))
    assert str(line(refused)) == "    2.000 ← Refusal    number 3, reason FAULT_LATCHED"
    nan = SeenFrame(2.0, True, b"", Setpoint(float("nan"), 1.0, 1, 1))
    assert as_json(nan)["target_kPa"] is None
    assert as_json(LinkNote(0.5, "gone", False)) == {"t": 0.5, "told": "gone"}


def test_faults_of_a_later_firmware_are_reported_by_number() -> None:
    assert fault_names(Fault.DEAD_MAN | Fault(1 << 14)) == "DEAD_MAN, 0x4000"


def test_the_verdict_counts_from_the_first_answer() -> None:
    began = Traffic().statistics(0.0, Codec(), HostSession(), 0)._replace(bad_frames=1)

    def counted(good: int, bad: int, lost: int) -> str:
        return str(verdict(began._replace(good_frames=good, bad_frames=bad, lost_frames=lost), began))

    assert str(verdict(began, None)).startswith("not known")
    assert counted(100, 1, 0) == "clean: 100 frames, all good"
    assert counted(98, 3, 2) == "not clean: 2 corrupt, 2 lost; 2.00% of all frames"
