"""Runs a simulated autopilot on UDP and TCP, and a ground station for it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import cast

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config.address import NetworkAddress, parse_address
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.autopilot.links import COMPANION, GCS
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage

SocketAddress = tuple[str, int]
Script = Sequence[tuple[float, Callable[[FakeAutopilot], None]]]

PACE_S = 0.01
MAX_CLIENTS = 8
"""Maximum number of TCP clients on all TCP ports together, because an autopilot has few ports."""
MAX_QUEUED_BYTES = 64 * 1024
FIRST_CLIENT = "the first TCP client"
SYSTEM_ID, COMPONENT_ID = 255, 190
"""The ground station's."""


class AutopilotServer:
    """Connects an autopilot with a companion and a ground station on UDP, and with TCP clients.

    Each peer has its own port of the autopilot, as if it had its own serial port. UDP peers must answer to
    the sender's address. They may start later: until then their frames are lost. A TCP client gets a free
    port; this may be the port of a client that has left. The autopilot must be new; call `run` only once.
    """

    def __init__(
        self,
        autopilot: FakeAutopilot,
        companion: str | SocketAddress | None = "udpout:127.0.0.1:14540",
        gcs: str | SocketAddress | None = None,
        script: Script = (),
        *,
        listen: Sequence[SocketAddress] = (),
        speed: float = 1.0,
    ) -> None:
        """`companion` and `gcs` are (host, port) or "udpout:host:port"; otherwise raises `ValueError`.

        A `companion` that is `FIRST_CLIENT` is the first TCP client.

        `script`: times (s since the start of `run`) and stimuli, in any order. `listen`: TCP ports;
        port 0 is any free port. `speed`: 10 is ten times real time.
        """
        self.autopilot = autopilot
        self._peers: dict[str, SocketAddress] = {}
        self._links = [f"tcp{number}" for number in range(1, MAX_CLIENTS + 1)]
        """The autopilot's ports for TCP clients, each for one."""
        if companion == FIRST_CLIENT:
            self._links.insert(0, COMPANION)
        elif companion is not None:
            self._peers[COMPANION] = _host_and_port(companion)
        if gcs is not None:
            self._peers[GCS] = _host_and_port(gcs)
        self._script = sorted(script, key=lambda entry: entry[0])
        self._listen = listen
        self._speed = speed
        self._start_s = 0.0
        self._ends: dict[str, _UdpPeer | _TcpClient] = {}
        self.ports: list[int] = []
        """The TCP ports, in the order of `listen`; valid after `open` and once `ready`."""
        self._servers: list[asyncio.Server] = []
        self.ready = asyncio.Event()
        self.frames_unsent = 0

    @property
    def now_s(self) -> float:
        """The vehicle's time since the start of `run`, s."""
        return (asyncio.get_running_loop().time() - self._start_s) * self._speed

    async def open(self) -> None:
        """Open the TCP ports. `run` does it, too, but then the ports are known later. Raises `OSError`."""
        for address in self._listen[len(self._servers) :]:
            with _named(address):
                server = await asyncio.get_running_loop().create_server(lambda: _TcpClient(self), *address)
            self._servers.append(server)
        self.ports = [server.sockets[0].getsockname()[1] for server in self._servers]

    async def run(self) -> None:
        """Serve until cancelled.

        Raises `OSError` if an address cannot be used; its text names the address. Raises any error of a
        stimulus.
        """
        loop = asyncio.get_running_loop()
        self._start_s = loop.time()
        try:
            for link, address in self._peers.items():
                with _named(address):
                    await self._connect(link, address)
            await self.open()
            self.ready.set()
            slot = 0
            while True:
                self._step(self.now_s)
                # Fixed slots instead of pauses, so that a late step does not delay later ones.
                slot = max(slot + 1, int((loop.time() - self._start_s) / PACE_S))
                await asyncio.sleep(self._start_s + slot * PACE_S - loop.time())
        finally:
            for server in self._servers:
                server.close()
            for end in list(self._ends.values()):
                end.close()

    async def _connect(self, link: str, address: SocketAddress) -> None:
        peer = self._ends[link] = _UdpPeer(self, link)
        self.autopilot.add_link(link)
        await asyncio.get_running_loop().create_datagram_endpoint(lambda: peer, remote_addr=address)

    def receive(self, link: str, data: bytes) -> None:
        self.autopilot.receive(self.now_s, link, data)

    def add_client(self, client: _TcpClient) -> str | None:
        """The autopilot's port for a TCP client; None if none is free."""
        for link in self._links[:MAX_CLIENTS]:
            if link not in self._ends:
                self._ends[link] = client
                self.autopilot.add_link(link)
                return link
        return None

    def remove_client(self, link: str) -> None:
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
            if end is None or not end.send(frame):
                self.frames_unsent += 1


