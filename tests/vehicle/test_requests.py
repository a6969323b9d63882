"""Our answers to any component: identity, a message, a rate, a ping."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Sequence
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.clock import Timesync
from flying_vines.vehicle.component.requests import (
    ProtocolVersion,
    Requests,
    autopilot_version,
    packed_version,
)
from flying_vines.vehicle.component.senders import Sender
from flying_vines.vehicle.component.telemetry import Heartbeat, NamedValues
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage

ACCEPTED, DENIED, UNSUPPORTED = 0, 2, 3
US, STATION, AUTOPILOT = (1, 191), (255, 190), (1, 1)
REQUEST_MESSAGE, SET_INTERVAL, GET_INTERVAL = 512, 511, 510
REQUEST_PROTOCOL_VERSION, REQUEST_CAPABILITIES = 519, 520
TICK_S = 0.02
VALUES = {"RES_KPA": 500.0, "CYC_LEFT": 40.0, "CV_KPA": 3.0}


def from_sender(message: MavlinkMessage, sender: tuple[int, int] = STATION) -> MavlinkMessage:
    return mavlink.MAVLink(None).parse_char(message.pack(mavlink.MAVLink(None, *sender)))


def command(
    number: int, params: Sequence[float] = (), target: tuple[int, int] = US, as_int: bool = False
) -> MavlinkMessage:
    numbers = [*params, *(7 * [0.0])][:7]
    if as_int:
        return mavlink.MAVLink_command_int_message(*target, 0, number, 0, 0, *numbers[:4], 0, 0, 0.0)
    return mavlink.MAVLink_command_long_message(*target, number, 0, *numbers)


class Bench:
    """Requests, and the telemetry that they control."""

    def __init__(self) -> None:
        self.heartbeat = Heartbeat()
        self.values = NamedValues(0.5)
        self.requests = Requests(191, self.heartbeat, self.values)
        self.t = 100.0

    def take(self, message: MavlinkMessage, sender: tuple[int, int] = STATION) -> list[MavlinkMessage] | None:
        kind = Sender(*sender, is_autopilot=sender == AUTOPILOT, is_station=sender == STATION)
        return self.requests.handle(self.t, from_sender(message, sender), 1, kind)

    def ask(
        self, number: int, *params: float, sender: tuple[int, int] = STATION
    ) -> tuple[int, list[MavlinkMessage]]:
        """The result in the acknowledgement, which is sent first and to the sender; and the other
        messages."""
        answers = self.take(command(number, params), sender)
        assert answers is not None
        acknowledgement, *rest = answers
        assert acknowledgement.get_type() == "COMMAND_ACK"
        assert acknowledgement.command == number
        assert (acknowledgement.target_system, acknowledgement.target_component) == sender
        assert self.take(command(number, params, as_int=True), sender) is not None
        return acknowledgement.result, rest

    def wait(self, for_s: float) -> list[tuple[float, str]]:
        """The named values that are sent."""
        sent = []
        for _ in range(round(for_s / TICK_S)):
            sent += [(self.t, message.name) for message in self.values.due(self.t, 0, VALUES)]
            self.t += TICK_S
        return sent


# Identity.


@pytest.mark.parametrize("asked", [(REQUEST_MESSAGE, 148), (REQUEST_CAPABILITIES, 1)])
def test_our_version_and_what_we_can_do(asked: tuple[int, float]) -> None:
    result, (answer,) = Bench().ask(*asked)
    assert result == ACCEPTED
    (received,) = MavlinkCodec(255, 190).decode(MavlinkCodec(*US).encode(answer, 1))
    assert (received.get_srcSystem(), received.get_srcComponent()) == US
    major, minor, patch = (int(part) for part in version("flying-vines").split(".")[:3])
    assert list(received.flight_sw_version.to_bytes(4, "big"))[:3] == [major, minor, patch]


def test_only_true_capabilities_are_reported() -> None:
    """With file transfer claimed, Mission Planner would wait for a parameter file."""
    claimed = {
        name.removeprefix("MAV_PROTOCOL_CAPABILITY_")
        for name, bit in vars(mavlink).items()
        if name.startswith("MAV_PROTOCOL_CAPABILITY_")
        and not name.endswith("_END")
        and autopilot_version().capabilities & bit
    }
    assert claimed == {"MAVLINK2", "COMMAND_INT", "PARAM_ENCODE_C_CAST"}


@pytest.mark.parametrize(
    ("text", "packed"),
    [
        ("0.1.0", 0x000100FF),
        ("1.2", 0x010200FF),
        ("1.2.3", 0x010203FF),
        ("1.2.3a4", 0x01020340),
        ("1.2.3b1", 0x01020380),
        ("1.2.3rc1", 0x010203C0),
        ("1.2.4.dev3", 0x01020400),
        ("1.2.4rc1.dev3+g12ab", 0x01020400),
        ("300.2.3", 0xFF0203FF),
        ("unknown", 0),
    ],
)
def test_versions_are_packed_as_mavlink_has_them(text: str, packed: int) -> None:
    assert packed_version(text) == packed


DIALECT = """<?xml version="1.0"?><mavlink><dialect>0</dialect><messages>
<message id="300" name="PROTOCOL_VERSION"><description>-</description>
<field type="uint16_t" name="version">-</field><field type="uint16_t" name="min_version">-</field>
<field type="uint16_t" name="max_version">-</field><field type="uint8_t[8]" name="spec_version_hash">-</field>
<field type="uint8_t[8]" name="library_version_hash">-</field></message></messages></mavlink>
"""


@pytest.mark.parametrize("asked", [(REQUEST_MESSAGE, 300), (REQUEST_PROTOCOL_VERSION, 1)])
def test_the_protocol_version_is_read_by_a_dialect_that_has_it(
    tmp_path: Path, asked: tuple[int, float]
) -> None:
    """The dialect is generated by pymavlink from MAVLink's own definition."""
    _, (answer,) = Bench().ask(*asked)
    frame = answer.pack(mavlink.MAVLink(None, *US))
    (tmp_path / "own.xml").write_text(DIALECT)
    generate = "from pymavlink.generator import mavgen; mavgen.mavgen(mavgen.Opts('own', '2.0'), ['own.xml'])"
    subprocess.run([sys.executable, "-c", generate], cwd=tmp_path, check=True, capture_output=True)
    read = f"import own; print(own.MAVLink(None).parse_char(bytes.fromhex('{frame.hex()}')).to_dict())"
    shown = subprocess.run(
        [sys.executable, "-c", read], cwd=tmp_path, check=True, capture_output=True, text=True
    )
    assert "'version': 200, 'min_version': 100, 'max_version': 200" in shown.stdout
    assert ProtocolVersion.id == answer.get_msgId() == 300


