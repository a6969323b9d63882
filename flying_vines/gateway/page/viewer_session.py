"""Serves one browser or terminal, which may be slow or hostile: sends all news and reads its requests."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Sequence
from typing import Annotated, NamedTuple

import msgspec
from aiohttp import WSCloseCode, WSMsgType
from aiohttp.web import WebSocketResponse
from msgspec import Meta

from flying_vines.config.config import Config
from flying_vines.gateway.feed import Feed, FeedReader, NoAnswerError
from flying_vines.gateway.messages import Happened, Request, SnapshotMessage
from flying_vines.vehicle.token_bucket import TokenBucket
from flying_vines.vine.intent import CommandName
from flying_vines.vine.profile import flatten, top_kPa

BEAT_S = 1.0
"""A message is sent at least this often. After 2 s without one, the viewer reports a lost link."""
SLOW_S = 5.0
"""A viewer that accepts no data for this long is disconnected."""
MAX_REQUEST_BYTES = 512
MAX_PER_S = 20.0
MAX_AT_ONCE = 40.0
HISTORY_S = 120.0
EVERY_S = 0.19
"""Takes every other snapshot: there are ten a second."""


class PageRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A browser's request: a pressed button. The answer has the same `id`."""

    id: Annotated[int, Meta(ge=0, le=2**53)]
    command: CommandName
    value: float | None = None
    name: Annotated[str, Meta(max_length=100)] | None = None
    made_at: float | None = None
    """Time of the press, on the clock of the snapshots."""
    seen_at: float | None = None
    """The `t` of the snapshot that was shown at that time."""


def read_request(text: str) -> PageRequest:
    """Raises `msgspec.DecodeError`, or `ValueError` for an invalid command."""
    request = _REQUEST.decode(text)
    Request(0, "page", request.command, request.value, request.name)
    return request


_REQUEST = msgspec.json.Decoder(PageRequest)


class Sample(NamedTuple):
    """Time in seconds; gauge kPa, None if unknown. The page gets it as an array."""

    t: float
    cv_kPa: float | None
    command_kPa: float | None
    reservoir_kPa: float | None


class _Pressures(msgspec.Struct, frozen=True):
    t: float
    cv_kPa: float | None
    command_kPa: float | None
    reservoir_kPa: float | None


class History:
    """The pressures of the last two minutes, for a newly opened page. `take` gets all snapshots in order."""

    def __init__(self) -> None:
        self.samples: deque[Sample] = deque()

    def take(self, seen: SnapshotMessage) -> None:
        now = _PRESSURES.decode(seen.snapshot)
        if self.samples and now.t - self.samples[-1].t < EVERY_S:
            return
        while self.samples and now.t - self.samples[0].t > HISTORY_S:
            self.samples.popleft()
        pressures = _rounded(now.cv_kPa), _rounded(now.command_kPa), _rounded(now.reservoir_kPa)
        self.samples.append(Sample(round(now.t, 2), *pressures))


def _rounded(pressure_kPa: float | None) -> float | None:
    return None if pressure_kPa is None else round(pressure_kPa, 2)


_PRESSURES = msgspec.json.Decoder(_Pressures)


class _Vine(msgspec.Struct, frozen=True):
    """What the page needs from the configuration."""

    profiles: dict[str, float]
    """The largest angle of each profile, degrees."""
    curve: tuple[tuple[float, float], ...]
    max_kPa: float
    full_kPa: float
    bench_mode: bool


class _Hello(msgspec.Struct, frozen=True, tag="hello", tag_field="kind"):
    t: float
    """The present time, on the same clock as all other times."""
    version: str
    may_ask: bool
    flights: bool
    """True if this viewer may open `/flights`."""
    vine: _Vine
    history: Sequence[Sample]
    happened: Sequence[Happened]


class _Answer(msgspec.Struct, frozen=True, tag="answer", tag_field="kind"):
    """The answer to a request."""

    id: int
    safety: str
    reason: str


class _Missed(msgspec.Struct, frozen=True, tag="missed", tag_field="kind"):
    """Events that a slow viewer has lost."""

    count: int


class _Beat(msgspec.Struct, frozen=True, tag="beat", tag_field="kind"):
    pass


