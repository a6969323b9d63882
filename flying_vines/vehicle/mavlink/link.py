"""Transports for MAVLink: UDP, TCP and serial. `firmware_link.reconnect` says when each is opened again.

All have the interface of `firmware_link.serial_port.SerialPort`: `run()` runs until cancelled. `write()`
never blocks. `on_bytes` is called from the event loop. `on_state(up, why)` is called at each change.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
from collections.abc import Callable
from typing import Any, Protocol

from firmware_link.find import UsbBoard
from firmware_link.reconnect import KeptOpen, Policy, Problem, why_not
from flying_vines.config.address import DEFAULT_BAUD, Address, NetworkAddress, SerialAddress
from flying_vines.vehicle.mavlink.frames import from_autopilot

POLICY = Policy(
    first_wait_s=0.5,
    longest_wait_s=2.0,
    quiet_s=5.0,
    short_lived=Problem("it accepts the connection and closes it at once"),
)
"""An autopilot sends a HEARTBEAT each second."""
CONNECTS_WITHIN_S = 3.0
LISTENING = Policy(first_wait_s=0.5, longest_wait_s=2.0)
"""A socket that listens hears every sender. Opened again, it could lose its port to another program."""
_NO_WAY_OUT = (errno.ENETUNREACH, errno.EADDRNOTAVAIL, errno.EINVAL, errno.ENETDOWN, errno.ENODEV)
"""Errors of a UDP socket whose own address is gone. Others end when the receiver starts."""
MAX_PEERS = 4
PEER_FORGOTTEN_S = 30.0
PEER_REPLACED_S = 3.0
"""A new peer may replace one that was silent for this time: a restarted router has another port."""
MAX_FIRST_DATAGRAM_BYTES = 2048
"""Maximum size of a new sender's first datagram. A frame has up to 280 bytes, an Ethernet packet 1500."""
MAX_QUEUED_BYTES = 64 * 1024
MAX_READ_BYTES = 4096
"""Maximum bytes of a read; a longer datagram is cut. Routers send up to 1500. Noise that looks like headers
takes 3 µs per byte, and the loop must not wait for it until the board's dead-man acts."""

RECEIVE_BUFFER_BYTES = 2 * 1024 * 1024
"""Receive buffer of a UDP socket: 12 s of PX4's 400 frames per second. Linux grants at most
`net.core.rmem_max`, which is often 208 KiB: 1.3 s. A full buffer drops the newest datagrams, such as a vent
that was sent while our process did not run."""
BUFFERED_FRAME_BYTES = 416
"""Measured on Linux 6: what a datagram of at most 60 bytes takes of `net.core.rmem_max`."""

OnBytes = Callable[[bytes], None]
OnStranger = Callable[[bytes, Callable[[], None]], None]
"""A datagram of a new sender, and the function to call to make it a peer."""
OnState = Callable[[bool, str], None]


class Link(Protocol):
    """A transport of bytes in both directions."""

    @property
    def dropped_bytes(self) -> int:
        """The number of bytes that could not be sent."""

    async def run(self) -> None:
        """Keep the link open until cancelled."""

    def write(self, data: bytes) -> bool:
        """Send, or drop and return False."""


def open_link(
    address: Address, on_bytes: OnBytes, on_state: OnState, on_stranger: OnStranger | None = None
) -> Link:
    """The transport for an address; it opens in `run`.

    Without `on_stranger`, a `udpin` link answers every sender.
    """
    if isinstance(address, (SerialAddress, UsbBoard)):
        from firmware_link.serial_port import SerialPort

        if isinstance(address, UsbBoard):
            return SerialPort(address, DEFAULT_BAUD, on_bytes, on_state)
        return SerialPort(address.path, address.baud, on_bytes, on_state)
    if address.kind == "tcp":
        return TcpLink(address, on_bytes, on_state)
    return UdpLink(address, on_bytes, on_state, on_stranger)


def unread_from(link: Link) -> str:
    """The latest IP address that was ignored because the link's setting names another one."""
    return link.unread_from if isinstance(link, UdpLink) else ""