# Request of a message.


def test_a_requested_heartbeat_is_the_next_message_sent() -> None:
    bench = Bench()
    assert len(bench.heartbeat.due(bench.t, 4)) == 1
    assert bench.heartbeat.due(bench.t + 0.1, 4) == []
    assert bench.ask(REQUEST_MESSAGE, 0) == (ACCEPTED, [])
    assert len(bench.heartbeat.due(bench.t + 0.1, 4)) == 1


def test_requested_values_are_sent_soon_and_one_after_another() -> None:
    bench = Bench()
    bench.ask(SET_INTERVAL, 251, 10e6)
    bench.wait(31.0)
    assert bench.ask(REQUEST_MESSAGE, 251) == (ACCEPTED, [])
    sent = bench.wait(0.4)
    assert sorted(name for _, name in sent) == sorted(VALUES)
    assert all(0.1 - 1e-6 <= later - t <= 0.13 for (t, _), (later, _) in pairwise(sent))
    assert bench.wait(2.0) == []


@pytest.mark.parametrize("asked", [(REQUEST_MESSAGE, 65), (REQUEST_MESSAGE, 253), (SET_INTERVAL, 65, 1e5)])
def test_messages_that_are_not_ours_are_unsupported(asked: tuple[float, ...]) -> None:
    assert Bench().ask(int(asked[0]), *asked[1:]) == (UNSUPPORTED, [])


