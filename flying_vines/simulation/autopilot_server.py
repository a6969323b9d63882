"""A fake autopilot on UDP and TCP: the edge that has the sockets and the clock."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import cast

from flying_vines.config.address import NetworkAddress, parse_address
from flying_vines.simulation.autopilot import FakeAutopilot

SocketAddress = tuple[str, int]
Script = Sequence[tuple[float, Callable[[FakeAutopilot], None]]]

PACE_S = 0.01
MOST_CLIENTS = 8
"""On all TCP ports together; an autopilot has no more ports than that."""
MAX_QUEUED_BYTES = 64 * 1024

_COMPANION, _GCS = "companion", "gcs"


class AutopilotServer:
    """Connects an autopilot with a companion and a ground station on UDP, and with whoever comes by TCP.

    Each has a port of the autopilot of its own, as serial ports are on a real one. UDP peers answer to where
    the frames come from, and need not listen yet: frames to a closed port are lost. A TCP client that goes
    leaves its port to the next. The autopilot must be a fresh one, and `run` is for once.
    """

    def __init__(
        self,
        autopilot: FakeAutopilot,
        companion: str | SocketAddress | None = "udpout:127.0.0.1:14540",
        gcs: str | SocketAddress | None = None,
        script: Script = (),
        *,
        listen: Sequence[str | SocketAddress] = (),
        speed: float = 1.0,
    ) -> None:
        """`companion` and `gcs` are (host, port) or "udpout:host:port"; ValueError for anything else.

        `script` holds stimuli and when to apply them, in seconds since `run` started, in any order. `listen`
        are TCP ports, "tcpin:host:port" or (host, port), where port 0 is any free one. At `speed` 10 the
        vehicle lives ten seconds in one.
        """
        self.autopilot = autopilot
        self._peers: dict[str, SocketAddress] = {}
        if companion is not None:
            self._peers[_COMPANION] = _host_and_port(companion)
        if gcs is not None:
            self._peers[_GCS] = _host_and_port(gcs)
        self._script = sorted(script, key=lambda entry: entry[0])
        self._listen = [_listening(address) for address in listen]
        self._speed = speed
        self._start_s = 0.0
        self._ends: dict[str, _UdpPeer | _TcpClient] = {}
        self.ports: list[int] = []
        """The TCP ports, in the order of `listen`, once `ready`."""
        self.ready = asyncio.Event()
        self.frames_sent = 0
        self.frames_unsent = 0

    @property
    def now_s(self) -> float:
        """Seconds of the vehicle's time since `run` started."""
        return (asyncio.get_running_loop().time() - self._start_s) * self._speed

    async def run(self) -> None:
        """Serve until cancelled. A taken TCP port ends it, and what a stimulus of the script raises."""
        loop = asyncio.get_running_loop()
        self._start_s = loop.time()
        servers: list[asyncio.Server] = []
        try:
            for link, address in self._peers.items():
                await self._connect(link, address)
            for host, port in self._listen:
                servers.append(await loop.create_server(lambda: _TcpClient(self), host, port))
            self.ports = [server.sockets[0].getsockname()[1] for server in servers]
            self.ready.set()
            slot = 0
            while True:
                self._step(self.now_s)
                # Slots of the clock, not pauses: a late one does not delay those after it.
                slot = max(slot + 1, int((loop.time() - self._start_s) / PACE_S))
                await asyncio.sleep(self._start_s + slot * PACE_S - loop.time())
        finally:
            for server in servers:
                server.close()
            for end in list(self._ends.values()):
                end.close()

    async def _connect(self, link: str, address: SocketAddress) -> None:
        peer = self._ends[link] = _UdpPeer(self, link)
        self.autopilot.add_link(link)
        await asyncio.get_running_loop().create_datagram_endpoint(lambda: peer, remote_addr=address)

    def hear(self, link: str, data: bytes) -> None:
        self.autopilot.receive(self.now_s, link, data)

    def seat(self, client: _TcpClient) -> str | None:
        """A port of the autopilot for a TCP client; None when all are taken."""
        for number in range(1, MOST_CLIENTS + 1):
            link = f"tcp{number}"
            if link not in self._ends:
                self._ends[link] = client
                self.autopilot.add_link(link)
                return link
        return None

    def leave(self, link: str) -> None:
        self._ends.pop(link, None)

    def _step(self, t_s: float) -> None:
        while self._script and self._script[0][0] <= t_s:
            at_s, stimulus = self._script.pop(0)
            self._send(self.autopilot.advance(at_s))
            stimulus(self.autopilot)
        self._send(self.autopilot.advance(t_s))

    def _send(self, frames: list[tuple[str, bytes]]) -> None:
        for link, frame in frames:
            end = self._ends.get(link)
            if end is not None and end.send(frame):
                self.frames_sent += 1
            else:
                self.frames_unsent += 1


class _UdpPeer(asyncio.DatagramProtocol):
    """One peer, who is sent to whether or not somebody is there."""

    def __init__(self, server: AutopilotServer, link: str) -> None:
        self._server = server
        self._link = link
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        # Before Python 3.12 the transport does not say so by its class.
        self._transport = cast("asyncio.DatagramTransport", transport)

    def datagram_received(self, data: bytes, addr: object) -> None:
        self._server.hear(self._link, data)

    def error_received(self, exc: Exception) -> None:
        """Nobody listens (yet); what was sent is lost, as on a serial line with nothing at its end."""

    def send(self, frame: bytes) -> bool:
        if self._transport is None or self._transport.is_closing():
            return False
        self._transport.sendto(frame)
        return True

    def close(self) -> None:
        if self._transport is not None:
            self._transport.close()


class _TcpClient(asyncio.Protocol):
    """One client, on a port of the autopilot for as long as it stays."""

    def __init__(self, server: AutopilotServer) -> None:
        self._server = server
        self._link: str | None = None
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        self._link = self._server.seat(self)
        if self._link is None:
            self._transport.close()

    def data_received(self, data: bytes) -> None:
        if self._link is not None:
            self._server.hear(self._link, data)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._link is not None:
            self._server.leave(self._link)

    def send(self, frame: bytes) -> bool:
        transport = self._transport
        if (
            transport is None
            or transport.is_closing()
            or transport.get_write_buffer_size() > MAX_QUEUED_BYTES
        ):
            return False
        transport.write(frame)
        return True

    def close(self) -> None:
        if self._transport is not None:
            self._transport.close()


def _host_and_port(peer: str | SocketAddress) -> SocketAddress:
    if not isinstance(peer, str):
        return peer
    address = parse_address(peer)
    if not isinstance(address, NetworkAddress) or address.kind != "udpout":
        raise ValueError(f"a fake autopilot sends to udpout:HOST:PORT, not to {peer!r}")
    return address.host, address.port


def _listening(at: str | SocketAddress) -> SocketAddress:
    if not isinstance(at, str):
        return at
    kind, _, place = at.partition(":")
    if kind != "tcpin":
        raise ValueError(f"a fake autopilot listens at tcpin:HOST:PORT, not at {at!r}")
    address = parse_address(f"tcp:{place}")
    assert isinstance(address, NetworkAddress)
    return address.host, address.port
