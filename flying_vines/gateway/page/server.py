"""The page's port: plain HTTP, a few files, and a WebSocket for each viewer."""

from __future__ import annotations

import asyncio
import html
import ipaddress
import logging
import os
import socket
from importlib import resources
from pathlib import Path

from aiohttp import hdrs
from aiohttp.web import (
    BaseRequest,
    FileResponse,
    RequestHandler,
    Response,
    Server,
    StreamResponse,
    WebSocketResponse,
)

from flying_vines.gateway.feed import Feed
from flying_vines.gateway.messages import SnapshotMessage
from flying_vines.gateway.page import flights
from flying_vines.gateway.page.access import MAX_VIEWERS, Access, Connections, Refused
from flying_vines.gateway.page.viewer_session import MAX_REQUEST_BYTES, History, ViewerSession

KEEP_ALIVE_S = 5.0
CLOSING_S = 0.2
HEARTBEAT_S = 10.0
MAX_BACKLOG = 1024
"""Maximum number of connections that wait until we accept them."""
ACCEPT_RETRY_S = 1.0
"""Wait if the process has no free file descriptor."""
SEND_BUFFER = 32 * 1024
"""Size of the system's buffer and of ours, bytes. Small, because a slow viewer gets buffered data late."""
A_YEAR_S = 365 * 24 * 3600

FILES = {
    "/": ("index.html", "text/html"),
    "/style.css": ("style.css", "text/css"),
    "/page.js": ("page.js", "text/javascript"),
    "/drawing.js": ("drawing.js", "text/javascript"),
    "/link.js": ("link.js", "text/javascript"),
    "/words.js": ("words.js", "text/javascript"),
    "/icon.svg": ("icon.svg", "image/svg+xml"),
}
HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "Server": "flying-vines",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


async def serve(feed: Feed) -> None:
    """Serve until cancelled. Raises `OSError` if the port is not free."""
    page = feed.start.config.page
    access = Access(page.host, page.port, feed.start.page_token)
    history = History()
    try:
        listener = _listener(page.host, page.port)
    except OSError as error:
        why = os.strerror(error.errno or 0)
        raise OSError(f"{page.host}:{page.port} cannot be opened: {why}") from None
    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(_remember(feed, history))
        tasks.create_task(PageServer(feed, access, history).serve(listener))


async def _remember(feed: Feed, history: History) -> None:
    with feed.reader() as reader:
        while True:
            for message in await reader.next():
                if isinstance(message, SnapshotMessage):
                    history.take(message)