@pytest.mark.parametrize("number", [REQUEST_MESSAGE, SET_INTERVAL, GET_INTERVAL])
@pytest.mark.parametrize("message_id", [math.nan, math.inf, -math.inf, 251.5])
def test_an_invalid_message_id_is_denied(number: int, message_id: float) -> None:
    assert Bench().ask(number, message_id, 1e6) == (DENIED, [])


@pytest.mark.parametrize("number", [REQUEST_PROTOCOL_VERSION, REQUEST_CAPABILITIES])
@pytest.mark.parametrize("param", [0.0, 2.0, math.nan])
def test_a_request_that_requests_nothing_is_denied(number: int, param: float) -> None:
    assert Bench().ask(number, param) == (DENIED, [])


# Rates.


def test_the_interval_of_values_is_set_reported_and_kept() -> None:
    bench = Bench()
    for interval_us in (1e5, 2.5e5, 1e6, 5e6):
        assert bench.ask(SET_INTERVAL, 251, interval_us) == (ACCEPTED, [])
        for asked in ((GET_INTERVAL, 251.0), (REQUEST_MESSAGE, 244.0, 251.0)):
            result, (answer,) = bench.ask(int(asked[0]), *asked[1:])
            assert (result, answer.message_id, answer.interval_us) == (ACCEPTED, 251, interval_us)
        bench.wait(interval_us / 1e6)
        sent = bench.wait(4 * interval_us / 1e6)
        assert len(sent) == pytest.approx(4 * len(VALUES), abs=2)


def test_values_are_switched_off_and_on_again() -> None:
    bench = Bench()
    assert len(bench.wait(2.0)) == pytest.approx(12, abs=1)
    result, (notice,) = bench.ask(SET_INTERVAL, 251, -1)
    assert (result, notice.text) == (ACCEPTED, "Vine: 255/190 switched the values off, for 60 s")
    assert bench.wait(30.0) == []
    _, (answer,) = bench.ask(GET_INTERVAL, 251)
    assert answer.interval_us == -1
    assert bench.ask(SET_INTERVAL, 251, 0) == (ACCEPTED, [])
    assert len(bench.wait(2.0)) == pytest.approx(12, abs=1)
    _, (answer,) = bench.ask(GET_INTERVAL, 251)
    assert answer.interval_us == 500_000


@pytest.mark.parametrize("interval_us", [99_000.0, 1.01e7, 1.0, -2.0, math.nan, math.inf])
def test_a_rate_that_is_too_fast_or_too_slow_is_denied_and_changes_nothing(interval_us: float) -> None:
    bench = Bench()
    assert bench.ask(SET_INTERVAL, 251, interval_us) == (DENIED, [])
    assert bench.values.period_s(bench.t) == 0.5


@pytest.mark.parametrize(
    ("interval_us", "result"),
    [(0.0, ACCEPTED), (1e6, ACCEPTED), (-1.0, DENIED), (2e6, DENIED), (5e5, DENIED)],
)
def test_nobody_can_change_the_heartbeat(interval_us: float, result: int) -> None:
    bench = Bench()
    assert bench.ask(SET_INTERVAL, 0, interval_us) == (result, [])
    _, (answer,) = bench.ask(GET_INTERVAL, 0)
    assert answer.interval_us == 1_000_000


def test_the_interval_of_what_we_never_send_is_reported_as_such() -> None:
    result, (answer,) = Bench().ask(GET_INTERVAL, 65)
    assert (result, answer.message_id, answer.interval_us) == (ACCEPTED, 65, 0)
    assert Bench().ask(GET_INTERVAL, 70_000) == (DENIED, [])


# Requests that are not for us, or not supported.


@pytest.mark.parametrize("target", [(1, 0), (0, 0), (1, 1), (2, 191), (0, 191)])
@pytest.mark.parametrize("number", [REQUEST_MESSAGE, SET_INTERVAL, GET_INTERVAL, 519, 520])
def test_requests_to_others_are_left_alone(number: int, target: tuple[int, int]) -> None:
    bench = Bench()
    for as_int in (False, True):
        assert bench.take(command(number, (251.0, -1.0), target, as_int)) is None
    assert bench.values.period_s(bench.t) == 0.5


