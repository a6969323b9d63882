"""Transports for MAVLink: UDP, TCP and serial. Each reopens by itself after a loss.

All have the interface of `firmware_link.serial_port.SerialPort`: `run()` runs until cancelled. `write()`
never blocks. `on_bytes` is called from the event loop. `on_state(up, why)` is called at each change.
"""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Callable
from typing import Any, Protocol

from firmware_link.find import UsbBoard
from flying_vines.config.address import DEFAULT_BAUD, Address, NetworkAddress, SerialAddress
from flying_vines.vehicle.mavlink.frames import from_autopilot

RETRY_S = 1.0
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


class _NetworkLink:
    """Base of the network links: it has the address, and reports each change once."""

    def __init__(self, address: NetworkAddress, on_bytes: OnBytes, on_state: OnState) -> None:
        self._address = address
        self._on_bytes = on_bytes
        self._on_state = on_state
        self._why_down = ""
        self.dropped_bytes = 0

    def _up(self) -> None:
        self._why_down = ""
        self._on_state(True, "")

    def _down(self, reason: str) -> None:
        why = f"{self._address.kind}:{self._address.host}:{self._address.port}: {reason}"
        if why != self._why_down:
            self._why_down = why
            self._on_state(False, why)

    def write(self, data: bytes) -> bool:
        """Send, or drop and return False."""
        sent = self._send(data)
        if not sent:
            self.dropped_bytes += len(data)
        return sent

    def _send(self, data: bytes) -> bool:
        raise NotImplementedError


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
        self._on_stranger = on_stranger
        self._transport: asyncio.DatagramTransport | None = None
        self._full = False
        self._peers = Peers()

    async def run(self) -> None:
        loop = asyncio.get_running_loop()
        endpoint = (self._address.host, self._address.port)
        listening = self._address.kind == "udpin"
        while True:
            try:
                transport, _ = await loop.create_datagram_endpoint(
                    lambda: self,
                    local_addr=endpoint if listening else None,
                    remote_addr=None if listening else endpoint,
                )
            except (OSError, UnicodeError) as error:
                self._down(_reason(error))
                await asyncio.sleep(RETRY_S)
                continue
            _limit_reads(transport)
            self._transport, self._full = transport, False
            self._up()
            try:
                await loop.create_future()
            finally:
                self._transport = None
                transport.close()

    def _send(self, data: bytes) -> bool:
        if self._transport is None or self._full:
            return False
        if self._address.kind == "udpout":
            self._transport.sendto(data)
            return True
        peers = self._peers.present(asyncio.get_running_loop().time())
        for peer in peers:
            self._transport.sendto(data, peer)
        return bool(peers)

    def datagram_received(self, data: bytes, addr: Source) -> None:
        now = asyncio.get_running_loop().time()
        if self._peers.note(addr, now):
            self._on_bytes(data)
        elif not self._address.reads(addr[0]):
            self.unread_from = addr[0]
        elif self._address.kind == "udpout" or self._on_stranger is None:
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

    def pause_writing(self) -> None:
        """64 KiB are queued. Drop from now on: asyncio itself has no limit."""
        self._full = True

    def resume_writing(self) -> None:
        self._full = False

    def error_received(self, exc: Exception) -> None:
        """Ignore the ICMP error: the receiver may start later."""


class TcpLink(_NetworkLink, asyncio.Protocol):
    def __init__(self, address: NetworkAddress, on_bytes: OnBytes, on_state: OnState) -> None:
        super().__init__(address, on_bytes, on_state)
        self._transport: asyncio.Transport | None = None
        self._lost: asyncio.Future[None] | None = None

    async def run(self) -> None:
        loop = asyncio.get_running_loop()
        host, port = self._address.host, self._address.port
        while True:
            self._lost = loop.create_future()
            try:
                transport, _ = await loop.create_connection(lambda: self, host, port)
            except (OSError, UnicodeError) as error:
                self._down(_reason(error))
                await asyncio.sleep(RETRY_S)
                continue
            _limit_reads(transport)
            self._transport = transport
            self._up()
            try:
                await self._lost
            finally:
                self._transport = None
                transport.abort()
            self._down("the connection was closed")
            await asyncio.sleep(RETRY_S)

    def _send(self, data: bytes) -> bool:
        if self._transport is None or self._transport.get_write_buffer_size() > MAX_QUEUED_BYTES:
            return False
        self._transport.write(data)
        return True

    def data_received(self, data: bytes) -> None:
        self._on_bytes(data)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._lost is not None and not self._lost.done():
            self._lost.set_result(None)


def _limit_reads(transport: Any) -> None:
    """Give each read a smaller buffer than asyncio's 256 KiB, which the C library would map each time."""
    transport.max_size = MAX_READ_BYTES


def _reason(error: OSError | UnicodeError) -> str:
    """The operating system's text for the error. An invalid host name raises a `UnicodeError`."""
    if isinstance(error, OSError) and error.errno and not isinstance(error, socket.gaierror):
        return os.strerror(error.errno)
    return getattr(error, "strerror", None) or str(error)
