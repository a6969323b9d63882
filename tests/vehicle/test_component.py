"""Our own messages are steady, spread out, short and never repeated."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from random import Random
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from examples import examples
from flying_vines.config import config
from flying_vines.core.core import Core
from flying_vines.core.events import Action, Event, ToVehicle, VehicleMessage
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.component import Component
from flying_vines.vehicle.component.parameter_table import SETTINGS
from flying_vines.vehicle.component.telemetry import NamedValues
from flying_vines.vehicle.component.texts import (
    BURST,
    CHUNK_LENGTH,
    MAX_TEXT_LENGTH,
    MAX_WAIT_S,
    PER_MINUTE,
    RESERVED,
    SAME_AGAIN_S,
    SPACING_S,
    Texts,
)
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage
from flying_vines.vehicle.mission.item import AutopilotKind
from flying_vines.vehicle.notice import Notice, Severity
from flying_vines.vehicle.state import VehicleState

TICK_S = 0.02
VALUES = {"RES_KPA": 500.0, "CYC_LEFT": 40.0, "CV_KPA": 3.0, "CMD_KPA": 2.5, "BEND_DEG": 12.0}
US = 191


def component(**telemetry: Any) -> Component:
    conf = config.default()
    table = msgspec.structs.replace(conf.telemetry, **telemetry)
    return Component(msgspec.structs.replace(conf, telemetry=table))


def run(
    ours: Component, for_s: float, values: dict[str, float] | None = None, start_s: float = 0.0
) -> list[tuple[float, MavlinkMessage]]:
    """The sent messages, as a receiver decodes them."""
    sender, receiver, received = MavlinkCodec(1, US), MavlinkCodec(255, 190), []
    for i in range(round(for_s / TICK_S)):
        t = start_s + i * TICK_S
        due = ours.due(t, int(t * 1000), VALUES if values is None else values, 4)
        for message in due:
            received += [(t, m) for m in receiver.decode(sender.encode(message, 1))]
    return received


def of(kind: str, sent: list[tuple[float, MavlinkMessage]]) -> list[tuple[float, MavlinkMessage]]:
    return [(t, message) for t, message in sent if message.get_type() == kind]


def gaps_s(times_s: list[float]) -> list[float]:
    return [b - a for a, b in itertools.pairwise(times_s)]


def test_a_heartbeat_each_second_has_our_type() -> None:
    beats = of("HEARTBEAT", run(component(), 100.0))
    assert len(beats) == 100
    assert all(gap_s == pytest.approx(1.0) for gap_s in gaps_s([t for t, _ in beats]))
    _, beat = beats[0]
    assert (beat.type, beat.autopilot, beat.base_mode, beat.system_status) == (18, 8, 0, 4)
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == (1, US)


def test_five_values_each_twice_a_second_never_two_at_once() -> None:
    sent = of("NAMED_VALUE_FLOAT", run(component(), 60.0))
    assert max(Counter(t for t, _ in sent).values()) == 1
    for name, value in VALUES.items():
        times_s = [t for t, message in sent if message.name == name]
        assert len(times_s) == pytest.approx(120, abs=2)
        assert all(gap_s == pytest.approx(0.5, abs=TICK_S + 1e-6) for gap_s in gaps_s(times_s)[1:])
        assert {message.value for _, message in sent if message.name == name} == {value}
    assert all(0.08 - 1e-9 <= gap_s <= 0.14 for gap_s in gaps_s([t for t, _ in sent]))
    assert all(message.time_boot_ms == int(t * 1000) for t, message in sent)


@settings(max_examples=20, deadline=None)
@given(
    rate_Hz=st.floats(0.5, 5.0),
    jitter_s=st.floats(0.0, 0.015),
    known=st.integers(1, 5),
    seed=st.integers(0, 1000),
)
def test_named_values_are_sent_at_the_requested_rate(
    rate_Hz: float, jitter_s: float, known: int, seed: int
) -> None:
    """With intervals counted from tick to tick, only 1.84 a second were sent instead of 2."""
    values, random = NamedValues(1.0 / rate_Hz), Random(seed)
    sent_values = {name: value if i < known else math.nan for i, (name, value) in enumerate(VALUES.items())}
    sent = Counter(
        message.name
        for i in range(3000)
        for message in values.due(i * TICK_S + random.uniform(0.0, jitter_s), 0, sent_values)
    )
    assert len(sent) == known
    assert all(abs(count - 60.0 * rate_Hz) <= 0.01 * 60.0 * rate_Hz + 1 for count in sent.values())


def test_values_missed_in_a_stall_are_not_sent_later() -> None:
    values = NamedValues(0.5)
    ticks_s = [i * TICK_S for i in range(3000) if not 500 <= i < 1500]
    sent = [(t, message.name) for t in ticks_s for message in values.due(t, 0, VALUES)]
    after = [t for t, _ in sent if t >= 30.0]
    assert len([t for t in after if t < 32.0]) <= 21
    assert min(gaps_s(after)) > 0.1 - TICK_S - 1e-6


@pytest.mark.parametrize("rate_Hz", [0.1, 1.0, 5.0, 10.0])
def test_other_rates_are_kept_too(rate_Hz: float) -> None:
    sent = of("NAMED_VALUE_FLOAT", run(component(rate_Hz=rate_Hz), 40.0))
    counts = Counter(message.name for _, message in sent)
    assert all(count == pytest.approx(40 * rate_Hz, rel=0.1, abs=2) for count in counts.values())
    assert len(counts) == 5
    assert max(Counter(t for t, _ in sent).values()) == 1


def test_our_messages_fit_a_slow_radio() -> None:
    """A 57600 baud radio carries about 5000 B/s in total; we use a few hundred."""
    ours, sender = component(), MavlinkCodec(1, US)
    sent = [
        sender.encode(message, 1)
        for i in range(round(60.0 / TICK_S))
        for message in ours.due(i * TICK_S, i * 20, VALUES, 4)
    ]
    assert 150 < sum(map(len, sent)) / 60.0 < 300


@pytest.mark.parametrize("unknown", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_unknown_is_left_out_and_comes_when_it_is_known(unknown: float) -> None:
    ours = component()
    sent = of("NAMED_VALUE_FLOAT", run(ours, 5.0, VALUES | {"CYC_LEFT": unknown}))
    assert {message.name for _, message in sent} == set(VALUES) - {"CYC_LEFT"}
    assert Counter(message.name for _, message in sent)["RES_KPA"] == pytest.approx(10, abs=1)
    later = of("NAMED_VALUE_FLOAT", run(ours, 1.0, start_s=5.0))
    assert "CYC_LEFT" in {message.name for _, message in later}


def test_without_values_nothing_is_sent() -> None:
    assert of("NAMED_VALUE_FLOAT", run(component(), 5.0, {})) == []


# Texts.


def sent_texts(texts: list[str], for_s: float = 20.0) -> list[tuple[float, MavlinkMessage]]:
    ours = component()
    for words in texts:
        ours.say(Notice(0.0, Severity.WARNING, words))
    return of("STATUSTEXT", run(ours, for_s, {}))


def joined(sent: list[tuple[float, MavlinkMessage]]) -> list[str]:
    """Assemble texts like a ground station: a full chunk is followed by another one."""
    texts: list[str] = []
    for _, message in sent:
        if message.id == 0 or message.chunk_seq == 0:
            texts.append("")
        texts[-1] += message.text
    return texts


def test_texts_keep_their_order_and_their_spacing() -> None:
    words = [f"Vine: line {i}" for i in range(12)]
    sent = sent_texts(words)
    assert [message.text for _, message in sent] == words
    assert all(gap_s >= SPACING_S - 1e-9 for gap_s in gaps_s([t for t, _ in sent]))
    assert {message.severity for _, message in sent} == {4}


LINES = st.text("abxyz 019()%/-", min_size=1, max_size=180).map(
    lambda text: " ".join(["Vine:", *text.split()])
)


@given(st.lists(LINES, max_size=5))
@settings(max_examples=examples(60), deadline=None)
def test_long_texts_come_in_chunks_that_join_again(texts: list[str]) -> None:
    different = list(dict.fromkeys(texts))
    sent = sent_texts(different, for_s=5.0)
    assert joined(sent) == different
    for _, message in sent:
        assert len(message.text) <= CHUNK_LENGTH
        if message.id != 0:
            parts = [part for _, part in sent if part.id == message.id]
            assert [part.chunk_seq for part in parts] == list(range(len(parts)))
            assert all(len(part.text) == CHUNK_LENGTH for part in parts[:-1])
            assert len(parts[-1].text) < CHUNK_LENGTH


@pytest.mark.parametrize(
    ("length", "chunks"), [(49, 1), (50, 1), (51, 2), (99, 2), (100, 3), (101, 3), (150, 4), (199, 4)]
)
def test_a_receiver_finds_the_end_of_a_text(length: int, chunks: int) -> None:
    words = "Vine: ".ljust(length, "x")
    sent = sent_texts([words])
    assert len(sent) == chunks
    assert joined(sent) == [words]
    assert chunks == 1 or len(sent[-1][1].text) < CHUNK_LENGTH


def test_a_text_without_end_is_cut() -> None:
    (words,) = joined(sent_texts(["Vine: " + 5000 * "x"]))
    assert len(words) == MAX_TEXT_LENGTH
    assert words.endswith("x..")


def test_two_long_texts_have_different_ids() -> None:
    sent = sent_texts(["Vine: " + "a" * 120, "Vine: " + "b" * 120])
    assert len({message.id for _, message in sent}) == 2


def test_the_same_text_is_sent_again_only_after_a_while() -> None:
    ours = component()
    received = []
    for i in range(1000):
        t = i * TICK_S
        ours.say(Notice(t, Severity.WARNING, "Vine: reservoir low"))
        received += [t for m in ours.due(t, 0, {}, 4) if m.get_type() == "STATUSTEXT"]
    assert len(received) == 4
    assert all(gap_s >= SAME_AGAIN_S - 1e-9 for gap_s in gaps_s(received))


def test_a_flood_of_texts_stays_bounded() -> None:
    ours = component()
    for i in range(1000):
        ours.say(Notice(i * 0.001, Severity.WARNING, f"Vine: {i}"))
    sent = of("STATUSTEXT", run(ours, 60.0, {}, start_s=1.0))
    assert len(sent) == 30
    assert sent[-1][1].text == "Vine: 999"


def test_however_many_texts_there_are_a_minute_has_its_budget_and_a_fault_comes_at_once() -> None:
    texts, came = Texts(), []
    for i in range(6000):
        t = i * SPACING_S
        texts.say(Notice(t, Severity.WARNING, f"Vine: refused {i}", source="7/1"))
        if i % 600 == 599:
            texts.say(Notice(t, Severity.WARNING, f"Vine: fault {i}"))
        came += [(t, message.text) for message in texts.due(t)]
    assert len(came) <= BURST + 10 * PER_MINUTE
    assert [text for t, text in came if "fault" in text] == [
        f"Vine: fault {i}" for i in range(599, 6000, 600)
    ]
    assert all(t - SPACING_S * int(text.split()[-1]) < MAX_WAIT_S + SPACING_S for t, text in came)
    assert [t for t, text in came if "fault" in text] == [i * SPACING_S for i in range(599, 6000, 600)]


def test_a_flood_does_not_interrupt_a_text_that_is_half_sent() -> None:
    texts, long = Texts(), "Vine: " + 150 * "x"
    texts.say(Notice(0.0, Severity.WARNING, long))
    sent = texts.due(0.0)
    for i in range(1000):
        texts.say(Notice(0.01, Severity.WARNING, f"Vine: {i}"))
    for i in range(1, 100):
        sent += texts.due(i * SPACING_S)
    assert joined([(0.0, message) for message in sent])[0] == long


def test_the_services_own_warning_is_sent_before_refusals_and_never_dropped_for_them() -> None:
    texts = Texts()
    for i in range(100):
        if i == 50:
            texts.say(Notice(0.0, Severity.WARNING, "Vine: RC lost, vented"))
        texts.say(Notice(0.0, Severity.WARNING, f"Vine: refused {i}", source="7/1"))
        texts.say(Notice(0.0, Severity.INFO, f"Vine: news {i}"))
    sent = [(0.0, message) for i in range(100) for message in texts.due(i * SPACING_S)]
    came = joined(sent)
    assert 10 <= len(came) <= BURST
    assert came[0] == "Vine: RC lost, vented"
    assert all("refused" in text for text in came[1:])


def test_an_old_refusal_is_not_sent_and_news_never_take_what_is_kept_for_faults() -> None:
    texts = Texts()
    for i in range(BURST):
        texts.say(Notice(0.0, Severity.NOTICE, f"Vine: news {i}"))
    sent = [text.text for i in range(round(8.0 / SPACING_S)) for text in texts.due(i * SPACING_S)]
    assert BURST - RESERVED <= len(sent) < BURST
    texts.say(Notice(8.0, Severity.ERROR, "Vine: refused", source="7/1"))
    texts.say(Notice(8.0, Severity.WARNING, "Vine: RC lost, vented"))
    late_s = 8.0 + MAX_WAIT_S + 1.0
    assert next(text.text for i in range(9) for text in texts.due(late_s + i)) == "Vine: RC lost, vented"


# All messages together.


def from_sender(message: MavlinkMessage, sender: tuple[int, int]) -> MavlinkMessage:
    return mavlink.MAVLink(None).parse_char(message.pack(mavlink.MAVLink(None, *sender)))


class Link:
    """Our component on a vehicle."""

    def __init__(self, autopilot: int = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA) -> None:
        self.ours = component()
        self.state = VehicleState()
        self.autopilot = autopilot
        self.t = 0.0
        self.sent: list[tuple[float, MavlinkMessage]] = []
        self.notices: list[Notice] = []

    def take(self, message: MavlinkMessage, sender: tuple[int, int] = (255, 190)) -> None:
        message = from_sender(message, sender)
        self.state.handle(self.t, message)
        for output in self.ours.handle(self.t, message, self.state, True) or []:
            if isinstance(output, Notice):
                self.notices.append(output)
            elif isinstance(output, mavlink.MAVLink_message):
                self.ours.send(output)
        self.sent += [(self.t, message) for message in self.ours.leaving(self.t)]

    def wait(self, for_s: float, station: int = 0, autopilot: bool = True) -> None:
        """Let time pass. The autopilot and a ground station send a heartbeat once a second."""
        for _ in range(round(for_s / TICK_S)):
            tick = round(self.t / TICK_S)
            if autopilot and tick % 50 == 0:
                self.take(mavlink.MAVLink_heartbeat_message(2, self.autopilot, 0, 0, 3, 3), (1, 1))
            if station and tick % 50 == 25:
                self.take(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), (station, 190))
            self.sent += [(self.t, m) for m in self.ours.due(self.t, 0, VALUES, 4)]
            self.t = round(self.t + TICK_S, 6)


def test_the_autopilot_gets_our_messages_as_soon_as_it_sends_again() -> None:
    link = Link()
    link.t = 0.3
    link.wait(0.4, autopilot=False)  # one of our messages is sent before the autopilot appears
    link.t = 1.0
    link.wait(10.0)
    assert [t for t, _ in of("HEARTBEAT", link.sent)][:3] == pytest.approx([0.3, 1.0, 2.0])
    link.sent.clear()
    link.wait(1.24, autopilot=False)  # it reboots: its heartbeats have a gap
    back = link.t
    link.take(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3), (1, 1))
    link.wait(0.1, autopilot=False)
    beats = [t for t, _ in of("HEARTBEAT", link.sent) if t >= back]
    assert beats == [back]


def test_nobody_is_answered_before_there_is_a_vehicle() -> None:
    link = Link()
    link.take(mavlink.MAVLink_param_request_list_message(1, US))
    link.take(mavlink.MAVLink_ping_message(1, 1, 0, 0))
    link.wait(1.0, autopilot=False)
    assert of("PARAM_VALUE", link.sent) == of("PING", link.sent) == []


def test_parameters_are_shown_once_to_each_ground_station_of_an_ardupilot() -> None:
    link = Link()
    link.wait(1.0)
    link.wait(6.0, station=255)
    assert of("PARAM_VALUE", link.sent) == []
    link.wait(60.0, station=255)
    first = of("PARAM_VALUE", link.sent)
    assert [message.param_index for _, message in first] == list(range(len(SETTINGS)))
    assert all(gap_s >= 0.1 - 1e-6 for gap_s in gaps_s([t for t, _ in first]))
    link.wait(20.0, station=254)
    assert len(of("PARAM_VALUE", link.sent)) == 2 * len(SETTINGS)
    link.wait(50.0, station=254)
    link.wait(60.0, station=255)  # away for longer than a minute
    assert len(of("PARAM_VALUE", link.sent)) == 3 * len(SETTINGS)
    link.wait(30.0)
    link.wait(30.0, station=255)  # a short absence
    assert len(of("PARAM_VALUE", link.sent)) == 3 * len(SETTINGS)


def test_a_list_that_is_being_sent_continues_when_a_ground_station_appears() -> None:
    link = Link()
    link.wait(1.0)
    link.wait(7.0, station=255)
    link.take(mavlink.MAVLink_param_request_list_message(1, US))
    link.wait(10.0, station=255)  # the seven seconds of the station end while the list is sent
    assert [message.param_index for _, message in of("PARAM_VALUE", link.sent)] == list(range(len(SETTINGS)))


def test_on_px4_parameters_are_sent_only_on_request() -> None:
    link = Link(mavlink.MAV_AUTOPILOT_PX4)
    link.wait(60.0, station=255)
    assert of("PARAM_VALUE", link.sent) == []


def test_under_load_at_most_two_messages_are_sent_per_tick() -> None:
    """A parameter list, many commands, a text and the values at the same time."""
    link = Link()
    link.wait(2.0)
    link.sent.clear()
    start_s = link.t
    link.take(mavlink.MAVLink_param_request_list_message(1, US))
    link.ours.say(Notice(link.t, Severity.WARNING, "Vine: " + 120 * "x"))
    for _ in range(10):
        link.take(mavlink.MAVLink_command_long_message(1, US, 512, 0, 148, 0, 0, 0, 0, 0, 0))
    link.wait(3.0)
    kinds = Counter(message.get_type() for _, message in link.sent)
    assert kinds["COMMAND_ACK"] == kinds["AUTOPILOT_VERSION"] == 10
    assert kinds["PARAM_VALUE"] == len(SETTINGS)
    assert kinds["STATUSTEXT"] == 3
    assert kinds["HEARTBEAT"] == 3
    assert kinds["NAMED_VALUE_FLOAT"] == pytest.approx(30, abs=2)
    times_s = [t for t, _ in link.sent]
    assert all(third - first >= TICK_S - 1e-5 for first, third in zip(times_s, times_s[2:], strict=False))
    acknowledged = [t - start_s for t, _ in of("COMMAND_ACK", link.sent)]
    assert acknowledged[0] <= 2 * TICK_S
    assert link.ours.dropped == 0


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_in_flight_at_most_two_messages_are_sent_per_tick(
    kind: AutopilotKind, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The whole core, from the first heartbeat: requests, mission, parameters, commands and values."""
    flight = SimulatedFlight(config.default(), FakeAutopilot(kind))
    handle = flight.core.handle
    left: list[tuple[float, MavlinkMessage]] = []

    def watched(event: Event) -> list[Action]:
        actions = handle(event)
        left.extend((event.t, action.message) for action in actions if isinstance(action, ToVehicle))
        return actions

    monkeypatch.setattr(flight.core, "handle", watched)
    station = MavlinkCodec(255, 190)

    def ask(message: MavlinkMessage) -> None:
        flight.autopilot.receive(flight.world.now, "gcs", station.encode(message, 255))

    for quarter in range(4, 80):  # one at a time, because an autopilot loses messages of a burst
        flight.run(quarter / 4)
        if quarter == 20:
            ask(mavlink.MAVLink_param_request_list_message(1, US))
        elif quarter % 4 == 0:
            ask(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        else:
            ask(mavlink.MAVLink_command_long_message(1, US, 512, 0, 148, 0, 0, 0, 0, 0, 0))
    flight.run(21.0)
    times_s = [t for t, _ in left]
    assert all(third - first >= TICK_S - 1e-5 for first, third in zip(times_s, times_s[2:], strict=False))
    kinds = Counter(message.get_type() for _, message in left)
    assert kinds["AUTOPILOT_VERSION"] == kinds["COMMAND_ACK"] == 3 * 19
    assert kinds["PARAM_VALUE"] == len(SETTINGS) * (2 if kind == "ardupilot" else 1)
    assert kinds["COMMAND_LONG"] >= 5
    assert kinds["HEARTBEAT"] == pytest.approx(20, abs=2)
    assert flight.core._vehicle.component.dropped == 0


# A signing key that a ground station gives the vehicle.


def texts_about_key(conf: config.Config, target_system: int, times: int = 1) -> list[str]:
    """The texts when a ground station gives a vehicle its key."""
    core, codec = Core(conf), MavlinkCodec(0, US)
    autopilot, station = mavlink.MAVLink(None, 1, 1), mavlink.MAVLink(None, 255, 190)
    setup = mavlink.MAVLink_setup_signing_message(target_system, 1, list(range(32)), 1)
    frames = [mavlink.MAVLink_heartbeat_message(2, 3, 0x80, 3, 4, 3).pack(autopilot)]
    for station.seq in range(times):
        frames.append(setup.pack(station))
    actions = [
        action
        for i, frame in enumerate(frames)
        for message in codec.decode(frame)
        for action in core.handle(VehicleMessage(float(i), message))
    ]
    return [action.text for action in actions if isinstance(action, Notice) and "serving" not in action.text]


@pytest.mark.parametrize("target_system", [0, 1])
def test_a_key_for_a_vehicle_without_one_in_its_configuration_is_reported_once(target_system: int) -> None:
    texts = texts_about_key(config.default(), target_system, times=3)
    assert texts == ["Vine: SETUP_SIGNING ignored: no key configured"]


def test_a_key_for_another_vehicle_or_beside_our_own_is_not_reported() -> None:
    assert texts_about_key(config.default(), 2) == []
    conf = config.default()
    with_key = msgspec.structs.replace(conf.vehicle, signing_key="key.txt")
    assert texts_about_key(msgspec.structs.replace(conf, vehicle=with_key), 1) == []


def test_in_a_simulated_flight_the_answer_to_a_fed_command_reaches_the_autopilot(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    flight = SimulatedFlight(config.default())
    flight.run(3.0)
    frames: list[bytes] = []
    monkeypatch.setattr(flight.autopilot, "receive", lambda t, link, data: frames.append(data))
    ours = MavlinkCodec(1, US)
    command = mavlink.MAVLink_command_long_message(1, US, mavlink.MAV_CMD_USER_4, 0, *[0.0] * 7)
    (received,) = ours.decode(MavlinkCodec(255, 190).encode(command, 255))
    flight.feed(VehicleMessage(flight.world.now, received))
    sent = [message for frame in frames for message in MavlinkCodec(255, 190).decode(frame)]
    assert [message.command for message in sent if message.get_type() == "COMMAND_ACK"] == [
        mavlink.MAV_CMD_USER_4
    ]
