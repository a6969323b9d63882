"""The doctor on real sockets and ports: findings about healthy and faulty stand-ins."""

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

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from real_time import real_time
from wrapped_board import WrappedBoard

from firmware_link import protocol
from firmware_link.protocol import (
    PROTOCOL_VERSION,
    Fault,
    GetSetting,
    Hello,
    Mode,
    Ping,
    SettingsMemory,
    Telemetry,
    Units,
    Welcome,
)
from flying_vines.cli.doctor_fakes import between, linked
from flying_vines.config import config as configuration
from flying_vines.config.config import Config
from flying_vines.doctor.configuration import ServiceConfiguration, given, read
from flying_vines.doctor.examine import RadioQuestion, examine
from flying_vines.doctor.finding import DoctorFinding, may_fly
from flying_vines.doctor.vehicle_probe import SwitchFacts
from flying_vines.physics.plant.effects import Effects
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.autopilot.links import COMPANION
from flying_vines.simulation.phlosar.firmware import Firmware
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.mavlink.signing import UNITS_PER_S, UNIX_TIME_OF_ZERO_S
from flying_vines.vehicle.mission.item import AutopilotKind, MissionItem

pytestmark = real_time

ONBOARD, NONE = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID
KEY, KEY_FILE = bytes(range(32)), "vine.key"
SYS_STATUS = mavlink.MAVLINK_MSG_ID_SYS_STATUS
QUADROTOR, ARDUPILOT = mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA

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
    start: Callable[[Config, Path], ServiceConfiguration] = lambda config, folder: given(config, "test")
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


def without_rc() -> Vehicle:
    vehicle = Vehicle()
    vehicle.lose_rc()
    return vehicle


def after_a_watchdog() -> SimulatedPhlosar:
    board = phlosar()
    board.reset_firmware(watchdog=True)
    return board


def moved_through_all(vehicle: Vehicle) -> RadioQuestion:
    """A person who moves the switch as asked."""

    def ask(radio: SwitchFacts) -> None:
        unseen = min({0, 1, 2} - radio.seen, default=0)
        vehicle.set_rc(9, (1000, 1500, 2000)[unseen])

    return ask


def no_port(config: Config, folder: Path) -> ServiceConfiguration:
    return given(linked(config, config.vehicle.link, "serial:/dev/there-is-none"), "test")


def no_vehicle(config: Config, folder: Path) -> ServiceConfiguration:
    return given(linked(config, "tcp:127.0.0.1:9", config.firmware.link), "test")


def with_a_key(config: Config, folder: Path) -> ServiceConfiguration:
    """The configuration as a file, with a signing key beside it."""
    default = configuration.default()
    text = configuration.default_text().replace('signing_key = ""', f'signing_key = "{KEY_FILE}"')
    text = text.replace(default.vehicle.link, config.vehicle.link)
    file = folder / "signed.toml"
    file.write_text(text.replace(default.firmware.link, config.firmware.link))
    (folder / KEY_FILE).write_text(KEY.hex())
    (folder / KEY_FILE).chmod(0o600)
    return read(file)


