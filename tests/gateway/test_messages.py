"""Messages between service and gateway are read as they were sent, or refused."""

from __future__ import annotations

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flying_vines.gateway import messages
from flying_vines.gateway.messages import (
    Answered,
    FromGateway,
    Happened,
    Request,
    SnapshotMessage,
    ToGateway,
    Trouble,
)
from flying_vines.vine.intent import BendTo, CommandName, SetPressure, StartProfile, VentVine

from .gateway_inputs import decision, happened, notice, seen, start

plain = [word for word in messages.COMMANDS if word not in ("bend", "pressure", "profile")]
finite = st.floats(allow_nan=False, allow_infinity=False)
by = st.sampled_from(["page", "broker"])
number = st.integers(0, 2**53)
asks = st.one_of(
    st.builds(Request, number, by, st.sampled_from(plain)),
    st.builds(Request, number, by, st.sampled_from(["bend", "pressure"]), finite),
    st.builds(
        lambda n, b, name: Request(n, b, "profile", None, name), number, by, st.text().filter(str.isprintable)
    ),
)


@given(asks | st.builds(Trouble, st.text()))
def test_messages_of_the_gateway_are_read_back_equal(message: FromGateway) -> None:
    assert messages.read_from_gateway(messages.packet(message)) == message


@given(st.builds(Answered, number, st.sampled_from(["accepted", "limited", "refused"]), st.text()))
def test_answers_of_the_service_are_read_back_equal(message: Answered) -> None:
    assert messages.read_to_gateway(messages.packet(message)) == message


@pytest.mark.parametrize(
    "message", [seen(1.0), start(), *(happened(thing(2.0)) for thing in (decision, notice))]
)
def test_messages_of_the_service_are_read_back_equal(message: ToGateway) -> None:
    again = messages.read_to_gateway(messages.packet(message))
    assert type(again) is type(message)
    assert messages.packet(again) == messages.packet(message)
    if isinstance(again, SnapshotMessage):
        snapshot = msgspec.json.decode(again.snapshot)
        assert snapshot["bend_deg"] == 59.7
        assert snapshot["evp_opening"] is None, "what is not known is null"
    if isinstance(again, Happened):
        assert msgspec.json.decode(again.fields)["t"] == 2.0


@pytest.mark.parametrize("name", ["\x1b[2J\x1b]0;vented\x07", "a\n   0.1  Vine: vented", "\u202e", "\x9b2J"])
def test_a_name_cannot_write_control_characters_or_lines_to_a_terminal(name: str) -> None:
    with pytest.raises(ValueError, match="cannot be printed"):
        Request(0, "page", "profile", None, name)


@given(asks)
def test_every_ask_is_an_intent(ask: Request) -> None:
    match ask.intent:
        case BendTo(value) | SetPressure(value):
            assert value == ask.value
        case StartProfile(name):
            assert name == ask.name
        case intent:
            assert ask.command in plain
            assert (ask.command == "vent") == (intent == VentVine())


@given(
    st.sampled_from(messages.COMMANDS),
    st.none() | st.floats(),
    st.none() | st.text(max_size=5),
    st.booleans(),
)
def test_an_ask_that_cannot_be_is_refused_wherever_it_comes_from(
    command: CommandName, value: float | None, name: str | None, as_bytes: bool
) -> None:
    good = (value is not None) == (command in ("bend", "pressure")) and (name is not None) == (
        command == "profile"
    )
    good = good and (value is None or abs(value) < float("inf")) and (name is None or name.isprintable())
    said = {"kind": "ask", "number": 1, "by": "page", "command": command, "value": value, "name": name}
    try:
        if as_bytes:
            messages.read_from_gateway(msgspec.json.encode(said))
        else:
            Request(1, "page", command, value, name)
    except ValueError:
        assert not good
    else:
        # JSON has no NaN and no infinity: they become null.
        assert good or (as_bytes and value is not None and not abs(value) < float("inf"))


@given(st.binary(max_size=100))
def test_no_bytes_are_a_message_by_accident(data: bytes) -> None:
    for read in (messages.read_from_gateway, messages.read_to_gateway):
        with pytest.raises((msgspec.DecodeError, UnicodeDecodeError)):
            read(data)
