"""The WebSocket of a service's page; reconnects after each loss."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable

from aiohttp import (
    ClientConnectorError,
    ClientError,
    ClientSession,
    ClientTimeout,
    WSMsgType,
    WSServerHandshakeError,
)
from yarl import URL

from flying_vines.terminal.page_protocol import LATE_S

OPENS_WITHIN_S = 3.0
FIRST_BACKOFF_S, MAX_BACKOFF_S = 0.25, 4.0
MAX_MESSAGE_BYTES = 1024 * 1024


class NotAdmittedError(Exception):
    """The page refuses us permanently; the text is a sentence."""


def socket_of(page: str) -> URL:
    """The WebSocket's URL for the page's URL. Raises `ValueError` if the page's URL is invalid."""
    url = URL(page if "://" in page else f"http://{page}")
    if url.scheme not in ("http", "https") or not url.host:
        raise ValueError("give http://HOST:PORT")
    return url.with_path("/live").with_query(url.query)


class PageSocket:
    """A link to a page's socket. `take` gets each message; `problem` is a sentence while there is no link."""

    def __init__(self, url: URL, token: str, take: Callable[[str], None]) -> None:
        self.problem = "connecting"
        self._url = url
        self._headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._take = take
        self._to_send: asyncio.Queue[str] = asyncio.Queue(maxsize=1)
        self._backoff_s = FIRST_BACKOFF_S

    def send(self, text: str) -> None:
        """Send if there is a link; otherwise drop the text, because it would be late."""
        if not self.problem and not self._to_send.full():
            self._to_send.put_nowait(text)

    async def run(self) -> None:
        """Run until cancelled. Raises `NotAdmittedError`."""
        async with ClientSession(
            headers=self._headers, timeout=ClientTimeout(connect=OPENS_WITHIN_S)
        ) as session:
            while True:
                try:
                    await self._communicate(session)
                    self.problem = "the page has closed the link"
                except WSServerHandshakeError as refused:
                    self.problem = _why(refused.status)
                except TimeoutError:
                    self.problem = "no data from the page"
                except ClientConnectorError as error:
                    self.problem = f"{error.host}:{error.port}: {os.strerror(error.errno or 0)}"
                except (ClientError, OSError) as error:
                    self.problem = str(error) or type(error).__name__
                await asyncio.sleep(self._backoff_s)
                self._backoff_s = min(2.0 * self._backoff_s, MAX_BACKOFF_S)

    async def _communicate(self, session: ClientSession) -> None:
        async with asyncio.timeout(OPENS_WITHIN_S):
            viewing = await session.ws_connect(self._url, max_msg_size=MAX_MESSAGE_BYTES)
        async with viewing:
            self.problem = ""
            while not self._to_send.empty():
                self._to_send.get_nowait()
            sending = asyncio.create_task(self._send_all(viewing.send_str))
            try:
                while True:
                    message = await viewing.receive(LATE_S)
                    if message.type is not WSMsgType.TEXT:
                        return
                    self._backoff_s = FIRST_BACKOFF_S
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
