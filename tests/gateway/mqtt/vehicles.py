"""Vehicles on a broker: the gateway between a real broker and a simulated service."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

from waiting import until

from flying_vines.gateway import mqtt
from flying_vines.gateway.feed import Feed
from flying_vines.gateway.messages import Answered, FromGateway, Request, Trouble

from ..gateway_inputs import happened, notice, seen, start


class Vehicle:
    """A vehicle whose service sends a snapshot ten times a second, and carries out requests if not `deaf`."""

    def __init__(self, **settings: Any) -> None:
        self.feed = Feed(start(**settings), self._receive)
        self.troubles: list[str] = []
        self.asked: list[Request] = []
        self.deaf = False

    @property
    def t(self) -> float:
        return asyncio.get_running_loop().time()

    def say(self, text: str) -> None:
        self.feed.take(happened(notice(self.t, text)))

    def _receive(self, message: FromGateway) -> None:
        if isinstance(message, Trouble):
            self.troubles.append(message.text)
            return
        assert isinstance(message, Request)
        self.asked.append(message)
        if not self.deaf:
            answer = Answered(message.number, "accepted", "")
            asyncio.get_running_loop().call_soon(self.feed.take, answer)

    async def live(self) -> None:
        while True:
            self.feed.take(seen(self.t))
            await asyncio.sleep(0.1)

    async def in_trouble(self, text: str) -> None:
        await until(lambda: any(text in trouble for trouble in self.troubles), text)


@contextlib.asynccontextmanager
async def flying(**settings: Any) -> AsyncIterator[Vehicle]:
    vehicle = Vehicle(**settings)
    parts = [asyncio.create_task(part) for part in (vehicle.live(), mqtt.serve(vehicle.feed))]
    try:
        yield vehicle
    finally:
        for part in parts:
            part.cancel()
        ended = await asyncio.gather(*parts, return_exceptions=True)
    assert all(isinstance(end, asyncio.CancelledError) for end in ended), ended
