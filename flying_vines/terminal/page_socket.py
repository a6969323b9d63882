"""The WebSocket of a service's page; opened again after each loss."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

from aiohttp import (
    ClientConnectorError,
    ClientError,
    ClientSession,
    ClientTimeout,
    ClientWSTimeout,
    WSMsgType,
    WSServerHandshakeError,
)
from yarl import URL

from firmware_link.reconnect import KeptOpen, Policy, Problem, why_not
from flying_vines.terminal.page_protocol import LATE_S

POLICY = Policy(first_wait_s=0.25, longest_wait_s=4.0, opens_within_s=3.0, quiet_s=LATE_S)
CLOSING_S = 0.5
"""A page that is silent does not answer a goodbye, either."""
MAX_MESSAGE_BYTES = 1024 * 1024


class NotAdmittedError(Exception):
    """The page refuses us permanently; the text is a sentence."""


def socket_of(page: str) -> URL:
    """The WebSocket's URL for the page's URL. Raises `ValueError` if the page's URL is invalid."""
    with contextlib.suppress(ValueError):
        url = URL(page if "://" in page else f"http://{page}")
        if url.scheme in ("http", "https") and url.host:
            return url.with_path("/live").with_query(url.query)
    raise ValueError("give http://HOST:PORT, with an IPv6 address in brackets")


class PageSocket:
    """A link to a page's socket. `take` gets each message; `problem` is a sentence while there is no link."""

    def __init__(self, url: URL, token: str, take: Callable[[str], None]) -> None:
        self._why_down = "connecting"
        self._url = url
        self._headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._take = take
        self._to_send: asyncio.Queue[str] = asyncio.Queue(maxsize=1)
        self._kept = KeptOpen(POLICY, self._connect, self._changed)

    @property
    def problem(self) -> str:
        return self._why_down or ("no data from the page" if self._kept.is_silent else "")

    def send(self, text: str) -> None:
        """Send if there is a link; otherwise drop the text, because it would be late."""
        if not self.problem and not self._to_send.full():
            self._to_send.put_nowait(text)

    async def run(self) -> None:
        """Run until cancelled. Raises `NotAdmittedError`."""
        await self._kept.run()

    def _changed(self, up: bool, why: str) -> None:
        self._why_down = "" if up else why

    async def _connect(self) -> Problem:
        try:
            async with ClientSession(
                headers=self._headers, timeout=ClientTimeout(connect=POLICY.opens_within_s)
            ) as session:
                await self._communicate(session)
        except WSServerHandshakeError as refused:
            return Problem(_why(refused.status))
        except ClientConnectorError as error:
            return Problem(f"{error.host}:{error.port}: {why_not(error.os_error)}")
        except (ClientError, OSError) as error:
            return Problem(str(error) or type(error).__name__)
        return Problem("the page has closed the link")

    async def _communicate(self, session: ClientSession) -> None:
        async with session.ws_connect(
            self._url, max_msg_size=MAX_MESSAGE_BYTES, timeout=ClientWSTimeout(ws_close=CLOSING_S)
        ) as viewing:
            while not self._to_send.empty():
                self._to_send.get_nowait()
            self._kept.opened()
            sending = asyncio.create_task(self._send_all(viewing.send_str))
            try:
                async for message in viewing:
                    if message.type is not WSMsgType.TEXT:
                        return
                    self._kept.heard()
                    self._take(message.data)
            finally:
                sending.cancel()

    async def _send_all(self, send: Callable[[str], object]) -> None:
        while True:
            await send(await self._to_send.get())  # type: ignore[misc]


def _why(status: int) -> str:
    """The problem for an HTTP status. Raises `NotAdmittedError` if a retry cannot help."""
    if status == 401:
        raise NotAdmittedError(
            "the page needs a token: give --token-file FILE (`run` shows the token, or its file)"
        )
    if status in (403, 404, 421):
        raise NotAdmittedError(
            "this is not a Flying Vines page, or it refuses this host name: give its IP address"
        )
    if status == 503:
        return "too many viewers"
    return f"HTTP status {status}"
