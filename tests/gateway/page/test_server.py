"""The page on real sockets: its content, access, and attacks."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import socket
import time
from collections.abc import AsyncIterator
from importlib import resources

import pytest
from aiohttp import ClientSession, TCPConnector, WSMsgType, WSServerHandshakeError
from page_bench import TOKEN, Bench, client, next_of_kind, served, snapshot
from ports import free_port
from real_time import real_time
from waiting import MAX_WAIT_S, until

from flying_vines.config.config import PageConfig
from flying_vines.core.events import Decision
from flying_vines.gateway import page, page_token
from flying_vines.gateway.page import server, viewer_session
from flying_vines.gateway.page.access import MAX_NEW, MAX_PILOTS, MAX_VIEWERS
from flying_vines.vehicle.notice import Notice, Severity

pytestmark = real_time

VENT = '{"id": 1, "command": "vent"}'


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    async with served() as bench:
        yield bench


@pytest.fixture
async def session() -> AsyncIterator[ClientSession]:
    async with client() as session:
        yield session


async def test_all_files_are_served_and_nothing_but_them(bench: Bench, session: ClientSession) -> None:
    folder = resources.files("flying_vines.gateway.page").joinpath("static")
    assert {name for name, _ in server.FILES.values()} == {file.name for file in folder.iterdir()}
    size = 0
    for path, (_, kind) in server.FILES.items():
        async with session.get(bench.url + path) as response:
            assert response.status == 200
            assert response.content_type == kind
            size += len(await response.read())
    assert size < 50_000
    for path in (
        "/../__init__.py",
        "/static/page.js",
        "/%2e%2e/server.py",
        "//style.css",
        "/page.js/",
        "/x" * 500,
    ):
        async with session.get(bench.url + path) as response:
            assert response.status == 404
    async with session.post(bench.url + "/", data=b"x" * 100_000) as response:
        assert response.status == 405


async def test_the_headers_forbid_the_browser_to_load_anything_else(
    bench: Bench, session: ClientSession
) -> None:
    async with session.get(bench.url) as response:
        policy = response.headers["Content-Security-Policy"]
        text = await response.text()
    assert "default-src 'self'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "unsafe" not in policy
    assert response.headers["X-Content-Type-Options"] == "nosniff"
    assert response.headers["Referrer-Policy"] == "no-referrer"
    assert response.headers["Server"] == "flying-vines"
    folder = resources.files("flying_vines.gateway.page").joinpath("static")
    for file in folder.iterdir():
        links = re.findall(
            r"(?:https?:)?//[\w.]+", file.read_text().replace("http://www.w3.org/2000/svg", "")
        )
        assert not [link for link in links if "." in link], file.name
    assert "style=" not in text
    assert "<script>" not in text


async def test_a_viewer_gets_past_events_and_the_present_state(bench: Bench, session: ClientSession) -> None:
    bench.happen(Notice(1.0, Severity.INFO, "Vine: ready"))
    bench.show(snapshot(2.0, cv_kPa=3.0))
    await asyncio.sleep(0)
    async with session.ws_connect(bench.url + "/live") as viewing:
        hello = await next_of_kind(viewing, "hello")
        assert hello["version"] == "1.2.3"
        assert hello["may_ask"]
        angles = {"straight": 0.0, "bend-half": 30.0, "bend-full": 60.0, "reach": 45.0, "wave": 40.0}
        assert hello["vine"]["profiles"] == angles
        assert hello["history"] == [[2.0, 3.0, 0.0, 600.0]]
        assert hello["happened"][0]["fields"]["text"] == "Vine: ready"
        assert (await next_of_kind(viewing, "snapshot"))["snapshot"]["cv_kPa"] == 3.0
        bench.happen(Decision(3.0, "page", {}, "vent", "accepted", "", 0.0))
        assert (await next_of_kind(viewing, "happened"))["fields"]["intent"] == "vent"
        bench.show(snapshot(3.0, cv_kPa=4.0))
        assert (await next_of_kind(viewing, "snapshot"))["snapshot"]["cv_kPa"] == 4.0


async def test_a_page_without_news_gets_signs_of_life(bench: Bench, session: ClientSession) -> None:
    async with session.ws_connect(bench.url + "/live") as viewing:
        await next_of_kind(viewing, "hello")
        await next_of_kind(viewing, "beat")


async def test_requests_are_answered(bench: Bench, session: ClientSession) -> None:
    async with session.ws_connect(bench.url + "/live") as viewing:
        await viewing.send_str('{"id": 5, "command": "bend", "value": 30}')
        assert await next_of_kind(viewing, "answer") == {
            "kind": "answer",
            "id": 5,
            "safety": "accepted",
            "reason": "",
        }
        bench.answer = ("refused", "not armed")
        await viewing.send_str('{"id": 6, "command": "profile", "name": "wave"}')
        answer = await next_of_kind(viewing, "answer")
    assert (answer["safety"], answer["reason"]) == ("refused", "not armed")
    assert [(ask.by, ask.command, ask.value, ask.name) for ask in bench.asked] == [
        ("page", "bend", 30.0, None),
        ("page", "profile", None, "wave"),
    ]


async def test_a_request_has_at_least_its_stated_age(bench: Bench, session: ClientSession) -> None:
    loop = asyncio.get_running_loop()
    began = loop.time()
    async with session.ws_connect(bench.url + "/live") as viewing:
        for times in ("", f', "made_at": {began - 9}, "seen_at": 7.5', f', "made_at": {began + 9}'):
            await viewing.send_str(f'{{"id": 5, "command": "hold"{times}}}')
            await next_of_kind(viewing, "answer")
    made = [ask.made_at for ask in bench.asked]
    assert made[1] == began - 9
    assert all(at is not None and began <= at <= loop.time() for at in (made[0], made[2]))
    assert [ask.seen_at for ask in bench.asked] == [None, 7.5, None]


async def test_a_client_that_waits_for_an_answer_can_still_vent(bench: Bench, session: ClientSession) -> None:
    async with session.ws_connect(bench.url + "/live") as viewing:
        bench.answers = False
        for i in range(5):
            await viewing.send_str(f'{{"id": {i}, "command": "hold"}}')
        await until(lambda: len(bench.asked) == 5, "all are asked")
        bench.answers = True
        await viewing.send_str('{"id": 9, "command": "vent"}')
        answer = await next_of_kind(viewing, "answer")
        assert (answer["id"], answer["safety"]) == (9, "accepted")
        answer = await next_of_kind(viewing, "answer")
        assert (answer["safety"], answer["reason"]) == ("unanswered", "the service does not answer")


@pytest.mark.parametrize("path", ["/", "/page.js", "/live"])
async def test_other_sites_and_other_names_are_refused(
    bench: Bench, session: ClientSession, path: str
) -> None:
    for headers, status in (
        ({"Origin": "http://evil.example"}, 403),
        ({"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"}, 403),
        ({"Host": "evil.example"}, 421),
        ({"Host": ""}, 421),
    ):
        async with session.get(bench.url + path, headers=headers) as response:
            assert response.status == status
    with pytest.raises(WSServerHandshakeError) as refused:
        await session.ws_connect(bench.url + "/live", origin="http://evil.example")
    assert refused.value.status == 403
    assert not bench.asked


async def test_on_the_network_it_opens_by_token_then_by_cookie() -> None:
    async with served("0.0.0.0") as bench, client() as session:
        with pytest.raises(WSServerHandshakeError) as refused:
            await session.ws_connect(bench.url + "/live")
        assert refused.value.status == 401
        for path in server.FILES:
            async with session.get(bench.url + path) as response:
                assert response.status == 401
                assert "Token" in await response.text()
        async with session.get(bench.url + "/?token=wrong-one-is-not-right") as response:
            assert response.status == 401
            assert "Set-Cookie" not in response.headers
        async with session.get(f"{bench.url}/?token={TOKEN}") as response:
            assert response.status == 200
            cookie = response.headers["Set-Cookie"]
        assert "HttpOnly" in cookie
        assert "SameSite=Strict" in cookie
        remembered = {"Cookie": cookie.partition(";")[0]}
        async with session.ws_connect(bench.url + "/live", headers=remembered) as viewing:
            assert (await next_of_kind(viewing, "hello"))["may_ask"]


async def test_requests_of_a_viewer_are_refused() -> None:
    token = page_token.watching(TOKEN)
    async with served("0.0.0.0") as bench, client(Authorization=f"Bearer {token}") as session:
        async with session.ws_connect(bench.url + "/live") as viewing:
            assert not (await next_of_kind(viewing, "hello"))["may_ask"]
            await viewing.send_str(VENT)
            assert (await next_of_kind(viewing, "answer"))["reason"] == "you may only watch"
        assert not bench.asked


@pytest.mark.parametrize(
    "said, code",
    [
        ("x" * 513, 1009),
        ("not JSON", 1007),
        ('{"id": 1, "command": "explode"}', 1007),
        (b"\x00\x01", 1000),
    ],
)
async def test_an_invalid_message_ends_only_its_own_socket(
    bench: Bench, session: ClientSession, said: str | bytes, code: int
) -> None:
    async with (
        session.ws_connect(bench.url + "/live") as pilot,
        session.ws_connect(bench.url + "/live") as other,
    ):
        await (other.send_str(said) if isinstance(said, str) else other.send_bytes(said))
        async with asyncio.timeout(MAX_WAIT_S):
            async for message in other:
                assert message.type is WSMsgType.TEXT
        assert other.close_code == code
        await _vents(pilot)
    assert [ask.command for ask in bench.asked] == ["vent"]


async def test_a_client_that_asks_too_often_is_disconnected(bench: Bench, session: ClientSession) -> None:
    async with (
        session.ws_connect(bench.url + "/live") as pilot,
        session.ws_connect(bench.url + "/live") as flood,
    ):
        with contextlib.suppress(ConnectionError):
            for i in range(1000):
                await flood.send_str(f'{{"id": {i}, "command": "vent"}}')
        async with asyncio.timeout(MAX_WAIT_S):
            async for _ in flood:
                pass
        assert flood.close_code in (1013, 1006)
        assert len(bench.asked) < 100
        await _vents(pilot)


async def test_pings_are_answered_but_not_too_many(bench: Bench, session: ClientSession) -> None:
    async with (
        session.ws_connect(bench.url + "/live", heartbeat=0.2) as pilot,
        session.ws_connect(bench.url + "/live") as flood,
    ):
        with contextlib.suppress(ConnectionError):
            for _ in range(1000):
                await flood.ping()
        async with asyncio.timeout(MAX_WAIT_S):
            async for _ in flood:
                pass
        assert flood.close_code in (1013, 1006)
        # A client disconnects if its pings are not answered.
        await next_of_kind(pilot, "beat")
        await _vents(pilot)


async def test_viewers_from_four_addresses_and_half_open_connections_keep_no_pilot_out() -> None:
    """One pilot shares an attacker's address, and one does not."""
    watching = f"Bearer {page_token.watching(TOKEN)}"
    addresses = [f"127.0.0.{number}" for number in (61, 62, 63, 64)]
    async with served("0.0.0.0") as bench, contextlib.AsyncExitStack() as stack:
        viewers = [await stack.enter_async_context(_from(address, watching)) for address in addresses]
        for i in range(MAX_VIEWERS):
            await stack.enter_async_context(viewers[i % 4].ws_connect(bench.url + "/live"))
        for viewer_session in viewers:
            with pytest.raises(WSServerHandshakeError) as refused:
                await viewer_session.ws_connect(bench.url + "/live")
            assert refused.value.status == 503
        flood = [stack.enter_context(_started(bench.page.port, addresses[i % 4])) for i in range(4 * MAX_NEW)]
        for address in (addresses[0], "127.0.0.1"):
            async with _from(address, f"Bearer {TOKEN}") as pilot, asyncio.timeout(1.0):
                async with pilot.get(bench.url + "/") as response:
                    assert response.status == 200
                async with pilot.ws_connect(bench.url + "/live") as viewing:
                    await _vents(viewing)
        assert [ask.command for ask in bench.asked] == ["vent", "vent"]
        assert sum(not _closed(connection) for connection in flood) <= MAX_NEW


