"""What page and MQTT client know of the service, and how they send it commands. No socket."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

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

REMEMBERED = 500
"""Events kept for viewers that come later."""
MOST_BEHIND = 200
"""Unread events of one reader. Beyond that it loses the oldest."""
ANSWERED_WITHIN_S = ACTS_WITHIN_S + 0.2
"""After this time the service no longer executes the command."""


class NoAnswerError(Exception):
    """The service does not answer. It is unknown whether it executed the command."""


class FeedReader:
    """Follows the feed at its own speed: the latest snapshot, and every event unless it is far behind."""

    def __init__(self) -> None:
        self.missed = 0
        """Events lost because it was too slow."""
        self._events: deque[Happened] = deque()
        self._latest: SnapshotMessage | None = None
        self._news = asyncio.Event()

    async def next(self) -> list[Happened | SnapshotMessage]:
        """The news, at least one; the snapshot last."""
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
            if len(self._events) == MOST_BEHIND:
                self._events.popleft()
                self.missed += 1
            self._events.append(message)
        self._news.set()


class Feed:
    """The feed of one service. `send` sends it a message."""

    def __init__(self, profile: GatewayStart, send: Callable[[FromGateway], None]) -> None:
        self.profile = profile
        self.latest: SnapshotMessage | None = None
        self.happened: deque[Happened] = deque(maxlen=REMEMBERED)
        self._send = send
        self._readers: set[FeedReader] = set()
        self._number = 0
        self._waiting: dict[int, asyncio.Future[Answered]] = {}

    @contextmanager
    def reader(self) -> Iterator[FeedReader]:
        """A reader of what comes from now on; `latest` and `happened` hold what came before."""
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
        """What safety made of it; raises ValueError for an impossible ask, and `NoAnswerError`.

        `made_at` and `seen_at` are those of `Request`. Nothing was made later than it came here.
        """
        self._number += 1
        now = asyncio.get_running_loop().time()
        ask = Request(self._number, by, command, value, name, min(now, made_at or now), seen_at)
        answer: asyncio.Future[Answered] = asyncio.get_running_loop().create_future()
        self._waiting[ask.number] = answer
        self._send(ask)
        try:
            # `wait_for` would lose a cancellation that comes with the answer.
            async with asyncio.timeout(ANSWERED_WITHIN_S):
                return await answer
        except TimeoutError:
            raise NoAnswerError("the service does not answer") from None
        finally:
            del self._waiting[ask.number]

    def trouble(self, text: str) -> None:
        """Tells the crew, once when something fails and once when it works again."""
        self._send(Trouble(text))

    def take(self, message: ToGateway) -> None:
        """A message from the service."""
        match message:
            case SnapshotMessage():
                self.latest = message
            case Happened():
                self.happened.append(message)
            case Answered(number):
                waiting = self._waiting.get(number)
                if waiting is not None and not waiting.done():
                    waiting.set_result(message)
                return
            case GatewayStart():
                return
        for reader in self._readers:
            reader.take(message)
