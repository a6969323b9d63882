"""The service with any of its parts, a script that flips the switch, and viewers."""

from __future__ import annotations

import asyncio
import contextlib
import multiprocessing
import os
import re
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO

import msgspec
from aiohttp import ClientSession, ClientTimeout
from latency import configuration_text, ended, environment
from ports import free_port
from process_cost import cpu_s, only_child, pss_MB
from serial_board import SerialBoard
from switch_flips import Flight, Flipper, NotMeasured

from flying_vines.gateway import page_token
from flying_vines.vehicle.mavlink.signing import KEY_SIZE, Signing

STARTS_WITHIN_S = 20.0
VEHICLE = "benchmark"
ASKED_OVER_MQTT = "clear_faults"
"""A command that the configuration allows and that does not move the vine."""


@dataclass(frozen=True)
class Switched:
    """The parts that are on, besides flight and recorder."""

    page: bool = False
    host: str = "127.0.0.1"
    viewers: int = 0
    broker_port: int = 0
    """0: no MQTT."""
    signing: bool = False
    watch: bool = False


@dataclass(frozen=True)
class Looked:
    """Mean number of snapshots that a viewer received in a second, and the longest time without a
    snapshot."""

    snapshots_per_s: float
    longest_gap_s: float


@dataclass(frozen=True)
class Flown:
    """One flight, and its cost under load. Shares are of one core; memory is the proportional set size."""

    flight: Flight
    service_share: float
    gateway_share: float
    service_MB: float
    gateway_MB: float
    looked: Looked | None


class Whole:
    """A running service, its flight, and its viewers."""

    def __init__(
        self,
        folder: Path,
        process: subprocess.Popen[bytes],
        switched: Switched,
        port: int,
        board: SerialBoard,
    ) -> None:
        self.port = port
        """The page's port; 0 without a page."""
        self.pid = process.pid
        self.viewers: Viewers | None = None
        self.board = board
        self._process = process
        self._folder = folder
        self._switched = switched

    def fly(self, flipper: Flipper, loaded: Callable[[], None] = lambda: None) -> Flown:
        """Fly once. `loaded` is called when the loaded time begins."""
        used_s = (0.0, 0.0)

        def begin() -> None:
            nonlocal used_s
            used_s = self._cpu_s()
            if self.viewers:
                self.viewers.begin()
            loaded()

        try:
            flight = flipper.fly(lambda: self._process.poll() is None, begin)
        except NotMeasured as problem:
            raise NotMeasured(f"{problem}; the service's output ends:\n{self.output[-2000:]}") from None
        service, gateway = (
            (now - then) / flight.loaded_s for then, now in zip(used_s, self._cpu_s(), strict=True)
        )
        looked = self.viewers.end() if self.viewers else None
        gateway_MB = pss_MB(self.gateway) if self._has_gateway else 0.0
        return Flown(flight, service, gateway, pss_MB(self.pid), gateway_MB, looked)

    @property
    def gateway(self) -> int:
        """Id of the gateway's process."""
        return only_child(self.pid)

    @property
    def output(self) -> str:
        return (self._folder / "output").read_text(encoding="utf-8").strip()

    @property
    def token_file(self) -> Path:
        return self._folder / "vine.page-token"

    @property
    def token(self) -> str:
        """The token of the page; empty if it needs none."""
        return "" if self._switched.host == "127.0.0.1" else page_token.read(self.token_file)

    @property
    def _has_gateway(self) -> bool:
        return self._switched.page or bool(self._switched.broker_port)

    def _cpu_s(self) -> tuple[float, float]:
        return cpu_s(self.pid), cpu_s(self.gateway) if self._has_gateway else 0.0


@contextlib.contextmanager
def running(
    switched: Switched, flips: int, seed: int, cores: set[int] | None = None
) -> Iterator[tuple[Whole, Flipper]]:
    """Start a service, only on these cores if they are given, and prepare its flight."""
    udp_port, port = free_port(), free_port() if switched.page else 0
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="whole-service-")))
        board = stack.enter_context(SerialBoard(time.monotonic()))
        signing = None
        if switched.signing:
            signing = Signing(os.urandom(KEY_SIZE))
            signing.advance(time.time())
            _write_private(folder / "key", signing.key.hex())
        config_file = folder / "vine.toml"
        config_file.write_text(_configuration(switched, udp_port, board.path, port, folder), encoding="utf-8")
        output = stack.enter_context((folder / "output").open("wb"))
        process = _flying_vines(
            *("run", "--config", str(config_file), "--plain", "--out", str(folder / "flights")),
            output=output,
            cores=cores,
        )
        stack.enter_context(ended(process))
        whole = Whole(folder, process, switched, port, board)
        if switched.page:
            _until_it_listens(whole)
        if switched.viewers:
            whole.viewers = stack.enter_context(_looking_on(port, whole.token, switched.viewers))
        if switched.watch:
            token = ("--token-file", str(whole.token_file)) if whole.token else ()
            watch = _flying_vines("watch", "--url", f"http://127.0.0.1:{port}", *token, "--plain")
            stack.enter_context(ended(watch))
        yield whole, Flipper(udp_port, board, flips, seed, signing)


