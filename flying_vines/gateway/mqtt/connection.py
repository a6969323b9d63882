"""Keeps a connection to the broker."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Sequence
from typing import Any

import aiomqtt
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from firmware_link.reconnect import KeptOpen, Policy, Problem
from flying_vines.gateway.feed import Feed, FeedReader, NoAnswerError
from flying_vines.gateway.messages import Happened
from flying_vines.gateway.mqtt.broker import (
    THROWN_OUT,
    FileError,
    RefusedError,
    login,
    may_want_other_version,
    problem_of,
)
from flying_vines.gateway.mqtt.payloads import AnswerPayload, Topics
from flying_vines.gateway.mqtt.publisher import Now, Publication, Publisher, discovery
from flying_vines.gateway.mqtt.requests import QueuedRequest, RequestQueue

MAX_PACKET = 4096
"""Bytes. An MQTT 5 broker does not send us longer packets."""
MAX_UNANSWERED = 50
KEEP_ALIVE_S = 30
"""MQTT's keep-alive: a lost connection is noticed after 1 to 2 times this."""
TIMEOUT_S = 10.0
"""Maximum wait for an answer of the broker."""
REQUEST_INTERVAL_S = 0.05
"""Minimum time between two requests to the service, which has other tasks."""
FLOOD_REPORT_S = 60.0
GOODBYE_S = 1.0
POLICY = Policy(
    first_wait_s=1.0,
    longest_wait_s=60.0,
    refused_waits_s=(15.0, 300.0),
    spread=0.5,
    report_after_s=5.0,
    short_lived=THROWN_OUT,
)
"""Short interruptions lose no events. The library ends a silent connection, by MQTT's keep-alive."""
_OTHER_VERSION = {
    aiomqtt.ProtocolVersion.V5: aiomqtt.ProtocolVersion.V311,
    aiomqtt.ProtocolVersion.V311: aiomqtt.ProtocolVersion.V5,
}


async def serve(feed: Feed) -> None:
    """Serve until cancelled."""
    with feed.reader() as reader:
        connection = Connection(feed)
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(connection.listen(reader))
            tasks.create_task(connection.stay_connected())


