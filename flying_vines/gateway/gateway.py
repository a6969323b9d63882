"""The service's end of the gateway: tells what it sees, asks what people want, and never waits for either.

Page and broker live in a process of their own, so that nothing that a network does can hold up the loop that
flies. When that process dies or hangs, it is started again; the service goes on.
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
from flying_vines.core.events import Action, Calibrated, Decision, Snapshot
from flying_vines.core.watcher import Watcher
from flying_vines.gateway.keep_alive import keep_alive
from flying_vines.gateway.messages import (
    Alive,
    Answered,
    Ask,
    Happened,
    Profile,
    Seen,
    Trouble,
    packet,
    raw,
    read_from_gateway,
)
from flying_vines.gateway.token_bucket import TokenBucket
from flying_vines.vehicle.notice import Notice, Severity
from flying_vines.vine.intent import Asker, Intent, Vent

COMMAND = (sys.executable, "-m", "flying_vines.gateway")
LONGEST_PACKET = 64 * 1024
MOST_BEHIND = 500
"""Events that wait for a gateway that starts, or is slow."""
LOOK_S = 0.25
HANGS_S = 2.0
"""A gateway that is silent for so long is ended: it says `Alive` twice a second."""
STARTS_S = 20.0
"""A worn card may take so long to load it."""
MOST_ASKED_PER_S = 20.0
VENTED_EVERY_S = 0.05
"""Of vents that come more often those in between wait, and the next is for all of them."""


class Gateway(Watcher):
    """One gateway process, kept alive by `run`. `ask` and `say` are the service's."""

    def __init__(
        self,
        config: Config,
        ask: Callable[[Asker, Intent, float | None, float | None], Decision],
        say: Callable[[str], None],
        page_token: str = "",
    ) -> None:
        version = metadata.version("flying-vines")
        self._profile = Profile(config, version, page_token)
        self._ask = ask
        self._say = say
        self._socket: socket.socket | None = None
        self._unsent: deque[bytes] = deque(maxlen=MOST_BEHIND)
        self._spoke = False
        """Since the last look."""
        self._bucket = TokenBucket(0.0, MOST_ASKED_PER_S, MOST_ASKED_PER_S)
        self._vents: dict[Asker, list[Ask]] = {}
        """Those that wait."""
        self._next_vents: asyncio.TimerHandle | None = None

    @staticmethod
    def wanted(config: Config) -> bool:
        return bool(config.page.port or config.mqtt.broker)

    def action(self, action: Action) -> None:
        if isinstance(action, Notice) and action.severity is Severity.DEBUG:
            return
        if isinstance(action, Decision | Notice | Calibrated):
            self._unsent.append(packet(Happened(type(action).__name__.lower(), raw(action))))

    def snapshot(self, snapshot: Snapshot) -> None:
        """What happened since the last, then how things stand; that is not kept for one who does not read."""
        if self._socket is None:
            return
        while self._unsent:
            if not self._send(self._unsent[0]):
                return
            self._unsent.popleft()
        self._send(packet(Seen(raw(snapshot))))

    async def run(self) -> None:
        """Until cancelled; then the gateway ends, too."""
        await keep_alive("page and broker", self._serve_once, self._say)

    async def _serve_once(self) -> str:
        """One process's life; why it ended."""
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
            self._send(packet(self._profile))
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
        """Wait until it is silent for too long, or ends by itself.

        Counts looks, not seconds: where this process stood still, the gateway is not to blame.
        """
        allowed_s, silent_s = STARTS_S, 0.0
        while silent_s < allowed_s:
            self._spoke = False
            done, _ = await asyncio.wait(ends, timeout=LOOK_S, return_when=asyncio.FIRST_COMPLETED)
            if done:
                return False
            silent_s = 0.0 if self._spoke else silent_s + LOOK_S
            if self._spoke:
                allowed_s = HANGS_S
        return True

    async def _why(self, listening: asyncio.Task[str], last_words: asyncio.Task[str]) -> str:
        if listening.done() and (why := listening.result()):
            return why
        with contextlib.suppress(TimeoutError):
            return await asyncio.wait_for(asyncio.shield(last_words), 1.0) or "it ended"
        return "it does not listen"

    async def _listen(self, ours: socket.socket) -> str:
        """Until it closes its end, or says what is not understood: then that is returned."""
        loop = asyncio.get_running_loop()
        try:
            while said := await loop.sock_recv(ours, LONGEST_PACKET):
                self._heard(said)
                # However much waits here, what flies comes first.
                await asyncio.sleep(0)
        except msgspec.DecodeError as error:
            return f"it said what is not understood: {error}"
        except OSError:
            # It died with something unread.
            return ""
        return ""

    def _heard(self, said: bytes) -> None:
        message = read_from_gateway(said)
        self._spoke = True
        if isinstance(message, Alive):
            return
        if isinstance(message, Trouble):
            self._say(message.text)
        elif message.command == "vent":
            self._vents.setdefault(message.by, []).append(message)
            if self._next_vents is None:
                self._vent()
        elif self._bucket.take(self._now):
            # In the order in which they were asked for.
            self._vent()
            decision = self._ask(message.by, message.intent, message.made_at, message.seen_at)
            self._answer(message.number, decision)
        else:
            self._send(packet(Answered(message.number, "refused", "asked too often")))

    def _vent(self) -> None:
        """One for all who wait for it; the next after `VENTED_EVERY_S`, or before something else is done."""
        if self._next_vents is not None:
            self._next_vents.cancel()
            self._next_vents = None
        if not self._vents:
            return
        vents, self._vents = self._vents, {}
        for by, asked in vents.items():
            # As if each were carried out: whoever has seen most clears most.
            seen = [ask.seen_at for ask in asked if ask.seen_at is not None]
            decision = self._ask(by, Vent(), None, max(seen, default=None))
            for ask in asked:
                self._answer(ask.number, decision)
        self._next_vents = asyncio.get_running_loop().call_later(VENTED_EVERY_S, self._vent)

    def _answer(self, number: int, decision: Decision) -> None:
        self._send(packet(Answered(number, decision.safety, decision.reason)))

    def _send(self, data: bytes) -> bool:
        if self._socket is None:
            return False
        try:
            self._socket.send(data)
        except BlockingIOError:
            return False
        except OSError:
            # It is gone: whoever listens to it notices.
            return False
        return True

    @property
    def _now(self) -> float:
        return asyncio.get_running_loop().time()


async def _last_line(stream: asyncio.StreamReader) -> str:
    """Of what a process says before it ends."""
    last = ""
    while said := await stream.read(4096):
        lines = (last + said.decode(errors="replace")).split("\n")
        last = "\n".join(lines[-2:])[-500:]
    return last.strip().split("\n")[-1]
