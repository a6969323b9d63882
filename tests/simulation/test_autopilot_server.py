"""The simulated autopilot on real sockets, UDP and TCP."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, cast

import command_line
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from real_time import real_time
from waiting import MAX_WAIT_S

from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.autopilot_server import MAX_CLIENTS, AutopilotServer

pytestmark = real_time


class Listener(asyncio.DatagramProtocol):
    """A companion that answers to the sender of the frames."""

    def __init__(self, system: int, component: int) -> None:
        self.messages: list[Any] = []
        self.arrived = asyncio.Event()
        self.port = 0
        self._mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self._ears = mavlink.MAVLink(None)
        self._peer: tuple[str, int] | None = None
        self.transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        # Before Python 3.12 the class of the transport does not show this.
        self.transport = cast("asyncio.DatagramTransport", transport)
        self.port = transport.get_extra_info("sockname")[1]

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self._peer = addr
        self.messages += self._ears.parse_buffer(data) or []
        self.arrived.set()

    def say(self, message: Any) -> None:
        assert self.transport is not None and self._peer is not None
        self.transport.sendto(message.pack(self._mav), self._peer)

    async def receive(self, name: str, count: int = 1) -> list[Any]:
        async with asyncio.timeout(MAX_WAIT_S):
            while len(found := [m for m in self.messages if m.get_type() == name]) < count:
                self.arrived.clear()
                await self.arrived.wait()
        return found


@contextlib.asynccontextmanager
async def listening(system: int, component: int) -> AsyncIterator[Listener]:
    loop = asyncio.get_running_loop()
    transport, listener = await loop.create_datagram_endpoint(
        lambda: Listener(system, component), local_addr=("127.0.0.1", 0)
    )
    try:
        yield listener
    finally:
        transport.close()
        await asyncio.sleep(0)


@contextlib.asynccontextmanager
async def serving(server: AutopilotServer) -> AsyncIterator[asyncio.Task[None]]:
    task = asyncio.create_task(server.run())
    try:
        yield task
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task
        await asyncio.sleep(0)


async def test_a_companion_asks_for_a_stream_and_gets_it() -> None:
    async with listening(1, 191) as companion:
        server = AutopilotServer(FakeAutopilot(), f"udpout:127.0.0.1:{companion.port}")
        async with serving(server):
            await companion.receive("HEARTBEAT")
            companion.say(mavlink.MAVLink_command_long_message(1, 1, 511, 0, 65, 2e4, 0, 0, 0, 0, 0))
            acknowledged = await companion.receive("COMMAND_ACK")
            channels = await companion.receive("RC_CHANNELS", 10)
    assert acknowledged[0].result == 0
    assert channels[9].time_boot_ms - channels[0].time_boot_ms == pytest.approx(180, abs=2)
    assert server.frames_unsent == 0


async def test_a_ground_station_gets_the_messages_of_the_companion() -> None:
    async with listening(1, 191) as companion, listening(255, 190) as gcs:
        server = AutopilotServer(FakeAutopilot(), ("127.0.0.1", companion.port), ("127.0.0.1", gcs.port))
        async with serving(server):
            await companion.receive("HEARTBEAT")
            await gcs.receive("HEARTBEAT")
            gcs.say(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
            companion.say(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
            await asyncio.sleep(0.05)
            companion.say(mavlink.MAVLink_named_value_float_message(1, b"VINE_BEND", 40.0))
            value = (await gcs.receive("NAMED_VALUE_FLOAT"))[0]
    assert (value.get_srcComponent(), value.value) == (191, 40.0)


async def test_a_script_moves_the_sticks_in_time() -> None:
    autopilot = FakeAutopilot()
    async with listening(1, 191) as companion:
        server = AutopilotServer(
            autopilot,
            ("127.0.0.1", companion.port),
            script=[(0.3, lambda fake: fake.set_rc(9, 1000)), (0.1, lambda fake: fake.set_rc(9, 2000))],
        )
        async with serving(server):
            await companion.receive("HEARTBEAT")
            companion.say(mavlink.MAVLink_command_long_message(1, 1, 511, 0, 65, 2e4, 0, 0, 0, 0, 0))
            channels = await companion.receive("RC_CHANNELS", 22)
    high = [message.time_boot_ms for message in channels if message.chan9_raw == 2000]
    assert channels[0].chan9_raw == channels[-1].chan9_raw == 1000
    assert high[-1] - high[0] == pytest.approx(200, abs=30)


async def test_an_error_in_a_stimulus_ends_the_run() -> None:
    async with listening(1, 191) as companion:
        server = AutopilotServer(
            FakeAutopilot(), ("127.0.0.1", companion.port), script=[(0.0, lambda fake: fake.set_mode("NONE"))]
        )
        with pytest.raises(ValueError, match="NONE"):
            await asyncio.wait_for(server.run(), 2.0)
        await asyncio.sleep(0)


async def test_no_listener_is_needed() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    async with serving(AutopilotServer(FakeAutopilot(), ("127.0.0.1", port))) as task:
        await asyncio.sleep(0.1)
        assert not task.done()


@pytest.mark.parametrize("address", ["127.0.0.1:14540", "udpin:127.0.0.1:14540", "udpout:host:0", ""])
def test_other_addresses_are_refused(address: str) -> None:
    with pytest.raises(ValueError):
        AutopilotServer(FakeAutopilot(), address)


# TCP


class Client:
    """A ground station on TCP."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, system: int = 255) -> None:
        self._reader = reader
        self.writer = writer
        self._mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=190)
        self._ears = mavlink.MAVLink(None)

    def say(self, message: Any) -> None:
        self.writer.write(message.pack(self._mav))

    async def receive(self, name: str) -> Any:
        async with asyncio.timeout(MAX_WAIT_S):
            while True:
                data = await self._reader.read(4096)
                assert data, "the connection stands"
                for message in self._ears.parse_buffer(data) or []:
                    if message.get_type() == name:
                        return message

    async def close(self) -> None:
        self.writer.close()
        await self.writer.wait_closed()


