"""The link to a page: over real sockets, to pages that misbehave."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import replace

import pytest
from aiohttp import web
from waiting import until

from firmware_link import reconnect
from flying_vines.terminal import page_socket
from flying_vines.terminal.page_socket import PageSocket, socket_of


class Page:
    """A page whose WebSocket does what `kind` says, and counts its visitors."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.visits = 0

    async def live(self, request: web.Request) -> web.WebSocketResponse:
        self.visits += 1
        if self.kind == "never answers the greeting":
            await asyncio.sleep(3600)
        socket = web.WebSocketResponse(autoping=False)
        await socket.prepare(request)
        if self.kind == "never closes":
            await asyncio.sleep(3600)
        while self.kind == "sends":
            await socket.send_str("{}")
            await asyncio.sleep(0.02)
        return socket


@contextlib.asynccontextmanager
async def watched(kind: str, host: str = "127.0.0.1") -> AsyncIterator[tuple[Page, PageSocket, list[str]]]:
    page, received = Page(kind), list[str]()
    application = web.Application()
    application.router.add_get("/live", page.live)
    runner = web.AppRunner(application, shutdown_timeout=0.1)
    await runner.setup()
    await web.TCPSite(runner, host, 0).start()
    port = runner.addresses[0][1]
    socket = PageSocket(
        socket_of(f"[{host}]:{port}" if ":" in host else f"{host}:{port}"), "", received.append
    )
    following = asyncio.create_task(socket.run())
    try:
        yield page, socket, received
    finally:
        following.cancel()
        await asyncio.wait({following})
        await runner.cleanup()


@pytest.fixture(autouse=True)
def in_a_hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    quick = replace(
        page_socket.POLICY, first_wait_s=0.02, longest_wait_s=0.05, opens_within_s=0.5, quiet_s=0.5
    )
    monkeypatch.setattr(page_socket, "POLICY", quick)
    monkeypatch.setattr(reconnect, "CHECK_S", 0.02)


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
async def test_messages_arrive(host: str) -> None:
    async with watched("sends", host) as (page, socket, received):
        await until(lambda: len(received) > 50, "messages")
        assert (page.visits, socket.problem) == (1, "")


@pytest.mark.parametrize(
    ("kind", "problem"),
    [
        ("never answers the greeting", "no answer"),
        ("never closes", "no data from the page"),
        ("closes at once", "the page has closed the link"),
    ],
)
async def test_a_page_that_does_not_serve_is_tried_again_and_said(kind: str, problem: str) -> None:
    async with watched(kind) as (page, socket, _):
        await until(lambda: page.visits >= 3, "visits")
        await until(lambda: socket.problem == problem, "the problem")
        page.kind = "sends"
        await until(lambda: socket.problem == "", "the link")


@pytest.mark.parametrize("url", ["http://::1:8017", "::1:8017", "ftp://drone", "http://", "drone:x"])
def test_what_is_no_page_is_refused_with_a_clear_line(url: str) -> None:
    with pytest.raises(ValueError, match=r"give http://HOST:PORT, with an IPv6 address in brackets"):
        socket_of(url)
