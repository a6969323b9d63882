"""How many may be there, how often they may ask, and what the page remembers."""

from __future__ import annotations

import math

import msgspec
import pytest
from page_bench import snapshot

from flying_vines.gateway.messages import Seen, raw
from flying_vines.gateway.page.crowd import (
    COME_AT_ONCE,
    COME_PER_S,
    MOST_ADDRESSES,
    MOST_STRANGERS,
    MOST_VIEWERS,
    MOST_VIEWERS_EACH,
    PATIENCE_S,
    Crowd,
)
from flying_vines.gateway.page.history import KEPT_S, History
from flying_vines.gateway.page.wish import MOST_AT_ONCE, MOST_PER_S, Wish, read_wish
from flying_vines.gateway.patience import Patience


def test_a_flood_from_one_address_pushes_out_its_own() -> None:
    crowd: Crowd[str] = Crowd()
    assert crowd.came("pilot", "192.168.4.2", 0.0) is None
    pushed = [crowd.came(f"flood {i}", "192.168.4.66", 1.0) for i in range(1000)]
    out = [who for who in pushed if who is not None]
    assert out == [f"flood {i}" for i in range(1000 - MOST_STRANGERS + 1)]
    assert crowd.look_on("pilot") == ""


def test_each_address_comes_so_often_and_no_more() -> None:
    crowd: Crowd[int] = Crowd()
    borne = sum(crowd.bears("10.0.0.66", 0.001 * i) for i in range(10_000))
    assert borne == pytest.approx(COME_AT_ONCE + 10 * COME_PER_S, abs=1)
    assert crowd.bears("10.0.0.1", 10.0)
    assert sum(crowd.bears("10.0.0.66", 11.0) for _ in range(1000)) == pytest.approx(COME_PER_S, abs=1)


def test_many_addresses_do_not_fill_the_memory_nor_hide_one_that_makes_trouble() -> None:
    crowd: Crowd[int] = Crowd()
    assert sum(crowd.bears("10.0.0.66", 0.0) for _ in range(1000)) == COME_AT_ONCE
    for i in range(2 * MOST_ADDRESSES):
        assert crowd.bears(f"10.0.1.{i}", 0.001 * i)
    assert sum(crowd.bears("10.0.0.66", 0.5) for _ in range(1000)) == 0.5 * COME_PER_S
    for i in range(10_000):
        assert crowd.bears(f"10.1.0.{i}", 0.6)
    assert len(crowd._patience) <= MOST_ADDRESSES


def test_viewers_are_not_pushed_out() -> None:
    crowd: Crowd[int] = Crowd()
    crowd.came(-1, "10.0.0.1", 0.0)
    assert crowd.look_on(-1) == ""
    assert -1 not in {crowd.came(i, "10.0.0.1", 0.0) for i in range(1000)}


def test_so_many_viewers_and_no_more() -> None:
    crowd: Crowd[int] = Crowd()
    for i in range(MOST_VIEWERS_EACH):
        crowd.came(i, "10.0.0.1", 0.0)
        assert crowd.look_on(i) == ""
    crowd.came(100, "10.0.0.1", 0.0)
    assert "from 10.0.0.1" in crowd.look_on(100)
    for i in range(1000, 1000 + MOST_VIEWERS - MOST_VIEWERS_EACH):
        crowd.came(i, f"10.0.1.{i}", 0.0)
        assert crowd.look_on(i) == ""
    crowd.came(101, "10.0.0.2", 0.0)
    assert crowd.look_on(101)
    crowd.left(0)
    assert crowd.look_on(101) == ""


def test_strangers_that_ask_for_nothing_are_overdue_once() -> None:
    crowd: Crowd[str] = Crowd()
    crowd.came("slow", "a", 0.0)
    crowd.came("viewer", "a", 0.0)
    crowd.came("new", "a", PATIENCE_S)
    crowd.look_on("viewer")
    assert crowd.overdue(PATIENCE_S) == []
    assert crowd.overdue(PATIENCE_S + 0.1) == ["slow"]
    assert crowd.overdue(PATIENCE_S + 0.2) == []
    assert crowd.look_on("slow") == "too many connections"


def test_patience_is_for_thumbs_not_for_floods() -> None:
    patience = Patience(0.0, MOST_AT_ONCE, MOST_PER_S)
    assert all(patience.bears(0.1 * i) for i in range(1000))
    patience = Patience(0.0, MOST_AT_ONCE, MOST_PER_S)
    assert [patience.bears(0.0) for _ in range(int(MOST_AT_ONCE) + 1)] == [True] * int(MOST_AT_ONCE) + [False]
    patience = Patience(0.0, MOST_AT_ONCE, MOST_PER_S)
    borne = sum(patience.bears(0.001 * i) for i in range(1000))
    assert borne <= MOST_AT_ONCE + MOST_PER_S


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
def test_what_is_no_wish_is_refused(text: str) -> None:
    with pytest.raises((msgspec.DecodeError, ValueError)):
        read_wish(text)


def test_a_wish_is_read() -> None:
    assert read_wish('{"id": 7, "command": "bend", "value": 30, "name": null}') == Wish(7, "bend", 30.0)
    assert read_wish('{"id": 8, "command": "profile", "name": "wave"}') == Wish(8, "profile", None, "wave")


def test_two_minutes_are_remembered_five_times_a_second() -> None:
    history = History()
    for i in range(3000):
        history.take(Seen(raw(snapshot(0.1 * i, cv_kPa=math.nan if i % 2 else 0.123456))))
    times = [sample.t for sample in history.samples]
    assert times[-1] - times[0] == pytest.approx(KEPT_S, abs=0.5)
    assert len(times) == pytest.approx(5 * KEPT_S, abs=3)
    assert history.samples[-1].cv_kPa == 0.12
    assert len(msgspec.json.encode(tuple(history.samples))) < 25_000


def test_a_pressure_that_is_not_known_is_remembered_as_that() -> None:
    history = History()
    history.take(Seen(raw(snapshot(1.0, cv_kPa=math.nan, reservoir_kPa=math.nan))))
    assert msgspec.json.encode(tuple(history.samples)) == b"[[1.0,null,0.0,null]]"
