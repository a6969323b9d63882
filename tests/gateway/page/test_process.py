"""The page of the real service over its socket, without a browser."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import socket
from pathlib import Path
from typing import Any

import pytest
from aiohttp import ClientSession, ClientWebSocketResponse
from page_bench import client, next_of_kind
from page_service import Served, serving
from real_time import real_time
from waiting import until

from flying_vines.gateway import page_token

pytestmark = real_time


async def ask(viewing: ClientWebSocketResponse, command: str, **what: Any) -> tuple[str, str]:
    """Send a request. Returns the result."""
    await viewing.send_str(json.dumps({"id": 1, "command": command, **what}))
    answer = await next_of_kind(viewing, "answer")
    return answer["safety"], answer["reason"]


async def ready(viewing: ClientWebSocketResponse) -> None:
    while True:
        now = (await next_of_kind(viewing, "snapshot"))["snapshot"]
        if now["firmware"] == "ready" and now["vehicle"] != "not found":
            return


async def test_it_bends_and_vents_the_vine_and_its_process_may_die(tmp_path: Path) -> None:
    async with serving(tmp_path) as served, client() as session:
        assert f"Page {served.url}" in served.output.read_text()
        async with session.ws_connect(served.url + "live") as viewing:
            await ready(viewing)
            only_there = ("refused", "the page can bend the vine only in bench mode")
            assert await ask(viewing, "bend", value=50) == only_there
            assert await ask(viewing, "start_bench") == ("accepted", "")
            assert await ask(viewing, "profile", name="nothing") == (
                "refused",
                "there is no profile 'nothing'",
            )
            assert await ask(viewing, "bend", value=50) == ("accepted", "")
            await until(served.bench.bent, "the vine bends")
            before = served.gateway
            os.kill(before, signal.SIGKILL)
            while not viewing.closed:
                await viewing.receive()
        assert served.bench.bent(), "that nobody looks on any more moves nothing"
        await _another(served, before)
        await until(served.listens, "the page is back")
        async with session.ws_connect(served.url + "live") as viewing:
            await _vents_under_a_flood(viewing, served.port)
            await until(served.bench.vented, "the vine is vented")
            assert not served.bench.phlosar.firmware.faults


@pytest.mark.long
async def test_a_page_that_hangs_or_ends_is_back_within_five_seconds(tmp_path: Path) -> None:
    async with serving(tmp_path) as served, client() as session:
        async with session.ws_connect(served.url + "live") as viewing:
            await ready(viewing)
            assert await ask(viewing, "start_bench") == ("accepted", "")
            assert await ask(viewing, "bend", value=50) == ("accepted", "")
        await until(served.bench.bent, "the vine bends")
        for harm in (signal.SIGSTOP, signal.SIGKILL):
            before = served.gateway
            os.kill(before, harm)
            async with asyncio.timeout(5.0):
                await _another(served, before)
                await until(served.listens, "the page is back")
                assert served.bench.bent(), "the vine is not moved by it"
                async with session.ws_connect(served.url + "live") as viewing:
                    # It names the state that it has seen, so it is not an old page.
                    await next_of_kind(viewing, "snapshot")
                    assert await ask(viewing, "hold") == ("accepted", "")
        async with session.ws_connect(served.url + "live") as viewing:
            assert await ask(viewing, "vent") == ("accepted", "")
        await until(served.bench.vented, "the vine is vented")
        assert not served.bench.phlosar.firmware.faults
        said = served.output.read_text()
    assert said.count("page and broker stopped") == 1, "two in a row are told once"
    assert "page and broker stopped (it hung), starting again" in said


@pytest.mark.long
async def test_an_unanswered_request_is_not_executed_when_the_service_continues(tmp_path: Path) -> None:
    async with (
        serving(tmp_path) as served,
        client() as session,
        session.ws_connect(served.url + "live") as viewing,
    ):
        await ready(viewing)
        assert await ask(viewing, "start_bench") == ("accepted", "")
        os.kill(served.pid, signal.SIGSTOP)
        assert await ask(viewing, "bend", value=50) == ("unanswered", "the service does not answer")
        await asyncio.sleep(1.0)
        os.kill(served.pid, signal.SIGCONT)
        while True:
            told = await next_of_kind(viewing, "happened")
            if told["what"] == "decision" and told["fields"]["intent"] == "bend 50°":
                break
        assert told["fields"]["safety"] == "refused"
        assert told["fields"]["reason"].startswith("too late: requested ")
        await asyncio.sleep(1.0)
        assert not served.bench.bent()
        shown = await _all_well(viewing)
        assert await ask(viewing, "bend", value=50, made_at=shown) == ("accepted", "")
        late, _ = await ask(viewing, "bend", value=40, made_at=shown - 5.0)
        assert late == "refused"
        assert await ask(viewing, "vent", made_at=shown - 5.0) == ("accepted", "")


async def _all_well(viewing: ClientWebSocketResponse) -> float:
    """Wait for a new state without faults, and return its time. Latched faults of the board are cleared."""
    while True:
        now = (await next_of_kind(viewing, "snapshot"))["snapshot"]
        lies_here_s = asyncio.get_running_loop().time() - now["t"]
        if not now["safe_state"] and lies_here_s < 0.3:
            return float(now["t"])
        await ask(viewing, "clear_faults", seen_at=now["t"])


async def _another(served: Served, before: int) -> None:
    await until(lambda: _alive(served.pid, before), "it is started again")


def _alive(pid: int, before: int) -> bool:
    """True if there is a child process, and not the former one."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return bool(children) and str(before) not in children


async def _vents_under_a_flood(viewing: ClientWebSocketResponse, port: int) -> None:
    with contextlib.ExitStack() as stack:
        # The fakes run in this loop, which must not be delayed.
        flooding = asyncio.create_task(asyncio.to_thread(_flood, stack, port))
        await asyncio.sleep(0.05)
        assert await ask(viewing, "vent") == ("accepted", "")
        await flooding
        assert await ask(viewing, "vent") == ("accepted", "")


def _flood(stack: contextlib.ExitStack, port: int) -> None:
    for _ in range(1000):
        connection = stack.enter_context(socket.create_connection(("127.0.0.1", port)))
        with contextlib.suppress(OSError):
            connection.send(b"GET / HTTP/1.1\r\n")


async def test_its_token_is_made_and_never_logged(tmp_path: Path) -> None:
    async with serving(tmp_path, host="0.0.0.0") as served, client() as session:
        file = tmp_path / "vine.page-token"
        token = page_token.read(file)
        said = served.output.read_text()
        assert f"token in {file}" in said
        assert token not in said
        assert await _status(session, served.url) == 401
        assert await _status(session, f"{served.url}?token={token}") == 200


async def _status(session: ClientSession, url: str) -> int:
    async with session.get(url) as response:
        return response.status