@contextlib.asynccontextmanager
async def on_tcp(autopilot: FakeAutopilot, speed: float = 1.0) -> AsyncIterator[AutopilotServer]:
    server = AutopilotServer(autopilot, None, listen=[("127.0.0.1", 0)], speed=speed)
    async with serving(server):
        await asyncio.wait_for(server.ready.wait(), 5.0)
        yield server


async def connect(server: AutopilotServer, system: int = 255) -> Client:
    return Client(*await asyncio.open_connection("127.0.0.1", server.ports[0]), system)


async def test_tcp_clients_have_a_port_each_and_leave_it_to_the_next() -> None:
    autopilot = FakeAutopilot()
    async with on_tcp(autopilot) as server:
        one, other = await connect(server), await connect(server, 254)
        for client in (one, other):
            await client.receive("HEARTBEAT")
            client.say(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        await asyncio.sleep(0.05)
        one.say(mavlink.MAVLink_statustext_message(6, b"from the one"))
        assert (await other.receive("STATUSTEXT")).text == "from the one"
        await one.close()
        third = await connect(server)
        await third.receive("HEARTBEAT")
        assert sorted(name for name in autopilot._links.ports if name.startswith("tcp")) == ["tcp1", "tcp2"]
        for client in (other, third):
            await client.close()


async def test_one_client_too_many_is_sent_away() -> None:
    async with on_tcp(FakeAutopilot()) as server:
        clients = [await connect(server) for _ in range(MAX_CLIENTS)]
        await clients[-1].receive("HEARTBEAT")
        last = await asyncio.open_connection("127.0.0.1", server.ports[0])
        assert await asyncio.wait_for(last[0].read(), 5.0) == b""
        last[1].close()
        for client in clients:
            await client.close()


async def test_time_can_run_fast() -> None:
    async with on_tcp(FakeAutopilot(), speed=20.0) as server:
        client = await connect(server)
        await client.receive("HEARTBEAT")
        client.say(mavlink.MAVLink_command_long_message(1, 1, 511, 0, 2, 1e6, 0, 0, 0, 0, 0))
        first = await client.receive("SYSTEM_TIME")
        begun = asyncio.get_running_loop().time()
        while (await client.receive("SYSTEM_TIME")).time_boot_ms < first.time_boot_ms + 10_000:
            pass
        assert asyncio.get_running_loop().time() - begun < 3.0
        await client.close()


async def test_a_port_that_is_taken_ends_the_run() -> None:
    async with on_tcp(FakeAutopilot()) as server:
        taken = ("127.0.0.1", server.ports[0])
        second = AutopilotServer(FakeAutopilot(), None, listen=[("127.0.0.1", 0), taken])
        with pytest.raises(OSError) as error:
            await asyncio.wait_for(second.run(), 5.0)
        assert (error.value.strerror or "").startswith(f"127.0.0.1:{taken[1]}: ")


def test_an_address_that_cannot_be_used_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def unknown(*_: object, **__: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr("socket.getaddrinfo", unknown)
    with Path(os.devnull).open() as nothing_typed:
        monkeypatch.setattr("sys.stdin", nothing_typed)
        status, _, err = command_line.run(capsys, "fake", "autopilot", "--to", "companion:14540")
    assert (status, err) == (2, "flying-vines: companion:14540: Name or service not known\n")
