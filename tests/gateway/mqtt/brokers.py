"""Brokers for tests as processes: mosquitto, and amqtt from PyPI."""

from __future__ import annotations

import asyncio
import contextlib
import re
import shlex
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import aiomqtt
import msgspec
import pytest
from ports import free_port
from required_programs import need
from waiting import MAX_WAIT_S, until

MOSQUITTO_HOW = "sudo apt install mosquitto"
AMQTT = """\
import asyncio, logging, sys
from amqtt.broker import Broker
logging.disable()
async def serve():
    listeners = {"default": {"type": "tcp", "bind": f"127.0.0.1:{sys.argv[1]}"}}
    plugins = {"amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True}}
    broker = Broker({"listeners": listeners, "plugins": plugins})
    await broker.start()
    await asyncio.Event().wait()
asyncio.run(serve())
"""


def mosquitto() -> str | None:
    """Path of mosquitto. Debian installs it where only root searches."""
    return shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin")


class Broker:
    """A broker that can be killed and started again on the same port."""

    def __init__(self, folder: Path, settings: str = "allow_anonymous true", kind: str = "mosquitto") -> None:
        self.port = free_port()
        self.folder = folder
        self._settings = settings
        self._kind = kind
        self.process: subprocess.Popen[bytes] | None = None

    @property
    def url(self) -> str:
        return f"mqtt://127.0.0.1:{self.port}"

    async def start(self) -> None:
        self._begin()
        await until(self._listens, "the broker listens")

    def _begin(self) -> None:
        self.process = subprocess.Popen(self._command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def kill(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None

    @property
    def _command(self) -> list[str]:
        if self._kind == "amqtt":
            return [sys.executable, "-c", AMQTT, str(self.port)]
        path = mosquitto()
        if path is None:
            pytest.skip(f"needs mosquitto: {MOSQUITTO_HOW}")
        # Started by root, mosquitto would change to another user, who cannot read the tests' folders.
        file = self.folder / f"mosquitto-{self.port}.conf"
        file.write_text(f"user root\nlistener {self.port} 127.0.0.1\n{self._settings}\n")
        return [path, "-c", str(file)]

    def _listens(self) -> bool:
        assert self.process is not None
        assert self.process.poll() is None, "the broker runs"
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0


@contextlib.asynccontextmanager
async def running(broker: Broker) -> AsyncIterator[Broker]:
    await broker.start()
    try:
        yield broker
    finally:
        broker.kill()


class Line:
    """A line between a vehicle and a broker; while it is cut, nobody answers."""

    def __init__(self, broker: Broker) -> None:
        self._broker = broker
        self._open: set[asyncio.StreamWriter] = set()
        self.is_cut = False
        self.port = 0

    @property
    def url(self) -> str:
        return f"mqtt://127.0.0.1:{self.port}"

    @contextlib.asynccontextmanager
    async def laid(self) -> AsyncIterator[Line]:
        server = await asyncio.start_server(self._forward, "127.0.0.1", 0)
        self.port = server.sockets[0].getsockname()[1]
        try:
            yield self
        finally:
            server.close()
            self.cut()

    def cut(self) -> None:
        self.is_cut = True
        for writer in self._open:
            writer.transport.abort()

    def mend(self) -> None:
        self.is_cut = False

    async def _forward(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self.is_cut:
            writer.transport.abort()
            return
        far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._broker.port)
        ends = {writer, far_writer}
        self._open |= ends

        async def pass_on(source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
            with contextlib.suppress(OSError):
                while data := await source.read(65536):
                    sink.write(data)
                    await sink.drain()
            for end in ends:
                end.close()

        await asyncio.gather(pass_on(reader, far_writer), pass_on(far_reader, writer))
        self._open -= ends


class Onlooker:
    """Another client on the broker, with its received messages by topic."""

    def __init__(self, client: aiomqtt.Client) -> None:
        self.client = client
        self.received: list[aiomqtt.Message] = []

    def on(self, topic: str) -> list[dict[str, Any]]:
        return [read(message) for message in self.received if str(message.topic) == topic]

    async def until(self, topic: str, count: int = 1, **fields: Any) -> dict[str, Any]:
        """The latest message on a topic, after at least `count` with these fields."""
        deadline = time.monotonic() + MAX_WAIT_S
        while True:
            fit = [told for told in self.on(topic) if all(told.get(key) == fields[key] for key in fields)]
            if len(fit) >= count:
                return fit[-1]
            assert time.monotonic() < deadline, f"{fields} is not in {self.on(topic)[-5:]}"
            await asyncio.sleep(0.01)

    async def say(self, topic: str, payload: dict[str, Any] | bytes, **how: Any) -> None:
        text = payload if isinstance(payload, bytes) else msgspec.json.encode(payload)
        await self.client.publish(topic, text, **how)


def read(message: aiomqtt.Message) -> dict[str, Any]:
    assert isinstance(message.payload, bytes)
    told: dict[str, Any] = msgspec.json.decode(message.payload) if message.payload else {}
    return told


@contextlib.asynccontextmanager
async def onlooker(broker: Broker, host: str = "127.0.0.1", **client: Any) -> AsyncIterator[Onlooker]:
    async with aiomqtt.Client(host, broker.port, **client) as connected:
        await connected.subscribe("#", qos=1)
        person = Onlooker(connected)

        async def listen() -> None:
            async for message in connected.messages:
                person.received.append(message)

        listening = asyncio.create_task(listen())
        try:
            yield person
        finally:
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)


def run_quietly(*command: str, folder: Path | None = None) -> None:
    subprocess.run(command, cwd=folder, check=True, capture_output=True)


def commands_of_the_page() -> list[list[str]]:
    """docs/mqtt.md's commands for an authority, and for the broker's certificate."""
    page = (Path(__file__).parents[3] / "docs" / "mqtt.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```sh\n(openssl .*?)^```$", page, re.MULTILINE | re.DOTALL)
    return [
        shlex.split(line) for line in block.replace("\\\n", "").splitlines() if line.startswith("openssl")
    ]


def make_certificates(folder: Path) -> None:
    """`server`, for the name localhost, and `heron` are signed by `ca`. `another` is an authority that signed
    nothing. `lax` is an authority as many guides make it, and has signed `of_lax`."""
    need("openssl", "sudo apt install openssl")

    def run(command: list[str], **instead: str) -> None:
        for old, new in instead.items():
            command = [word.replace(old.replace("_", "."), new) for word in command]
        run_quietly(*command, folder=folder)

    authority, certificate = commands_of_the_page()
    lax = [word for word in authority if word != "-addext" and not word.startswith("keyUsage")]
    run(authority)
    run(authority, ca_key="another.key", ca_pem="another.pem")
    run(lax, ca_key="lax.key", ca_pem="lax.pem")
    run(certificate, broker_example="localhost")
    run(certificate, broker_example="heron", server_key="heron.key", server_pem="heron.pem")
    run(
        certificate,
        broker_example="localhost",
        ca_key="lax.key",
        ca_pem="lax.pem",
        server_key="of_lax.key",
        server_pem="of_lax.pem",
    )
