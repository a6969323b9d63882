"""Links over real sockets and a pseudo-terminal carry both directions and reconnect by themselves."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import socket
import time
import tracemalloc
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ports import free_port
from pseudo_terminal import Terminal
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from examples import examples
from firmware_link import reconnect, serial_port
from flying_vines.config.address import Address, NetworkAddress, SerialAddress, parse_address
from flying_vines.vehicle.mavlink import link as link_module
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage
from flying_vines.vehicle.mavlink.frames import Frames
from flying_vines.vehicle.mavlink.link import (
    MAX_FIRST_DATAGRAM_BYTES,
    MAX_PEERS,
    MAX_QUEUED_BYTES,
    MAX_READ_BYTES,
    PEER_FORGOTTEN_S,
    Link,
    Peers,
    UdpLink,
    open_link,
)
from flying_vines.vehicle.mavlink.signing import Signing

HOST = "127.0.0.1"
TIMEOUT_S = 5.0


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reconnect.Reconnect, "wait_s", lambda *_: 0.02)
    monkeypatch.setattr(reconnect, "CHECK_S", 0.02)


@pytest.fixture
def soon_quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link_module, "POLICY", replace(link_module.POLICY, quiet_s=0.2))


class Watched:
    """A running link and its events, with a function that waits for a condition."""

    def __init__(self, address: Address) -> None:
        self.data = b""
        self.states: list[tuple[bool, str]] = []
        self._changed = asyncio.Event()
        self.link: Link = open_link(address, self._on_bytes, self._on_state)

    def _on_bytes(self, data: bytes) -> None:
        self.data += data
        self._changed.set()

    def _on_state(self, up: bool, why: str) -> None:
        self.states.append((up, why))
        self._changed.set()

    @property
    def up(self) -> bool:
        return bool(self.states) and self.states[-1][0]

    async def until(self, satisfied: Callable[[], bool]) -> None:
        async with asyncio.timeout(TIMEOUT_S):
            while not satisfied():
                self._changed.clear()
                await self._changed.wait()


@contextlib.asynccontextmanager
async def running(address: Address) -> AsyncIterator[Watched]:
    watched = Watched(address)
    task = asyncio.create_task(watched.link.run())
    try:
        yield watched
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


class Peer(asyncio.DatagramProtocol):
    """The other side of a UDP link."""

    def __init__(self) -> None:
        self.received: asyncio.Queue[tuple[bytes, tuple[str, int]]] = asyncio.Queue()

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self.received.put_nowait((data, addr))

    async def next(self) -> tuple[bytes, tuple[str, int]]:
        async with asyncio.timeout(TIMEOUT_S):
            return await self.received.get()


@contextlib.asynccontextmanager
async def udp_peer(
    to: tuple[str, int] | None = None,
) -> AsyncIterator[tuple[Peer, asyncio.DatagramTransport, int]]:
    loop = asyncio.get_running_loop()
    local = None if to else (HOST, 0)
    transport, peer = await loop.create_datagram_endpoint(Peer, local_addr=local, remote_addr=to)
    try:
        yield peer, transport, transport.get_extra_info("sockname")[1]
    finally:
        transport.close()


class Server:
    """A TCP server that can be shut down with its connections, and opened again on the same port."""

    def __init__(self) -> None:
        self.port = 0
        self.readers: asyncio.Queue[asyncio.StreamReader] = asyncio.Queue()
        self.writers: list[asyncio.StreamWriter] = []
        self._server: asyncio.Server | None = None

    async def open(self) -> None:
        self._server = await asyncio.start_server(self._accept, HOST, self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.writers.append(writer)
        self.readers.put_nowait(reader)

    async def connection(self) -> asyncio.StreamReader:
        async with asyncio.timeout(TIMEOUT_S):
            return await self.readers.get()

    async def close(self) -> None:
        if self._server is not None:
            self._server.close()
        for writer in self.writers:
            writer.transport.abort()
        self.writers.clear()


@contextlib.asynccontextmanager
async def tcp_server() -> AsyncIterator[Server]:
    server = Server()
    await server.open()
    try:
        yield server
    finally:
        await server.close()


async def test_udp_that_listens_answers_the_senders() -> None:
    port = free_port()
    async with running(NetworkAddress("udpin", HOST, port)) as watched:
        await watched.until(lambda: watched.up)
        assert not watched.link.write(b"nobody there")
        async with udp_peer((HOST, port)) as (one, to_us, _), udp_peer((HOST, port)) as (two, also_to_us, _):
            to_us.sendto(b"one")
            await watched.until(lambda: watched.data == b"one")
            also_to_us.sendto(b"two")
            await watched.until(lambda: watched.data == b"onetwo")
            assert watched.link.write(b"to all")
            assert (await one.next())[0] == b"to all"
            assert (await two.next())[0] == b"to all"


async def test_a_read_is_short_so_that_no_noise_stalls_the_loop_and_takes_little_memory() -> None:
    port = free_port()
    async with running(NetworkAddress("udpin", HOST, port)) as watched:
        await watched.until(lambda: watched.up)
        async with udp_peer((HOST, port)) as (_, to_us, _):
            tracemalloc.start()
            try:
                to_us.sendto(b"short")
                await watched.until(lambda: watched.data == b"short")
                assert tracemalloc.get_traced_memory()[1] < 100_000
            finally:
                tracemalloc.stop()
            # Each of these bytes looks like the header of a known message.
            to_us.sendto(b"\xfe" * 65507)
            to_us.sendto(b"end")
            await watched.until(lambda: watched.data.endswith(b"end"))
            assert len(watched.data) == 5 + MAX_READ_BYTES + 3
    began = time.process_time()
    Frames().take(watched.data)
    assert time.process_time() - began < 0.1


def frame_of(component: int, system: int = 1) -> bytes:
    sender = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
    return bytes(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3).pack(sender))


AUTOPILOT = frame_of(1)


@pytest.mark.parametrize("kind", ["udpin", "udpout"])
async def test_a_vent_after_a_second_of_frames_that_nobody_read_is_not_dropped(
    kind: Literal["udpin", "udpout"],
) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot:
        autopilot.bind((HOST, 0))
        autopilot.setblocking(False)
        port = free_port() if kind == "udpin" else autopilot.getsockname()[1]
        async with running(NetworkAddress(kind, HOST, port)) as watched:
            await watched.until(lambda: watched.up)
            assert kind == "udpin" or watched.link.write(b"hello")
            to = (HOST, port) if kind == "udpin" else autopilot.recvfrom(9)[1]
            for _ in range(400):  # PX4's frames of a second
                autopilot.sendto(AUTOPILOT, to)
            autopilot.sendto(b"vent", to)
            await watched.until(lambda: len(watched.data) >= 400 * len(AUTOPILOT) + 4)
            assert watched.data.endswith(b"vent")


@contextlib.asynccontextmanager
async def serving(
    address: NetworkAddress, codec: MavlinkCodec | None = None
) -> AsyncIterator[tuple[Watched, list[tuple[int, int]]]]:
    """A vehicle's link as in the service, and the senders whose messages were accepted."""
    accepted: list[tuple[int, int]] = []
    codec = codec or MavlinkCodec(0, 191)

    def stranger(data: bytes, enter: Callable[[], None]) -> None:
        messages, proven = codec.decode_stranger(data)
        if proven:
            enter()
        take(messages)

    def take(messages: list[MavlinkMessage]) -> None:
        accepted.extend((message.get_srcSystem(), message.get_srcComponent()) for message in messages)
        watched.data += b"."

    watched = Watched(address)
    watched.link = open_link(address, lambda data: take(codec.decode(data)), watched._on_state, stranger)
    task = asyncio.create_task(watched.link.run())
    try:
        await watched.until(lambda: watched.up)
        yield watched, accepted
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