def buffered_frames(link: Link) -> int | None:
    """The number of small frames that the system keeps while we do not read; None if the link is not UDP."""
    return link.buffer_bytes // BUFFERED_FRAME_BYTES if isinstance(link, UdpLink) else None


class _NetworkLink(asyncio.BaseProtocol):
    """Base of the network links: the address, and one connection after the other."""

    def __init__(self, address: NetworkAddress, on_bytes: OnBytes, on_state: OnState) -> None:
        self._address = address
        self._on_bytes = on_bytes
        self._is_listening = address.kind == "udpin"
        policy = LISTENING if self._is_listening else POLICY
        self._kept = KeptOpen(
            policy, self._connect, lambda up, why: on_state(up, "" if up else f"{address}: {why}")
        )
        self._transport: Any = None
        self._lost: asyncio.Future[str] | None = None
        self._full = False
        self.dropped_bytes = 0

    async def run(self) -> None:
        await self._kept.run()

    async def _connect(self) -> Problem:
        self._lost = asyncio.get_running_loop().create_future()
        try:
            transport = await self._open()
        except (OSError, UnicodeError) as error:
            return Problem(why_not(error))
        # asyncio reads into 256 KiB. The C library maps such a buffer anew for each datagram, which takes ten
        # times as long as the read itself.
        transport.max_size = MAX_READ_BYTES
        self._transport, self._full = transport, False
        self._kept.opened()
        try:
            return Problem(await self._lost)
        finally:
            self._transport = None
            transport.abort()

    async def _open(self) -> Any:
        """The open transport. Raises `OSError` or `UnicodeError`."""
        raise NotImplementedError

    async def _socket(self, kind: socket.SocketKind, local_port: int = 0) -> socket.socket:
        """A socket that is connected to the address, by whatever IP address its name has now."""
        loop = asyncio.get_running_loop()
        # Without a limit: the system has one, and a look-up that is given up leaves its thread behind.
        places = await loop.getaddrinfo(self._address.host, self._address.port, type=kind)
        return await _first_connected(places, local_port)

    def write(self, data: bytes) -> bool:
        """Send, or drop and return False."""
        sent = self._transport is not None and not self._full and self._send(data)
        if not sent:
            self.dropped_bytes += len(data)
        return sent

    def _send(self, data: bytes) -> bool:
        raise NotImplementedError

    def _lose(self, why: str) -> None:
        if self._lost is not None and not self._lost.done():
            self._lost.set_result(why)

    def pause_writing(self) -> None:
        """64 KiB are queued. Drop from now on: asyncio itself has no limit."""
        self._full = True

    def resume_writing(self) -> None:
        self._full = False


Source = tuple[str, int]
"""IP address and port of a datagram's sender. For IPv6 the tuple has more elements."""


class Peers:
    """The peers that get our messages. A peer that sends regularly is never replaced by a new one."""

    def __init__(self) -> None:
        self._received_at: dict[Source, float] = {}

    def __len__(self) -> int:
        return len(self._received_at)

    def note(self, source: Source, t: float) -> bool:
        """Note a datagram of `source`. Returns True if it is a peer."""
        if source not in self._received_at:
            return False
        self._received_at[source] = t
        return True

    def enter(self, source: Source, t: float) -> bool:
        """Make `source` a peer. Returns False if there is no room."""
        if source not in self._received_at and len(self._received_at) >= MAX_PEERS:
            most_silent = min(self._received_at, key=lambda peer: self._received_at[peer])
            if t - self._received_at[most_silent] <= PEER_REPLACED_S:
                return False
            del self._received_at[most_silent]
        self._received_at[source] = t
        return True

    def present(self, t: float) -> list[Source]:
        for peer, received_at in list(self._received_at.items()):
            if t - received_at > PEER_FORGOTTEN_S:
                del self._received_at[peer]
        return list(self._received_at)


