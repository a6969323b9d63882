"""The gateway's process: `python -m flying_vines.gateway FD`. FD is a socket to the service."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import sys
from collections.abc import Callable
from functools import partial

import msgspec

from flying_vines.gateway.feed import Feed
from flying_vines.gateway.messages import (
    ALIVE_EVERY_S,
    Alive,
    FromGateway,
    GatewayStart,
    packet,
    read_to_gateway,
)
from flying_vines.gateway.supervisor import supervise

MAX_PACKET = 1024 * 1024
NICE = 5
"""Lower priority than the service."""


async def serve(service: socket.socket) -> None:
    """Run until the service closes its end or sends an invalid message."""
    loop = asyncio.get_running_loop()

    def send(message: FromGateway) -> None:
        try:
            service.send(packet(message))
        except OSError:
            # The service does not read, or has ended. A person whose request gets no answer is told so.
            return

    start = read_to_gateway(await loop.sock_recv(service, MAX_PACKET))
    if not isinstance(start, GatewayStart):
        raise msgspec.DecodeError("the first message must be the start")
    feed = Feed(start, send)
    parts = [_beat(send)]
    if start.config.page.port:
        parts.append(supervise("page", partial(_page, feed), feed.trouble))
    if start.config.mqtt.broker:
        parts.append(supervise("MQTT", partial(_mqtt, feed), feed.trouble))
    tasks = [asyncio.create_task(part) for part in parts]
    try:
        with contextlib.suppress(ConnectionResetError):
            # Reset: the service died while messages were unread.
            while data := await loop.sock_recv(service, MAX_PACKET):
                feed.take(read_to_gateway(data))
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


# Each part is imported only if the configuration needs it. If one import fails, the other part still runs.


async def _page(feed: Feed) -> str:
    from flying_vines.gateway import page

    await page.serve(feed)
    return "it ended"


async def _mqtt(feed: Feed) -> str:
    from flying_vines.gateway import mqtt

    await mqtt.serve(feed)
    return "it ended"


async def _beat(send: Callable[[FromGateway], None]) -> None:
    # Imports block the loop: let them finish first. The service waits longer for the first `Alive`.
    await asyncio.sleep(0.0)
    await asyncio.sleep(0.0)
    while True:
        send(Alive())
        await asyncio.sleep(ALIVE_EVERY_S)


def main() -> None:
    # The service handles Ctrl-C: it vents, then closes its end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(NICE)
    with socket.socket(fileno=int(sys.argv[1])) as service:
        service.setblocking(False)
        asyncio.run(serve(service))


if __name__ == "__main__":
    main()