async def settled(watched: Watched, datagrams: int) -> None:
    """Wait until this number of datagrams was read."""
    async with asyncio.timeout(TIMEOUT_S):
        while len(watched.data) < datagrams:
            await asyncio.sleep(0.001)


async def test_the_autopilot_gets_its_answers_however_many_others_send() -> None:
    port = free_port()
    async with (
        serving(NetworkAddress("udpin", HOST, port)) as (watched, _),
        contextlib.AsyncExitStack() as stack,
    ):
        autopilot, to_us, _ = await stack.enter_async_context(udp_peer((HOST, port)))
        others = [await stack.enter_async_context(udp_peer((HOST, port))) for _ in range(8)]
        sent, read = 50, 0
        for i in range(sent):
            if i % 10 == 0:
                to_us.sendto(AUTOPILOT)
                read += 1
            for _, from_other, _ in others:
                from_other.sendto(AUTOPILOT if i % 2 else frame_of(190, system=255))
            read += len(others)
            await settled(watched, read)
            assert watched.link.write(b"%d" % i)
        for i in range(sent):
            assert (await autopilot.next())[0] == b"%d" % i
        assert isinstance(watched.link, UdpLink)
        assert len(watched.link._peers) == MAX_PEERS


async def test_senders_that_are_not_the_autopilot_are_read_and_not_answered() -> None:
    port = free_port()
    async with (
        serving(NetworkAddress("udpin", HOST, port)) as (watched, accepted),
        udp_peer((HOST, port)) as (script, to_us, _),
    ):
        for data in (frame_of(190, system=255), b"noise", AUTOPILOT[:-1]):
            to_us.sendto(data)
        await settled(watched, 3)
        assert accepted == [(255, 190)]
        assert not watched.link.write(b"for nobody")
        assert script.received.empty()


