"""The edge: one task group that feeds the core from sockets, serial port and clock."""

from __future__ import annotations

import asyncio
import signal
import time
import traceback
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

from firmware_link.actuator import ActuatorLine, Line, PhlosarLine
from firmware_link.answer_check import AnswerCheck
from flying_vines.config.address import NetworkAddress, parse_address
from flying_vines.config.config import Config, FirmwareConfig
from flying_vines.config.plugins import PluginError, find
from flying_vines.core.core import TICK_S, Core
from flying_vines.core.crash_safe_core import CrashSafeCore
from flying_vines.core.events import (
    Action,
    Asked,
    Decision,
    Event,
    Failed,
    FirmwareMessage,
    KeepBoardSettings,
    KeepDisarmed,
    KeepLatched,
    KeepLearned,
    KeepParameters,
    LinkChanged,
    Said,
    Stop,
    StoredState,
    Tick,
    ToFirmware,
    ToVehicle,
    VehicleMessage,
)
from flying_vines.core.watcher import Watcher
from flying_vines.service.host_clock import synchronised
from flying_vines.service.persistent_state import PersistentState, PersistentStateError
from flying_vines.supply import RigPrior
from flying_vines.vehicle.component import parameter_file
from flying_vines.vehicle.mavlink import handled_messages
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.mavlink.link import open_link, unread_from
from flying_vines.vehicle.mavlink.signing import Signing, SigningKeyError, TimestampFile
from flying_vines.vehicle.notice import Severity
from flying_vines.vehicle.triggers import messages_of, own_triggers
from flying_vines.vine.intent import Asker, Intent

FLUSH_S = 0.3
"""Time after a stop to send the vent and the queued status texts."""
REFUSALS_EVERY_S = 60.0
SNAPSHOT_S = 0.1
ECHOES = 5
"""So many of our frames that come back show a fault of the line."""
WRITE_AGAIN_S = 10.0
"""After this time, a state that could not be written is tried again."""
RESTART_S = 1.0
"""Wait before a failed task is started again."""
DISPLAY_MESSAGES = ("NAMED_VALUE_FLOAT",)
"""Messages that ground stations only display. An error in one of them does not vent the vine."""
_LINKS = ("flying_vines.vehicle.mavlink.link", "firmware_link.serial_port")
"""Modules whose callbacks are needed to move the vine."""


