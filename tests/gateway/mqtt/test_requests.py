"""Requests on the broker: only listed and recent ones, each once, and a vent before all others."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flying_vines.gateway.mqtt.payloads import AnswerPayload
from flying_vines.gateway.mqtt.publisher import Now
from flying_vines.gateway.mqtt.requests import MAX_REQUEST_LENGTH, MAX_WAITING, RequestQueue
from flying_vines.vine.intent import CommandName

NOW = Now(50.0, 1_700_000_000.0)
ALL: tuple[CommandName, ...] = ("vent", "bend", "profile", "hold")


def ask(id: str = "1", command: str = "hold", age_s: float = 0.0, **more: Any) -> bytes:
    return msgspec.json.encode({"id": id, "unix_s": NOW.unix_s - age_s, "command": command, **more})


def waiting(queue: RequestQueue) -> list[list[str]]:
    """Ids of the requests for the service, in order."""
    handed = []
    while together := queue.next():
        handed.append([one.request.id for one in together])
    return handed


def refusal(queue: RequestQueue, payload: bytes, retained: bool = False, now: Now = NOW) -> str:
    (answer,) = queue.receive(now, payload, retained)
    assert answer.safety == "refused"
    assert not queue.next()
    return answer.reason


def test_nothing_may_be_asked_for_unless_it_is_listed() -> None:
    assert "the configuration permits nothing" in refusal(RequestQueue(()), ask(command="vent"))
    assert "'bend' is not permitted" in refusal(RequestQueue(("vent",)), ask(command="bend", value=30))


def test_a_listed_request_is_passed_on_with_its_value() -> None:
    queue = RequestQueue(ALL)
    assert queue.receive(NOW, ask("1", "bend", value=30), False) == []
    assert queue.receive(NOW, ask("2", "profile", name="wave"), False) == []
    (bend,), (profile,) = queue.next(), queue.next()
    assert (bend.request.command, bend.request.value) == ("bend", 30.0)
    assert (profile.request.command, profile.request.name) == ("profile", "wave")
    assert not queue.next()


@pytest.mark.parametrize("command", ["vent", "hold"])
def test_an_old_request_is_refused(command: str) -> None:
    queue = RequestQueue(ALL)
    assert "requested 5.1 s ago by this vehicle's clock" in refusal(queue, ask("1", command, 5.1))
    assert "requested 60.0 s in the future" in refusal(queue, ask("2", command, -60.0))
    assert "a retained message" in refusal(queue, ask("3", command), retained=True)
    assert queue.receive(NOW, ask("4", command, 4.9), False) == []


@pytest.mark.parametrize("command", ["vent", "hold"])
def test_a_repeated_request_is_executed_once(command: str) -> None:
    queue = RequestQueue(ALL)
    assert queue.receive(NOW, ask("1", command), False) == []
    (answer,) = queue.receive(NOW, ask("1", command), False)
    assert "repeated: " in answer.reason
    assert waiting(queue) == [["1"]]
    # While a request is young enough to be executed, its id is known. After that it is too old.
    for later_s in (1.0, 4.9, 5.1, 400.0):
        later = Now(NOW.t + later_s, NOW.unix_s + later_s)
        assert refusal(queue, ask("1", command), now=later)


@pytest.mark.parametrize(
    ("payload", "said"),
    [
        (b"", "truncated"),
        (b"vent", "malformed"),
        (b"[" * 1000, "invalid request"),
        (b'{"id": "\xff"}', "invalid request"),
        (ask(command="explode"), "Invalid enum value 'explode'"),
        (ask(surprise=1), "unknown field `surprise`"),
        (ask(id=""), "length >= 1"),
        (ask(id="x" * 65), "length <= 64"),
        (ask(version=2), "version"),
        (ask(command="bend"), "'bend' takes a value"),
        (ask(command="bend", value=30, name="wave"), "'bend' takes a value"),
        (ask(command="profile", value=3), "'profile' takes a name"),
        (ask(command="hold", value=3), "'hold' takes no value"),
        (b'{"id": "1", "command": "hold"}', "unix_s"),
        (b'{"id": "1", "command": "hold", "unix_s": 1e999}', "invalid request"),
        (b'{"id": "1", "command": "bend", "value": 1e999, "unix_s": 1700000000}', "invalid request"),
        (ask() + b" " * MAX_REQUEST_LENGTH, "longer than"),
    ],
)
def test_an_impossible_request_is_refused_with_the_reason(payload: bytes, said: str) -> None:
    assert said in refusal(RequestQueue(ALL), payload)


def test_a_vent_overtakes_what_waits_and_that_is_not_done_afterwards() -> None:
    queue = RequestQueue(ALL)
    queue.receive(NOW, ask("1", "bend", value=30), False)
    queue.receive(NOW, ask("2", "hold"), False)
    overtaken = queue.receive(NOW, ask("3", "vent"), False)
    assert [(answer.id, answer.reason) for answer in overtaken] == [
        ("1", "overtaken by a vent"),
        ("2", "overtaken by a vent"),
    ]
    queue.receive(NOW, ask("4", "vent"), False)
    queue.receive(NOW, ask("5", "bend", value=30), False)
    assert waiting(queue) == [["3", "4"], ["5"]]


def test_a_client_that_asks_too_often_gets_no_answer_but_may_vent() -> None:
    queue = RequestQueue(ALL)
    answers = [answer for number in range(5000) for answer in queue.receive(NOW, ask(str(number)), False)]
    answers += [answer for _ in range(5000) for answer in queue.receive(NOW, b"{", False)]
    assert len(answers) + len(waiting(queue)) == 10
    assert queue.ignored == 9990
    assert queue.receive(NOW, ask("vent", "vent"), False) == []
    assert waiting(queue) == [["vent"]]
    later = Now(NOW.t + 1.0, NOW.unix_s + 1.0)
    assert queue.receive(later, ask("later", age_s=-1.0), False) == []
    assert waiting(queue) == [["later"]]


def test_a_flood_of_vents_is_one_vent() -> None:
    queue = RequestQueue(ALL)
    for number in range(20_000):
        assert queue.receive(NOW, ask(str(number), "vent"), False) == []
    (together,) = waiting(queue)
    assert len(together) == MAX_WAITING


def test_requests_that_wait_when_the_broker_disappears_are_dropped() -> None:
    queue = RequestQueue(ALL)
    queue.receive(NOW, ask("1", "bend", value=30), False)
    queue.disconnected()
    assert waiting(queue) == []
    assert "repeated: " in refusal(queue, ask("1", "bend", value=30))


def test_a_waiting_request_gets_older_with_any_clock_of_its_sender() -> None:
    queue = RequestQueue(ALL)
    queue.receive(NOW, ask("1", "bend", 3.0, value=30), False)
    queue.receive(NOW, ask("2", "bend", -3.0, value=30), False)
    (old,), (of_the_future,) = queue.next(), queue.next()
    assert (old.made_at, of_the_future.made_at) == (NOW.t - 3.0, NOW.t)


@given(st.binary(max_size=200) | st.text(max_size=50).map(str.encode), st.booleans())
def test_no_bytes_make_it_fail(payload: bytes, retained: bool) -> None:
    queue = RequestQueue(ALL)
    for answer in queue.receive(NOW, payload, retained):
        assert isinstance(answer, AnswerPayload)
        assert answer.safety == "refused"
        assert answer.reason
    assert waiting(queue) == []


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["vent", "hold", "bend"]),
            st.integers(0, 3),
            st.floats(-8, 8),
            st.floats(0.0, 3.0),
        ),
        max_size=40,
    )
)
def test_no_request_is_executed_twice_or_late(said: list[tuple[str, int, float, float]]) -> None:
    """Each row: a command, an id, its age and the time since the one before; some are late or repeated."""
    queue = RequestQueue(ALL)
    now = NOW
    done: list[tuple[str, float]] = []
    for command, id, age_s, after_s in said:
        now = Now(now.t + after_s, now.unix_s + after_s)
        value = {"value": 30.0} if command == "bend" else {}
        asked = {"id": str(id), "unix_s": now.unix_s - age_s, "command": command, **value}
        queue.receive(now, msgspec.json.encode(asked), False)
        for one, made_at in queue.next():
            assert now.unix_s - one.unix_s <= now.t - made_at + 1e-6
            assert made_at <= now.t
            assert abs(now.unix_s - one.unix_s) <= 5.0
            done.append((one.id, one.unix_s))
        assert not queue.next()
    assert len(set(done)) == len(done)
