"""The service's end of the gateway: sends state and events, receives commands, and never waits.

Page and MQTT client run in their own process, so that the network cannot delay the control loop. If that
process dies or hangs, it is restarted and the service continues.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import sys
from collections import deque
from collections.abc import Callable
from importlib import metadata

import msgspec

from flying_vines.config.config import Config
from flying_vines.core.events import Action, Decision
from flying_vines.core.snapshot import Snapshot
from flying_vines.core.watcher import Watcher
from flying_vines.gateway.messages import (
    Alive,
    Answered,
    GatewayStart,
    Happened,
    Request,
    SnapshotMessage,
    Trouble,
    packet,
    raw,
    read_from_gateway,
)
from flying_vines.gateway.supervisor import supervise
from flying_vines.vehicle.notice import Notice, Severity
from flying_vines.vehicle.token_bucket import TokenBucket
from flying_vines.vine.intent import Asker, Intent, VentVine

COMMAND = (sys.executable, "-m", "flying_vines.gateway")
MAX_PACKET = 64 * 1024
MAX_UNREAD = 500
"""Maximum number of events that wait while the gateway starts or is slow."""
POLL_S = 0.25
HANGS_S = 2.0
"""A gateway that is silent for this long is killed: it should send `Alive` twice a second."""
STARTS_S = 20.0
"""Time limit for the start of the gateway, which is slow from a worn SD card."""
MAX_REQUESTS_PER_S = 20.0
VENTED_EVERY_S = 0.05
"""The vent requests of one interval become one vent for the page and one for the broker."""


class Gateway(Watcher):
    """One gateway process, kept alive by `run`. `ask` and `say` call the service."""

    def __init__(
        self,
        config: Config,
        ask: Callable[[Asker, Intent, float | None, float | None], Decision],
        say: Callable[[str], None],
        page_token: str = "",
        flights: str = "",
    ) -> None:
        version = metadata.version("flying-vines")
        self._start = GatewayStart(config, version, page_token, flights)
        self._ask = ask
        self._say = say
        self._socket: socket.socket | None = None
        self._unsent: deque[bytes] = deque(maxlen=MAX_UNREAD)
        self._alive = False
        """True if a message came since the last poll."""
        self._bucket = TokenBucket(0.0, MAX_REQUESTS_PER_S, MAX_REQUESTS_PER_S)
        self._vents: dict[Asker, list[Request]] = {}
        """Requests that wait for the next vent."""
        self._next_vents: asyncio.TimerHandle | None = None

    @staticmethod
    def wanted(config: Config) -> bool:
        return bool(config.page.port or config.mqtt.broker)

    def action(self, action: Action) -> None:
        if isinstance(action, Notice) and action.severity is Severity.DEBUG:
            return
        if isinstance(action, Decision) and not action.shown:
            return
        if isinstance(action, Decision | Notice):
            self._unsent.append(packet(Happened(type(action).__name__.lower(), raw(action))))

    def snapshot(self, snapshot: Snapshot) -> None:
        """Sends the waiting events, then the snapshot. An unsent snapshot is dropped; unsent events stay."""
        if self._socket is None:
            return
        while self._unsent:
            if not self._send(self._unsent[0]):
                return
            self._unsent.popleft()
        self._send(packet(SnapshotMessage(raw(snapshot))))

    async def run(self) -> None:
        """Runs until cancelled; then the gateway process ends, too."""
        await supervise("page and broker", self._serve_once, self._say)

    async def _serve_once(self) -> str:
        """Runs one process, and returns why it ended."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with ours:
            ours.setblocking(False)
            with theirs:
                process = await asyncio.create_subprocess_exec(
                    *COMMAND,
                    str(theirs.fileno()),
                    stdin=asyncio.subprocess.DEVNULL,
                    stdout=asyncio.subprocess.DEVNULL,
                    stderr=asyncio.subprocess.PIPE,
                    pass_fds=(theirs.fileno(),),
                )
            assert process.stderr is not None
            last_words = asyncio.create_task(_last_line(process.stderr))
            self._socket = ours
            self._send(packet(self._start))
            listening = asyncio.create_task(self._listen(ours))
            try:
                if await self._hangs(listening, last_words):
                    return "it hung"
                return await self._why(listening, last_words)
            finally:
                self._socket = None
                listening.cancel()
                last_words.cancel()
                with contextlib.suppress(ProcessLookupError):
                    process.kill()
                await process.wait()

    async def _hangs(self, *ends: asyncio.Task[str]) -> bool:
        """Waits until the process hangs (True) or ends (False).

        Counts polls instead of seconds, so that a pause of our own process does not count as silence.
        """
        allowed_s, silent_s = STARTS_S, 0.0
        while silent_s < allowed_s:
            self._alive = False
            done, _ = await asyncio.wait(ends, timeout=POLL_S, return_when=asyncio.FIRST_COMPLETED)
            if done:
                return False
            silent_s = 0.0 if self._alive else silent_s + POLL_S
            if self._alive:
                allowed_s = HANGS_S
        return True

    async def _why(self, listening: asyncio.Task[str], last_words: asyncio.Task[str]) -> str:
        if listening.done() and (why := listening.result()):
            return why
        with contextlib.suppress(TimeoutError):
            return await asyncio.wait_for(asyncio.shield(last_words), 1.0) or "it ended"
        return "it closed its socket"

    async def _listen(self, ours: socket.socket) -> str:
        """Reads until the gateway closes its end or sends an invalid message.

        Returns the error of an invalid message; otherwise an empty text.
        """
        loop = asyncio.get_running_loop()
        try:
            while data := await loop.sock_recv(ours, MAX_PACKET):
                self._handle(data)
                # Let the control loop run before the next message.
                await asyncio.sleep(0)
        except msgspec.DecodeError as error:
            return f"it sent an invalid message: {error}"
        except OSError:
            # The gateway died while messages were unread.
            return ""
        return ""

    def _handle(self, data: bytes) -> None:
        message = read_from_gateway(data)
        self._alive = True
        if isinstance(message, Alive):
            return
        if isinstance(message, Trouble):
            self._say(message.text)
        elif message.command == "vent":
            self._vents.setdefault(message.by, []).append(message)
            if self._next_vents is None:
                self._vent()
        elif self._bucket.take(asyncio.get_running_loop().time()):
            # Earlier vents come first.
            self._vent()
            decision = self._ask(message.by, message.intent, message.made_at, message.seen_at)
            self._answer(message.number, decision)
        else:
            self._send(packet(Answered(message.number, "refused", "too many requests")))

    def _vent(self) -> None:
        """One vent for all waiting requests of an asker.

        The next vent comes after `VENTED_EVERY_S`, or before another command.
        """
        if self._next_vents is not None:
            self._next_vents.cancel()
            self._next_vents = None
        if not self._vents:
            return
        vents, self._vents = self._vents, {}
        for by, requests in vents.items():
            # The newest snapshot that was seen decides which faults are cleared.
            seen = [request.seen_at for request in requests if request.seen_at is not None]
            decision = self._ask(by, VentVine(), None, max(seen, default=None))
            for request in requests:
                self._answer(request.number, decision)
        self._next_vents = asyncio.get_running_loop().call_later(VENTED_EVERY_S, self._vent)

    def _answer(self, number: int, decision: Decision) -> None:
        self._send(packet(Answered(number, decision.safety, decision.reason)))

    def _send(self, data: bytes) -> bool:
        if self._socket is None:
            return False
        try:
            self._socket.send(data)
        except OSError:
            # The process does not read, or has ended; `_hangs` and `_listen` handle that.
            return False
        return True


async def _last_line(stream: asyncio.StreamReader) -> str:
    """The last line that the process writes to standard error."""
    last = ""
    while data := await stream.read(4096):
        lines = (last + data.decode(errors="replace")).split("\n")
        last = "\n".join(lines[-2:])[-500:]
    return last.strip().split("\n")[-1]
