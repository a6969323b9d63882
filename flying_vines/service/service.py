"""The edge: one task group that feeds the core from sockets, serial port and clock. No logic of its own."""

from __future__ import annotations

import asyncio
import time
import traceback
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

from firmware_link import protocol
from firmware_link.answer import Answer
from firmware_link.framing import FRAME_END
from flying_vines.config.address import parse_address
from flying_vines.config.config import Config
from flying_vines.core.contained import Contained
from flying_vines.core.core import TICK_S, Core
from flying_vines.core.events import (
    Action,
    Asked,
    Decision,
    Event,
    Failed,
    FirmwareMessage,
    KeepDisarmed,
    KeepParameters,
    LinkChanged,
    Said,
    Stop,
    Tick,
    ToFirmware,
    ToVehicle,
    VehicleMessage,
)
from flying_vines.core.watcher import Watcher
from flying_vines.service.host_clock import synchronised
from flying_vines.service.persistent_state import Kept, KeptError
from flying_vines.supply import Belief
from flying_vines.vehicle.component import parameter_file
from flying_vines.vehicle.mavlink.codec import Codec
from flying_vines.vehicle.mavlink.link import open_link, unread_from
from flying_vines.vehicle.mavlink.signing import Signing
from flying_vines.vehicle.mavlink.signing_key import SigningKeyError, TimestampFile
from flying_vines.vehicle.notice import Severity
from flying_vines.vine.intent import Asker, Intent

LAST_WORDS_S = 0.3
"""After a stop: the last status text and the vent must get out."""
REFUSALS_TOLD_S = 60.0
SNAPSHOT_S = 0.1
RESTART_S = 1.0
"""After which a task that has failed begins anew."""
BARE_VENT = FRAME_END + protocol.encode(protocol.Vent(1), 0)
"""Where a message cannot be made for the firmware this goes: a vent is accepted under every number."""
ONLY_SHOWN = ("NAMED_VALUE_FLOAT", "FUEL_STATUS")
"""What we send for displays alone."""
_LINKS = ("flying_vines.vehicle.mavlink.link", "firmware_link.serial_port")
"""Modules whose callbacks the vine needs."""


