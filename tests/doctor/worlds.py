"""Vehicles and phloSARs with faults, on real sockets and pseudo-terminals."""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
import tty
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from wrapped_board import WrappedBoard

from firmware_link import protocol
from firmware_link.protocol import PROTOCOL_VERSION, Fault, Mode, SettingsMemory, Telemetry, Units, Welcome
from flying_vines.config import config as configuration
from flying_vines.config.config import Config
from flying_vines.doctor.examine import RadioQuestion, examine
from flying_vines.doctor.fakes import between, linked
from flying_vines.doctor.finding import DoctorFinding
from flying_vines.doctor.look import configuration as look
from flying_vines.doctor.look.configuration import ServiceConfiguration
from flying_vines.physics.plant.effects import Effects
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.autopilot.links import COMPANION
from flying_vines.simulation.phlosar.firmware import Firmware
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.mission.storage import AutopilotKind

Mute = Callable[[int], bool]
"""True if a message with this number is not sent."""

SECONDS = 4.5
QUICK_HZ = 20
LIMITS = (30.0, 28.0, 760.0, 200.0)
MISSION = (
    MissionItem(0, 16, (0.0, 0.0, 0.0, 0.0, -35.36, 149.16, 584.0)),
    MissionItem(1, 22, (0.0, 0.0, 0.0, 0.0, -35.36, 149.16, 10.0), frame=3),
    MissionItem(2, 217, (1.0, 40.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
    MissionItem(3, 16, (0.0, 0.0, 0.0, 0.0, -35.35, 149.16, 10.0), frame=3),
)


class Vehicle(FakeAutopilot):
    """Records its inputs, and does not send some of its messages."""

    def __init__(
        self, kind: AutopilotKind = "ardupilot", mute: Mute = lambda message_id: False, **others: Any
    ) -> None:
        super().__init__(kind, unix_s=time.time(), **others)
        self.set_rc(9, 1000)
        self.received: list[Any] = []
        self._decoder = MavlinkCodec(0, 0)
        self._mute = mute
        self.stranger: Callable[[int], bytes] | None = None
        self._strange_frames = 0

    def receive(self, t: float, link: str, data: bytes) -> None:
        self.received += self._decoder.decode(data)
        super().receive(t, link, data)

    def advance(self, t: float) -> list[tuple[str, bytes]]:
        frames = [(link, frame) for link, frame in super().advance(t) if not self._mute(_message_id(frame))]
        while self.stranger is not None and self._strange_frames < 10.0 * t:
            frames.append((COMPANION, self.stranger(self._strange_frames)))
            self._strange_frames += 1
        return frames


def _message_id(frame: bytes) -> int:
    return int.from_bytes(frame[7:10], "little")


class Board(WrappedBoard):
    """Records its inputs."""

    def __init__(self) -> None:
        super().__init__(Firmware())
        self.received: list[protocol.Message] = []
        self._decoder = protocol.Codec()

    def receive(self, data: bytes) -> None:
        self.received += self._decoder.decode(data)
        super().receive(data)


def phlosar(board: Board | None = None, reservoir_kPa: float = 690.0) -> SimulatedPhlosar:
    return SimulatedPhlosar(firmware=board or Board(), effects=Effects(), reservoir_kPa=reservoir_kPa)


def gps() -> Callable[[bytes], bytes]:
    return lambda received: b"$GPGGA,092750.000,5321.6802,N,00630.3372,W,1,8,1.03,61.7,M,55.2,M,,*76\r\n"


def silent() -> Callable[[bytes], bytes]:
    return lambda received: b""


def quick_board() -> Callable[[bytes], bytes]:
    """A healthy firmware without a plant, for worlds that need no pressures: it is fast."""
    codec = protocol.Codec()
    began_s = time.monotonic()

    def answer(received: bytes) -> bytes:
        now_ms = round(1e3 * (time.monotonic() - began_s))
        said: list[protocol.Message] = []
        for message in codec.decode(received):
            match message:
                case protocol.Hello(_, nonce):
                    welcome = Welcome(PROTOCOL_VERSION, nonce, 7, "quick", 1, *LIMITS, 300, QUICK_HZ)
                    said.append(replace(welcome, settings_memory=SettingsMemory.STORED))
                case protocol.Ping(host_time_us):
                    said.append(protocol.Pong(host_time_us, now_ms))
                case protocol.GetSetting():
                    said.append(protocol.Setting(0, 1, "cv_limit_kPa", 30.0, 5.0, 60.0, 30.0))
        said.append(Telemetry(now_ms, Mode.VENT, Fault.NONE, 0, 0.0, 0.1, 650.0, 0.0, 0.0, True))
        return b"".join(map(codec.encode, said))

    return answer


def of_next_version() -> Callable[[bytes], bytes]:
    """A firmware with a newer protocol version than this host."""
    codec = protocol.Codec()

    def answer(received: bytes) -> bytes:
        hellos = [m for m in codec.decode(received) if isinstance(m, protocol.Hello)]
        return b"".join(
            codec.encode(
                Welcome(
                    PROTOCOL_VERSION + 1, hello.nonce, 7, "9.0", Units.KPA_GAUGE, 30, 28, 760, 200, 300, 100
                )
            )
            for hello in hellos
        )

    return answer


def heartbeats(system: int, component: int, kind: int, autopilot: int) -> Callable[[int], bytes]:
    out = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)

    def frame(count: int) -> bytes:
        out.seq = count % 256
        message = mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 4, 3)
        return bytes(message.pack(out))

    return frame


