"""Gives page and MQTT client the service's state and events, and sends their commands. Uses no socket."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from operator import itemgetter

from flying_vines.gateway.messages import (
    Answered,
    FromGateway,
    GatewayStart,
    Happened,
    Request,
    SnapshotMessage,
    ToGateway,
    Trouble,
)
from flying_vines.vine.intent import ACTS_WITHIN_S, Asker, CommandName

STORED_EVENTS = 250
"""Events of each kind stored for later viewers, so that many notices do not hide the decisions."""
MAX_UNREAD = 200
"""Maximum unread events of one reader. Above this it loses the oldest."""
ANSWERED_WITHIN_S = ACTS_WITHIN_S + 0.2
"""Time limit for an answer. The service refuses an older request, unless it deflates the vine."""


class NoAnswerError(Exception):
    """The service does not answer. It is unknown whether the command was carried out."""


class FeedReader:
    """Reads the feed at its own speed: the latest snapshot, and all events unless it is too slow."""

    def __init__(self) -> None:
        self.missed = 0
        """Events lost because the reader was too slow."""
        self._events: deque[Happened] = deque()
        self._latest: SnapshotMessage | None = None
        self._news = asyncio.Event()

    async def next(self) -> list[Happened | SnapshotMessage]:
        """Waits for at least one message. Returns all new ones, the snapshot last."""
        await self._news.wait()
        self._news.clear()
        news: list[Happened | SnapshotMessage] = list(self._events)
        self._events.clear()
        if self._latest is not None:
            news.append(self._latest)
            self._latest = None
        return news

    def take(self, message: Happened | SnapshotMessage) -> None:
        if isinstance(message, SnapshotMessage):
            self._latest = message
        else:
            if len(self._events) == MAX_UNREAD:
                self._events.popleft()
                self.missed += 1
            self._events.append(message)
        self._news.set()


class Feed:
    """The feed of one service. `send` sends a message to the service."""

    def __init__(self, start: GatewayStart, send: Callable[[FromGateway], None]) -> None:
        self.start = start
        self.latest: SnapshotMessage | None = None
        self._happened: dict[str, deque[tuple[int, Happened]]] = {}
        self._events = 0
        self._send = send
        self._readers: set[FeedReader] = set()
        self._number = 0
        self._waiting: dict[int, asyncio.Future[Answered]] = {}

    @property
    def happened(self) -> list[Happened]:
        """The stored events, in their order."""
        numbered = [event for stored in self._happened.values() for event in stored]
        return [event for _, event in sorted(numbered, key=itemgetter(0))]

    @contextmanager
    def reader(self) -> Iterator[FeedReader]:
        """A reader of all messages from now on. `latest` and `happened` have the earlier ones."""
        reader = FeedReader()
        self._readers.add(reader)
        try:
            yield reader
        finally:
            self._readers.discard(reader)

    async def ask(
        self,
        by: Asker,
        command: CommandName,
        value: float | None = None,
        name: str | None = None,
        made_at: float | None = None,
        seen_at: float | None = None,
    ) -> Answered:
        """Sends a request; returns safety's ruling. Raises `ValueError` (invalid request) or `NoAnswerError`.

        `made_at`, `seen_at`: see `Request`. A `made_at` in the future counts as now.
        """
        self._number += 1
        now = asyncio.get_running_loop().time()
        ask = Request(self._number, by, command, value, name, min(now, made_at or now), seen_at)
        answer: asyncio.Future[Answered] = asyncio.get_running_loop().create_future()
        self._waiting[ask.number] = answer
        self._send(ask)
        try:
            # `wait_for` would lose a cancellation that arrives together with the answer.
            async with asyncio.timeout(ANSWERED_WITHIN_S):
                return await answer
        except TimeoutError:
            raise NoAnswerError("the service does not answer") from None
        finally:
            del self._waiting[ask.number]

    def trouble(self, text: str) -> None:
        """Sends a text to the crew. Call it once at a failure, and once when it works again."""
        self._send(Trouble(text))

    def take(self, message: ToGateway) -> None:
        """Take in a message from the service."""
        match message:
            case SnapshotMessage():
                self.latest = message
            case Happened():
                self._events += 1
                stored = self._happened.setdefault(message.what, deque(maxlen=STORED_EVENTS))
                stored.append((self._events, message))
            case Answered(number):
                waiting = self._waiting.get(number)
                if waiting is not None and not waiting.done():
                    waiting.set_result(message)
                return
            case GatewayStart():
                return
        for reader in self._readers:
            reader.take(message)
