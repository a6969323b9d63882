"""The page's messages on a terminal, message by message."""

from __future__ import annotations

import json
import math
from typing import Any

import msgspec
import pytest
from page_bench import snapshot

from flying_vines.core.events import Decision
from flying_vines.gateway.messages import Happened, SnapshotMessage, raw
from flying_vines.terminal.page_protocol import VENT_AGAIN_S, InvalidMessageError, PageDecoder, VentRequest
from flying_vines.vehicle.notice import Notice, Severity

VINE = {
    "profiles": ["wave"],
    "curve": [[0, 0], [20, 60]],
    "max_kPa": 20.7,
    "full_kPa": 690.0,
    "bench_mode": False,
}


def happened(action: Decision | Notice) -> dict[str, Any]:
    message: dict[str, Any] = json.loads(
        msgspec.json.encode(Happened(type(action).__name__.lower(), raw(action)))
    )
    return message


def hello(t: float, *actions: Decision | Notice) -> str:
    events = [happened(action) for action in actions]
    return json.dumps({"kind": "hello", "t": t, "vine": VINE, "happened": events})


def notice(t: float, text: str = "Vine: ready") -> Notice:
    return Notice(t, Severity.INFO, text)


def decision(t: float) -> Decision:
    return Decision(t, "switch", {"channel": 9, "position": 2}, "bend-full", "accepted", "", 20.7)


def test_a_snapshot_is_what_the_service_had() -> None:
    decoder = PageDecoder()
    decoder.take(0.0, hello(10.0))
    sent = snapshot(10.1, cv_kPa=math.nan, safe_state={"rc": "RC lost"}, findings={"leak": 2})
    decoder.take(0.1, msgspec.json.encode(SnapshotMessage(raw(sent))).decode())
    assert decoder.snapshot is not None
    assert math.isnan(decoder.snapshot.cv_kPa)
    assert msgspec.to_builtins(decoder.snapshot) | {"cv_kPa": 0} == msgspec.to_builtins(sent) | {"cv_kPa": 0}
    assert decoder.snapshot_age_s(2.1) == pytest.approx(2.0)


def test_the_past_is_reported_once() -> None:
    decoder = PageDecoder()
    first, second, third = notice(5.0), decision(6.0), notice(8.0, "Vine: RC lost")
    assert decoder.take(0.0, hello(7.0, first, second)) == [first, second]
    assert decoder.began == 5.0
    assert decoder.take(0.1, json.dumps(happened(third))) == [third]
    fourth = notice(8.0, "Vine: of the same moment")
    assert decoder.take(0.1, json.dumps(happened(fourth))) == [fourth]
    missed = notice(9.0, "Vine: while the link was cut")
    assert decoder.take(0.2, hello(10.0, first, second, third, fourth, missed)) == [missed]
    assert decoder.began == 5.0


def test_a_restarted_machine_begins_a_new_list_of_events() -> None:
    decoder = PageDecoder()
    decoder.take(0.0, hello(1000.0, notice(999.0)))
    again = notice(3.0)
    assert decoder.take(60.0, hello(4.0, again)) == [again]
    assert decoder.began == 3.0


def test_other_messages_are_skipped() -> None:
    decoder = PageDecoder()
    assert decoder.take(0.0, '{"kind": "beat"}') == []
    assert decoder.take(0.0, '{"kind": "missed", "count": 3}') == []
    unknown = {"kind": "happened", "what": "of_another_version", "fields": {"t": 1.0}}
    assert decoder.take(0.0, json.dumps(unknown)) == []


@pytest.mark.parametrize(
    "text", ["", "nonsense", "[]", "{}", '{"kind": "hello"}', '{"kind": "snapshot", "snapshot": {"t": "x"}}']
)
def test_an_unknown_message_is_reported(text: str) -> None:
    with pytest.raises(InvalidMessageError):
        PageDecoder().take(0.0, text)


def test_a_vent_is_asked_for_until_it_is_confirmed() -> None:
    vent = VentRequest()
    assert vent.pop_message(0.0) is None
    vent.press(1.0, None)
    first = vent.pop_message(1.0)
    assert first is not None
    assert json.loads(first)["command"] == "vent"
    assert vent.pop_message(1.0 + 0.9 * VENT_AGAIN_S) is None
    second = vent.pop_message(1.0 + VENT_AGAIN_S)
    assert second not in (None, first)
    for said in ({"kind": "answer", "id": 1, "safety": "unanswered", "reason": ""}, {"kind": "beat"}):
        assert vent.take(2.0, json.dumps(said)) is None
    accepted = '{"kind": "answer", "id": 2, "safety": "accepted", "reason": ""}'
    assert vent.take(2.5, accepted) == "VENT confirmed after 1.50 s"
    assert vent.pop_message(9.0) is None
    assert vent.take(9.0, accepted) is None


def test_a_vent_that_is_refused_is_not_asked_for_again() -> None:
    vent = VentRequest()
    vent.press(1.0, snapshot(7.25))
    assert json.loads(vent.pop_message(1.0) or "")["seen_at"] == 7.25
    said = '{"kind": "answer", "id": 1, "safety": "refused", "reason": "you may only watch"}'
    assert vent.take(1.1, said) == "VENT refused: you may only watch"
    assert vent.pop_message(9.0) is None


@pytest.mark.parametrize(
    "wrong",
    [
        {"kind": "answer"},
        {"kind": "answer", "id": 1, "safety": "refused"},
        {"kind": "answer", "id": 1, "safety": "of another version", "reason": ""},
        {"kind": "answer", "id": "1", "safety": "accepted", "reason": ""},
        {},
    ],
)
def test_an_answer_that_cannot_be_read_is_reported_and_confirms_nothing(wrong: dict[str, Any]) -> None:
    vent = VentRequest()
    vent.press(1.0, None)
    vent.pop_message(1.0)
    with pytest.raises(InvalidMessageError):
        vent.take(1.1, json.dumps(wrong))
    assert vent.pressed_at is not None


def test_a_late_answer_to_an_earlier_press_confirms_nothing() -> None:
    vent = VentRequest()
    vent.press(1.0, None)
    first, second = (json.loads(vent.pop_message(t) or "")["id"] for t in (1.0, 1.0 + VENT_AGAIN_S))
    answer = {"kind": "answer", "safety": "accepted", "reason": ""}
    assert vent.take(2.0, json.dumps({**answer, "id": first}))
    vent.press(5.0, None)
    third = json.loads(vent.pop_message(5.0) or "")["id"]
    for number in (second, third + 1):
        assert vent.take(5.1, json.dumps({**answer, "id": number})) is None
    assert vent.pop_message(5.0 + VENT_AGAIN_S) is not None
    assert vent.take(5.6, json.dumps({**answer, "id": third})) == "VENT confirmed after 0.60 s"
