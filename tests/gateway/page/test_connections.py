"""Limits of connections and requests, and the page's memory."""

from __future__ import annotations

import asyncio
import math
from typing import Any, cast

import msgspec
import pytest
from page_bench import snapshot

from flying_vines.config import config
from flying_vines.gateway.feed import Feed
from flying_vines.gateway.messages import GatewayStart, SnapshotMessage, raw
from flying_vines.gateway.page.access import (
    MAX_NEW,
    MAX_PILOTS,
    MAX_VIEWERS,
    Connections,
)
from flying_vines.gateway.page.viewer_session import (
    HISTORY_S,
    History,
    PageRequest,
    ViewerSession,
    read_request,
)


class OpenSocket:
    """A viewer that only watches."""

    async def send_str(self, text: str) -> None:
        pass

    def __aiter__(self) -> OpenSocket:
        return self

    async def __anext__(self) -> Any:
        await asyncio.Event().wait()


async def turns(count: int) -> None:
    """Let all tasks go on `count` times."""
    for _ in range(count):
        await asyncio.sleep(0)


def test_a_flood_from_one_address_pushes_out_its_own() -> None:
    held: Connections[str] = Connections()
    assert held.opened("pilot", "192.168.4.2") is None
    pushed = [held.opened(f"flood {i}", "192.168.4.66") for i in range(1000)]
    out = [who for who in pushed if who is not None]
    assert out == [f"flood {i}" for i in range(1000 - MAX_NEW + 1)]


def test_so_many_viewers_and_no_more() -> None:
    held: Connections[int] = Connections()
    for i in range(MAX_VIEWERS):
        held.opened(i, "10.0.0.1")
        assert held.add_viewer(i)
    held.opened(100, "10.0.0.2")
    assert not held.add_viewer(100)
    held.closed(0)
    assert held.add_viewer(100)


def test_viewers_are_not_pushed_out() -> None:
    held: Connections[int] = Connections()
    held.opened(-1, "10.0.0.1")
    assert held.add_viewer(-1)
    assert -1 not in {held.opened(i, "10.0.0.1") for i in range(1000)}


def test_viewers_take_no_place_of_a_pilot() -> None:
    held: Connections[str] = Connections()
    for i in range(2 * MAX_VIEWERS):
        held.opened(f"viewer {i}", f"10.0.0.{i % 4}")
        held.add_viewer(f"viewer {i}")
    held.opened("pilot", "10.0.0.1")
    assert held.add_pilot("pilot") is None
    assert "pilot" not in {held.opened(f"new {i}", "10.0.0.1") for i in range(1000)}


def test_of_too_many_pilots_the_oldest_goes() -> None:
    held: Connections[int] = Connections()
    for i in range(MAX_PILOTS):
        held.opened(i, "10.0.0.1")
        assert held.add_pilot(i) is None
    held.closed(1)
    for i, out in ((100, None), (101, 0), (102, 2)):
        held.opened(i, "10.0.0.1")
        assert held.add_pilot(i) == out


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[]",
        "vent",
        '{"id": 1}',
        '{"id": 1, "command": "explode"}',
        '{"id": 1, "command": "bend"}',
        '{"id": 1, "command": "bend", "value": "60"}',
        '{"id": 1, "command": "bend", "value": 1e999}',
        '{"id": 1, "command": "bend", "value": NaN}',
        '{"id": 1, "command": "vent", "value": 3}',
        '{"id": 1, "command": "profile", "name": "' + 101 * "x" + '"}',
        '{"id": -1, "command": "vent"}',
        '{"id": 1, "command": "vent", "by": "broker"}',
        '{"id": 1.5, "command": "vent"}',
        '{"id": 1, "command": "vent"',
        "[" * 400,
        "\x00",
    ],
)
def test_an_invalid_request_is_refused(text: str) -> None:
    with pytest.raises((msgspec.DecodeError, ValueError)):
        read_request(text)


def test_a_request_is_read() -> None:
    assert read_request('{"id": 7, "command": "bend", "value": 30, "name": null}') == PageRequest(
        7, "bend", 30.0
    )
    assert read_request('{"id": 8, "command": "profile", "name": "wave"}') == PageRequest(
        8, "profile", None, "wave"
    )


def test_two_minutes_are_remembered_five_times_a_second() -> None:
    history = History()
    for i in range(3000):
        history.take(SnapshotMessage(raw(snapshot(0.1 * i, cv_kPa=math.nan if i % 2 else 0.123456))))
    times = [sample.t for sample in history.samples]
    assert times[-1] - times[0] == pytest.approx(HISTORY_S, abs=0.5)
    assert len(times) == pytest.approx(5 * HISTORY_S, abs=3)
    assert history.samples[-1].cv_kPa == 0.12
    assert len(msgspec.json.encode(tuple(history.samples))) < 25_000


def test_a_pressure_that_is_not_known_is_remembered_as_that() -> None:
    history = History()
    history.take(SnapshotMessage(raw(snapshot(1.0, cv_kPa=math.nan, reservoir_kPa=math.nan))))
    assert msgspec.json.encode(tuple(history.samples)) == b"[[1.0,null,0.0,null]]"


@pytest.mark.parametrize("later", range(6))
async def test_a_session_that_is_ended_together_with_news_ends(later: int) -> None:
    feed = Feed(GatewayStart(config.default(), "1.2.3"), lambda message: None)
    session = ViewerSession(feed, History(), cast(Any, OpenSocket()), may_ask=False)
    serving = asyncio.create_task(session.serve())
    await turns(10)
    feed.take(SnapshotMessage(raw(snapshot())))
    await turns(later)
    serving.cancel()
    await turns(20)
    assert serving.cancelled()