@pytest.mark.parametrize("number", [31010, 31013, 400, 187, 176, 246, 42428])
def test_other_commands_are_not_handled_here(number: int) -> None:
    assert Bench().take(command(number, (1.0,))) is None


def test_a_request_of_the_autopilot_itself_is_answered_too() -> None:
    assert Bench().ask(REQUEST_MESSAGE, 148, sender=AUTOPILOT)[0] == ACCEPTED


# Pings and clock.


@pytest.mark.parametrize("target", [(0, 0), (1, 0), US])
@pytest.mark.parametrize("sender", [STATION, AUTOPILOT, (1, 154)])
def test_a_ping_comes_back_once(target: tuple[int, int], sender: tuple[int, int]) -> None:
    bench = Bench()
    ping = mavlink.MAVLink_ping_message(123456, 7, *target)
    answers = bench.take(ping, sender)
    assert answers is not None
    (answer,) = answers
    assert (answer.time_usec, answer.seq) == (123456, 7)
    assert (answer.target_system, answer.target_component) == sender
    assert bench.take(ping, sender) == []
    assert len(bench.take(mavlink.MAVLink_ping_message(123999, 8, *target), sender) or []) == 1


@pytest.mark.parametrize(
    ("target", "sender"), [((2, 0), STATION), ((255, 190), AUTOPILOT), ((1, 1), STATION), ((0, 0), US)]
)
def test_pings_to_others_and_our_own_stay_unanswered(
    target: tuple[int, int], sender: tuple[int, int]
) -> None:
    assert Bench().take(mavlink.MAVLink_ping_message(1, 1, *target), sender) == []


def test_two_components_that_answer_pings_do_not_answer_each_other_forever() -> None:
    one, other = Bench(), Bench()
    other.requests = Requests(192, other.heartbeat, other.values)
    asked = [mavlink.MAVLink_ping_message(1, 1, 0, 0)]
    for turn in range(20):
        bench, sender = ((one, (1, 192)), (other, US))[turn % 2]
        asked = [answer for ping in asked for answer in bench.take(ping, sender) or []]
    assert asked == []


def test_the_autopilots_clock_is_answered_and_answers_are_not() -> None:
    bench = Bench()
    answers = bench.take(mavlink.MAVLink_timesync_message(0, 1234), AUTOPILOT)
    assert answers is not None
    (answer,) = answers
    assert (answer.tc1, answer.ts1) == (100_000_000_000, 1234)
    assert bench.take(mavlink.MAVLink_timesync_message(5, 1234), AUTOPILOT) == []
    for sender in (STATION, (1, 154), (2, 1)):
        assert bench.take(mavlink.MAVLink_timesync_message(0, 1234), sender) == []


def test_an_answer_about_the_clock_names_whom_it_is_for() -> None:
    """Without target fields PX4 forwards it to every link."""
    (answer,) = Bench().take(mavlink.MAVLink_timesync_message(0, 1234), AUTOPILOT) or []
    frame = answer.pack(mavlink.MAVLink(None, *US))
    assert frame[1] == 18
    assert tuple(frame[10 + 16 : 10 + 18]) == AUTOPILOT
    (received,) = MavlinkCodec(1, 1).decode(frame)
    assert (received.tc1, received.ts1) == (100_000_000_000, 1234)


@pytest.mark.parametrize(
    ("target", "answered"), [(US, True), ((1, 0), True), ((1, 154), False), ((2, 0), False)]
)
def test_a_timesync_request_is_answered_only_if_it_is_for_us(target: tuple[int, int], answered: bool) -> None:
    asked = Timesync(0, 1234, *target).pack(mavlink.MAVLink(None, *AUTOPILOT))
    (received,) = MavlinkCodec(*US).decode(asked)
    assert bool(Bench().requests.handle(0.0, received, 1, Sender(*AUTOPILOT, is_autopilot=True))) is answered


def test_the_clock_is_reported_once_a_second_however_often_it_is_asked() -> None:
    bench, answered = Bench(), 0
    for _ in range(600):  # PX4 asks ten times a second
        answered += len(bench.take(mavlink.MAVLink_timesync_message(0, 1234), AUTOPILOT) or [])
        bench.t += 0.1
    assert 60 <= answered <= 64