@dataclass(frozen=True)
class World:
    """A healthy vehicle and a healthy board. An argument changes or replaces one of them."""

    vehicle: Callable[[], Vehicle] = Vehicle
    phlosar: Callable[[], SimulatedPhlosar] | None = None
    firmware: Callable[[], Callable[[bytes], bytes]] = quick_board
    """Answers if there is no simulated phloSAR: received bytes to sent bytes."""
    start: Callable[[Config, Path], ServiceConfiguration] = lambda config, folder: look.given(config, "test")
    """Makes the configuration of the service from one with the right links, and from a folder for files."""
    stranger: Callable[[int], bytes] | None = None
    """Makes a frame of another program from a count; ten times a second one comes over the vehicle's link."""
    ask: Callable[[Vehicle], RadioQuestion] | None = None


@dataclass(frozen=True)
class Examined:
    findings: list[DoctorFinding]
    reported: list[Sequence[DoctorFinding]]
    vehicle: Vehicle
    phlosar: SimulatedPhlosar | None

    def of(self, check: str) -> DoctorFinding:
        """The worst finding of a check."""
        order = ("bad", "warning", "good", "skipped")
        return min((f for f in self.findings if f.check == check), key=lambda f: order.index(f.verdict))

    @property
    def bad(self) -> set[str]:
        return {finding.check for finding in self.findings if finding.verdict == "bad"}


async def examined(world: World, folder: Path) -> Examined:
    vehicle, board = world.vehicle(), world.phlosar() if world.phlosar else None
    vehicle.stranger = world.stranger
    told: list[Sequence[DoctorFinding]] = []
    async with AsyncExitStack() as stack:
        config = configuration.default()
        if board is None:
            path = await stack.enter_async_context(_instead(world.firmware()))
            config = linked(config, config.vehicle.link, f"serial:{path}")
        config = await stack.enter_async_context(between(config, vehicle, board))
        ask = world.ask(vehicle) if world.ask else None
        findings = await examine(world.start(config, folder), folder, SECONDS, told.append, ask)
        return Examined(findings, told, vehicle, board)


@asynccontextmanager
async def _instead(answer: Callable[[bytes], bytes]) -> AsyncIterator[str]:
    """Another device on a pseudo-terminal."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    os.set_blocking(ours, False)

    async def live() -> None:
        while True:
            received = b""
            with contextlib.suppress(BlockingIOError):
                received = os.read(ours, 4096)
            with contextlib.suppress(BlockingIOError):
                os.write(ours, answer(received))
            await asyncio.sleep(1.0 / QUICK_HZ)

    living = asyncio.create_task(live())
    try:
        yield os.ttyname(theirs)
    finally:
        living.cancel()
        await asyncio.wait([living])
        os.close(ours)
        os.close(theirs)
