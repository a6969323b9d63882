"""A fake autopilot on UDP: the edge that has the sockets and the clock."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Callable, Sequence

from flying_vines.address import NetworkAddress, parse_address
from flying_vines.fakes.autopilot import Autopilot

Address = tuple[str, int]
Script = Sequence[tuple[float, Callable[[Autopilot], None]]]

PACE_S = 0.01

_COMPANION, _GCS = "companion", "gcs"


class AutopilotServer:
    """Sends an autopilot's frames to a companion and a ground station that listen on UDP, and hears them.

    Each has a socket of its own here, as a serial port has on a real one; the peers answer to where the
    frames come from. Nobody needs to listen yet: frames to a closed port are lost. The autopilot must be
    a fresh one, and `run` is for once.
    """

    def __init__(
        self,
        autopilot: Autopilot,
        companion: str | Address = "udpout:127.0.0.1:14540",
        gcs: str | Address | None = None,
        script: Script = (),
    ) -> None:
        """`companion` and `gcs` are (host, port) or "udpout:host:port"; ValueError for anything else.

        `script` holds stimuli and when to apply them, in seconds since `run` started, in any order.
        """
        self.autopilot = autopilot
        self._peers = {_COMPANION: _host_and_port(companion)}
        if gcs is not None:
            self._peers[_GCS] = _host_and_port(gcs)
        self._script = sorted(script, key=lambda entry: entry[0])
        self.frames_sent = 0
        self.frames_unsent = 0

    async def run(self) -> None:
        """Serve until cancelled. What a stimulus of the script raises ends it."""
        loop = asyncio.get_running_loop()
        start_s = loop.time()
        transports: dict[str, asyncio.DatagramTransport] = {}
        try:
            for link, address in self._peers.items():
                self.autopilot.add_link(link)
                transports[link], _ = await loop.create_datagram_endpoint(
                    functools.partial(_Hearing, self.autopilot, link, start_s),
                    remote_addr=address,
                )
            slot = 0
            while True:
                self._step(loop.time() - start_s, transports)
                # Slots of the clock, not pauses: a late one does not delay those after it.
                slot = max(slot + 1, int((loop.time() - start_s) / PACE_S))
                await asyncio.sleep(start_s + slot * PACE_S - loop.time())
        finally:
            for transport in transports.values():
                transport.close()

    def _step(self, t_s: float, transports: dict[str, asyncio.DatagramTransport]) -> None:
        while self._script and self._script[0][0] <= t_s:
            at_s, stimulus = self._script.pop(0)
            self._send(self.autopilot.advance(at_s), transports)
            stimulus(self.autopilot)
        self._send(self.autopilot.advance(t_s), transports)

    def _send(
        self, frames: list[tuple[str, bytes]], transports: dict[str, asyncio.DatagramTransport]
    ) -> None:
        for link, frame in frames:
            transport = transports.get(link)
            if transport is None or transport.is_closing():
                self.frames_unsent += 1
            else:
                transport.sendto(frame)
                self.frames_sent += 1


class _Hearing(asyncio.DatagramProtocol):
    """Hands datagrams to the autopilot as they come."""

    def __init__(self, autopilot: Autopilot, link: str, start_s: float) -> None:
        self._autopilot = autopilot
        self._link = link
        self._start_s = start_s

    def datagram_received(self, data: bytes, addr: object) -> None:
        t_s = asyncio.get_running_loop().time() - self._start_s
        self._autopilot.receive(t_s, self._link, data)

    def error_received(self, exc: Exception) -> None:
        """Nobody listens (yet); what was sent is lost, as on a serial line with nothing at its end."""


def _host_and_port(peer: str | Address) -> Address:
    if not isinstance(peer, str):
        return peer
    address = parse_address(peer)
    if not isinstance(address, NetworkAddress) or address.kind != "udpout":
        raise ValueError(f"a fake autopilot sends to udpout:HOST:PORT, not to {peer!r}")
    return address.host, address.port
