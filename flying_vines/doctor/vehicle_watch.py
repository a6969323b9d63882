"""Connects the probe to the vehicle's link."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from flying_vines.config.address import Address
from flying_vines.config.config import Config
from flying_vines.doctor.vehicle_probe import VehicleFacts, VehicleProbe
from flying_vines.service.host_clock import synchronised
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage
from flying_vines.vehicle.mavlink.link import buffered_frames, open_link, unread_from
from flying_vines.vehicle.mavlink.signing import RefusedFrames, Signing

TICK_S = 0.02


class VehicleWatch:
    """Listens and sends requests at `address` while `run` runs. Times are the event loop's."""

    def __init__(
        self,
        address: Address,
        config: Config,
        signing: Signing | None = None,
        probe: VehicleProbe | None = None,
    ) -> None:
        self.probe = probe or VehicleProbe(config)
        self._down = "it was not opened"
        self._signing = signing
        self._synchronised = bool(synchronised())
        self._codec = MavlinkCodec(config.vehicle.system_id, config.vehicle.component_id, signing)
        self._received = 0
        self._link = open_link(address, self._bytes, self._state, self._stranger)

    @property
    def t(self) -> float:
        return asyncio.get_running_loop().time()

    @property
    def facts(self) -> VehicleFacts:
        refused = self._signing.refused if self._signing else RefusedFrames()
        return replace(
            self.probe.facts(self.t),
            down=self._down,
            bytes=self._received,
            refused=refused,
            unread_from=unread_from(self._link),
            echoes=self._codec.echoes,
            buffered=buffered_frames(self._link),
        )

    async def run(self, over: Callable[[], bool]) -> None:
        opening = asyncio.create_task(self._link.run())
        try:
            while not over() and not opening.done():
                if self._signing is not None:
                    self._signing.advance(time.time(), self.t, self._synchronised)
                for message in self.probe.due(self.t):
                    self._link.write(self._codec.encode(message, self.probe.system_id))
                await asyncio.sleep(TICK_S)
        finally:
            opening.cancel()
            await asyncio.wait([opening])
        if not opening.cancelled():
            opening.result()

    def _bytes(self, data: bytes) -> None:
        self._received += len(data)
        self._take(self._codec.decode(data, self.t))

    def _stranger(self, data: bytes, enter: Callable[[], None]) -> None:
        self._received += len(data)
        messages, proven = self._codec.decode_stranger(data, self.t)
        if proven:
            enter()
        self._take(messages)

    def _take(self, messages: Sequence[MavlinkMessage]) -> None:
        now, unix_s = self.t, time.time()
        for message in messages:
            self.probe.take(now, unix_s, message)

    def _state(self, up: bool, why: str) -> None:
        self._down = "" if up else why