class Service:
    """A core between two real links. The `watchers` see all that happens, once it was carried out.

    `parameters`, `disarmed` and `signing` are what was kept of the last service; `kept` says where it is kept
    for the next one, and without it it ends with this one.
    """

    def __init__(
        self,
        config: Config,
        watchers: Sequence[Watcher] = (),
        belief: Belief | None = None,
        parameters: Mapping[str, float] | None = None,
        disarmed: bool = False,
        signing: Signing | None = None,
        kept: Kept | None = None,
    ) -> None:
        self.core = Contained(
            Core(config, belief=belief, parameters=parameters, disarmed=disarmed),
            lambda error: self.failed("display", error),
        )
        self._failed: set[str] = set()
        """Parts that were told to have failed."""
        self.link_problems: dict[str, str] = {}
        self._profile = config
        self._disarmed_before = disarmed
        self._kept = kept
        self._to_keep: dict[str, Callable[[], None]] = {}
        """How to write what has changed, by what it is."""
        self._something_to_keep = asyncio.Event()
        self._signing = signing
        self._synchronised = bool(synchronised())
        self._watchers = list(watchers)
        self._untold: list[tuple[Event, list[Action]]] = []
        self._mavlink = Codec(config.vehicle.system_id, config.vehicle.component_id, signing)
        self._serial = protocol.Codec()
        self._answer = Answer()
        self._unread_told = False
        self._stopping = asyncio.Event()
        self._vehicle = open_link(
            parse_address(config.vehicle.link),
            self._vehicle_bytes,
            self._vehicle_state,
            self._vehicle_stranger,
        )
        self._firmware = open_link(
            parse_address(config.firmware.link), self._firmware_bytes, self._firmware_state
        )

    @property
    def now(self) -> float:
        """The clock that all events are stamped with, in seconds."""
        return asyncio.get_running_loop().time()

    def stop(self) -> None:
        """Vent, say so, and end."""
        self._stopping.set()

    def say(self, severity: Severity, text: str) -> None:
        """Let people read this, here and on the ground station."""
        self._feed(Said(self.now, severity, text))

    def failed(self, part: str, error: BaseException, needed: bool = False) -> None:
        """Something has failed, which the vine needs or which is only for people: told and logged, once."""
        # What fails at every tick is one failure.
        if part not in self._failed:
            self._failed.add(part)
            self._feed(Failed.by(self.now, part, error, needed))

    def ask(
        self, by: Asker, intent: Intent, made_at: float | None = None, seen_at: float | None = None
    ) -> Decision:
        """What a person wants who does not ask over MAVLink, and what comes of it.

        `made_at` and `seen_at` are those of `Asked`.
        """
        actions = self._feed(Asked(self.now, by, intent, made_at, seen_at))
        return next(action for action in actions if isinstance(action, Decision) and action.trigger == by)

    async def run(self) -> None:
        """Serve until `stop`; cancelling it does not vent, but then the firmware's dead-man does."""
        if self._disarmed_before:
            self.say(Severity.WARNING, "pneumatics disarmed before restart: arm them")
        loop = asyncio.get_running_loop()
        handled_before = loop.get_exception_handler()
        loop.set_exception_handler(self._callback_failed)
        try:
            async with asyncio.TaskGroup() as tasks:
                edges = [
                    tasks.create_task(self._restarted(part, run, needed), name=part)
                    for part, run, needed in (
                        ("vehicle link", self._vehicle.run, True),
                        ("phloSAR link", self._firmware.run, True),
                        ("tick", self._tick, True),
                        ("display", self._show, False),
                        ("keeping files", self._keep_changes, False),
                        ("keeping the signing clock", self._keep_signing, False),
                    )
                ]
                await self._stopping.wait()
                self._feed(Stop(self.now))
                await asyncio.sleep(LAST_WORDS_S)
                for edge in edges:
                    edge.cancel()
        finally:
            loop.set_exception_handler(handled_before)
            self.tell_watchers()

    async def _restarted(self, part: str, run: Callable[[], Awaitable[None]], needed: bool) -> None:
        """Run a task until it is done; one that fails is told and begins anew."""
        while True:
            with self._contained(part, needed):
                return await run()
            await asyncio.sleep(RESTART_S)

    @contextmanager
    def _contained(self, part: str, needed: bool = False) -> Iterator[None]:
        """An unexpected error of a part of this edge is told to the core and goes no further."""
        try:
            yield
        except Exception as error:
            self.failed(part, error, needed)

    def _callback_failed(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Of anything in the loop; without a link's the vine is not to be flown."""
        error = context.get("exception") or RuntimeError(context.get("message"))
        modules = {frame.f_globals.get("__name__") for frame, _ in traceback.walk_tb(error.__traceback__)}
        self.failed("event loop", error, needed=not modules.isdisjoint(_LINKS))

    async def _keep_changes(self) -> None:
        """Write the latest; a slow disk delays nothing else."""
        while True:
            await self._something_to_keep.wait()
            self._something_to_keep.clear()
            while self._to_keep:
                what, write = self._to_keep.popitem()
                try:
                    await asyncio.to_thread(write)
                except (parameter_file.ParameterFileError, KeptError) as error:
                    self.say(Severity.WARNING, f"{what} not kept: {error}")

    def _keep(self, what: str, write: Callable[[], None]) -> None:
        self._to_keep[what] = write
        self._something_to_keep.set()

    async def _keep_signing(self) -> None:
        """Keep the clock that we sign with, and tell who is not believed."""
        if self._signing is None:
            return
        file = TimestampFile(self._kept.signing_timestamp) if self._kept else None
        told, told_at = self._signing.refused.total, -REFUSALS_TOLD_S
        try:
            while True:
                self._synchronised = bool(synchronised())
                if file is not None and file.due(self._signing.timestamp):
                    try:
                        await asyncio.to_thread(file.save, self._signing.memory)
                    except SigningKeyError as error:
                        self.say(Severity.WARNING, str(error))
                while self._signing.news:
                    self.say(Severity.WARNING, self._signing.news.pop(0))
                refused = self._signing.refused
                if refused.total > told and self.now - told_at >= REFUSALS_TOLD_S:
                    self.say(Severity.WARNING, f"refused messages: {refused}")
                    told, told_at = refused.total, self.now
                await asyncio.sleep(1.0)
        finally:
            # Exactly, so that nothing recorded in this run is believed in the next one.
            if file is not None:
                with suppress(SigningKeyError):
                    file.save(self._signing.memory)

    async def _tick(self) -> None:
        due = self.now
        while True:
            with self._contained("signing clock"):
                if self._signing is not None:
                    self._signing.advance(time.time(), self.now, self._synchronised)
            self._feed(Tick(self.now))
            with self._contained("watch over the links"):
                self._tell_silence(self.now)
                self._tell_unread()
            self.tell_watchers()
            due = max(due + TICK_S, self.now - TICK_S)
            await asyncio.sleep(max(0.0, due - self.now))

    async def _show(self) -> None:
        while self._watchers:
            self.tell_watchers()
            snapshot = self.core.snapshot(self.now)
            for watcher in tuple(self._watchers):
                with self._unharmed_by(watcher):
                    watcher.snapshot(snapshot)
            await asyncio.sleep(SNAPSHOT_S)

    def _vehicle_bytes(self, data: bytes) -> None:
        now = self.now
        with self._contained("vehicle bytes", needed=True):
            for message in self._mavlink.decode(data):
                self._feed(VehicleMessage(now, message))

    def _vehicle_stranger(self, data: bytes, enter: Callable[[], None]) -> None:
        now = self.now
        with self._contained("vehicle bytes", needed=True):
            messages, proven = self._mavlink.decode_stranger(data)
            if proven:
                enter()
            for message in messages:
                self._feed(VehicleMessage(now, message))

    def _firmware_bytes(self, data: bytes) -> None:
        now = self.now
        with self._contained("phloSAR bytes", needed=True):
            messages = self._serial.decode(data)
            for message in messages:
                self._feed(FirmwareMessage(now, message))
            self._answer.received(data, messages)

    def _vehicle_state(self, up: bool, why: str) -> None:
        self.link_problems["vehicle"] = "" if up else why
        self._feed(LinkChanged(self.now, "vehicle", up, why))

    def _firmware_state(self, up: bool, why: str) -> None:
        self.link_problems["firmware"] = "" if up else why
        if up:
            self._serial.restart()
            self._answer.opened(self.now)
        else:
            self._answer.closed()
        self._feed(LinkChanged(self.now, "firmware", up, why))

    def _tell_unread(self) -> None:
        """Once: a stranger could fill the log, and the one who is told of may be the autopilot itself."""
        sender = unread_from(self._vehicle)
        if sender and not self._unread_told:
            self._unread_told = True
            self.say(Severity.WARNING, f"not read: {sender} is not vehicle.link's peer")

    def _tell_silence(self, t: float) -> None:
        """Somebody else's port, or a board that does not run: that a port is open is not enough."""
        problem = self._answer.news(t)
        if problem is None:
            return
        self.link_problems["firmware"] = problem
        if problem:
            self.say(Severity.WARNING, f"phloSAR: {problem}")

    def _feed(self, event: Event) -> list[Action]:
        actions = self.core.handle(event)
        for action in actions:
            try:
                self._carry_out(action)
            except Exception as error:
                self._not_carried_out(action, error)
        self._untold.append((event, actions))
        return actions

    def tell_watchers(self) -> None:
        """Of all that happened since. At each tick: no setpoint is to wait for what they make of it."""
        untold, self._untold = self._untold, []
        for watcher in tuple(self._watchers):
            with self._unharmed_by(watcher):
                for event, actions in untold:
                    watcher.event(event)
                    for action in actions:
                        watcher.action(action)

    @contextmanager
    def _unharmed_by(self, watcher: Watcher) -> Iterator[None]:
        """One that fails sees no more; what flies goes on."""
        try:
            yield
        except Exception as error:
            self._watchers.remove(watcher)
            asyncio.get_running_loop().call_soon(self.failed, type(watcher).__name__, error)

    def _not_carried_out(self, action: Action, error: Exception) -> None:
        match action:
            case ToFirmware():
                with self._contained("phloSAR vent", needed=True):
                    self._firmware.write(BARE_VENT)
                self.failed("phloSAR messages", error, needed=True)
            case ToVehicle(message) if message.get_type() not in ONLY_SHOWN:
                self.failed("vehicle messages", error, needed=True)
            case ToVehicle():
                self.failed("named values", error)
            case _:
                self.failed("keeping files", error)

    def _carry_out(self, action: Action) -> None:
        match action:
            case ToFirmware(message):
                # Half a frame before ours, of anyone, must not cost us a greeting.
                self._firmware.write(FRAME_END + self._serial.encode(message))
            case ToVehicle(message, system_id):
                self._vehicle.write(self._mavlink.encode(message, system_id))
            case KeepParameters(_, values) if self._kept is not None:
                file = self._kept.parameters
                self._keep("parameters", partial(parameter_file.write, file, values, self._profile))
            case KeepDisarmed(_, disarmed) if self._kept is not None:
                self._keep("disarming", partial(self._kept.keep_disarmed, disarmed))
