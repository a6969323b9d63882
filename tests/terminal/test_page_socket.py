"""The link to a page, with scripted connections and no waiting."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest
from aiohttp import ClientConnectionError, WSMsgType

from flying_vines.terminal import page_socket
from flying_vines.terminal.page_socket import FIRST_BACKOFF_S, PageSocket, socket_of

DOWN = [ClientConnectionError()]
TEXT, CLOSED = (SimpleNamespace(type=kind, data="{}") for kind in (WSMsgType.TEXT, WSMsgType.CLOSED))


class Page:
    """A session, and its present connection. A connection is opened, then receives; each may be an error."""

    def __init__(self, connections: list[list[Any]]) -> None:
        self._connections = iter(connections)

    async def __aenter__(self) -> Page:
        return self

    async def __aexit__(self, *_: object) -> None:
        pass

    async def ws_connect(self, *_: object, **__: object) -> Page:
        self._received = iter(next(self._connections))
        await self.receive()
        return self

    async def receive(self, *_: object) -> Any:
        received = next(self._received)
        if isinstance(received, Exception):
            raise received
        return received

    async def send_str(self, text: str) -> None:
        raise AssertionError(text)


async def waits(monkeypatch: pytest.MonkeyPatch, *connections: list[Any]) -> list[float]:
    """The waits after these connections, as multiples of the first one."""
    slept: list[float] = []

    async def sleep(seconds: float) -> None:
        slept.append(seconds / FIRST_BACKOFF_S)
        if len(slept) == len(connections):
            raise asyncio.CancelledError

    monkeypatch.setattr(page_socket, "ClientSession", lambda **_: Page(list(connections)))
    monkeypatch.setattr(asyncio, "sleep", sleep)
    with pytest.raises(asyncio.CancelledError):
        await PageSocket(socket_of("drone"), "", lambda text: None).run()
    return slept


@pytest.mark.parametrize("end", [CLOSED, TimeoutError(), ClientConnectionError()])
async def test_a_link_that_has_worked_is_soon_opened_again(monkeypatch: pytest.MonkeyPatch, end: Any) -> None:
    assert await waits(monkeypatch, DOWN, DOWN, [None, TEXT, end], DOWN) == [1, 2, 1, 2]


@pytest.mark.parametrize("end", [CLOSED, TimeoutError()])
async def test_a_link_without_a_message_has_not_worked(monkeypatch: pytest.MonkeyPatch, end: Any) -> None:
    assert await waits(monkeypatch, [None, end], [None, end], [None, end]) == [1, 2, 4]
