"""The reason that is given if a board does not answer."""

from __future__ import annotations

import pytest

from firmware_link.answer_check import ANSWER_WITHIN_S, AnswerCheck
from firmware_link.protocol import (
    PROTOCOL_VERSION,
    Codec,
    Fault,
    Hello,
    Message,
    Mode,
    Refusal,
    RefusalReason,
    Telemetry,
    Vent,
    Welcome,
)

TELEMETRY = Telemetry(1, Mode.VENT, Fault.NONE, 0, 0.0, 1.0, 690.0, 0.0, 0.0, True)
WELCOME = Welcome(PROTOCOL_VERSION, 1, 1, "test", 1, 30.0, 28.0, 760.0, 200.0, 300, 100)
HELLO = Hello(PROTOCOL_VERSION, 7)
GPS = b"$GNGGA,092725.00,4717.11399,N,00833.91590,E,1,08,1.01,499.6,M,48.0,M,,*45\r\n"


def check_after(*pieces: bytes) -> AnswerCheck:
    check, codec = AnswerCheck(), Codec()
    check.opened(10.0)
    for data in pieces:
        check.received(data, codec.decode(data))
    return check


@pytest.mark.parametrize(
    ("pieces", "says"),
    [
        ((), "open but silent"),
        ((GPS, GPS), "this is another device"),
        ((bytes(100),), "this is another device"),
        ((Codec().encode(HELLO), Codec().encode(Vent(0))), "this port returns what we send"),
        ((Codec().encode(HELLO), Codec().encode(TELEMETRY)), "no answer"),
        ((Codec().encode(TELEMETRY),), "no answer: the line from us to the board"),
    ],
)
def test_each_silence_is_reported_once_after_a_while(pieces: tuple[bytes, ...], says: str) -> None:
    check = check_after(*pieces)
    assert check.news(10.0 + ANSWER_WITHIN_S - 0.01) is None
    told = check.news(10.0 + ANSWER_WITHIN_S)
    assert told is not None
    assert says in told
    assert check.news(10.0 + ANSWER_WITHIN_S + 1.0) is None


@pytest.mark.parametrize("message", [WELCOME, Refusal(0, RefusalReason.VERSION)])
def test_an_answer_ends_the_silence(message: Message) -> None:
    check = check_after(Codec().encode(message))
    assert check.news(100.0) is None


def test_a_late_answer_ends_it() -> None:
    check = check_after()
    assert check.news(20.0)
    check.received(b"", [WELCOME])
    assert check.news(20.1) == ""
    assert check.news(20.2) is None


def test_a_closed_port_has_its_own_reason_and_each_opening_counts_anew() -> None:
    check = check_after(GPS)
    check.closed()
    assert check.news(100.0) is None
    check.opened(100.0)
    assert check.news(101.0) is None
    told = check.news(103.0)
    assert told is not None
    assert "silent" in told
