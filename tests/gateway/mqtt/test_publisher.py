"""Messages to the broker: the latest states, and all events in order or the number of lost ones."""

from __future__ import annotations

import re
from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any

import jinja2
import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flying_vines.core.events import Action, Asked, Decision
from flying_vines.core.pending_bend import PendingBend
from flying_vines.gateway.messages import Happened, SnapshotMessage, raw
from flying_vines.gateway.mqtt.payloads import (
    PAYLOADS,
    EventPayload,
    LostEvent,
    NoticeEvent,
    RequestPayload,
    Topics,
)
from flying_vines.gateway.mqtt.publisher import (
    RESERVOIR_S,
    SILENT_S,
    Events,
    Now,
    Publication,
    Publisher,
    discovery,
)
from flying_vines.simulation.simulated_world import SimulatedWorld
from flying_vines.vehicle.notice import Notice
from flying_vines.vine.intent import BendTo, Intent, StartBench, StartProfile, VentVine

from ..gateway_inputs import configured, decision, happened, notice, seen, start

UNIX_S = 1_700_000_000.0
TOPICS = Topics("flying-vines", "heron")


def now(t: float) -> Now:
    return Now(t, UNIX_S + t)


def teller(**mqtt: Any) -> Publisher:
    return Publisher(start(**mqtt), TOPICS)


def read(publication: Publication) -> dict[str, Any]:
    """The payload, which must match its topic."""
    msgspec.json.decode(publication.payload, type=PAYLOADS[publication.topic.rsplit("/", 1)[1]])
    sent: dict[str, Any] = msgspec.json.decode(publication.payload)
    return sent


def tell_all(events: Events, t: float = 10.0) -> list[EventPayload]:
    sent = []
    while pending := events.first(now(t)):
        event: EventPayload = msgspec.json.decode(pending.publication.payload, type=EventPayload)
        sent.append(event)
        events.published(pending)
    return sent


def test_a_vehicle_is_silent_before_and_after_the_messages_of_its_service() -> None:
    vehicle = teller()
    status, about = vehicle.greeting(now(0.0))
    assert (status.topic, status.retain, status.qos) == ("flying-vines/heron/status", True, 1)
    assert read(status)["status"] == "silent"
    assert (about.topic, about.retain) == ("flying-vines/heron/about", True)
    assert read(about)["limits"]["max_kPa"] == 20.7
    assert vehicle.due(now(0.1)) == []

    vehicle.take(0.2, seen(0.2))
    assert [read(sent).get("status") for sent in vehicle.due(now(0.2))] == ["online", None, None]
    assert vehicle.due(now(0.3)) == [], "the same moment is not told twice"
    (status,) = vehicle.due(now(0.2 + SILENT_S))
    assert read(status)["status"] == "silent"
    vehicle.take(9.0, seen(9.0))
    assert read(vehicle.greeting(now(9.0))[0])["status"] == "online"
    will = vehicle.last_will(now(9.0))
    assert (will.topic, will.retain, read(will)["status"]) == (status.topic, True, "offline")


def test_a_state_has_the_time_of_its_snapshot_and_null_for_what_is_not_known() -> None:
    vehicle = teller()
    vehicle.take(5.0, seen(5.0, altitude_m=float("nan"), safe_state={"rc": "RC lost"}))
    _, state, reservoir = vehicle.due(now(7.0))
    sent = read(state)
    assert sent["t"] == 5.0
    assert (state.topic, state.qos, state.retain) == ("flying-vines/heron/state", 0, False)
    assert sent["unix_s"] == UNIX_S + 5.0
    assert sent["altitude_m"] is None
    assert (sent["cv_kPa"], sent["bend_deg"], sent["doing"]) == (20.6, 59.7, "bend-full")
    assert sent["safe_state"] == {"rc": "RC lost"}
    assert reservoir.topic == "flying-vines/heron/reservoir"
    assert (
        read(reservoir)["cycles"] | {"expected": 31.2, "low": 27.9, "high": 35.0} == read(reservoir)["cycles"]
    )


def test_the_reservoir_is_reported_less_often() -> None:
    vehicle = teller()
    topics = []
    for tenth in range(101):
        vehicle.take(tenth / 10, seen(tenth / 10, cycles=None))
        topics += [sent.topic for sent in vehicle.due(now(tenth / 10))]
    assert topics.count(TOPICS.state) == 101
    assert topics.count(TOPICS.reservoir) == 1 + 10 / RESERVOIR_S


