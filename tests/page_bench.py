"""A page that is served in this process; the test holds the service's end of its feed."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from typing import Any

import msgspec
from aiohttp import ClientSession, ClientTimeout, ClientWebSocketResponse
from ports import free_port
from waiting import MAX_WAIT_S

from flying_vines.config import config
from flying_vines.config.config import PageConfig
from flying_vines.core.events import Decision
from flying_vines.core.snapshot import Snapshot
from flying_vines.gateway import page
from flying_vines.gateway.feed import Feed
from flying_vines.gateway.messages import (
    Answered,
    FromGateway,
    GatewayStart,
    Happened,
    Request,
    SnapshotMessage,
    Trouble,
    raw,
)
from flying_vines.supply import CyclesLeft
from flying_vines.vehicle.notice import Notice

TOKEN = "abcd-efgh-ijkl-mnop"


def snapshot(t: float = 0.0, **changed: Any) -> Snapshot:
    """The snapshot of a straight vine without any problem, with changes."""
    well: dict[str, Any] = {
        "t": t,
        "vehicle": "ardupilot 1",
        "mode": "GUIDED",
        "armed": True,
        "altitude_m": 6.0,
        "rc": "good",
        "switch_position": 0,
        "actuator": "phloSAR",
        "firmware": "ready",
        "round_trip_s": 0.004,
        "telemetry_gaps": 0,
        "reservoir_kPa": 600.0,
        "cv_kPa": 0.1,
        "command_kPa": 0.0,
        "bend_deg": 0.0,
        "evp_opening": 0.0,
        "dvp_opening": 0.0,
        "solenoid": True,
        "cycles": CyclesLeft(40.0, 35.0, 49.0, 3.0, 9.0, 80.0, 15.0, 1.2, 95.0, 80.0, 130.0),
        "doing": "vented",
    }
    return Snapshot(**{**well, **changed})


@dataclass
class Bench:
    """A served page, and the requests that it sent to its service."""

    page: PageConfig
    feed: Feed = field(init=False)
    flights: str = ""
    answers: bool = True
    answer: tuple[str, str] = ("accepted", "")
    asked: list[Request] = field(default_factory=list)
    troubles: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        conf = msgspec.structs.replace(config.default(), page=self.page)
        token = TOKEN if self.page.needs_token else ""
        self.feed = Feed(GatewayStart(conf, "1.2.3", token, self.flights), self._take)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.page.port}"

    def _take(self, message: FromGateway) -> None:
        if isinstance(message, Trouble):
            self.troubles.append(message.text)
        elif isinstance(message, Request):
            self.asked.append(message)
            if self.answers:
                safety, reason = self.answer
                assert safety in ("accepted", "limited", "refused")
                self.feed.take(Answered(message.number, safety, reason))  # type: ignore[arg-type]

    def show(self, shown: Snapshot) -> None:
        self.feed.take(SnapshotMessage(raw(shown)))

    def happen(self, action: Decision | Notice) -> None:
        self.feed.take(Happened(type(action).__name__.lower(), raw(action)))


@contextlib.asynccontextmanager
async def served(host: str = "127.0.0.1", flights: str = "") -> AsyncIterator[Bench]:
    bench = Bench(PageConfig(host=host, port=free_port()), flights=flights)
    serving = asyncio.create_task(page.serve(bench.feed))
    try:
        async with asyncio.timeout(MAX_WAIT_S):
            while not _listens(bench.page.port):
                assert not serving.done(), serving
                await asyncio.sleep(0.01)
        yield bench
    finally:
        serving.cancel()
        await asyncio.gather(serving, return_exceptions=True)


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@contextlib.asynccontextmanager
async def client(**headers: str) -> AsyncIterator[ClientSession]:
    async with ClientSession(headers=headers, timeout=ClientTimeout(total=MAX_WAIT_S)) as session:
        yield session


async def next_of_kind(viewer: ClientWebSocketResponse, kind: str) -> dict[str, Any]:
    """The next message of this type."""
    async with asyncio.timeout(MAX_WAIT_S):
        while True:
            message: dict[str, Any] = await viewer.receive_json()
            if message["kind"] == kind:
                return message