async def test_half_a_frame_of_an_unknown_sender_does_not_delay_the_autopilots() -> None:
    port = free_port()
    async with (
        serving(NetworkAddress("udpin", HOST, port)) as (watched, accepted),
        udp_peer((HOST, port)) as (_, to_us, _),
        udp_peer((HOST, port)) as (_, from_stranger, _),
    ):
        for i in range(20):
            from_stranger.sendto(b"\xfd\xff\x00\x00\x00\x01\x01\x00\x00\x00")
            await settled(watched, 2 * i + 1)
            sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
            sender.seq = i
            to_us.sendto(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3).pack(sender))
            await settled(watched, 2 * i + 2)
            assert len(accepted) == i + 1


async def test_only_a_named_peer_is_read() -> None:
    port = free_port()
    async with (
        serving(NetworkAddress("udpin", "127.0.0.1", port, peer="127.0.0.2")) as (watched, accepted),
        udp_peer((HOST, port)) as (_, from_stranger, _),
    ):
        assert isinstance(watched.link, UdpLink)
        from_stranger.sendto(AUTOPILOT)
        async with asyncio.timeout(TIMEOUT_S):
            while not watched.link.unread_from:
                await asyncio.sleep(0.001)
        assert (accepted, watched.link.unread_from) == ([], HOST)
        assert not watched.link.write(b"for nobody")
        loop = asyncio.get_running_loop()
        transport, peer = await loop.create_datagram_endpoint(
            Peer, local_addr=("127.0.0.2", 0), remote_addr=(HOST, port)
        )
        try:
            transport.sendto(AUTOPILOT)
            await settled(watched, 1)
            assert accepted == [(1, 1)]
            assert watched.link.write(b"for you")
            assert (await peer.next())[0] == b"for you"
        finally:
            transport.close()