class _UdpPeer(asyncio.DatagramProtocol):
    """One UDP peer. Frames are sent even if the peer does not listen."""

    def __init__(self, server: AutopilotServer, link: str) -> None:
        self._server = server
        self._link = link
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        # Before Python 3.12 the transport's class is not a DatagramTransport.
        self._transport = cast("asyncio.DatagramTransport", transport)

    def datagram_received(self, data: bytes, addr: object) -> None:
        self._server.receive(self._link, data)

    def error_received(self, exc: Exception) -> None:
        """The peer does not listen: the frame is lost, as on a serial line without a receiver."""

    def send(self, frame: bytes) -> bool:
        if self._transport is None or self._transport.is_closing():
            return False
        self._transport.sendto(frame)
        return True

    def close(self) -> None:
        if self._transport is not None:
            self._transport.close()


class _TcpClient(asyncio.Protocol):
    """One TCP client on a port of the autopilot."""

    def __init__(self, server: AutopilotServer) -> None:
        self._server = server
        self._link: str | None = None
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        self._link = self._server.add_client(self)
        if self._link is None:
            self._transport.close()

    def data_received(self, data: bytes) -> None:
        if self._link is not None:
            self._server.receive(self._link, data)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._link is not None:
            self._server.remove_client(self._link)

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


class GroundStation(asyncio.DatagramProtocol):
    """A simulated ground station: sends heartbeats and stores the vine's values and texts.

    It listens on a UDP port of this computer; `values` and `texts` come from companions.
    """

    def __init__(self) -> None:
        self.values: dict[str, float] = {}
        self.texts: list[str] = []
        self._codec = MavlinkCodec(SYSTEM_ID, COMPONENT_ID)
        self._transport: asyncio.DatagramTransport | None = None
        self._autopilot: tuple[str, int] | None = None

    async def listen(self, host: str = "127.0.0.1") -> int:
        """Open a free port and return its number."""
        transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
            lambda: self, local_addr=(host, 0)
        )
        self._transport = transport
        port: int = transport.get_extra_info("sockname")[1]
        return port

    async def run(self) -> None:
        """Send one heartbeat per second to the last sender, until cancelled."""
        try:
            while True:
                self.send(
                    mavlink.MAVLink_heartbeat_message(
                        mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
                    )
                )
                await asyncio.sleep(1.0 if self._autopilot else 0.1)
        finally:
            if self._transport is not None:
                self._transport.close()

    def send(self, message: MavlinkMessage) -> None:
        """Send a message to the last sender; it is lost if there was none."""
        if self._transport is not None and self._autopilot is not None:
            self._transport.sendto(self._codec.encode(message, SYSTEM_ID), self._autopilot)

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self._autopilot = addr
        for message in self._codec.decode(data):
            if message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1:
                continue
            if message.get_type() == "NAMED_VALUE_FLOAT":
                self.values[message.name] = message.value
            elif message.get_type() == "STATUSTEXT":
                self.texts.append(message.text)


@contextmanager
def _named(address: SocketAddress) -> Iterator[None]:
    """Let an `OSError` name the address."""
    try:
        yield
    except OSError as error:
        host, port = address
        raise OSError(error.errno, f"{host}:{port}: {error.strerror or error}") from None


def _host_and_port(peer: str | SocketAddress) -> SocketAddress:
    if not isinstance(peer, str):
        return peer
    address = parse_address(peer)
    if not isinstance(address, NetworkAddress) or address.kind != "udpout":
        raise ValueError(f"a simulated autopilot sends to udpout:HOST:PORT, not to {peer!r}")
    return address.host, address.port
