"""What we send unasked: steady, spread out, short, and nothing twice."""

from __future__ import annotations

import itertools
import math
from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.codec import Codec, Message
from flying_vines.vehicle.component import SAME_TEXT_AGAIN_S, TEXT_SPACING_S, Component, answer_timesync

TICK_S = 0.02
VALUES = {"RES_KPA": 500.0, "CYC_LEFT": 40.0, "CV_KPA": 3.0, "CMD_KPA": 2.5, "BEND_DEG": 12.0}


def run(
    component: Component, for_s: float, values: dict[str, float] | None = None, start_s: float = 0.0
) -> list[tuple[float, Message]]:
    """What is sent, as a receiver has it."""
    sender, receiver, received = Codec(1, 191), Codec(255, 190), []
    for i in range(round(for_s / TICK_S)):
        t = start_s + i * TICK_S
        due = component.due(t, int(t * 1000), VALUES if values is None else values, 4)
        for message in due:
            received += [(t, m) for m in receiver.decode(sender.encode(message, 1))]
    return received


def of(kind: str, sent: list[tuple[float, Message]]) -> list[tuple[float, Message]]:
    return [(t, message) for t, message in sent if message.get_type() == kind]


def gaps_s(times_s: list[float]) -> list[float]:
    return [b - a for a, b in itertools.pairwise(times_s)]


def test_a_heartbeat_each_second_that_says_what_we_are() -> None:
    beats = of("HEARTBEAT", run(Component(2.0), 100.0))
    assert len(beats) == 100
    assert all(gap_s == pytest.approx(1.0) for gap_s in gaps_s([t for t, _ in beats]))
    _, beat = beats[0]
    assert (beat.type, beat.autopilot, beat.base_mode, beat.system_status) == (18, 8, 0, 4)
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == (1, 191)


def test_five_values_each_twice_a_second_never_two_at_once() -> None:
    sent = of("NAMED_VALUE_FLOAT", run(Component(2.0), 60.0))
    assert max(Counter(t for t, _ in sent).values()) == 1
    for name, value in VALUES.items():
        times_s = [t for t, message in sent if message.name == name]
        assert len(times_s) == pytest.approx(120, abs=2)
        assert all(gap_s == pytest.approx(0.5, abs=TICK_S + 1e-6) for gap_s in gaps_s(times_s)[1:])
        assert {message.value for _, message in sent if message.name == name} == {value}
    assert all(0.08 - 1e-9 <= gap_s <= 0.14 for gap_s in gaps_s([t for t, _ in sent]))
    assert all(message.time_boot_ms == int(t * 1000) for t, message in sent)


@pytest.mark.parametrize("rate_Hz", [0.1, 1.0, 5.0, 10.0])
def test_other_rates_are_kept_too(rate_Hz: float) -> None:
    sent = of("NAMED_VALUE_FLOAT", run(Component(rate_Hz), 40.0))
    counts = Counter(message.name for _, message in sent)
    assert all(count == pytest.approx(40 * rate_Hz, rel=0.1, abs=2) for count in counts.values())
    assert len(counts) == 5
    assert max(Counter(t for t, _ in sent).values()) == 1


@pytest.mark.parametrize("unknown", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_unknown_is_left_out_and_comes_when_it_is_known(unknown: float) -> None:
    component = Component(2.0)
    sent = of("NAMED_VALUE_FLOAT", run(component, 5.0, VALUES | {"CYC_LEFT": unknown}))
    assert {message.name for _, message in sent} == set(VALUES) - {"CYC_LEFT"}
    assert Counter(message.name for _, message in sent)["RES_KPA"] == pytest.approx(10, abs=1)
    later = of("NAMED_VALUE_FLOAT", run(component, 1.0, start_s=5.0))
    assert "CYC_LEFT" in {message.name for _, message in later}


def test_without_values_there_are_none() -> None:
    assert of("NAMED_VALUE_FLOAT", run(Component(2.0), 5.0, {})) == []


def said(texts: list[str], for_s: float = 20.0) -> list[tuple[float, Message]]:
    component = Component(2.0)
    for words in texts:
        component.say(0.0, 4, words)
    return of("STATUSTEXT", run(component, for_s))


def joined(sent: list[tuple[float, Message]]) -> list[str]:
    """Texts put together as a ground station does it: a chunk that is full is followed by another."""
    texts: list[str] = []
    for _, message in sent:
        if message.id == 0 or message.chunk_seq == 0:
            texts.append("")
        texts[-1] += message.text
    return texts


def test_texts_keep_their_order_and_their_distance() -> None:
    words = [f"Vine: line {i}" for i in range(12)]
    sent = said(words)
    assert [message.text for _, message in sent] == words
    assert all(gap_s >= TEXT_SPACING_S - 1e-9 for gap_s in gaps_s([t for t, _ in sent]))
    assert {message.severity for _, message in sent} == {4}


@given(st.lists(st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=180), max_size=5))
@settings(max_examples=60, deadline=None)
def test_long_texts_come_in_chunks_that_join_again(texts: list[str]) -> None:
    different = list(dict.fromkeys(texts))
    sent = said(different, for_s=5.0)
    assert joined(sent) == different
    for _, message in sent:
        assert len(message.text) <= 50
        if message.id != 0:
            parts = [part for _, part in sent if part.id == message.id]
            assert [part.chunk_seq for part in parts] == list(range(len(parts)))
            assert all(len(part.text) == 50 for part in parts[:-1])
            assert len(parts[-1].text) < 50


@pytest.mark.parametrize(
    ("length", "chunks"), [(49, 1), (50, 1), (51, 2), (99, 2), (100, 3), (101, 3), (150, 4)]
)
def test_a_receiver_can_tell_where_a_text_ends(length: int, chunks: int) -> None:
    sent = said(["x" * length])
    assert len(sent) == chunks
    assert joined(sent) == ["x" * length]
    assert chunks == 1 or len(sent[-1][1].text) < 50


def test_two_long_texts_have_different_ids() -> None:
    sent = said(["a" * 120, "b" * 120])
    assert len({message.id for _, message in sent}) == 2


def test_signs_that_mavlink_lacks_are_written_out() -> None:
    sent = said(["bend 40° refused…", "5 µs → ∞"])
    assert [message.text for _, message in sent] == ["bend 40 deg refused..", "5 ?s ? ?"]


def test_the_same_text_is_news_only_after_a_while() -> None:
    component = Component(2.0)
    heard = []
    for i in range(1000):
        t = i * TICK_S
        component.say(t, 4, "Vine: bottle low")
        heard += [t for m in component.due(t, 0, {}, 4) if m.get_type() == "STATUSTEXT"]
    assert len(heard) == 4
    assert all(gap_s >= SAME_TEXT_AGAIN_S - 1e-9 for gap_s in gaps_s(heard))


def test_a_flood_of_texts_stays_bounded() -> None:
    component = Component(2.0)
    for i in range(1000):
        component.say(i * 0.001, 4, f"Vine: {i}")
    sent = of("STATUSTEXT", run(component, 30.0, start_s=1.0))
    assert len(sent) == 30
    assert sent[-1][1].text == "Vine: 999"


def test_timesync_requests_are_answered_and_answers_are_not() -> None:
    (answer,) = answer_timesync(mavlink.MAVLink_timesync_message(0, 1234), 99)
    assert (answer.tc1, answer.ts1) == (99, 1234)
    assert answer_timesync(mavlink.MAVLink_timesync_message(5, 1234), 99) == []