def _listener(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ipaddress.ip_address(host).version == 6 else socket.AF_INET
    listener = socket.create_server(
        (host, port), family=family, backlog=MAX_BACKLOG, dualstack_ipv6=host == "::"
    )
    # Accepted connections inherit this option.
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
    listener.setblocking(False)
    return listener


class PageServer(Server):
    """All connections to the page."""

    def __init__(self, feed: Feed, access: Access, history: History) -> None:
        # aiohttp would log every malformed request, and strangers can send many.
        silent = logging.Logger("flying_vines.page", logging.CRITICAL + 1)
        super().__init__(
            self._answer,
            keepalive_timeout=KEEP_ALIVE_S,
            lingering_time=CLOSING_S,
            access_log=None,
            logger=silent,
        )
        self._feed = feed
        self._access = access
        self._history = history
        self._limits: Connections[asyncio.Transport] = Connections()
        folder = resources.files("flying_vines.gateway.page").joinpath("static")
        self._files = {
            path: (folder.joinpath(name).read_bytes(), kind) for path, (name, kind) in FILES.items()
        }

    async def serve(self, listener: socket.socket) -> None:
        """Serve until cancelled; then all connections are closed at once."""
        try:
            await self._receive(listener)
        finally:
            listener.close()
            for transport in self._connections.values():
                transport.abort()
            await self.shutdown(CLOSING_S)

    async def _receive(self, listener: socket.socket) -> None:
        # asyncio's own server accepts all waiting connections in one loop turn: a flood would delay a vent.
        loop = asyncio.get_running_loop()
        while True:
            try:
                connection, _ = await loop.sock_accept(listener)
                await loop.connect_accepted_socket(self, connection)
            except ConnectionError:
                # The client closed it before we accepted.
                continue
            except OSError:
                await asyncio.sleep(ACCEPT_RETRY_S)

    def connection_made(self, handler: RequestHandler, transport: asyncio.Transport) -> None:
        super().connection_made(handler, transport)
        transport.set_write_buffer_limits(high=SEND_BUFFER)
        peer = transport.get_extra_info("peername")
        address = str(peer[0]) if peer else "unknown"
        self._close(self._limits.opened(transport, address))

    def connection_lost(self, handler: RequestHandler, exc: BaseException | None = None) -> None:
        transport = self._connections.get(handler)
        if transport is not None:
            self._limits.closed(transport)
        super().connection_lost(handler, exc)

    def _close(self, transport: asyncio.Transport | None) -> None:
        if transport is not None:
            transport.abort()

    async def _answer(self, request: BaseRequest) -> StreamResponse:
        if request.method not in (hdrs.METH_GET, hdrs.METH_HEAD):
            return _refusal(Refused(405, "this page accepts GET and HEAD only"))
        found = self._access.check(request.headers, request.query.get("token", ""), request.cookies)
        if isinstance(found, Refused):
            return _refusal(found)
        if request.path == "/live":
            return await self._show(request, found.may_ask)
        if request.path == "/flights" or request.path.startswith("/flights/"):
            return await self._offer(request, found.may_ask)
        if request.path not in self._files:
            return _refusal(Refused(404, "there is no such page"))
        body, kind = self._files[request.path]
        response = Response(body=body, content_type=kind, charset="utf-8", headers=_headers(request.host))
        if found.token:
            response.set_cookie(
                self._access.cookie, found.token, max_age=A_YEAR_S, httponly=True, samesite="Strict"
            )
        return response

    async def _offer(self, request: BaseRequest, may_ask: bool) -> StreamResponse:
        """The list of flights, or a flight's file. Only for the full token: a log holds the configuration."""
        if not may_ask:
            return _refusal(Refused(403, "flights are for holders of the full token"))
        if not self._feed.start.flights:
            return _refusal(Refused(404, "this service offers no flights"))
        folder = Path(self._feed.start.flights)
        _, _, flight, name = (*request.path.split("/"), "", "")[:4]
        try:
            if request.path == "/flights":
                page = await asyncio.to_thread(lambda: flights.page_of(flights.listed(folder)))
                headers = _headers(request.host)
                return Response(text=page, content_type="text/html", charset="utf-8", headers=headers)
            path = await asyncio.to_thread(flights.file_of, folder, flight, name)
        except OSError as error:
            return _refusal(Refused(404, f"the flights cannot be read: {os.strerror(error.errno or 0)}"))
        if path is None or request.path != f"/flights/{flight}/{name}":
            return _refusal(Refused(404, "there is no such flight"))
        saved_as = f'attachment; filename="{flight}{path.suffix}"'
        return FileResponse(path, headers={**HEADERS, "Content-Disposition": saved_as})

    async def _show(self, request: BaseRequest, may_ask: bool) -> StreamResponse:
        viewing = WebSocketResponse(
            autoping=False,
            heartbeat=HEARTBEAT_S,
            compress=False,
            max_msg_size=MAX_REQUEST_BYTES,
            writer_limit=SEND_BUFFER // 2,
        )
        transport = request.transport
        if transport is None or transport.is_closing() or not viewing.can_prepare(request).ok:
            return _refusal(Refused(400, "this address is for the page itself"))
        if may_ask:
            self._close(self._limits.add_pilot(transport))
        elif not self._limits.add_viewer(transport):
            return _refusal(Refused(503, f"the limit of {MAX_VIEWERS} viewers is reached"))
        await viewing.prepare(request)
        try:
            await ViewerSession(self._feed, self._history, viewing, may_ask).serve()
        except (TimeoutError, ConnectionError):
            transport.abort()
        return viewing


def _headers(host: str) -> dict[str, str]:
    # In some browsers 'self' does not include a WebSocket to the same host.
    policy = (
        f"default-src 'self'; connect-src 'self' ws://{host}; object-src 'none'; base-uri 'none'; "
        "form-action 'self'; frame-ancestors 'none'"
    )
    return {**HEADERS, "Content-Security-Policy": policy}


_REFUSAL = """\
<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>Flying Vines</title><h1>Flying Vines</h1><p>{why}.</p>{form}
"""
_FORM = """\
<form><p><label>Token <input name="token" autocomplete="off" autocapitalize="none" autofocus></label>
<button>Open</button></form>
<p>The service on the drone prints the token at its start, or the name of the file that contains it."""


def _refusal(refused: Refused) -> Response:
    why = html.escape(refused.why[:1].upper() + refused.why[1:])
    text = _REFUSAL.format(why=why, form=_FORM if refused.status == 401 else "")
    policy = "default-src 'none'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    response = Response(
        status=refused.status,
        text=text,
        content_type="text/html",
        headers={**HEADERS, "Content-Security-Policy": policy},
    )
    response.force_close()
    return response
