"""The service's messages to systemd, over real datagram sockets."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from ports import free_port
from real_time import real_time
from service_bench import between
from waiting import until

from flying_vines.config import config
from flying_vines.core.core import Core
from flying_vines.core.events import LinkChanged, Stop, Tick
from flying_vines.service.service import Service
from flying_vines.service.systemd import PER_WATCHDOG, ServiceManager, service_manager, status_line

pytestmark = real_time

WATCHDOG_S = 0.4


class Listener:
    """Systemd's end: a socket with a name, as a file or abstract."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind("\0" + address[1:] if address.startswith("@") else address)
        self.socket.settimeout(10.0)

    def received(self) -> list[str]:
        """All received messages."""
        found = []
        self.socket.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                found.append(self.socket.recv(4096).decode())
        return found

    def manager(self, watchdog_s: float = WATCHDOG_S) -> ServiceManager:
        """Our manager, with this environment."""
        environment = {"NOTIFY_SOCKET": self.address, "WATCHDOG_USEC": f"{watchdog_s * 1e6:.0f}"}
        (manager,) = service_manager(environment)
        assert isinstance(manager, ServiceManager)
        assert not environment, "what we start must not tell in our place"
        return manager


@pytest.fixture(params=["a file", "no file"])
def listener(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Listener]:
    name = str(tmp_path / "notify") if request.param == "a file" else f"@flying-vines-{os.getpid()}"
    listener = Listener(name)
    with listener.socket:
        yield listener


def test_a_service_started_by_hand_notifies_nobody() -> None:
    assert service_manager({"HOME": "/"}) == ()


def test_ready_once_and_alive_four_times_in_the_watchdogs_time(listener: Listener) -> None:
    manager = listener.manager(watchdog_s=0.5)
    said = []
    for tick in range(65):
        manager.event(Tick(50.0 + tick / 32))
        said += listener.received()
    assert said == ["READY=1"] + ["WATCHDOG=1"] * int(2.0 / 0.5 * PER_WATCHDOG)


def test_only_a_tick_shows_that_the_loop_runs(listener: Listener) -> None:
    manager = listener.manager()
    for second in range(20):
        manager.event(LinkChanged(float(second), "vehicle", up=True))
    assert listener.received() == []


@pytest.mark.parametrize(
    "of_another", [{}, {"WATCHDOG_USEC": "400000", "WATCHDOG_PID": "1"}, {"WATCHDOG_USEC": "x"}]
)
def test_without_a_watchdog_of_ours_it_notifies_ready_and_no_more(
    listener: Listener, of_another: dict[str, str]
) -> None:
    (manager,) = service_manager({"NOTIFY_SOCKET": listener.address, **of_another})
    for second in range(1000):
        manager.event(Tick(float(second)))
    assert listener.received() == ["READY=1"]


def test_a_status_that_was_not_accepted_is_sent_again(listener: Listener) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as crowd:
        crowd.connect("\0" + listener.address[1:] if listener.address[0] == "@" else listener.address)
        with pytest.raises(BlockingIOError):
            while True:
                crowd.send(b"noise")
    manager = listener.manager()
    manager.event(Tick(0.0))
    assert set(listener.received()) == {"noise"}
    manager.event(Tick(0.02))
    assert listener.received() == ["READY=1"]


def test_a_manager_that_is_gone_stops_nothing(tmp_path: Path) -> None:
    listener = Listener(str(tmp_path / "notify"))
    manager = listener.manager()
    listener.socket.close()
    manager.event(Tick(0.0))
    manager.event(Stop(1.0))


def test_the_status_is_reported_when_it_changes_and_not_more_than_once_a_second(listener: Listener) -> None:
    manager = listener.manager()
    snapshot = Core(config.default()).snapshot(0.0)
    for tenth in range(50):
        manager.snapshot(replace(snapshot, t=tenth / 10, reservoir_kPa=690.0 - (tenth if tenth < 25 else 25)))
    assert [status.split("; ")[3] for status in listener.received()] == [
        "reservoir 690 kPa",
        "reservoir 680 kPa",
        "reservoir 670 kPa",
        "reservoir 665 kPa",
    ]


def test_nobody_adds_a_line_to_the_status() -> None:
    snapshot = replace(Core(config.default()).snapshot(0.0), firmware="odd\nWATCHDOG=trigger", armed=True)
    assert "\n" not in status_line(snapshot)
    assert "odd WATCHDOG=trigger" in status_line(snapshot)


async def test_a_loop_that_hangs_does_not_notify_the_watchdog(tmp_path: Path) -> None:
    listener = Listener(str(tmp_path / "notify"))
    received_at: list[float] = []

    def listen() -> None:
        while listener.socket.recv(4096) != b"STOPPING=1":
            received_at.append(time.monotonic())

    # Another thread, which receives while the loop hangs.
    ear = threading.Thread(target=listen)
    ear.start()
    conf = config.parse(between(free_port(), str(tmp_path / "none")), "test")
    service = Service(conf, (listener.manager(),))
    serving = asyncio.create_task(service.run())
    await until(lambda: len(received_at) > 3, "it is alive")
    hangs_at = time.monotonic()
    time.sleep(2 * WATCHDOG_S)  # noqa: ASYNC251
    goes_on_at = time.monotonic()
    await until(lambda: received_at[-1] > goes_on_at, "it is alive again")
    service.stop()
    await serving
    ear.join()
    listener.socket.close()
    assert not [t for t in received_at if hangs_at + 0.05 < t < goes_on_at]


def test_the_command_notifies_ready_watchdog_and_stopping(tmp_path: Path) -> None:
    listener = Listener(str(tmp_path / "notify"))
    config_file = tmp_path / "vine.toml"
    config_file.write_text(between(free_port(), str(tmp_path / "none")), encoding="utf-8")
    command = (
        sys.executable,
        "-m",
        "flying_vines",
        "run",
        "--config",
        str(config_file),
        "--out",
        str(tmp_path),
    )
    environment = os.environ | {"NOTIFY_SOCKET": listener.address, "WATCHDOG_USEC": "400000"}
    with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL) as service:
        said: list[str] = []
        while said.count("WATCHDOG=1") < 3:
            said.append(listener.socket.recv(4096).decode())
        service.send_signal(signal.SIGTERM)
        while said[-1] != "STOPPING=1":
            said.append(listener.socket.recv(4096).decode())
    listener.socket.close()
    assert service.returncode == 0
    assert said[0] == "READY=1"
    assert any(line.startswith("STATUS=vehicle not found") for line in said)