def test_every_kind_of_event_is_reported_with_its_time_and_number() -> None:
    vehicle = teller()
    for thing in (decision(1.0, "limited", "to 60 kPa/s"), notice(2.0)):
        vehicle.take(3.0, happened(thing))
    sent = []
    while pending := vehicle.events.first(now(4.0)):
        assert (pending.publication.topic, pending.publication.qos) == (TOPICS.event, 1)
        sent.append(read(pending.publication))
        vehicle.events.published(pending)
    assert [event["event"] for event in sent] == ["decision", "notice"]
    assert [event["unix_s"] - UNIX_S for event in sent] == [1.0, 2.0]
    assert [event["number"] for event in sent] == [1, 2]
    assert sent[0]["reason"] == "to 60 kPa/s"
    assert sent[1]["severity"] == "notice"


def test_an_event_has_the_time_of_the_clock_as_it_was_set_since() -> None:
    events = Events("event", "run", 10)
    events.take(happened(notice(100.0)))
    first = events.first(Now(105.0, 5.0))
    assert first is not None
    assert msgspec.json.decode(first.publication.payload)["unix_s"] == 0.0
    first = events.first(Now(160.0, UNIX_S))
    assert first is not None
    assert msgspec.json.decode(first.publication.payload)["unix_s"] == UNIX_S - 60.0


def test_an_event_is_reported_again_until_the_broker_has_it() -> None:
    events = Events("event", "run", 10)
    events.take(happened(notice(1.0)))
    first = events.first(now(1.0))
    assert first is not None
    assert first == events.first(now(1.0))
    events.published(first)
    assert events.first(now(1.0)) is None


def test_more_than_are_kept_are_lost_and_counted() -> None:
    events = Events("event", "run", 3)
    for number in range(8):
        events.take(happened(notice(1.0, f"{number + 1}")))
    lost, *kept = tell_all(events)
    assert lost == LostEvent(unix_s=UNIX_S + 10.0, run="run", number=5, count=5)
    assert [(event.number, event.text) for event in kept if isinstance(event, NoticeEvent)] == [
        (6, "6"),
        (7, "7"),
        (8, "8"),
    ]


@given(st.lists(st.sampled_from(["happens", "told", "told meanwhile"]), max_size=60), st.integers(1, 4))
def test_every_event_is_sent_once_and_in_order_or_counted(steps: list[str], most: int) -> None:
    """`told meanwhile`: events between sending an event and the broker's receipt."""
    events = Events("event", "run", most)
    made, sent, lost = 0, [], 0

    def happen() -> None:
        nonlocal made
        made += 1
        events.take(happened(notice(1.0)))

    def tell(meanwhile: int) -> None:
        nonlocal lost
        pending = events.first(now(1.0))
        for _ in range(meanwhile):
            happen()
        if pending is not None:
            event: EventPayload = msgspec.json.decode(pending.publication.payload, type=EventPayload)
            if isinstance(event, LostEvent):
                lost += event.count
            else:
                sent.append(event.number)
            events.published(pending)

    for step in steps:
        if step == "happens":
            happen()
        else:
            tell(meanwhile=most + 1 if step == "told meanwhile" else 0)
        assert len(events) <= most
    while events.first(now(1.0)):
        tell(0)
    assert sent == sorted(set(sent))
    assert len(sent) + lost == made


def test_messages_of_a_later_service_do_not_end_the_connection() -> None:
    """Unknown fields are left out, and unknown kinds are not published."""
    vehicle = teller()
    vehicle.take(1.0, Happened("stretched", msgspec.Raw(b'{"t": 1.0}')))
    vehicle.take(
        1.0, Happened("notice", msgspec.Raw(b'{"t":1.0,"severity":6,"text":"x","of_decision":false,"new":1}'))
    )
    (event,) = tell_all(vehicle.events)
    assert isinstance(event, NoticeEvent)
    assert (event.text, event.severity, event.number) == ("x", "info", 1)


def test_every_output_of_a_core_can_be_published() -> None:
    vehicle = teller()
    world = SimulatedWorld(configured())
    wanted: tuple[Intent, ...] = (
        StartBench(),
        StartProfile("wave"),
        BendTo(500.0),
        VentVine(),
    )
    made = []

    def watch(actions: Iterable[Action]) -> None:
        for action in actions:
            if isinstance(action, Decision | Notice):
                made.append(type(action).__name__.lower())
                vehicle.take(world.now, happened(action))

    for second, intent in enumerate(wanted, start=1):
        watch(world.advance(float(second)))
        watch(world.feed(Asked(float(second), "calibration", intent)))
    watch(world.advance(12.0))
    assert set(made) == {"decision", "notice"}
    sent: list[str] = [event.__struct_config__.tag for event in tell_all(vehicle.events)]  # type: ignore[misc]
    assert sent == made
    vehicle.take(12.0, SnapshotMessage(raw(world.core.snapshot(12.0))))
    _, state, reservoir = vehicle.due(now(12.0))
    assert read(state)["doing"] == "vented"
    assert read(reservoir)["reservoir_kPa"] > 100.0