_Message = _Hello | _Answer | _Missed | _Beat | Happened | SnapshotMessage


class ViewerSession:
    """The server side of one WebSocket."""

    def __init__(self, feed: Feed, history: History, socket: WebSocketResponse, may_ask: bool) -> None:
        self._feed = feed
        self._history = history
        self._socket = socket
        self._may_ask = may_ask
        self._asking: set[asyncio.Task[None]] = set()

    async def serve(self) -> None:
        """Serve until the socket closes. Raises `TimeoutError` or `ConnectionError` if sending fails."""
        with self._feed.reader() as reader:
            await self._send(self._hello())
            if self._feed.latest is not None:
                await self._send(self._feed.latest)
            sending = asyncio.create_task(self._send_news(reader))
            listening = asyncio.create_task(self._listen())
            tasks = {sending, listening}
            try:
                await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            finally:
                tasks |= self._asking
                for task in tasks:
                    task.cancel()
                ended = await asyncio.gather(*tasks, return_exceptions=True)
        for end in ended:
            if isinstance(end, Exception):
                raise end

    def _hello(self) -> _Hello:
        return _Hello(
            asyncio.get_running_loop().time(),
            self._feed.start.version,
            self._may_ask,
            self._may_ask and bool(self._feed.start.flights),
            _vine(self._feed.start.config),
            tuple(self._history.samples),
            self._feed.happened,
        )

    async def _send_news(self, reader: FeedReader) -> None:
        missed = 0
        while True:
            try:
                # `wait_for` would lose a cancellation that arrives together with the news.
                async with asyncio.timeout(BEAT_S):
                    news: Sequence[_Message] = await reader.next()
            except TimeoutError:
                news = (_Beat(),)
            if reader.missed > missed:
                await self._send(_Missed(reader.missed - missed))
                missed = reader.missed
            for message in news:
                await self._send(message)

    async def _listen(self) -> None:
        loop = asyncio.get_running_loop()
        bucket = TokenBucket(loop.time(), MAX_AT_ONCE, MAX_PER_S)
        async for message in self._socket:
            if not bucket.take(loop.time()):
                await self._close(WSCloseCode.TRY_AGAIN_LATER, "too many requests")
                return
            if message.type is WSMsgType.PING:
                await self._socket.pong(message.data)
                continue
            if message.type is WSMsgType.PONG:
                continue
            if message.type is not WSMsgType.TEXT:
                return
            try:
                request = read_request(message.data)
            except (msgspec.DecodeError, ValueError):
                await self._close(WSCloseCode.INVALID_TEXT, "not understood")
                return
            # In a task, so that a viewer can vent while it waits for an answer.
            task = asyncio.create_task(self._answer_request(request))
            self._asking.add(task)
            task.add_done_callback(self._asking.discard)

    async def _answer_request(self, request: PageRequest) -> None:
        if not self._may_ask:
            answer = _Answer(request.id, "refused", "you may only watch")
        else:
            try:
                found = await self._feed.ask(
                    "page", request.command, request.value, request.name, request.made_at, request.seen_at
                )
                answer = _Answer(request.id, found.safety, found.reason)
            except NoAnswerError as error:
                answer = _Answer(request.id, "unanswered", str(error))
        await self._send(answer)

    async def _send(self, message: _Message) -> None:
        async with asyncio.timeout(SLOW_S):
            await self._socket.send_str(msgspec.json.encode(message).decode())

    async def _close(self, code: WSCloseCode, why: str) -> None:
        await self._socket.close(code=code, message=why.encode())


def _vine(config: Config) -> _Vine:
    curve, max_kPa = config.vine.bend_curve(), config.limits.max_kPa
    segments = {name: tuple(flatten(config.profiles, name)) for name in config.profiles}
    tops_kPa = {name: top_kPa(flat, curve, max_kPa) for name, flat in segments.items()}
    return _Vine(
        {name: round(curve.angle_deg(kPa), 1) for name, kPa in tops_kPa.items()},
        config.vine.curve,
        max_kPa,
        config.pneumatics.full_kPa,
        config.interlocks.bench_mode,
    )