class Service:
    """A core between two real links. The `watchers` get each event and its actions afterwards.

    `stored` is the state that the last run stored. `signing` has the signing key; None: no signing.
    `persistent` has the files for the next run; None: nothing is stored.
    """

    def __init__(
        self,
        config: Config,
        watchers: Sequence[Watcher] = (),
        prior: RigPrior | None = None,
        stored: StoredState | None = None,
        signing: Signing | None = None,
        persistent: PersistentState | None = None,
    ) -> None:
        self.core = CrashSafeCore(
            Core(config, prior=prior, stored=stored),
            lambda error: self.failed("display", error),
        )
        self._failed: set[str] = set()
        """Parts whose failure was already reported."""
        self.link_problems: dict[str, str] = {}
        self._config = config
        self._stored = stored or StoredState()
        self._persistent = persistent
        self._unwritten: dict[str, Callable[[], None]] = {}
        """A function to write each changed state, by the state's name."""
        self._changed = asyncio.Event()
        self._signing = signing
        self._synchronised = bool(synchronised())
        self._watchers = list(watchers)
        self._unpublished: list[tuple[Event, list[Action]]] = []
        read = handled_messages.NUMBERS.union(messages_of(own_triggers(config.triggers)).values())
        self._mavlink = MavlinkCodec(config.vehicle.system_id, config.vehicle.component_id, signing, read)
        self._serial = line_to(config.firmware)
        self._answer_check = AnswerCheck()
        self._link_reported: set[str] = set()
        """The kinds of texts about the vehicle link that were said."""
        self._stopping = asyncio.Event()
        self._ending = False
        """Only the changed states must still be written."""
        address = parse_address(config.vehicle.link)
        self._vehicle_is_serial = not isinstance(address, NetworkAddress)
        self._vehicle = open_link(
            address,
            self._vehicle_bytes,
            self._vehicle_state,
            self._vehicle_stranger,
        )
        self._firmware = open_link(
            parse_address(config.firmware.link), self._firmware_bytes, self._firmware_state
        )

    @property
    def now(self) -> float:
        """The time in seconds, on the clock of all events."""
        return asyncio.get_running_loop().time()

    def stop(self) -> None:
        """Vent the vine and end."""
        self._stopping.set()

    def say(self, severity: Severity, text: str) -> None:
        """Show a text on this screen and on the ground station."""
        self._feed(Said(self.now, severity, text))

    def failed(self, part: str, error: BaseException, needed: bool = False) -> None:
        """Report a part's failure once, because it may fail at every tick.

        `needed`: the vine must not bend without this part.
        """
        if part not in self._failed:
            self._failed.add(part)
            self._feed(Failed.by(self.now, part, error, needed))

    def ask(
        self, by: Asker, intent: Intent, made_at: float | None = None, seen_at: float | None = None
    ) -> Decision:
        """Handle a request that did not come over MAVLink. `made_at`, `seen_at`: see `Asked`."""
        actions = self._feed(Asked(self.now, by, intent, made_at, seen_at))
        return next(action for action in actions if isinstance(action, Decision) and action.trigger == by)

    async def run(self) -> None:
        """Serve until `stop`. If this task is cancelled, the firmware's dead-man vents the vine."""
        if self._stored.disarmed:
            self.say(Severity.WARNING, "pneumatics disarmed before restart: arm them")
        for reason in self._stored.latched.values():
            self.say(Severity.WARNING, f"latched before restart: {reason}")
        loop = asyncio.get_running_loop()
        previous_handler = loop.get_exception_handler()
        loop.set_exception_handler(self._callback_failed)
        try:
            async with asyncio.TaskGroup() as tasks:
                edges = [
                    tasks.create_task(self._restarted(part, run, needed), name=part)
                    for part, run, needed in (
                        ("vehicle link", self._vehicle.run, True),
                        ("actuator link", self._firmware.run, True),
                        ("tick", self._tick, True),
                        ("display", self._show, False),
                        ("signing clock storage", self._store_signing_clock, False),
                    )
                ]
                tasks.create_task(self._restarted("file storage", self._write_changes, False))
                await self._stopping.wait()
                self._feed(Stop(self.now))
                await asyncio.sleep(FLUSH_S)
                for edge in edges:
                    edge.cancel()
                self._ending = True
                self._changed.set()
        finally:
            loop.set_exception_handler(previous_handler)
            self.notify_watchers()

    async def _restarted(self, part: str, run: Callable[[], Awaitable[None]], needed: bool) -> None:
        """Run a task until it is done. A failed task is reported and started again."""
        while True:
            with self._contained(part, needed):
                return await run()
            await asyncio.sleep(RESTART_S)

    @contextmanager
    def _contained(self, part: str, needed: bool = False) -> Iterator[None]:
        """Report an unexpected error of a part to the core, and continue."""
        try:
            yield
        except Exception as error:
            self.failed(part, error, needed)

    def _callback_failed(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """A callback of the loop failed. If it belongs to a link, the vine must not bend."""
        error = context.get("exception") or RuntimeError(context.get("message"))
        modules = {frame.f_globals.get("__name__") for frame, _ in traceback.walk_tb(error.__traceback__)}
        self.failed("event loop", error, needed=not modules.isdisjoint(_LINKS))

    async def _write_changes(self) -> None:
        """Write changed states in a thread, so that a slow disk delays nothing else.

        A state that cannot be written is reported once and tried again. At the end all states are written.
        """
        failed: dict[str, Callable[[], None]] = {}
        while not self._ending:
            with suppress(TimeoutError):
                async with asyncio.timeout(WRITE_AGAIN_S if failed else None):
                    await self._changed.wait()
            self._changed.clear()
            self._unwritten = {**failed, **self._unwritten}
            while self._unwritten:
                state, write = self._unwritten.popitem()
                try:
                    await asyncio.to_thread(write)
                    failed.pop(state, None)
                except (parameter_file.ParameterFileError, PersistentStateError) as error:
                    if state not in failed:
                        self.say(Severity.WARNING, f"{state} not saved: {error}")
                    failed[state] = write

    def _store(self, state: str, write: Callable[[], None]) -> None:
        self._unwritten[state] = write
        self._changed.set()

    async def _store_signing_clock(self) -> None:
        """Store the signing clock, and report refused messages."""
        if self._signing is None:
            return
        file = TimestampFile(self._persistent.signing_timestamp) if self._persistent else None
        reported, reported_at = self._signing.refused.total, -REFUSALS_EVERY_S
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
                if refused.total > reported and self.now - reported_at >= REFUSALS_EVERY_S:
                    self.say(Severity.WARNING, f"refused messages: {refused}")
                    reported, reported_at = refused.total, self.now
                await asyncio.sleep(1.0)
        finally:
            # Save the exact time, so that the next run refuses messages recorded in this run.
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
            with self._contained("link monitor"):
                self._report_silence(self.now)
                self._report_vehicle_link()
            self.notify_watchers()
            due = max(due + TICK_S, self.now - TICK_S)
            await asyncio.sleep(max(0.0, due - self.now))

    async def _show(self) -> None:
        while self._watchers:
            self.notify_watchers()
            snapshot = self.core.snapshot(self.now)
            for watcher in tuple(self._watchers):
                try:
                    watcher.snapshot(snapshot)
                except Exception as error:
                    self._remove(watcher, error)
            await asyncio.sleep(SNAPSHOT_S)

    def _vehicle_bytes(self, data: bytes) -> None:
        now = self.now
        try:
            for message in self._mavlink.decode(data, now):
                self._feed(VehicleMessage(now, message))
        except Exception as error:  # `_contained` would take a tenth of this function's time
            self.failed("vehicle bytes", error, needed=True)

    def _vehicle_stranger(self, data: bytes, enter: Callable[[], None]) -> None:
        now = self.now
        with self._contained("vehicle bytes", needed=True):
            messages, proven = self._mavlink.decode_stranger(data, now)
            if proven:
                enter()
            for message in messages:
                self._feed(VehicleMessage(now, message))

    def _firmware_bytes(self, data: bytes) -> None:
        now = self.now
        try:
            messages = self._serial.decode(now, data)
            for message in messages:
                self._feed(FirmwareMessage(now, message))
            self._answer_check.received(data, messages)
        except Exception as error:
            self.failed("actuator bytes", error, needed=True)

    def _vehicle_state(self, up: bool, why: str) -> None:
        self.link_problems["vehicle"] = "" if up else why
        self._feed(LinkChanged(self.now, "vehicle", up, why))

    def _firmware_state(self, up: bool, why: str) -> None:
        self.link_problems["firmware"] = "" if up else why
        if up:
            self._serial.restart()
            self._answer_check.opened(self.now)
        else:
            self._answer_check.closed()
        self._feed(LinkChanged(self.now, "firmware", up, why))

    def _report_vehicle_link(self) -> None:
        """Report once an ignored sender, which may be the autopilot, and a line that returns our frames."""
        if sender := unread_from(self._vehicle):
            self._say_once("unread", f"ignored {sender}: it is not vehicle.link's peer")
        if self._mavlink.echoes >= ECHOES and self._vehicle_is_serial:
            self._say_once("echo", "our own frames come back on vehicle.link: check its TX and RX")

    def _say_once(self, kind: str, text: str) -> None:
        if kind not in self._link_reported:
            self._link_reported.add(kind)
            self.say(Severity.WARNING, text)

    def _report_silence(self, t: float) -> None:
        """Report an open port without answer: it may belong to another device, or the board does not run."""
        problem = self._answer_check.news(t)
        if problem is None:
            return
        self.link_problems["firmware"] = problem
        if problem:
            self.say(Severity.WARNING, f"{self.core.config.firmware.name}: {problem}")

    def _feed(self, event: Event) -> list[Action]:
        actions = self.core.handle(event)
        for action in actions:
            try:
                self._carry_out(action)
            except Exception as error:
                self._not_carried_out(action, error)
        self._unpublished.append((event, actions))
        return actions

    def notify_watchers(self) -> None:
        """Give the watchers the events since the last call. The setpoints of these events are already out."""
        unpublished, self._unpublished = self._unpublished, []
        for watcher in tuple(self._watchers):
            try:
                for event, actions in unpublished:
                    watcher.event(event)
                    for action in actions:
                        watcher.action(action)
            except Exception as error:
                self._remove(watcher, error)

    def _remove(self, watcher: Watcher, error: Exception) -> None:
        """A watcher has failed; the service continues without it."""
        self._watchers.remove(watcher)
        asyncio.get_running_loop().call_soon(self.failed, type(watcher).__name__, error)

    def _not_carried_out(self, action: Action, error: Exception) -> None:
        match action:
            case ToFirmware():
                with self._contained("actuator vent", needed=True):
                    self._firmware.write(self._serial.vent)
                self.failed("actuator messages", error, needed=True)
            case ToVehicle(message) if message.get_type() not in DISPLAY_MESSAGES:
                self.failed("vehicle messages", error, needed=True)
            case ToVehicle():
                self.failed("named values", error)
            case _:
                self.failed("file storage", error)

    def _carry_out(self, action: Action) -> None:
        match action:
            case ToFirmware(message):
                if data := self._serial.encode(message):
                    self._firmware.write(data)
            case ToVehicle(message, system_id):
                self._vehicle.write(self._mavlink.encode(message, system_id))
            case KeepParameters(_, values) if self._persistent is not None:
                file = self._persistent.parameters
                self._store("parameters", partial(parameter_file.write, file, values, self._config))
            case KeepDisarmed(_, disarmed) if self._persistent is not None:
                self._store("disarming", partial(self._persistent.store_disarmed, disarmed))
            case KeepLearned(_, text) if self._persistent is not None:
                self._store("learned air", partial(self._persistent.store_learned, text))
            case KeepLatched(_, faults) if self._persistent is not None:
                self._store("latched faults", partial(self._persistent.store_latched, faults))
            case KeepBoardSettings(_, digest) if self._persistent is not None:
                self._store("board settings", partial(self._persistent.store_board_settings, digest))


def on_stop_signals(stop: Callable[[], None]) -> None:
    """Call `stop` after Ctrl-C, SIGTERM, or the end of the terminal; not after the latter under `nohup`."""
    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if name != signal.SIGHUP or signal.getsignal(name) != signal.SIG_IGN:
            asyncio.get_running_loop().add_signal_handler(name, stop)


def line_to(config: FirmwareConfig) -> Line:
    """The line to the actuator that the configuration names. Raises `PluginError`."""
    if config.is_phlosar:
        return PhlosarLine()
    try:
        return ActuatorLine(find("actuators", config.kind, "firmware.kind")(**config.settings))
    except PluginError:
        raise
    except Exception as error:
        raise PluginError(f"firmware.kind: {config.kind}: {error}") from error