async def test_on_an_open_port_only_a_signed_sender_is_answered() -> None:
    signing, theirs = Signing(bytes(32)), Signing(bytes(32))
    signing.advance(1_790_000_000.0)
    theirs.advance(1_790_000_000.0)
    signed = MavlinkCodec(1, 1, theirs).encode(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3), 1)
    radio = mavlink.MAVLink(None, srcSystem=51, srcComponent=68)
    status = mavlink.MAVLink_radio_status_message(200, 200, 90, 30, 30, 0, 0).pack(radio)
    port = free_port()
    async with (
        serving(NetworkAddress("udpin", "0.0.0.0", port), MavlinkCodec(0, 191, signing)) as (
            watched,
            accepted,
        ),
        udp_peer((HOST, port)) as (_, from_stranger, _),
        udp_peer((HOST, port)) as (autopilot, to_us, _),
    ):
        for data in (AUTOPILOT, status, signed[:-1] + bytes((signed[-1] ^ 1,))):
            from_stranger.sendto(data)
        await settled(watched, 3)
        assert accepted == [(51, 68)]
        assert not watched.link.write(b"for nobody")
        to_us.sendto(signed)
        await settled(watched, 4)
        from_stranger.sendto(signed)  # recorded, and sent again from another address
        await settled(watched, 5)
        assert watched.link.write(b"for the autopilot")
        assert (await autopilot.next())[0] == b"for the autopilot"
        assert isinstance(watched.link, UdpLink)
        assert len(watched.link._peers) == 1