class UdpLink(_NetworkLink, asyncio.DatagramProtocol):
    """UDP: `udpout` sends to one address, `udpin` listens and answers its `Peers`.

    A sender becomes a peer when it sends a frame of an autopilot. The sender must be on this computer, or
    at the address that the link names. On a link that is open to a network, any sender may become a
    peer, but its frame must be signed.
    """

    def __init__(
        self,
        address: NetworkAddress,
        on_bytes: OnBytes,
        on_state: OnState,
        on_stranger: OnStranger | None = None,
    ) -> None:
        super().__init__(address, on_bytes, on_state)
        self.unread_from = ""
        self.buffer_bytes = 0
        """The granted receive buffer."""
        self._on_stranger = on_stranger
        self._local_port = 0
        """The port of the last connection. The receiver knows us by it."""
        self._peers = Peers()

    async def _open(self) -> asyncio.DatagramTransport:
        loop = asyncio.get_running_loop()
        if self._is_listening:
            here = (self._address.host, self._address.port)
            transport, _ = await loop.create_datagram_endpoint(lambda: self, local_addr=here)
        else:
            connected = await self._socket(socket.SOCK_DGRAM, self._local_port)
            self._local_port = connected.getsockname()[1]
            transport, _ = await loop.create_datagram_endpoint(lambda: self, sock=connected)
        buffer = socket.SOL_SOCKET, socket.SO_RCVBUF
        opened = transport.get_extra_info("socket")
        with contextlib.suppress(OSError):  # macOS refuses more than its limit
            opened.setsockopt(*buffer, RECEIVE_BUFFER_BYTES)
        self.buffer_bytes = opened.getsockopt(*buffer) // 2  # Linux returns twice what it grants
        return transport

    def _send(self, data: bytes) -> bool:
        if not self._is_listening:
            self._transport.sendto(data)
            return True
        peers = self._peers.present(asyncio.get_running_loop().time())
        for peer in peers:
            self._transport.sendto(data, peer)
        return bool(peers)

    def datagram_received(self, data: bytes, addr: Source) -> None:
        self._kept.heard()
        now = asyncio.get_running_loop().time()
        if self._peers.note(addr, now):
            self._on_bytes(data)
        elif not self._address.reads(addr[0]):
            self.unread_from = addr[0]
        elif not self._is_listening or self._on_stranger is None:
            self._peers.enter(addr, now)
            self._on_bytes(data)
        elif len(data) > MAX_FIRST_DATAGRAM_BYTES:
            return
        elif not self._address.is_open and from_autopilot(data) and self._peers.enter(addr, now):
            self._on_bytes(data)
        else:
            self._on_stranger(data, lambda: self._enter(addr))

    def _enter(self, source: Source) -> None:
        self._peers.enter(source, asyncio.get_running_loop().time())

    def error_received(self, exc: Exception) -> None:
        """A receiver that is not there may start later."""
        if not self._is_listening and isinstance(exc, OSError) and exc.errno in _NO_WAY_OUT:
            self._lose(why_not(exc))


class TcpLink(_NetworkLink, asyncio.Protocol):
    async def _open(self) -> asyncio.Transport:
        connected = await self._socket(socket.SOCK_STREAM)
        transport, _ = await asyncio.get_running_loop().create_connection(lambda: self, sock=connected)
        transport.set_write_buffer_limits(MAX_QUEUED_BYTES)
        return transport

    def _send(self, data: bytes) -> bool:
        self._transport.write(data)
        return True

    def data_received(self, data: bytes) -> None:
        # A peer that sends and does not read is as good as silent: it gets no message of ours.
        if not self._full:
            self._kept.heard()
        self._on_bytes(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._lose("the connection was closed")


async def _first_connected(places: list[Any], local_port: int) -> socket.socket:
    """A socket that is connected to the first of `places` that can be reached. Raises `OSError`."""
    failure = OSError("no address")
    for family, kind, protocol, _, place in places:
        one = socket.socket(family, kind, protocol)
        try:
            one.setblocking(False)
            if local_port:
                with contextlib.suppress(OSError):
                    one.bind(("", local_port))
            async with asyncio.timeout(CONNECTS_WITHIN_S):
                await asyncio.get_running_loop().sock_connect(one, place)
        except OSError as error:
            one.close()
            failure = error
        except BaseException:
            one.close()
            raise
        else:
            return one
    raise failure
