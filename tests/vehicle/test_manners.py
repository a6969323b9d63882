"""Behaviour towards other programs: only own texts, no reaction to echoes, a notice about an id in use."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

import flying_vines
from examples import examples
from flying_vines.config import config
from flying_vines.vehicle.component import Component
from flying_vines.vehicle.component.component import REPORT_AGAIN_S, WITHIN_S, DuplicateIdDetector
from flying_vines.vehicle.component.parameter_table import SETTINGS
from flying_vines.vehicle.component.texts import MAX_TEXT_LENGTH, harmless
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.notice import Notice, Severity
from flying_vines.vehicle.triggers import Trigger
from flying_vines.vehicle.vehicle import Vehicle
from flying_vines.vine.intent import VentVine

READ_BY_OTHERS = (
    "copter", "rover", "plane", "frame", "prearm", "arm:", "tuning:", "mission:", "radio failsafe",
    "flight plan received", "ardupilot ready", "#", "\t", "\n",
)  # fmt: skip
"""Texts that ground stations, autopilots and other companions search for, in lower case."""


def problems(text: str) -> list[str]:
    return [word for word in READ_BY_OTHERS if word in text.lower()]


@pytest.mark.parametrize(
    ("text", "made"),
    [
        ("Vine: bend 40° refused…", "Vine: bend 40 deg refused.."),
        ("Vine: 5 µs → 3 × 2 − 1", "Vine: 5 us -> 3 x 2 - 1"),
        ("Vine: 0…18 kPa, ±2 °", "Vine: 0..18 kPa, +/-2 deg"),
        ("Vine: Größe naïve", "Vine: Grosse naive"),
        ("Vine: 日本 ∞", "Vine: ?? ?"),
        ("no prefix", "Vine: no prefix"),
        ("", "Vine:"),
        ("PreArm: low", "Vine: Pre-Arm : low"),
        ("#speak", "Vine: no. speak"),
        ("Vine: refused hexacopter-wave", "Vine: refused hexacop-ter-wave"),
        ("Vine: refused Airframe plane ROVER", "Vine: refused Airfra-me pla-ne RO-VER"),
        ("Vine: Mission: 3 Scripting", "Vine: Mission : 3 Scripting"),
        ("Vine: Radio Failsafe Cleared", "Vine: Radio Fail-safe Cleared"),
        ("Vine: Flight plan received", "Vine: Flight plan re-ceived"),
        ("Vine: two\nlines\tand a tab\t", "Vine: two lines and a tab"),
        ("Vine: \x00\x07bell", "Vine: ??bell"),
        ("Vine: cop\u0301ter \uff03", "Vine: cop-ter no."),
    ],
)
def test_texts_are_made_harmless_and_stay_readable(text: str, made: str) -> None:
    assert harmless(text) == made
    assert problems(made) == []


PIECES = st.sampled_from(
    [*READ_BY_OTHERS, "co", "pter", "cop", "ter", "pla", "ne", " ", "°", "…", "Vine: ", "##"]
)
NASTY = st.lists(PIECES | st.text(max_size=12), max_size=30).map("".join)


@given(NASTY)
@settings(max_examples=examples(400), deadline=None)
def test_any_text_is_made_harmless(text: str) -> None:
    made = harmless(text)
    assert problems(made) == []
    assert made.startswith("Vine:")
    assert all(" " <= sign <= "~" for sign in made)
    assert made == made.strip()
    assert len(made) <= MAX_TEXT_LENGTH
    assert harmless(made) == made


@given(NASTY)
@settings(max_examples=examples(100), deadline=None)
def test_no_chunk_begins_with_what_others_look_for(text: str) -> None:
    """Some ground stations show each chunk alone."""
    ours = Component(config.default())
    ours.say(Notice(0.0, Severity.WARNING, text))
    for i in range(20):
        for message in ours.due(i * 0.1, 0, {}, 3):
            if message.get_type() == "STATUSTEXT":
                assert problems(message.text) == []


SPEAKING = [
    "core/core.py",
    "core/safety.py",
    "vehicle/vehicle.py",
    "vehicle/triggers.py",
    "vehicle/radio/rc.py",
]
SPEAKING += ["vehicle/commands.py", "vehicle/component/*.py", "vine/intent.py"]


def sentences() -> list[str]:
    """All texts for people in the code: each string that is not documentation."""
    found = []
    here = Path(flying_vines.__file__).parent
    for pattern in SPEAKING:
        files = [file for file in here.glob(pattern) if file.stem != "parameter_file"]
        assert files, pattern
        for file in files:
            tree = ast.parse(file.read_text())
            passed_over = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
            for node in ast.walk(tree):
                # Strings of comparisons and searches are texts of others.
                looks = isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
                if looks and node.func.attr in ("startswith", "compile"):  # type: ignore[attr-defined]
                    passed_over |= {id(part) for part in ast.walk(node)}
            for node in ast.walk(tree):
                text = node.value if isinstance(node, ast.Constant) else None
                if isinstance(text, str) and id(node) not in passed_over and re.search("[a-z] [a-z]", text):
                    found.append(text)
    return found


def test_no_text_in_the_code_breaks_a_rule() -> None:
    texts = sentences()
    assert len(texts) > 50
    assert any("autopilot rebooted, vented" in text for text in texts)
    assert any("another program has" in text for text in texts)
    broken = {text for text in [*texts, *(row.name for row in SETTINGS)] if problems(text)}
    assert broken <= {"radio failsafe"}  # of the RC link, as the pilot knows it


def test_notices_begin_with_their_sender() -> None:
    """This is true for the texts in the code and for the sent ones."""
    here = Path(flying_vines.__file__).parent
    notices = []
    for file in [*here.glob("core/*.py"), *here.glob("vehicle/**/*.py")]:
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Notice":
                text = node.args[2]
                if isinstance(text, ast.JoinedStr):
                    text = text.values[0]
                if isinstance(text, ast.Constant):
                    notices.append(text.value)
    assert len(notices) >= 3
    assert all(str(text).startswith("Vine: ") for text in notices)


# Our id, and echoes of our messages.


def from_sender(message: MavlinkMessage, sender: tuple[int, int]) -> MavlinkMessage:
    return mavlink.MAVLink(None).parse_char(message.pack(mavlink.MAVLink(None, *sender)))


HEARTBEAT = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 3, 3)
TAKEN = "Vine: another program has component id 191: set vehicle.component_id"


def test_a_second_component_with_our_id_is_reported_once_a_minute() -> None:
    detector = DuplicateIdDetector(191)
    assert detector.received(10.0) == []
    assert detector.received(11.0) == [Notice(11.0, Severity.ERROR, TAKEN)]
    reported_s = [t for t in range(12, 200) for _ in detector.received(float(t))]
    assert reported_s == [
        11 + round(REPORT_AGAIN_S),
        11 + 2 * round(REPORT_AGAIN_S),
        11 + 3 * round(REPORT_AGAIN_S),
    ]


def test_one_stray_message_is_no_clash() -> None:
    detector = DuplicateIdDetector(191)
    for i in range(20):
        assert detector.received(i * (WITHIN_S + 0.1)) == []


@pytest.mark.parametrize(
    "message",
    [
        HEARTBEAT,
        mavlink.MAVLink_named_value_float_message(0, b"RES_KPA", 600.0),
        mavlink.MAVLink_statustext_message(6, b"Vine: bend"),
        mavlink.MAVLink_command_ack_message(31010, 0),
        mavlink.MAVLink_param_value_message(b"VINE_RATE", 1.0, 9, 1, 0),
        mavlink.MAVLink_debug_message(0, 1, 1.0),
    ],
)
def test_a_clash_is_seen_on_the_link_by_any_message_and_only_there(message: mavlink.MAVLink_message) -> None:
    """ArduPilot forwards no HEARTBEAT of a second program with our ids, but its other messages."""
    ours = Vehicle(config.default())
    autopilot = mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3)
    ours.handle(0.0, from_sender(autopilot, (1, 1)))
    outputs = []
    for i in range(4):
        for sender in ((1, 192), (2, 191), (255, 191), (1, 1)):
            assert not ours.handle(float(i), from_sender(message, sender))
    for i in range(4):
        outputs += ours.handle(5.0 + i, from_sender(message, (1, 191)))
    assert [notice.text for notice in outputs if isinstance(notice, Notice)] == [TAKEN]
    assert len(outputs) == 1


def test_a_vent_of_a_second_program_with_our_ids_acts() -> None:
    ours = Vehicle(config.default())
    ours.handle(0.0, from_sender(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3), (1, 1)))
    vent = mavlink.MAVLink_command_long_message(1, 191, mavlink.MAV_CMD_USER_4, 0, 0, 0, 0, 0, 0, 0, 0)
    outputs = [*ours.handle(5.0, from_sender(vent, (1, 191))), *ours.tick(6.0)]
    assert [output.intent for output in outputs if isinstance(output, Trigger)] == [VentVine()]


@pytest.mark.parametrize("sender", [(1, 1), (1, 191)])
def test_echoes_of_our_values_are_ignored(sender: tuple[int, int]) -> None:
    """PX4 repeats each NAMED_VALUE_FLOAT as its own, with a name of nine characters."""
    vehicle = Vehicle(config.default())
    vehicle.handle(0.0, from_sender(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3), (1, 1)))
    for i, name in enumerate([b"RES_KPA", b"CYC_LEFT", b"CV_KPA", b"CMD_KPA", b"BEND_DEG"]):
        for echo in (
            mavlink.MAVLink_named_value_float_message(i, name, 1e9),
            mavlink.MAVLink_named_value_int_message(i, name, -1),
        ):
            outputs = vehicle.handle(0.1 + 10 * i, from_sender(echo, sender))
            assert [output for output in outputs if not isinstance(output, Notice)] == []
            assert sender == (1, 191) or outputs == []


def test_a_request_data_stream_is_ignored_without_a_text() -> None:
    """Mission Planner sends it to every component."""
    vehicle = Vehicle(config.default())
    vehicle.handle(0.0, from_sender(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3), (1, 1)))
    request = mavlink.MAVLink_request_data_stream_message(1, 191, 0, 10, 1)
    assert vehicle.handle(0.1, from_sender(request, (255, 190))) == []