def test_home_assistant_is_informed_only_if_wanted() -> None:
    assert discovery(configured(), TOPICS, "1.2.3") == []


def test_home_assistant_gets_sensors_and_a_button_only_where_venting_is_allowed() -> None:
    vehicle = teller()
    vehicle.take(1.0, seen(1.0))
    known = {sent.topic: read(sent) for sent in vehicle.due(now(1.0))}
    for commands, pressed in (((), b""), (("bend", "vent"), None)):
        wanted = configured(discovery_prefix="homeassistant", commands=commands)
        *sensors, _, _, button = discovery(wanted, TOPICS, "1.2.3")
        assert all(sent.retain for sent in (*sensors, button))
        assert button.topic == "homeassistant/button/heron/flying-vines_vent/config"
        assert pressed is None or button.payload == pressed
        if pressed is None:
            vent = msgspec.json.decode(button.payload)
            assert vent["command_topic"] == TOPICS.ask
            assert '"command": "vent"' in vent["command_template"]
        configs = [msgspec.json.decode(sensor.payload) for sensor in sensors]
        assert len({config["unique_id"] for config in configs}) == len(configs) == 10
        for config in configs:
            assert config["availability_topic"] == TOPICS.status
            field = re.search(r"value_json\.(\w+)", config["value_template"])
            assert field is not None and field[1] in known[config["state_topic"]]


def rendered(template: str, **known: Any) -> str:
    """The template as Home Assistant renders it."""
    at = SimpleNamespace(timestamp=lambda: UNIX_S)
    return jinja2.Environment().from_string(template).render(now=lambda: at, **known)


@pytest.mark.parametrize("commands", [(), ("vent",), ("bend",), ("profile",), ("bend", "profile", "vent")])
def test_home_assistant_bends_only_where_the_configuration_allows_it(commands: tuple[str, ...]) -> None:
    wanted = configured(discovery_prefix="homeassistant", commands=commands)
    *_, number, select, button = discovery(wanted, TOPICS, "1.2.3")
    asked = {"bend": (number, 25.0), "profile": (select, "wave"), "vent": (button, None)}
    for command, (sent, value) in asked.items():
        assert bool(sent.payload) is (command in commands)
        if sent.payload:
            template = msgspec.json.decode(sent.payload)["command_template"]
            request = msgspec.json.decode(rendered(template, value=value), type=RequestPayload)
            assert (request.command, request.value or request.name) == (command, value)


@pytest.mark.parametrize(
    ("snapshot", "shown"),
    [
        ({}, {"problem": "False", "armed": "True", "waiting": "nothing", "profile": "bend-full"}),
        (
            {"safe_state": {"rc": "RC lost"}, "armed": False, "doing": "vented"}
            | {"waiting": PendingBend("RC lost", "switch down, then up")},
            {"problem": "True", "armed": "False", "waiting": "switch down, then up", "profile": "None"},
        ),
    ],
)
def test_home_assistant_reads_the_state(snapshot: dict[str, Any], shown: dict[str, str]) -> None:
    vehicle = teller()
    vehicle.take(1.0, seen(1.0, **snapshot))
    (state,) = (read(sent) for sent in vehicle.due(now(1.0)) if sent.topic == TOPICS.state)
    wanted = configured(discovery_prefix="homeassistant", commands=("profile",))
    templates = {
        sent.topic.split("/")[-2].removeprefix("flying-vines_"): msgspec.json.decode(sent.payload)
        for sent in discovery(wanted, TOPICS, "1.2.3")
        if sent.payload
    }
    assert {key: rendered(templates[key]["value_template"], value_json=state) for key in shown} == shown
    for status, available in (("online", "online"), ("silent", "offline"), ("offline", "offline")):
        template = templates["problem"]["availability_template"]
        assert rendered(template, value_json={"status": status}) == available


def test_a_vehicle_without_a_name_goes_by_its_computer_s() -> None:
    topics = Topics.of(configured().mqtt)
    assert topics.prefix == "flying-vines"
    assert topics.name
    assert not set(topics.name) & set("/+# ")
    assert Topics.of(configured(name="heron", prefix="a/b").mqtt).ask == "a/b/heron/ask"
