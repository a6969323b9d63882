"""The programs that the service is compared with: the shortest ones from a switch to a setpoint.

They read channel 9 with the service's `SwitchReader` and write one setpoint frame for each move. They have no
safety, ramp, telemetry, reservoir, mission, log or dead-man. Started as `latency_peers.py NAME UDP_PORT TTY`.
"""

from __future__ import annotations

import asyncio
import importlib
import json
import os
import socket
import struct
import sys
from time import monotonic
from typing import Any

import serial

from firmware_link.protocol import Codec, Hello, Setpoint
from flying_vines.vehicle.radio.switch import SwitchMove, SwitchReader

TARGETS_KPA = (0.0, 11.35, 20.7)
_MAVLINK_2 = 0xFD
_HEADER_SIZE = 10
_RC_CHANNELS_ID = 65
_CHANNEL_9_AT = _HEADER_SIZE + 4 + 2 * 8


class SerialSwitch:
    """A switch with a serial port behind it."""

    def __init__(self, tty: str) -> None:
        self._port = serial.Serial(tty, 115200)
        self._codec = Codec()
        self._switch = SwitchReader(positions=3, debounce_s=0.15, settle_s=1.0, hysteresis_us=25.0)
        self._number = 0

    def listening(self) -> None:
        """Tell the benchmark that messages are being read from now on."""
        self._port.write(self._codec.encode(Hello(1, 1)))

    def sample(self, pulse_us: float) -> None:
        move = self._switch.sample(monotonic(), pulse_us)
        if isinstance(move, SwitchMove):
            self._number = self._number % 0xFFFF + 1
            setpoint = Setpoint(TARGETS_KPA[move.position], 60.0, 250, self._number)
            self._port.write(self._codec.encode(setpoint))


def bare_socket(udp_port: int, switch: SerialSwitch) -> None:
    """The minimum: a blocking socket and six bytes of one message, without a MAVLink library."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.bind(("127.0.0.1", udp_port))
    switch.listening()
    while True:
        frame = link.recv(2048)
        message_id = int.from_bytes(frame[7:10], "little")
        if frame[0] == _MAVLINK_2 and message_id == _RC_CHANNELS_ID:
            switch.sample(struct.unpack_from("<H", frame, _CHANNEL_9_AT)[0])


def mavutil_loop(udp_port: int, switch: SerialSwitch) -> None:
    """Reads messages as most pymavlink scripts do."""
    os.environ["MAVLINK20"] = "1"
    from pymavlink import mavutil

    link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{udp_port}")
    switch.listening()
    while True:
        message = link.recv_match(type="RC_CHANNELS", blocking=True)
        if message is not None:
            switch.sample(message.chan9_raw)


async def mavsdk_stream(udp_port: int, switch: SerialSwitch) -> None:
    """Reads messages as MAVSDK-Python's example of raw messages does."""
    # Imported by name, because type checkers must accept this with and without the optional package.
    mavsdk: Any = importlib.import_module("mavsdk.asyncio")
    direct: Any = importlib.import_module("mavsdk.asyncio.plugins.mavlink_direct")
    configuration = mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.COMPANION_COMPUTER)
    async with mavsdk.Mavsdk(configuration) as sdk:
        await sdk.add_any_connection(f"udpin://127.0.0.1:{udp_port}")
        system = await sdk.first_autopilot(-1)
        switch.listening()
        async for message in direct.MavlinkDirectAsync(system).subscribe_message("RC_CHANNELS"):
            switch.sample(json.loads(message.fields_json)["chan9_raw"])


def main() -> None:
    name, udp_port, tty = sys.argv[1], int(sys.argv[2]), sys.argv[3]
    switch = SerialSwitch(tty)
    match name:
        case "bare":
            bare_socket(udp_port, switch)
        case "mavutil":
            mavutil_loop(udp_port, switch)
        case "mavsdk":
            asyncio.run(mavsdk_stream(udp_port, switch))
        case _:
            sys.exit(f"no peer '{name}'")


if __name__ == "__main__":
    main()
