"""The real core as a program behind a pseudo-terminal, with the real host at the other end."""

from __future__ import annotations

import asyncio
import contextlib
import subprocess
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from real_time import real_time
from required_programs import host_compiler, need
from waiting import MAX_WAIT_S, until

from firmware_link.host import HostEvent, Ready, Regulate, TelemetryReceived
from firmware_link.link import FirmwareLink
from firmware_link.protocol import Fault, GetSetting, Message, Mode, SetSetting, Setting, Telemetry
from flying_vines.simulation.phlosar.core_library import SOURCES

from .once import made_once

pytestmark = real_time


@pytest.fixture(scope="session")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    host_compiler()
    make = need("make", "sudo apt install make")

    def build(folder: Path) -> None:
        command = [make, "-C", str(SOURCES / "host"), f"BUILD={folder}"]
        made = subprocess.run(command, capture_output=True, text=True, check=False)
        assert made.returncode == 0, made.stderr

    return made_once(tmp_path_factory, "pty", build) / "phlosar-pty"


@contextlib.asynccontextmanager
async def running(program: Path, *options: str) -> AsyncIterator[str]:
    """Run the program. Yields the path of its port, and checks that it ends without an error."""
    process = await asyncio.create_subprocess_exec(program, *options, stdout=asyncio.subprocess.PIPE)
    try:
        assert process.stdout is not None
        async with asyncio.timeout(MAX_WAIT_S):
            yield (await process.stdout.readline()).decode().strip()
    finally:
        process.terminate()
        assert await process.wait() == 0


class Host:
    """A link, and its results."""

    def __init__(self, path: str) -> None:
        self.link = FirmwareLink(path, self._handle)
        self.ready: Ready | None = None
        self.telemetry: list[Telemetry] = []
        self.received: list[Message] = []
        decode = self.link.codec.decode

        def decoded(data: bytes) -> list[Message]:
            messages = decode(data)
            self.received.extend(messages)
            return messages

        self.link.codec.decode = decoded  # type: ignore[method-assign]

    def _handle(self, event: HostEvent) -> None:
        match event:
            case Ready():
                self.ready = event
            case TelemetryReceived(telemetry):
                self.telemetry.append(telemetry)

    @property
    def cv_kPa(self) -> float:
        return self.telemetry[-1].cv_kPa if self.telemetry else 0.0

    async def hold(self, kPa: float, telemetry: int) -> None:
        """Hold until this number of telemetry messages in a row confirms it. On a busy machine the dead-man
        may interrupt."""

        def held() -> bool:
            if self.telemetry and self.telemetry[-1].faults:
                self.link.clear_faults(Fault.DEAD_MAN)
            self.link.command(Regulate(kPa, 60.0))
            last = self.telemetry[-telemetry:]
            return len(last) == telemetry and all(
                one.mode is Mode.REGULATE and abs(one.cv_kPa - kPa) < 0.5 for one in last
            )

        await until(held, f"{kPa} kPa are held")

    def say(self, message: GetSetting | SetSetting) -> None:
        self.link.port.write(self.link.codec.encode(message))

    async def setting(self, number: int) -> Setting:
        self.say(GetSetting(number))
        await until(lambda: any(isinstance(m, Setting) for m in self.received), "the setting is told")
        return next(m for m in self.received if isinstance(m, Setting))


@contextlib.asynccontextmanager
async def connected(path: str) -> AsyncIterator[Host]:
    host = Host(path)
    link = asyncio.create_task(host.link.run())
    try:
        await until(lambda: host.ready is not None, "the firmware answers")
        yield host
    finally:
        link.cancel()
        await asyncio.gather(link, return_exceptions=True)


@pytest.mark.long
async def test_it_greets_fills_the_bag_and_vents_it(program: Path, tmp_path: Path) -> None:
    link = tmp_path / "phlosar"
    async with running(program, "--link", str(link), "--boot-id", "77") as path:
        assert str(link.readlink()) == path
        async with connected(str(link)) as host:
            assert host.ready is not None
            assert (host.ready.welcome.boot_id, host.ready.welcome.firmware_build) == (77, "1.1 pty")
            await host.hold(15.0, 30)
            assert host.telemetry[-1].reservoir_kPa < 690.0
        # The end of the link has vented.
        async with connected(str(link)) as host:
            await until(lambda: bool(host.telemetry) and host.cv_kPa < 1.0, "it is vented")
            assert host.telemetry[-1].faults is Fault.NONE
    assert not link.is_symlink()


async def test_the_dead_man_vents_when_the_host_falls_silent(program: Path) -> None:
    async with running(program) as path, connected(path) as host:
        await host.hold(15.0, 1)
        host.link.command(Regulate(15.1, 60.0))
        number = host.link.session.number
        host.link._send = lambda messages: None  # type: ignore[method-assign]
        await until(lambda: host.telemetry[-1].mode is Mode.FAULT, "the dead-man vents")
        accepted = next(one for one in host.telemetry if one.number == number)
        vented = next(one for one in host.telemetry if one.mode is Mode.FAULT and one.number == number)
        assert accepted.mode is Mode.REGULATE
        assert vented.faults is Fault.DEAD_MAN
        assert vented.solenoid
        assert vented.evp_opening == 0.0
        # The setpoint lives for 250 ms, and telemetry comes every 10 ms.
        assert 240 <= vented.device_time_ms - accepted.device_time_ms <= 260


async def test_settings_survive_in_their_file(program: Path, tmp_path: Path) -> None:
    kept = tmp_path / "settings"
    async with running(program, "--settings", str(kept)) as path, connected(path) as host:
        host.say(SetSetting(0, 25.0))
        assert (await host.setting(0)).value == 25.0
        await until(kept.exists, "the settings are written")
    async with running(program, "--settings", str(kept)) as path, connected(path) as host:
        assert host.ready is not None
        assert host.ready.welcome.cv_limit_kPa == 25.0
        assert (await host.setting(0)).value == 25.0
    kept.write_bytes(b"\x00" * kept.stat().st_size)
    async with running(program, "--settings", str(kept)) as path, connected(path) as host:
        await until(lambda: bool(host.telemetry), "telemetry")
        assert host.telemetry[-1].faults is Fault.SETTINGS


async def test_sensors_that_always_read_the_same(program: Path) -> None:
    async with running(program, "--cv-kPa", "45", "--reservoir-kPa", "300") as path, connected(path) as host:
        await until(lambda: bool(host.telemetry), "telemetry")
        told = host.telemetry[-1]
        assert told.cv_kPa == pytest.approx(45.0, abs=0.01)
        assert told.reservoir_kPa == pytest.approx(300.0, abs=0.1)
        assert told.faults is Fault.CV_OVERPRESSURE


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--boot-id", "-1"], "--boot-id -1: is not within 0 to 4294967295"),
        (["--cv-kPa", "much"], "--cv-kPa much: is not a pressure"),
        (["--link", "."], ". is not a link and is not replaced"),
        (["--settings", "."], "cannot read"),
        (["here"], "here is not an option"),
        (["--speed"], "--boot-id N"),
    ],
)
def test_bad_options_are_named(program: Path, options: list[str], text: str) -> None:
    ran = subprocess.run([program, *options], capture_output=True, text=True, timeout=MAX_WAIT_S, check=False)
    assert ran.returncode == 2
    assert text in ran.stderr
    assert not ran.stdout
