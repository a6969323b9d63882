"""The page on MQTT shows the real topics, payloads and schema."""

from __future__ import annotations

import re
from pathlib import Path

import msgspec

from flying_vines.gateway.messages import COMMANDS
from flying_vines.gateway.mqtt.broker import THROWN_OUT
from flying_vines.gateway.mqtt.connection import MAX_PACKET, POLICY
from flying_vines.gateway.mqtt.payloads import ASKED_WITHIN_S, PAYLOADS, SCHEMA_VERSION, Topics, schemas
from flying_vines.gateway.mqtt.publisher import MAX_STORED_EVENTS, RESERVOIR_S
from flying_vines.gateway.mqtt.requests import MAX_AT_ONCE, MAX_PER_S

from ..gateway_inputs import configured

DOCS = Path(__file__).parents[3] / "docs"
PAGE = (DOCS / "mqtt.md").read_text(encoding="utf-8")


def test_the_schema_is_the_code_s() -> None:
    made = msgspec.json.format(msgspec.json.encode(schemas()), indent=2) + b"\n"
    assert (DOCS / "mqtt-schema.json").read_bytes() == made


def test_every_topic_is_in_the_table() -> None:
    table = re.findall(r"^\| `(\w+)` \|", PAGE, re.MULTILINE)[: len(PAYLOADS)]
    assert sorted(table) == sorted(PAYLOADS)
    topics = Topics("p", "n")
    assert {getattr(topics, name) for name in PAYLOADS} == {f"p/n/{name}" for name in PAYLOADS}


def test_every_example_is_what_is_sent_and_of_every_topic_there_is_one() -> None:
    shown = set()
    topic = ""
    for name, example in re.findall(r"(?:`flying-vines/heron/(\w+)`\n)?```json\n(.*?)```", PAGE, re.DOTALL):
        topic = name or topic
        shown.add(topic)
        payload = msgspec.json.decode(example, type=PAYLOADS[topic])
        assert msgspec.json.encode(payload) == msgspec.json.encode(
            msgspec.convert(msgspec.json.decode(example), PAYLOADS[topic])
        )
        missing = msgspec.to_builtins(payload).keys() - msgspec.json.decode(example).keys()
        assert topic == "ask" or not missing, f"{topic}: {missing}"
    assert shown == set(PAYLOADS)


def test_its_numbers_and_commands_are_the_code_s() -> None:
    mqtt = configured().mqtt
    for said in (
        f"`version` ({SCHEMA_VERSION})",
        f"every {RESERVOIR_S:g} s",
        f"`mqtt.rate_Hz`, {mqtt.rate_Hz:g} a second",
        f"the last {MAX_STORED_EVENTS} events",
        f"a time more than {ASKED_WITHIN_S:g} s from now",
        f"longer than {MAX_PACKET // 1024} kB",
        f"shorter than {POLICY.report_after_s:g} s",
        "after 15 s, later every five minutes",
        THROWN_OUT.text,
    ):
        assert said in " ".join(PAGE.split()), said
    assert (MAX_AT_ONCE, MAX_PER_S, POLICY.longest_wait_s, POLICY.refused_waits_s) == (
        10,
        5,
        60,
        (15, 300),
    )
    guide = PAGE[PAGE.index("## Commands to the vehicle") :]
    assert all(f"`{command}`" in guide for command in COMMANDS)
