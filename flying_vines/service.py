"""The edge: one task group that feeds the core from sockets, serial port and clock. No logic of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from firmware_link import protocol
from flying_vines.address import parse_address
from flying_vines.config import Config
from flying_vines.core import TICK_S, Core
from flying_vines.events import (
    Action,
    Event,
    FirmwareMessage,
    LinkChanged,
    Stop,
    Tick,
    ToFirmware,
    ToVehicle,
    VehicleMessage,
)
from flying_vines.reservoir import Belief
from flying_vines.vehicle.codec import Codec
from flying_vines.vehicle.link import open_link

LAST_WORDS_S = 0.3
"""After a stop: the last status text and the vent must get out."""


class Service:
    """A core between two real links. `on_action` sees every action after it was carried out."""

    def __init__(
        self,
        config: Config,
        on_action: Callable[[Action], None] | None = None,
        belief: Belief | None = None,
    ) -> None:
        self.core = Core(config, belief=belief)
        self.link_problems: dict[str, str] = {}
        self._on_action = on_action or (lambda action: None)
        self._mavlink = Codec(config.vehicle.system_id, config.vehicle.component_id)
        self._serial = protocol.Codec()
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

    async def run(self) -> None:
        """Serve until `stop`; cancelling it does not vent, but then the firmware's dead-man does."""
        async with asyncio.TaskGroup() as tasks:
            edges = [
                tasks.create_task(self._vehicle.run()),
                tasks.create_task(self._firmware.run()),
                tasks.create_task(self._tick()),
            ]
            await self._stopping.wait()
            self._feed(Stop(self.now))
            await asyncio.sleep(LAST_WORDS_S)
            for edge in edges:
                edge.cancel()

    async def _tick(self) -> None:
        due = self.now
        while True:
            self._feed(Tick(self.now))
            due = max(due + TICK_S, self.now - TICK_S)
            await asyncio.sleep(max(0.0, due - self.now))

    def _vehicle_bytes(self, data: bytes) -> None:
        now = self.now
        for message in self._mavlink.decode(data):
            self._feed(VehicleMessage(now, message))

    def _firmware_bytes(self, data: bytes) -> None:
        now = self.now
        for message in self._serial.decode(data):
            self._feed(FirmwareMessage(now, message))

    def _vehicle_state(self, up: bool, why: str) -> None:
        self.link_problems["vehicle"] = "" if up else why
        self._feed(LinkChanged(self.now, "vehicle", up, why))

    def _firmware_state(self, up: bool, why: str) -> None:
        self.link_problems["firmware"] = "" if up else why
        if up:
            self._serial.restart()
        self._feed(LinkChanged(self.now, "firmware", up, why))

    def _feed(self, event: Event) -> None:
        for action in self.core.handle(event):
            match action:
                case ToFirmware(message):
                    self._firmware.write(self._serial.encode(message))
                case ToVehicle(message, system_id):
                    self._vehicle.write(self._mavlink.encode(message, system_id))
            self._on_action(action)