async def test_of_too_many_pilots_the_oldest_goes(bench: Bench, session: ClientSession) -> None:
    """Pages left open do not lock out a pilot who needs one now."""
    async with contextlib.AsyncExitStack() as stack:
        pilots = [
            await stack.enter_async_context(session.ws_connect(bench.url + "/live"))
            for _ in range(MAX_PILOTS + 1)
        ]
        await _vents(pilots[-1])
        await _vents(pilots[1])
        async with asyncio.timeout(MAX_WAIT_S):
            async for _ in pilots[0]:
                pass


async def test_a_slow_reader_is_dropped_and_delays_nothing(
    bench: Bench, session: ClientSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(viewer_session, "SLOW_S", 0.3)
    slow = socket.create_connection(("127.0.0.1", bench.page.port))
    with slow:
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow.sendall(
            f"GET /live HTTP/1.1\r\nHost: 127.0.0.1:{bench.page.port}\r\nUpgrade: websocket\r\n"
            "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
        )
        async with session.ws_connect(bench.url + "/live") as pilot:
            await next_of_kind(pilot, "hello")
            long = snapshot(doing="x" * 40_000)
            for i in range(60):
                bench.show(long)
                await next_of_kind(pilot, "snapshot")
                if i == 30:
                    await asyncio.sleep(0.5)
            await _vents(pilot)
        slow.settimeout(MAX_WAIT_S)
        with contextlib.suppress(ConnectionResetError):
            async with asyncio.timeout(MAX_WAIT_S):
                while await asyncio.to_thread(slow.recv, 65536):
                    pass


def _from(address: str, authorization: str) -> ClientSession:
    return ClientSession(
        connector=TCPConnector(local_addr=(address, 0)), headers={"Authorization": authorization}
    )


def _started(port: int, address: str = "127.0.0.66") -> socket.socket:
    """A stranger's connection that begins a request and never ends it."""
    connection = socket.create_connection(("127.0.0.1", port), source_address=(address, 0))
    connection.setblocking(False)
    with contextlib.suppress(OSError):
        connection.send(b"GET / HTTP/1.1\r\nX: ")
    return connection


def _closed(connection: socket.socket) -> bool:
    try:
        return connection.recv(1) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True


async def _vents(viewing: object, number: int = 1) -> None:
    await viewing.send_str(json.dumps({"id": number, "command": "vent"}))  # type: ignore[attr-defined]
    answer = await next_of_kind(viewing, "answer")  # type: ignore[arg-type]
    assert (answer["id"], answer["safety"]) == (number, "accepted")


async def test_a_port_that_is_taken_is_reported_and_had_later(session: ClientSession) -> None:
    bench = Bench(PageConfig(port=free_port()))
    taken = "cannot be opened: Address already in use"
    with socket.create_server(("127.0.0.1", bench.page.port)), pytest.raises(OSError, match=taken):
        await page.serve(bench.feed)
    serving = asyncio.create_task(page.serve(bench.feed))
    await asyncio.sleep(0)
    async with session.get(bench.url) as response:
        assert response.status == 200
    serving.cancel()
    await asyncio.gather(serving, return_exceptions=True)


async def test_it_ends_at_once_with_viewers_and_they_see_it(session: ClientSession) -> None:
    async with served() as bench:
        viewing = await session.ws_connect(bench.url + "/live")
        await next_of_kind(viewing, "hello")
        began = time.monotonic()
    assert time.monotonic() - began < 10.0, "aiohttp alone waits for a minute"
    async with asyncio.timeout(MAX_WAIT_S):
        while (await viewing.receive()).type not in (WSMsgType.CLOSED, WSMsgType.CLOSE, WSMsgType.ERROR):
            pass