async def test_a_datagram_too_large_for_mavlink_is_not_read_from_unknown_senders() -> None:
    port = free_port()
    async with (
        serving(NetworkAddress("udpin", HOST, port)) as (watched, accepted),
        udp_peer((HOST, port)) as (_, to_us, _),
    ):
        to_us.sendto(AUTOPILOT * (MAX_FIRST_DATAGRAM_BYTES // len(AUTOPILOT) + 1))
        to_us.sendto(frame_of(154))
        await settled(watched, 1)
        assert accepted == [(1, 154)]


moments = st.lists(st.tuples(st.integers(0, 12), st.booleans(), st.floats(0.0, 10.0)), max_size=80)


@given(moments)
@settings(max_examples=examples(200), deadline=None)
def test_a_sender_that_sends_often_keeps_its_place(
    others: list[tuple[int, bool, float]],
) -> None:
    peers, t = Peers(), 0.0
    assert peers.enter(("autopilot", 0), t)
    for number, proven, pause_s in others:
        while pause_s > 1.0:
            pause_s -= 1.0
            t += 1.0
            assert peers.note(("autopilot", 0), t)
        t += pause_s
        source = ("other", number)
        if not peers.note(source, t) and proven:
            peers.enter(source, t)
        present = peers.present(t)
        assert ("autopilot", 0) in present
        assert len(present) == len(peers) <= MAX_PEERS
        assert peers.note(("autopilot", 0), t)


def test_a_router_that_restarts_with_another_port_is_answered_again_soon() -> None:
    peers = Peers()
    for restart in range(20):
        assert peers.enter(("router", restart), 1.0 * restart)
    assert len(peers.present(19.0)) == MAX_PEERS
    assert peers.present(19.0 + PEER_FORGOTTEN_S + 1.0) == []


async def test_udp_out_sends_first_and_gets_the_answer() -> None:
    async with (
        udp_peer() as (peer, transport, port),
        running(NetworkAddress("udpout", HOST, port)) as watched,
    ):
        await watched.until(lambda: watched.up)
        assert watched.link.write(b"hello")
        data, sender = await peer.next()
        assert data == b"hello"
        transport.sendto(b"welcome", sender)
        await watched.until(lambda: watched.data == b"welcome")


async def test_udp_without_a_receiver_continues_until_there_is_one() -> None:
    port = free_port()
    async with running(NetworkAddress("udpout", HOST, port)) as watched:
        await watched.until(lambda: watched.up)
        for _ in range(3):
            watched.link.write(b"anybody?")
            await asyncio.sleep(0)
        loop = asyncio.get_running_loop()
        transport, peer = await loop.create_datagram_endpoint(Peer, local_addr=(HOST, port))
        try:
            async with asyncio.timeout(TIMEOUT_S):
                while peer.received.empty():
                    # The error of the previous datagram is reported instead of sending the next one.
                    watched.link.write(b"and now?")
                    with contextlib.suppress(TimeoutError):
                        await asyncio.wait_for(peer.received.get(), 0.05)
                        break
        finally:
            transport.close()
        assert watched.states == [(True, "")]


async def test_a_udp_port_in_use_gives_a_sentence_and_is_taken_when_it_is_free() -> None:
    async with udp_peer() as (_, transport, port), running(NetworkAddress("udpin", HOST, port)) as watched:
        await watched.until(lambda: bool(watched.states))
        assert watched.states == [(False, f"udpin:{HOST}:{port}: Address already in use")]
        assert not watched.link.write(b"x")
        transport.close()
        await watched.until(lambda: watched.up)
        assert len(watched.states) == 2


async def test_tcp_both_ways() -> None:
    async with tcp_server() as server, running(NetworkAddress("tcp", HOST, server.port)) as watched:
        assert not watched.link.write(b"too early")
        reader = await server.connection()
        await watched.until(lambda: watched.up)
        assert watched.link.write(b"hello")
        async with asyncio.timeout(TIMEOUT_S):
            assert await reader.readexactly(5) == b"hello"
        server.writers[0].write(b"welcome")
        await watched.until(lambda: watched.data == b"welcome")


async def test_tcp_comes_back_when_the_server_does() -> None:
    async with tcp_server() as server, running(NetworkAddress("tcp", HOST, server.port)) as watched:
        await server.connection()
        await watched.until(lambda: watched.up)
        for round_number in range(2):
            await server.close()
            await watched.until(lambda: not watched.up)
            assert not watched.link.write(b"lost")
            await watched.until(lambda: "refused" in watched.states[-1][1].lower())
            await server.open()
            reader = await server.connection()
            await watched.until(lambda: watched.up)
            watched.data = b""
            server.writers[-1].write(b"again")
            await watched.until(lambda: watched.data == b"again")
            assert watched.link.write(b"yes")
            async with asyncio.timeout(TIMEOUT_S):
                assert await reader.readexactly(3) == b"yes"
            assert [up for up, _ in watched.states].count(True) == round_number + 2


@pytest.mark.usefixtures("soon_quiet")
async def test_tcp_that_falls_silent_is_opened_again_where_its_name_leads_now(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As after a peer without power: no FIN comes. The link stays up, so nothing is vented for it."""
    loop = asyncio.get_running_loop()
    async with tcp_server() as old, tcp_server() as new:
        ports = iter((old.port, new.port))

        async def look_up(*_: Any, **__: Any) -> Any:
            return [(socket.AF_INET, socket.SOCK_STREAM, 0, "", (HOST, next(ports, new.port)))]

        monkeypatch.setattr(loop, "getaddrinfo", look_up)
        async with running(NetworkAddress("tcp", "drone", 5760)) as watched:
            await old.connection()
            old.writers[0].write(b"once")
            reader = await new.connection()
            new.writers[0].write(b" and again")
            await watched.until(lambda: watched.data == b"once and again")
            assert watched.link.write(b"hello")
            assert await reader.readexactly(5) == b"hello"
        assert watched.states == [(True, "")]


@pytest.mark.usefixtures("soon_quiet")
async def test_tcp_that_sends_and_never_reads_is_opened_again() -> None:
    async with tcp_server() as server, running(NetworkAddress("tcp", HOST, server.port)) as watched:
        await server.connection()
        await watched.until(lambda: watched.up)
        async with asyncio.timeout(TIMEOUT_S):
            while len(server.writers) < 2:
                while watched.link.write(bytes(32 * 1024)):
                    pass  # the buffers of the system grow for some time
                server.writers[0].write(b"news")
                await asyncio.sleep(0.01)
        assert watched.states == [(True, "")]


async def test_tcp_that_accepts_and_closes_at_once_is_told_a_few_times() -> None:
    tries = 0

    async def close(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal tries
        tries += 1
        writer.close()

    async with await asyncio.start_server(close, HOST, 0) as server:
        port = server.sockets[0].getsockname()[1]
        async with running(NetworkAddress("tcp", HOST, port)) as watched, asyncio.timeout(TIMEOUT_S):
            while tries < 20:
                await asyncio.sleep(0.01)
        assert len(watched.states) == 6
        assert watched.states[-1][1].endswith("it accepts the connection and closes it at once")


@pytest.mark.usefixtures("soon_quiet")
@pytest.mark.parametrize("ends_by", ["an error", "silence"])
async def test_udp_out_is_opened_again_after_its_address_went_or_the_peer_fell_silent(ends_by: str) -> None:
    async with (
        udp_peer() as (peer, _, port),
        running(NetworkAddress("udpout", HOST, port)) as watched,
    ):
        await watched.until(lambda: watched.up)
        assert isinstance(watched.link, UdpLink)
        watched.link.write(b"one")
        first = await peer.next()
        before = watched.link._transport
        if ends_by == "an error":
            watched.link.error_received(OSError(errno.ENETUNREACH, "Network is unreachable"))
        async with asyncio.timeout(TIMEOUT_S):
            while watched.link._transport in (before, None):
                await asyncio.sleep(0.01)
        watched.link.write(b"one")
        assert await peer.next() == first, "the peer knows us by our port"
        down = (False, f"udpout:{HOST}:{port}: Network is unreachable")
        assert watched.states == [(True, ""), *([down, (True, "")] if ends_by == "an error" else [])]


@pytest.mark.parametrize("host", ["[::1]", "::1", "[::ffff:127.0.0.1]"])
async def test_ipv6_with_and_without_brackets(host: str) -> None:
    """TCP, and UDP in both directions."""
    port = free_port()
    accepted: asyncio.Queue[asyncio.StreamWriter] = asyncio.Queue()
    served = "127.0.0.1" if "127" in host else "::1"
    server = await asyncio.start_server(lambda _, writer: accepted.put_nowait(writer), served, port)
    async with server, running(parse_address(f"tcp:{host}:{port}")) as watched:
        writer = await asyncio.wait_for(accepted.get(), TIMEOUT_S)
        writer.write(b"tcp")
        await watched.until(lambda: watched.data == b"tcp")
        writer.transport.abort()
    async with (
        running(parse_address(f"udpin:{host}:{port}")) as listening,
        running(parse_address(f"udpout:{host}:{port}")) as sending,
    ):
        await listening.until(lambda: listening.up)
        await sending.until(lambda: sending.up)
        sending.link.write(b"udp")
        await listening.until(lambda: listening.data == b"udp")
        listening.link.write(b"answer")
        await sending.until(lambda: sending.data == b"answer")


async def test_tcp_reports_once_why_there_is_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    loop, tried = asyncio.get_running_loop(), asyncio.Semaphore(0)
    connect = loop.sock_connect

    async def counted(*args: Any) -> None:
        tried.release()
        await connect(*args)

    monkeypatch.setattr(loop, "sock_connect", counted)
    port = free_port()
    async with running(NetworkAddress("tcp", HOST, port)) as watched, asyncio.timeout(TIMEOUT_S):
        for _ in range(4):
            await tried.acquire()
        assert watched.states == [(False, f"tcp:{HOST}:{port}: Connection refused")]


async def test_tcp_does_not_queue_without_end_for_a_server_that_does_not_read() -> None:
    async with tcp_server() as server, running(NetworkAddress("tcp", HOST, server.port)) as watched:
        await server.connection()
        await watched.until(lambda: watched.up)
        written = 0
        while watched.link.write(bytes(32 * 1024)):
            written += 32 * 1024
            assert written < 64 * 1024 * 1024
        assert not watched.link.write(bytes(MAX_QUEUED_BYTES))


async def test_udp_does_not_queue_without_end_for_a_network_that_takes_nothing() -> None:
    async with (
        udp_peer() as (peer, _, port),
        running(NetworkAddress("udpout", HOST, port)) as watched,
    ):
        await watched.until(lambda: watched.up)
        assert isinstance(watched.link, UdpLink)
        # As asyncio's transport does; a loopback is never full.
        watched.link.pause_writing()
        assert not watched.link.write(b"stale") and watched.link.dropped_bytes == 5
        watched.link.resume_writing()
        assert watched.link.write(b"news")
        assert (await peer.next())[0] == b"news"


@pytest.mark.parametrize("host", ["no-such-host.invalid", "a..b", "x" * 70])
async def test_a_host_that_does_not_exist_gives_a_sentence(host: str) -> None:
    async with running(NetworkAddress("tcp", host, 5760)) as watched:
        await watched.until(lambda: bool(watched.states))
        assert not watched.up
        assert watched.states[0][1].startswith(f"tcp:{host}:5760: ")
        assert "\n" not in watched.states[0][1]


@pytest.mark.parametrize("kind", ["udpin", "udpout"])
async def test_a_host_that_does_not_exist_gives_a_sentence_for_udp_too(kind: str) -> None:
    address = NetworkAddress("udpin" if kind == "udpin" else "udpout", "a..b", 5760)
    async with running(address) as watched:
        await watched.until(lambda: bool(watched.states))
        assert watched.states[0][0] is False
        assert watched.states[0][1].startswith(f"{kind}:a..b:5760: ")


async def test_serial_both_ways_and_back_after_it_was_pulled_out(tmp_path: Path) -> None:
    name = tmp_path / "port"
    terminal = Terminal(name)
    try:
        async with running(SerialAddress(str(name), 57600)) as watched:
            await watched.until(lambda: watched.up)
            assert watched.link.write(b"\xfd\x00\n\r\x11")
            assert await terminal.read(5) == b"\xfd\x00\n\r\x11"
            os.write(terminal.device, b"\xfe\x13\x03")
            await watched.until(lambda: watched.data == b"\xfe\x13\x03")
            terminal.pull_out()
            await watched.until(lambda: not watched.up)
            terminal = Terminal(name)
            await watched.until(lambda: watched.up)
            os.write(terminal.device, b"back")
            await watched.until(lambda: watched.data.endswith(b"back"))
            assert watched.link.write(b"yes")
            assert await terminal.read(3) == b"yes"
    finally:
        terminal.pull_out()


async def test_a_silent_serial_port_is_opened_again_where_its_name_leads_now(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The device's file stays open and dead, and udev has made a new link."""
    monkeypatch.setattr(serial_port, "POLICY", replace(serial_port.POLICY, quiet_s=0.2))
    name = tmp_path / "port"
    dead = Terminal(name)
    async with running(SerialAddress(str(name), 57600)) as watched:
        await watched.until(lambda: watched.up)
        os.write(dead.device, b"last words")
        await watched.until(lambda: watched.data == b"last words")
        live = Terminal(name)
        async with asyncio.timeout(TIMEOUT_S):
            while not watched.data.endswith(b"here"):
                os.write(live.device, b"here")
                await asyncio.sleep(0.05)
        assert watched.link.write(b"yes")
        assert b"yes" in await live.read(3)
        assert [up for up, _ in watched.states] == [True]
    dead.pull_out()
    live.unplug()


async def test_a_serial_port_that_is_not_there_gives_a_sentence(tmp_path: Path) -> None:
    async with running(SerialAddress(str(tmp_path / "nothing"))) as watched:
        await watched.until(lambda: bool(watched.states))
        up, why = watched.states[0]
        assert not up
        assert "is not there" in why
        assert not watched.link.write(b"x")
