"""A simulated ground station: sends heartbeats and stores the vine's values and texts."""

from __future__ import annotations

import asyncio

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage

SYSTEM_ID, COMPONENT_ID = 255, 190


class GroundStation(asyncio.DatagramProtocol):
    """Listens on a UDP port of this computer; `values` and `texts` come from companions."""

    def __init__(self) -> None:
        self.values: dict[str, float] = {}
        self.texts: list[str] = []
        self._codec = MavlinkCodec(SYSTEM_ID, COMPONENT_ID)
        self._transport: asyncio.DatagramTransport | None = None
        self._autopilot: tuple[str, int] | None = None

    async def listen(self, host: str = "127.0.0.1") -> int:
        """Open a free port and return its number."""
        transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
            lambda: self, local_addr=(host, 0)
        )
        self._transport = transport
        port: int = transport.get_extra_info("sockname")[1]
        return port

    async def run(self) -> None:
        """Send one heartbeat per second to the last sender, until cancelled."""
        try:
            while True:
                self.send(
                    mavlink.MAVLink_heartbeat_message(
                        mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
                    )
                )
                await asyncio.sleep(1.0 if self._autopilot else 0.1)
        finally:
            if self._transport is not None:
                self._transport.close()

    def send(self, message: MavlinkMessage) -> None:
        """Send a message to the last sender; it is lost if there was none."""
        if self._transport is not None and self._autopilot is not None:
            self._transport.sendto(self._codec.encode(message, SYSTEM_ID), self._autopilot)

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self._autopilot = addr
        for message in self._codec.decode(data):
            if message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1:
                continue
            if message.get_type() == "NAMED_VALUE_FLOAT":
                self.values[message.name] = message.value
            elif message.get_type() == "STATUSTEXT":
                self.texts.append(message.text)
