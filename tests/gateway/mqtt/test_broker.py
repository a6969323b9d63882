"""Vehicles on a real broker: topics, requests, and a broker that disappears and returns."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import re
import ssl
import time
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from real_time import real_time
from required_programs import need
from waiting import until

from firmware_link import reconnect
from flying_vines.config.config import MqttConfig
from flying_vines.doctor.network import broker_facts
from flying_vines.gateway import mqtt as client
from flying_vines.gateway.feed import Feed
from flying_vines.gateway.messages import Answered, FromGateway, Request, Trouble
from flying_vines.gateway.mqtt import connection, publisher
from flying_vines.gateway.mqtt.broker import THROWN_OUT
from flying_vines.gateway.mqtt.publisher import Publication

from ..gateway_inputs import happened, notice, seen, start
from .brokers import MOSQUITTO_HOW, Broker, Line, Onlooker, make_certificates, onlooker, run_quietly, running

pytestmark = real_time

BASE = "flying-vines/heron"


class Vehicle:
    """A vehicle whose service sends a snapshot ten times a second, and carries out requests if not `deaf`."""

    def __init__(self, **settings: Any) -> None:
        self.feed = Feed(start(**settings), self._receive)
        self.troubles: list[str] = []
        self.asked: list[Request] = []
        self.deaf = False

    @property
    def t(self) -> float:
        return asyncio.get_running_loop().time()

    def say(self, text: str) -> None:
        self.feed.take(happened(notice(self.t, text)))

    def _receive(self, message: FromGateway) -> None:
        if isinstance(message, Trouble):
            self.troubles.append(message.text)
            return
        assert isinstance(message, Request)
        self.asked.append(message)
        if not self.deaf:
            answer = Answered(message.number, "accepted", "")
            asyncio.get_running_loop().call_soon(self.feed.take, answer)

    async def live(self) -> None:
        while True:
            self.feed.take(seen(self.t))
            await asyncio.sleep(0.1)

    async def in_trouble(self, text: str) -> None:
        await until(lambda: any(text in trouble for trouble in self.troubles), text)


@contextlib.asynccontextmanager
async def flying(**settings: Any) -> AsyncIterator[Vehicle]:
    vehicle = Vehicle(**settings)
    parts = [asyncio.create_task(part) for part in (vehicle.live(), client.serve(vehicle.feed))]
    try:
        yield vehicle
    finally:
        for part in parts:
            part.cancel()
        ended = await asyncio.gather(*parts, return_exceptions=True)
    assert all(isinstance(end, asyncio.CancelledError) for end in ended), ended


@pytest.fixture(autouse=True)
def in_a_hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    quick = replace(connection.POLICY, first_wait_s=0.1, longest_wait_s=0.2, report_after_s=1e-6)
    monkeypatch.setattr(connection, "POLICY", quick)
    monkeypatch.setattr(reconnect, "STABLE_S", 0.1)


def ask(id: str, command: str = "vent", **more: Any) -> dict[str, Any]:
    return {"id": id, "unix_s": time.time(), "command": command, **more}


async def test_a_later_subscriber_gets_the_present_vehicles(broker: Broker, people: Onlooker) -> None:
    async with flying(broker=broker.url, name="heron") as vehicle:
        await people.until(f"{BASE}/status", status="online")
        await people.until(f"{BASE}/state", count=2, doing="bend-full")
        await people.until(f"{BASE}/reservoir")
        async with onlooker(broker) as latecomer:
            await latecomer.until(f"{BASE}/status", status="online")
            await latecomer.until(f"{BASE}/about", flying_vines="1.2.3")
            first = {str(message.topic): message.retain for message in latecomer.received}
            assert first[f"{BASE}/status"]
            assert first[f"{BASE}/about"]
        assert not vehicle.troubles
    await people.until(f"{BASE}/status", status="offline")
    async with onlooker(broker) as latecomer:
        await latecomer.until(f"{BASE}/status", status="offline")
        assert not latecomer.on(f"{BASE}/state"), "states are not kept"


async def test_events_while_the_broker_is_away_are_sent_once_and_in_order(
    broker: Broker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(publisher, "MAX_STORED_EVENTS", 20)
    async with Line(broker).laid() as line, flying(broker=line.url, name="heron") as vehicle:
        async with onlooker(broker) as people:
            vehicle.say("before")
            await people.until(f"{BASE}/event", text="before")
            line.cut()
            broker.kill()
        for number in range(30):
            vehicle.say(f"away {number}")
        await vehicle.in_trouble("the connection is lost")
        await broker.start()
        async with onlooker(broker) as people:
            line.mend()
            await people.until(f"{BASE}/event", text="away 29")
            vehicle.say("back")
            await people.until(f"{BASE}/event", text="back")
            lost, *told = people.on(f"{BASE}/event")
            assert (lost["event"], lost["count"], lost["number"]) == ("lost", 10, 11)
            assert [event["text"] for event in told] == [
                *(f"away {number}" for number in range(10, 30)),
                "back",
            ]
            assert [event["number"] for event in told] == list(range(12, 33))
            await people.until(f"{BASE}/status", status="online")
            await people.until(f"{BASE}/state")
            began_s = people.on(f"{BASE}/about")[0]["unix_s"]
            assert all(state["unix_s"] > began_s - 0.2 for state in people.on(f"{BASE}/state"))
        await vehicle.in_trouble("is back")
        assert len(vehicle.troubles) == 2


async def test_a_flood_of_requests_delays_neither_states_nor_a_vent(broker: Broker, people: Onlooker) -> None:
    async with flying(broker=broker.url, name="heron", rate_Hz=10.0, commands=("vent", "bend")) as vehicle:
        await people.until(f"{BASE}/status", status="online")
        before = len(people.on(f"{BASE}/state"))
        began = time.monotonic()
        for number in range(200):
            for nonsense in (b"{", b"x" * 3000, b"y" * 100_000, b'{"id":"1"}'):
                await people.say(f"{BASE}/ask", nonsense)
            await people.say(f"{BASE}/ask", ask(f"bend {number}", "bend", value=30.0))
        took_s = time.monotonic() - began
        await people.say(f"{BASE}/ask", ask("vent"))
        await people.until(f"{BASE}/answer", id="vent", safety="accepted")
        await people.until(f"{BASE}/state", count=before + 3)
        assert len(people.on(f"{BASE}/answer")) < 12 + 6 * (took_s + 1.0)
        assert len(vehicle.asked) < 12 + 6 * (took_s + 1.0)
        assert vehicle.troubles == ["MQTT: flying-vines/heron/ask: too many requests, some get no answer"]


async def test_listed_commands_are_executed_and_answered(broker: Broker, people: Onlooker) -> None:
    async with flying(broker=broker.url, name="heron", commands=("vent", "profile")) as vehicle:
        await people.until(f"{BASE}/about", commands=["vent", "profile"])
        await people.until(f"{BASE}/status", status="online")
        await people.say(f"{BASE}/ask", ask("1"))
        await people.until(f"{BASE}/answer", id="1", safety="accepted")
        await people.say(f"{BASE}/ask", ask("2", "profile", name="wave"))
        await people.until(f"{BASE}/answer", id="2", safety="accepted")
        assert [(asked.by, asked.command, asked.name) for asked in vehicle.asked] == [
            ("broker", "vent", None),
            ("broker", "profile", "wave"),
        ]
        await people.say(f"{BASE}/ask", ask("3", "bend", value=30.0))
        refused = await people.until(f"{BASE}/answer", id="3", safety="refused")
        assert "is not permitted" in refused["reason"]
        vehicle.deaf = True
        await people.say(f"{BASE}/ask", ask("4"))
        unknown = await people.until(f"{BASE}/answer", id="4", safety="unknown")
        assert unknown["reason"] == "the service does not answer"
        assert len(vehicle.asked) == 3


async def test_nothing_may_be_asked_for_unless_it_is_switched_on(broker: Broker, people: Onlooker) -> None:
    async with flying(broker=broker.url, name="heron") as vehicle:
        await people.until(f"{BASE}/status", status="online")
        await people.say(f"{BASE}/ask", ask("1"))
        await people.until(f"{BASE}/state", count=3)
        assert not vehicle.asked
        assert not people.on(f"{BASE}/answer")


async def test_a_request_from_before_the_vehicle_connected_is_not_executed(
    broker: Broker, people: Onlooker
) -> None:
    """The broker retained the request, or stored it for a client of that name."""
    await people.say(f"{BASE}/ask", ask("retained"), retain=True)
    async with flying(broker=broker.url, name="heron", commands=("vent",)):
        await people.until(f"{BASE}/status", status="online")
    await people.say(f"{BASE}/ask", ask("meanwhile"), qos=1)
    async with flying(broker=broker.url, name="heron", commands=("vent",)) as vehicle:
        await people.until(f"{BASE}/status", count=2, status="online")
        await people.until(f"{BASE}/answer", count=2)
        answers = people.on(f"{BASE}/answer")
        assert {(answer["id"], answer["safety"]) for answer in answers} == {("retained", "refused")}
        assert "retained" in answers[0]["reason"]
        assert not vehicle.asked


async def test_a_cancellation_is_not_lost_where_the_library_loses_it() -> None:
    class Loses:
        async def publish(self, *_: object) -> None:
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.sleep(60.0)

    async def tell() -> None:
        while True:
            await connection._publish(Loses(), Publication("topic", b""))  # type: ignore[arg-type]

    telling = asyncio.create_task(tell())
    await asyncio.sleep(0)
    telling.cancel()
    done, _ = await asyncio.wait({telling}, timeout=5.0)
    assert done and telling.cancelled()


async def test_vehicles_of_a_fleet_are_distinguished(broker: Broker, people: Onlooker) -> None:
    heron = flying(broker=broker.url, name="heron", commands=("vent",))
    egret = flying(broker=broker.url, name="egret", commands=("vent",))
    async with heron as first, egret as second:
        for vehicle, name in ((first, "heron"), (second, "egret")):
            await people.until(f"flying-vines/{name}/status", status="online")
            vehicle.say(f"I am {name}")
            await people.until(f"flying-vines/{name}/event", text=f"I am {name}")
        await people.say("flying-vines/egret/ask", ask("1"))
        await people.until("flying-vines/egret/answer", id="1")
        assert (len(first.asked), len(second.asked)) == (0, 1)
        assert not people.on("flying-vines/heron/answer")


async def test_two_vehicles_of_one_name_are_reported(broker: Broker, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reconnect, "STABLE_S", 3.0)
    monkeypatch.setattr(connection, "POLICY", replace(connection.POLICY, report_after_s=5.0))
    heron = {"broker": broker.url, "name": "heron"}
    async with flying(**heron) as first, flying(**heron) as second:
        await until(lambda: bool(first.troubles or second.troubles), "a trouble")
        troubles = first.troubles + second.troubles
        assert {trouble.split(": ", 2)[2] for trouble in troubles} == {THROWN_OUT.text}


async def test_a_user_and_a_password(tmp_path: Path) -> None:
    passwd = need("mosquitto_passwd", MOSQUITTO_HOW)
    users = tmp_path / "users"
    run_quietly(passwd, "-b", "-c", str(users), "heron", "right")
    run_quietly(passwd, "-b", str(users), "people", "look on")
    rights = tmp_path / "rights"
    rights.write_text(rights_of_the_page())
    password = tmp_path / "password"
    password.write_text("wrong\n")
    password.chmod(0o644)
    settings = f"allow_anonymous false\npassword_file {users}\nacl_file {rights}"
    login = {"username": "heron", "password_file": str(password)}
    async with (
        running(Broker(tmp_path, settings)) as broker,
        onlooker(broker, username="people", password="look on") as people,
    ):
        async with flying(broker=broker.url, name="heron", **login) as vehicle:
            await vehicle.in_trouble(f"others may read or change the password: chmod 600 {password}")
        password.chmod(0o600)
        async with flying(broker=broker.url, name="heron", **login) as vehicle:
            await vehicle.in_trouble("it refuses the login: check mqtt.username and mqtt.password_file")
            assert len(vehicle.troubles) == 1
        password.write_text("right\n")
        async with flying(broker=broker.url, name="heron", **login) as vehicle:
            await people.until(f"{BASE}/state")
            assert not vehicle.troubles
        async with flying(broker=broker.url, name="egret", **login) as vehicle:
            await vehicle.in_trouble("it does not let us publish to flying-vines/egret/…")
        assert not [message for message in people.received if "egret" in str(message.topic)]
        home = {"discovery_prefix": "homeassistant", "commands": ("vent",)}
        async with flying(broker=broker.url, name="heron", **home, **login) as vehicle:
            await people.until(f"{BASE}/about", commands=["vent"])
            await people.say(f"{BASE}/ask", ask("1"))
            await people.until(f"{BASE}/answer", id="1", safety="accepted")
            assert not vehicle.troubles
        seen = [
            message.topic.value for message in people.received if message.topic.matches("homeassistant/#")
        ]
        assert "homeassistant/button/heron/flying-vines_vent/config" in seen


def rights_of_the_page() -> str:
    """The access control list of docs/mqtt.md, with access of people to the discovery topics."""
    page = (Path(__file__).parents[3] / "docs" / "mqtt.md").read_text(encoding="utf-8")
    (rights,) = re.findall(r"```\n(pattern write .*?)```", page, re.DOTALL)
    (home,) = re.findall(r"`(pattern write homeassistant/[^`]*)`", page)
    return f"{home}\n{rights}topic read homeassistant/#\n"


# After a failed handshake the library leaves the socket to the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
async def test_tls_with_the_right_certificate_and_with_every_wrong_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_certificates(tmp_path)
    settings = (
        f"allow_anonymous true\ncafile {tmp_path}/ca.pem\ncertfile {tmp_path}/server.pem\n"
        f"keyfile {tmp_path}/server.key\nrequire_certificate true"
    )
    ours = {"certificate_file": f"{tmp_path}/heron.pem", "key_file": f"{tmp_path}/heron.key"}
    trusted = {"ca_file": f"{tmp_path}/ca.pem"}
    async with running(Broker(tmp_path, settings)) as broker:
        right = f"mqtts://localhost:{broker.port}"

        async def trouble(url: str, text: str, **files: str) -> None:
            async with flying(broker=url, name="heron", **files) as vehicle:
                await vehicle.in_trouble(text)
                assert vehicle.troubles == [f"MQTT: {url}: {vehicle.troubles[0].split(f'{url}: ')[1]}"]

        context = ssl.create_default_context(cafile=trusted["ca_file"])
        context.load_cert_chain(*ours.values())
        async with (
            onlooker(broker, host="localhost", tls_context=context) as people,
            flying(broker=right, name="heron", **trusted, **ours) as vehicle,
        ):
            await people.until(f"{BASE}/state")
            assert not vehicle.troubles
        await trouble(
            right, "no authority in this computer's list of authorities has signed its certificate", **ours
        )
        await trouble(
            right, f"no authority in {tmp_path}/another.pem has", ca_file=f"{tmp_path}/another.pem", **ours
        )
        wrong_name = f"mqtts://127.0.0.1:{broker.port}"
        await trouble(wrong_name, "its certificate is not for 127.0.0.1", **trusted, **ours)
        await trouble(right, "No such file", ca_file=f"{tmp_path}/nowhere.pem", **ours)
        await trouble(right, "it contains no certificates", ca_file=f"{tmp_path}/ca.key", **ours)
        with monkeypatch.context() as impatient:
            impatient.setattr(connection, "TIMEOUT_S", 0.5)
            await trouble(right, "or does it refuse mqtt.certificate_file?", **trusted)
        (tmp_path / "heron.key").chmod(0o644)
        await trouble(right, "others may read or change the key", **trusted, **ours)
    async with running(Broker(tmp_path)) as plain:
        await trouble(f"mqtts://127.0.0.1:{plain.port}", "does this port use TLS?", **trusted)
    gc.collect()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
async def test_an_authority_without_key_usage_is_refused_as_python_3_13_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_certificates(tmp_path)
    relaxed = ssl.create_default_context

    def strict(cafile: str | None = None) -> ssl.SSLContext:
        context = relaxed(cafile=cafile)
        context.verify_flags |= ssl.VERIFY_X509_STRICT
        return context

    monkeypatch.setattr(ssl, "create_default_context", strict)
    settings = f"allow_anonymous true\ncertfile {tmp_path}/of_lax.pem\nkeyfile {tmp_path}/of_lax.key"
    async with running(Broker(tmp_path, settings)) as broker:
        mqtt = MqttConfig(broker=f"mqtts://localhost:{broker.port}", ca_file=f"{tmp_path}/lax.pem")
        why = (
            f"refuses its certificate, or {tmp_path}/lax.pem: CA cert does not include key usage extension. "
            "Make both again (docs/mqtt.md)"
        )
        async with flying(broker=mqtt.broker, name="heron", ca_file=mqtt.ca_file) as vehicle:
            await vehicle.in_trouble(why)
        assert (await broker_facts(mqtt)).problem.endswith(why)
    gc.collect()


async def test_other_servers_than_a_broker(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "TIMEOUT_S", 0.3)
    greetings = (b"", b"HTTP/1.1 400 Bad Request\r\n\r\n", b"\x00" * 1000, b"\x20\x03\x00\x00", b"\xff" * 99)
    greeted: list[bytes] = []

    async def listen(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        greeted.append(greetings[len(greeted) % len(greetings)])
        writer.write(greeted[-1])
        with contextlib.suppress(OSError):
            await reader.read()
        writer.close()

    server = await asyncio.start_server(listen, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    async with flying(broker=f"mqtt://127.0.0.1:{port}", name="heron") as vehicle:
        await vehicle.in_trouble("it accepts the connection but sends nothing: is it a broker")
        await until(lambda: len(greeted) >= 5, "five greetings")
    server.close()
    async with flying(broker="mqtt://no.such.name.invalid", name="heron") as vehicle:
        await vehicle.in_trouble("unknown host name")


async def test_a_broker_that_knows_no_mqtt_5(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "TIMEOUT_S", 2.0)
    pytest.importorskip("amqtt", reason="needs amqtt: pip install 'flying-vines[dev]'")
    async with running(Broker(tmp_path, kind="amqtt")) as broker, onlooker(broker) as people:
        async with flying(broker=broker.url, name="heron", commands=("vent",)) as vehicle:
            vehicle.say("hello")
            await people.until(f"{BASE}/event", text="hello")
            await people.until(f"{BASE}/status", status="online")
            await people.until(f"{BASE}/state")
            await people.say(f"{BASE}/ask", ask("1"))
            await people.until(f"{BASE}/answer", id="1", safety="accepted")
        await people.until(f"{BASE}/status", status="offline")