def _flying_vines(
    *arguments: str, output: int | IO[bytes] = subprocess.DEVNULL, cores: set[int] | None = None
) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", "flying_vines", *arguments],
        env=environment(),
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=subprocess.STDOUT,
        preexec_fn=partial(os.sched_setaffinity, 0, cores) if cores else None,
    )


def _configuration(switched: Switched, udp_port: int, tty: str, port: int, folder: Path) -> str:
    text = configuration_text(udp_port, tty)
    text = _set(text, "page", "port", str(port))
    text = _set(text, "page", "host", f'"{switched.host}"')
    if switched.broker_port:
        text = _set(text, "mqtt", "broker", f'"mqtt://127.0.0.1:{switched.broker_port}"')
        text = _set(text, "mqtt", "name", f'"{VEHICLE}"')
        text = _set(text, "mqtt", "commands", f'["{ASKED_OVER_MQTT}"]')
        text = _set(text, "mqtt", "discovery_prefix", '"homeassistant"')
    if switched.signing:
        text = _set(text, "vehicle", "signing_key", f'"{folder / "key"}"')
    return text


def _set(text: str, table: str, key: str, value: str) -> str:
    before, heading, after = text.partition(f"\n[{table}]")
    after, found = re.subn(rf"^{key} = [^#\n]*", f"{key} = {value} ", after, count=1, flags=re.MULTILINE)
    if not (heading and found):
        raise NotMeasured(f"the built-in configuration has no {key} in [{table}]")
    return before + heading + after


def _write_private(path: Path, text: str) -> None:
    path.touch(mode=0o600)
    path.write_text(text, encoding="ascii")


def _until_it_listens(whole: Whole) -> None:
    deadline = time.monotonic() + STARTS_WITHIN_S
    while time.monotonic() < deadline:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", whole.port)) == 0:
                return
        time.sleep(0.02)
    raise NotMeasured(f"no page within {STARTS_WITHIN_S:g} s; the service's output:\n{whole.output[-2000:]}")


class Viewers:
    """Viewers of the page, in a process of their own."""

    def __init__(self, lead: Connection) -> None:
        self._lead = lead

    def begin(self) -> None:
        """Start counting."""
        self._lead.send("begin")

    def end(self) -> Looked:
        self._lead.send("end")
        looked: Looked = self._lead.recv()
        return looked


@contextlib.contextmanager
def _looking_on(port: int, token: str, viewers: int) -> Iterator[Viewers]:
    ours, theirs = multiprocessing.Pipe()
    process = multiprocessing.Process(target=_look_on, args=(port, token, viewers, theirs), daemon=True)
    process.start()
    try:
        ours.recv()
        yield Viewers(ours)
    finally:
        process.terminate()
        process.join()


def _look_on(port: int, token: str, viewers: int, lead: Connection) -> None:
    asyncio.run(_look_on_all([_Viewer() for _ in range(viewers)], port, token, lead))


async def _look_on_all(viewers: list[_Viewer], port: int, token: str, lead: Connection) -> None:
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    async with (
        ClientSession(headers=headers, timeout=ClientTimeout(connect=STARTS_WITHIN_S)) as session,
        asyncio.TaskGroup() as tasks,
    ):
        for viewer in viewers:
            tasks.create_task(viewer.view(session, port))
        for viewer in viewers:
            await viewer.sees.wait()
        lead.send("looking on")
        while True:
            await asyncio.to_thread(lead.recv)
            began = time.monotonic()
            for viewer in viewers:
                viewer.came = [began]
            await asyncio.to_thread(lead.recv)
            ended = time.monotonic()
            gaps = [later - at for viewer in viewers for at, later in pairwise([*viewer.came, ended])]
            each = statistics.mean(len(viewer.came) - 1 for viewer in viewers)
            lead.send(Looked(each / (ended - began), max(gaps)))


class _Viewer:
    """Receives everything; `came` has the time of each snapshot."""

    def __init__(self) -> None:
        self.sees = asyncio.Event()
        self.came: list[float] = []

    async def view(self, session: ClientSession, port: int) -> None:
        async with session.ws_connect(f"http://127.0.0.1:{port}/live") as viewing:
            async for message in viewing:
                if msgspec.json.decode(message.data)["kind"] == "snapshot":
                    self.came.append(time.monotonic())
                    self.sees.set()
        raise NotMeasured("an authorised viewer was disconnected")


def mosquitto() -> str:
    """Path of mosquitto. Debian installs it where only root searches."""
    path = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
    if path is None:
        raise NotMeasured("needs mosquitto: sudo apt install mosquitto")
    return path
