"""The edge: one task group that feeds the core from sockets, serial port and clock. No logic of its own."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping

from firmware_link import protocol
from firmware_link.answer import Answer
from firmware_link.framing import FRAME_END
from flying_vines.address import parse_address
from flying_vines.config import Config
from flying_vines.core import TICK_S, Core
from flying_vines.events import (
    Action,
    Event,
    FirmwareMessage,
    KeepParameters,
    LinkChanged,
    Said,
    Stop,
    Tick,
    ToFirmware,
    ToVehicle,
    VehicleMessage,
)
from flying_vines.kept import Kept
from flying_vines.notice import Severity
from flying_vines.reservoir import Belief
from flying_vines.vehicle import parameter_file
from flying_vines.vehicle.codec import Codec
from flying_vines.vehicle.link import open_link
from flying_vines.vehicle.signing import Signing
from flying_vines.vehicle.signing_key import SigningKeyError, TimestampFile

LAST_WORDS_S = 0.3
"""After a stop: the last status text and the vent must get out."""
REFUSALS_TOLD_S = 60.0


class Service:
    """A core between two real links. `on_action` sees every action after it was carried out.

    `kept` says where the parameters and the signing clock are kept; without it they end with the service.
    """

    def __init__(
        self,
        config: Config,
        on_action: Callable[[Action], None] | None = None,
        belief: Belief | None = None,
        parameters: Mapping[str, float] | None = None,
        signing: Signing | None = None,
        kept: Kept | None = None,
    ) -> None:
        self.core = Core(config, belief=belief, parameters=parameters)
        self.link_problems: dict[str, str] = {}
        self._profile = config
        self._kept = kept
        self._to_keep: dict[str, float] = {}
        self._something_to_keep = asyncio.Event()
        self._signing = signing
        self._on_action = on_action or (lambda action: None)
        self._mavlink = Codec(config.vehicle.system_id, config.vehicle.component_id, signing)
        self._serial = protocol.Codec()
        self._answer = Answer()
        self._stopping = asyncio.Event()
        self._vehicle = open_link(
            parse_address(config.vehicle.link), self._vehicle_bytes, self._vehicle_state
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

    async def run(self) -> None:
        """Serve until `stop`; cancelling it does not vent, but then the firmware's dead-man does."""
        async with asyncio.TaskGroup() as tasks:
            edges = [
                tasks.create_task(self._vehicle.run()),
                tasks.create_task(self._firmware.run()),
                tasks.create_task(self._tick()),
                tasks.create_task(self._keep_parameters()),
                tasks.create_task(self._keep_signing()),
            ]
            await self._stopping.wait()
            self._feed(Stop(self.now))
            await asyncio.sleep(LAST_WORDS_S)
            for edge in edges:
                edge.cancel()

    async def _keep_parameters(self) -> None:
        """Write the latest; a slow disk delays nothing else."""
        while self._kept is not None:
            await self._something_to_keep.wait()
            self._something_to_keep.clear()
            try:
                await asyncio.to_thread(
                    parameter_file.write, self._kept.parameters, self._to_keep, self._profile
                )
            except parameter_file.ParameterFileError as error:
                self.say(Severity.WARNING, f"parameters not kept: {error}")

    async def _keep_signing(self) -> None:
        """Keep the clock that we sign with, and tell who is not believed."""
        if self._signing is None:
            return
        file = TimestampFile(self._kept.signing_timestamp) if self._kept else None
        told, told_at = self._signing.refused.total, -REFUSALS_TOLD_S
        while True:
            if file is not None and file.due(self._signing.timestamp):
                try:
                    await asyncio.to_thread(file.save, self._signing.timestamp)
                except SigningKeyError as error:
                    self.say(Severity.WARNING, str(error))
            refused = self._signing.refused
            if refused.total > told and self.now - told_at >= REFUSALS_TOLD_S:
                self.say(Severity.WARNING, f"refused messages: {refused}")
                told, told_at = refused.total, self.now
            await asyncio.sleep(1.0)

    async def _tick(self) -> None:
        due = self.now
        while True:
            if self._signing is not None:
                self._signing.advance(time.time())
            self._feed(Tick(self.now))
            self._tell_silence(self.now)
            due = max(due + TICK_S, self.now - TICK_S)
            await asyncio.sleep(max(0.0, due - self.now))

    def _vehicle_bytes(self, data: bytes) -> None:
        now = self.now
        for message in self._mavlink.decode(data):
            self._feed(VehicleMessage(now, message))

    def _firmware_bytes(self, data: bytes) -> None:
        now = self.now
        messages = self._serial.decode(data)
        self._answer.received(data, messages)
        for message in messages:
            self._feed(FirmwareMessage(now, message))

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

    def _tell_silence(self, t: float) -> None:
        """Somebody else's port, or a board that does not run: that a port is open is not enough."""
        problem = self._answer.news(t)
        if problem is None:
            return
        self.link_problems["firmware"] = problem
        if problem:
            self.say(Severity.WARNING, f"phloSAR: {problem}")

    def _feed(self, event: Event) -> None:
        for action in self.core.handle(event):
            match action:
                case ToFirmware(message):
                    # Half a frame before ours, of anyone, must not cost us a greeting.
                    self._firmware.write(FRAME_END + self._serial.encode(message))
                case ToVehicle(message, system_id):
                    self._vehicle.write(self._mavlink.encode(message, system_id))
                case KeepParameters(_, values):
                    self._to_keep = values
                    self._something_to_keep.set()
            self._on_action(action)