WORLDS: dict[str, World] = {
    "healthy": World(lambda: Vehicle(mission=MISSION), phlosar=phlosar),
    "healthy on PX4": World(lambda: Vehicle("px4")),
    "no SYS_STATUS": World(lambda: Vehicle(mute=SYS_STATUS.__eq__)),
    "no vehicle": World(start=no_vehicle),
    "RC is lost": World(without_rc),
    "switch moved": World(lambda: Vehicle(mission=MISSION), ask=moved_through_all),
    "switch not moved": World(ask=lambda vehicle: lambda radio: None),
    "id is taken": World(stranger=heartbeats(1, 191, ONBOARD, NONE)),
    "two autopilots": World(stranger=heartbeats(2, 1, QUADROTOR, ARDUPILOT)),
    "noise": World(lambda: Vehicle(mute=lambda message_id: True), stranger=lambda count: bytes(range(50))),
    "signed": World(lambda: Vehicle(signing_key=KEY), start=with_a_key),
    "not signed": World(start=with_a_key),
    "signed, and no key": World(lambda: Vehicle(signing_key=KEY)),
    "no firmware": World(start=no_port),
    "a GPS": World(firmware=gps),
    "silence": World(firmware=silent),
    "next version": World(firmware=of_next_version),
    "reservoir empty": World(phlosar=lambda: phlosar(reservoir_kPa=61.8)),
    "latched fault": World(phlosar=after_a_watchdog),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("examined")


@pytest.fixture(scope="module")
def seen(folder: Path) -> dict[str, Examined]:
    """All worlds, examined in parallel, because each takes some seconds."""

    for name in WORLDS:
        (folder / name).mkdir()

    async def look() -> list[Examined]:
        return await asyncio.gather(*(examined(world, folder / name) for name, world in WORLDS.items()))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("flying_vines.doctor.examine.MOVING_S", 2.0)
        # Other services on this machine, as of another test, do not belong to these worlds.
        patch.setattr("flying_vines.doctor.processes.services", list)
        return dict(zip(WORLDS, asyncio.run(look()), strict=True))


@pytest.mark.parametrize("world", ["healthy", "healthy on PX4", "switch moved", "signed"])
def test_of_a_healthy_pair_one_may_fly(seen: dict[str, Examined], world: str) -> None:
    found = seen[world].findings
    if any(finding.check in ("load", "phloSAR line") and finding.verdict != "good" for finding in found):
        return  # too busy to judge the streams, and the doctor says so
    assert may_fly(found), [finding for finding in found if finding.verdict == "bad"]
    here = {"clock", "memory", "disk", "page", "phloSAR line", "service", "temperature"}
    # This machine may have warnings of its own, or be busy.
    assert {f.check for f in found if f.verdict == "warning"} <= here


@pytest.mark.parametrize(
    ("world", "check", "says"),
    [
        ("no SYS_STATUS", "SYS_STATUS", "does not arrive"),
        ("no vehicle", "vehicle link", "tcp:127.0.0.1:9: Connection refused"),
        ("RC is lost", "RC switch", "channel 9 is not valid"),
        ("switch not moved", "RC switch", "stayed in position 1 although you were asked"),
        ("id is taken", "component id", "191 is taken"),
        ("two autopilots", "vehicle link", "autopilots"),
        ("noise", "vehicle link", "but no MAVLink message"),
        ("not signed", "signing", "all messages were refused: "),
        ("no firmware", "phloSAR port", "/dev/there-is-none does not exist"),
        ("a GPS", "phloSAR", "this is another device"),
        ("silence", "phloSAR", "the port is open but silent"),
        ("next version", "phloSAR", "update the host"),
        ("reservoir empty", "reservoir", "62 kPa; a bend to 20.7 kPa needs 63"),
        ("latched fault", "phloSAR", "latched: watchdog reset"),
    ],
)
def test_each_fault_gives_its_finding_and_no_other(
    seen: dict[str, Examined], world: str, check: str, says: str
) -> None:
    assert seen[world].bad == {check}
    finding = seen[world].of(check)
    assert says in finding.what
    assert finding.do


def test_checks_that_depend_on_something_missing_are_skipped(seen: dict[str, Examined]) -> None:
    assert seen["no firmware"].of("phloSAR").verdict == "skipped"
    for check in ("RC switch", "mission"):
        assert seen["no vehicle"].of(check).verdict == "skipped"


def test_a_healthy_pair_is_described(seen: dict[str, Examined]) -> None:
    healthy = seen["healthy"]
    assert "ArduPilot 4.6.0, system 1" in healthy.of("autopilot").what
    assert "PX4 1.17.0" in seen["healthy on PX4"].of("autopilot").what
    assert "for the vine: 2 (bend 40°)" in healthy.of("mission").what
    assert "'1.1 host'" in healthy.of("phloSAR").what
    rates = {f.check: float(f.what.split()[0]) for f in healthy.findings if f.what.endswith(" a second")}
    assert rates.keys() >= {"RC_CHANNELS", "SYS_STATUS", "GLOBAL_POSITION_INT", "SYSTEM_TIME"}
    assert rates["RC_CHANNELS"] == pytest.approx(20.0, rel=0.5), "a busy machine receives in bursts"
    assert rates["GLOBAL_POSITION_INT"] == pytest.approx(5.0, rel=0.5)


def test_a_switch_that_is_moved_is_seen_in_all_positions(seen: dict[str, Examined]) -> None:
    assert "seen in all 3 positions" in seen["switch moved"].of("RC switch").what
    assert "position 1, “straight”" in seen["healthy"].of("RC switch").what


def test_an_autopilot_that_signs_is_distinguished(seen: dict[str, Examined]) -> None:
    assert seen["signed"].of("signing").what == "all messages were signed with our key"
    without = seen["signed, and no key"]
    assert "the configuration has no key" in without.of("signing").what
    assert without.bad >= {"SYS_STATUS", "GLOBAL_POSITION_INT", "RC_CHANNELS"}, "our messages do not reach it"


def test_used_signing_timestamps_are_not_used_again(seen: dict[str, Examined], folder: Path) -> None:
    kept = folder / "signed" / "signed.signing-timestamp"
    assert int(kept.read_text().split()[0]) > (time.time() - 60.0 - UNIX_TIME_OF_ZERO_S) * UNITS_PER_S


def test_nothing_is_commanded(seen: dict[str, Examined]) -> None:
    boards = [look.phlosar.firmware for look in seen.values() if look.phlosar]
    assert len(boards) == 3
    received = {type(message) for board in boards if isinstance(board, Board) for message in board.received}
    assert received == {Hello, Ping, GetSetting}


def test_the_vehicle_is_only_asked(seen: dict[str, Examined]) -> None:
    told = [message for look in seen.values() for message in look.vehicle.received]
    assert {message.get_type() for message in told} <= {
        "HEARTBEAT",
        "COMMAND_LONG",
        "MISSION_REQUEST_LIST",
        "MISSION_REQUEST_INT",
        "MISSION_ACK",
        "PARAM_REQUEST_READ",
    }
    commands = {message.command for message in told if message.get_type() == "COMMAND_LONG"}
    assert commands == {mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE}


def test_findings_are_reported_in_order_as_they_come(seen: dict[str, Examined]) -> None:
    for world in seen.values():
        assert [finding for told in world.reported for finding in told] == world.findings
        assert len(world.reported) > 5
