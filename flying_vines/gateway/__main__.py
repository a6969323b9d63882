"""The gateway's process: `python -m flying_vines.gateway FD`, FD a socket to the service that started it."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import sys
import traceback
from collections.abc import Awaitable, Iterator

import msgspec

from flying_vines.gateway.feed import Feed
from flying_vines.gateway.messages import FromGateway, Profile, packet, read_to_gateway

LONGEST_PACKET = 1024 * 1024
NICE = 5
"""Whoever looks on comes after what flies."""


async def serve(service: socket.socket) -> None:
    """Until the service closes its end, or says something that is not understood."""
    loop = asyncio.get_running_loop()

    def send(message: FromGateway) -> None:
        try:
            service.send(packet(message))
        except OSError:
            # It does not read, or is gone: then it does not answer either, and that is what people are told.
            return

    profile = read_to_gateway(await loop.sock_recv(service, LONGEST_PACKET))
    if not isinstance(profile, Profile):
        raise msgspec.DecodeError("the profile comes first")
    feed = Feed(profile, send)
    tasks = [asyncio.create_task(_guarded(feed, name, part)) for name, part in _parts(feed)]
    try:
        with contextlib.suppress(ConnectionResetError):
            # It may have died with something unread.
            while told := await loop.sock_recv(service, LONGEST_PACKET):
                feed.take(read_to_gateway(told))
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def _parts(feed: Feed) -> Iterator[tuple[str, Awaitable[None]]]:
    """What the profile asks for, imported only then."""
    config = feed.profile.config
    if config.page.port:
        from flying_vines.gateway import page

        yield "page", page.serve(feed)
    if config.mqtt.broker:
        from flying_vines.gateway import mqtt

        yield "MQTT", mqtt.serve(feed)


async def _guarded(feed: Feed, name: str, part: Awaitable[None]) -> None:
    """One that fails takes nobody with it."""
    try:
        await part
    except Exception as error:
        traceback.print_exc()
        feed.trouble(f"{name} ended: {error}")


def main() -> None:
    # Ctrl-C is for the service: it closes its end when it has vented.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(NICE)
    with socket.socket(fileno=int(sys.argv[1])) as service:
        service.setblocking(False)
        asyncio.run(serve(service))


if __name__ == "__main__":
    main()