class Connection:
    """The connection to one broker. It publishes the feed's messages."""

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._mqtt = feed.start.config.mqtt
        self._topics = Topics.of(self._mqtt)
        self._publisher = Publisher(feed.start, self._topics)
        self._requests = RequestQueue(self._mqtt.commands)
        self._answers: asyncio.Queue[AnswerPayload] = asyncio.Queue(MAX_UNANSWERED)
        self._happened, self._requested = asyncio.Event(), asyncio.Event()
        self._protocol = aiomqtt.ProtocolVersion.V5
        self._flood_reported_at = -FLOOD_REPORT_S
        self._kept = KeptOpen(POLICY, self._connect, self._changed)
        for happened in feed.happened:
            self._publisher.take(self._now.t, happened)

    @property
    def _now(self) -> Now:
        return Now(asyncio.get_running_loop().time(), round(time.time(), 3))

    async def listen(self, reader: FeedReader) -> None:
        """Take in the service's messages, also without a connection."""
        while True:
            for news in await reader.next():
                self._publisher.take(self._now.t, news)
                if isinstance(news, Happened):
                    self._happened.set()

    async def stay_connected(self) -> None:
        await self._kept.run()

    def _changed(self, up: bool, why: str) -> None:
        self._feed.trouble(f"MQTT: {self._mqtt.broker}{' is back' if up else f': {why}'}")

    async def _connect(self) -> Problem:
        """Runs one connection. Returns why it ended."""
        failure: Exception = RefusedError("the connection ended")
        client: _Client | None = None
        try:
            client = await self._client()
            async with client:
                self._kept.opened()
                try:
                    await self._communicate(client)
                finally:
                    await self._say_goodbye(client)
        except* (aiomqtt.MqttError, RefusedError, FileError, OSError) as group:
            failure = _first(group)
        finally:
            self._requests.disconnected()
            if client is not None:
                client.close()
        if not self._kept.is_open and may_want_other_version(failure):
            self._protocol = _OTHER_VERSION[self._protocol]
        return problem_of(failure, self._mqtt, self._kept.is_open)

    async def _client(self) -> _Client:
        arguments = await login(self._mqtt, self._protocol, TIMEOUT_S)
        will = self._publisher.last_will(self._now)
        properties = None
        if self._protocol is aiomqtt.ProtocolVersion.V5:
            properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
            properties.MaximumPacketSize = MAX_PACKET
        return _Client(
            self._receive,
            identifier=f"{self._topics.prefix}-{self._topics.name}".replace("/", "-"),
            will=aiomqtt.Will(will.topic, will.payload, will.qos, will.retain),
            keepalive=KEEP_ALIVE_S,
            properties=properties,
            **arguments,
        )

    async def _greet(self, client: _Client) -> None:
        # Subscribe first: a client that reads `about` may send a request at once.
        if self._mqtt.commands:
            await client.subscribe(self._topics.ask, qos=1)
        for publication in self._publisher.greeting(self._now):
            await _publish(client, publication)
        if client.refused:
            raise RefusedError(
                f"it does not let us publish to {self._topics.base}/…: check its access control list"
            )
        for publication in discovery(self._feed.start.config, self._topics, self._feed.start.version):
            await _publish(client, publication)

    async def _say_goodbye(self, client: _Client) -> None:
        """Publish `offline`: the broker sends no last will after a proper disconnection."""
        client.timeout = GOODBYE_S
        with contextlib.suppress(aiomqtt.MqttError):
            await _publish(client, self._publisher.last_will(self._now))

    async def _communicate(self, client: _Client) -> None:
        async with asyncio.TaskGroup() as tasks:
            # Detects a lost connection much faster than a failed publication does.
            tasks.create_task(_lost(client))
            await self._greet(client)
            tasks.create_task(self._publish_states(client))
            for part in (self._publish_events, self._ask_service, self._publish_answers):
                tasks.create_task(part(client))

    async def _publish_events(self, client: _Client) -> None:
        while True:
            # Clear first, so that events that arrive during the loop are not missed.
            self._happened.clear()
            while pending := self._publisher.events.first(self._now):
                await _publish(client, pending.publication)
                self._publisher.events.published(pending)
            await self._happened.wait()

    async def _publish_states(self, client: _Client) -> None:
        period_s = 1.0 / self._mqtt.rate_Hz
        due = self._now.t
        while True:
            for publication in self._publisher.due(self._now):
                await _publish(client, publication)
            due = max(due + period_s, self._now.t)
            await asyncio.sleep(due - self._now.t)

    def _receive(self, payload: bytes, retained: bool) -> None:
        for answer in self._requests.receive(self._now, payload, retained):
            self._answer(answer)
        if self._requests.waits:
            self._requested.set()
        self._report_flood()

    def _answer(self, answer: AnswerPayload) -> None:
        # If requests come faster than the broker accepts answers, some get no answer.
        with contextlib.suppress(asyncio.QueueFull):
            self._answers.put_nowait(answer)

    def _report_flood(self) -> None:
        now = self._now.t
        if self._requests.ignored and now - self._flood_reported_at >= FLOOD_REPORT_S:
            self._feed.trouble(f"MQTT: {self._topics.ask}: too many requests, some get no answer")
            self._requests.ignored, self._flood_reported_at = 0, now

    async def _ask_service(self, client: _Client) -> None:
        while True:
            self._requested.clear()
            while requests := self._requests.next():
                safety, reason = await self._ask(requests)
                for request, _ in requests:
                    self._answer(
                        AnswerPayload(unix_s=self._now.unix_s, id=request.id, safety=safety, reason=reason)
                    )
                await asyncio.sleep(REQUEST_INTERVAL_S)
            await self._requested.wait()

    async def _ask(self, requests: Sequence[QueuedRequest]) -> tuple[Any, str]:
        request, made_at = requests[0]
        seen_at = max((each.seen_at for each, _ in requests if each.seen_at is not None), default=None)
        try:
            answered = await self._feed.ask(
                "broker", request.command, request.value, request.name, made_at, seen_at
            )
        except NoAnswerError as error:
            return "unknown", str(error)
        return answered.safety, answered.reason

    async def _publish_answers(self, client: _Client) -> None:
        while True:
            await _publish(client, self._publisher.answer(await self._answers.get()))


class _Client(aiomqtt.Client):
    """Records whether the broker refused a publication, which the library does not report.

    Received messages go directly to `receive`: the library's queue would need a task per message of a flood.
    """

    def __init__(self, receive: Callable[[bytes, bool], None], **arguments: Any) -> None:
        super().__init__(**arguments)
        self.refused = False
        self._receive = receive

    def close(self) -> None:
        """Close the socket, also after a refused login, when the library leaves it open."""
        if self._client.socket() is not None:
            self._client.disconnect()
        if self._disconnected.done() and not self._disconnected.cancelled():
            # Otherwise asyncio logs an exception that was never retrieved.
            self._disconnected.exception()

    def _on_message(self, client: Any, userdata: Any, message: Any) -> None:
        self._receive(message.payload, message.retain)

    def _on_publish(self, client: Any, userdata: Any, mid: int, reason_code: Any, properties: Any) -> None:
        self.refused = self.refused or reason_code.is_failure
        super()._on_publish(client, userdata, mid, reason_code, properties)


async def _lost(client: _Client) -> None:
    """Waits until the connection is lost; raises `MqttError`. No message comes here: all go to `receive`."""
    async for _ in client.messages:
        pass


async def _publish(client: _Client, publication: Publication) -> None:
    """Returns when the message is sent; with QoS 1, when the broker has it. Raises `MqttError`."""
    await client.publish(publication.topic, publication.payload, publication.qos, publication.retain)
    # The library loses a cancellation that arrives together with the awaited result.
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError


def _first(error: BaseException) -> Exception:
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    assert isinstance(error, Exception)
    return error
