"""The serial port and the whole link over pseudo-terminals."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path

import pytest
import serial
from pseudo_terminal import Terminal
from real_time import real_time
from serial.tools.list_ports_common import ListPortInfo

from firmware_link import answer_check, serial_port
from firmware_link.find import UsbBoard
from firmware_link.framing import FRAME_END
from firmware_link.host import FirmwareReset, HostEvent, Ready, Regulate, SessionState, TelemetryReceived
from firmware_link.link import FirmwareLink
from firmware_link.protocol import PROTOCOL_VERSION, Codec, Hello, Mode, Telemetry, Vent, Welcome
from firmware_link.serial_port import MAX_QUEUED_BYTES, SerialPort
from flying_vines.simulation.phlosar.firmware import Firmware
from flying_vines.simulation.phlosar.phlosar import PtyPhlosar, SimulatedPhlosar

pytestmark = real_time

TIMEOUT_S = 5.0
KERNEL_BYTES = 64 * 1024
"""More than a pseudo-terminal holds."""


class Watch:
    """Stores the calls, and lets a test wait for them."""

    def __init__(self) -> None:
        self.states: list[tuple[bool, str]] = []
        self.data = b""
        self.events: list[HostEvent] = []
        self._changed = asyncio.Event()

    def on_state(self, up: bool, why: str) -> None:
        self.states.append((up, why))
        self._changed.set()

    def on_bytes(self, data: bytes) -> None:
        self.data += data
        self._changed.set()

    def on_event(self, event: HostEvent) -> None:
        self.events.append(event)
        self._changed.set()

    async def until(self, satisfied: Callable[[], bool]) -> None:
        async with asyncio.timeout(TIMEOUT_S):
            while not satisfied():
                self._changed.clear()
                await self._changed.wait()


@pytest.fixture
def link(tmp_path: Path) -> Path:
    return tmp_path / "port"


@pytest.fixture
def terminal(link: Path) -> Iterator[Terminal]:
    terminal = Terminal(link)
    yield terminal
    terminal.unplug()


@contextlib.asynccontextmanager
async def running(port: SerialPort | FirmwareLink | PtyPhlosar) -> AsyncIterator[None]:
    task = asyncio.create_task(port.run())
    try:
        yield
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.wait_for(task, TIMEOUT_S)


@contextlib.asynccontextmanager
async def opened(link: Path) -> AsyncIterator[tuple[SerialPort, Watch]]:
    watch = Watch()
    port = SerialPort(str(link), 115200, watch.on_bytes, watch.on_state)
    async with running(port):
        await watch.until(lambda: port.connected)
        yield port, watch


async def eventually(satisfied: Callable[[], bool]) -> None:
    for _ in range(1000):
        if satisfied():
            return
        await asyncio.sleep(TIMEOUT_S / 1000)
    raise TimeoutError


async def test_bytes_both_ways(link: Path, terminal: Terminal) -> None:
    async with opened(link) as (port, watch):
        os.write(terminal.device, bytes(range(256)))
        await watch.until(lambda: len(watch.data) == 256)
        assert watch.data == bytes(range(256))
        assert port.write(bytes(range(256)))
        assert await terminal.read(256) == bytes(range(256))
    assert not port.connected
    assert not port.write(b"late")
    assert port.dropped_bytes == 4
    assert watch.states == [(True, f"{link} is open")]


async def test_it_comes_back_after_being_unplugged(link: Path, terminal: Terminal) -> None:
    async with opened(link) as (port, watch):
        terminal.pull_out()
        await watch.until(lambda: len(watch.states) == 3)
        assert "was lost" in watch.states[1][1]
        assert "is not there" in watch.states[2][1]
        again = Terminal(link)
        await watch.until(lambda: port.connected)
        assert port.write(b"hello again")
        assert await again.read(11) == b"hello again"
    again.unplug()


async def test_writing_to_a_port_that_was_pulled_out_is_survived(link: Path, terminal: Terminal) -> None:
    async with opened(link) as (port, watch):
        terminal.pull_out()
        port.write(b"into the void")
        await watch.until(lambda: not port.connected)
        assert not port.write(b"still")


async def wedge(port: SerialPort) -> bytes:
    """Write until the kernel accepts nothing for so long that messages are dropped. Returns the written
    data."""
    sent = b""
    async with asyncio.timeout(TIMEOUT_S):
        while not port.dropped_bytes:
            piece = b"%07d\n" % (len(sent) // 8)
            assert port.write(piece)
            sent += piece
            await asyncio.sleep(0)
    return sent


async def test_a_blocked_reader_delays_nothing_and_old_messages_are_dropped(
    link: Path, terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serial_port, "STALE_S", 0.02)
    async with opened(link) as (port, _):
        sent = await wedge(port)
        await asyncio.sleep(0.05)
        assert port.write(b"fresh 1\n")
        assert port.write(b"fresh 2\n")
        dropped = port.dropped_bytes
        came = await terminal.read(len(sent) - dropped + 16)
        # Whole and in order. Only old data is missing, not the newest.
        assert sent.startswith(came[:-16])
        assert len(came) % 8 == 0
        assert came.endswith(b"fresh 1\nfresh 2\n")
        assert port.dropped_bytes == dropped > 0
        assert port.write(b"and on")
        assert await terminal.read(6) == b"and on"


async def test_a_burst_beyond_all_measure_keeps_the_newest(link: Path, terminal: Terminal) -> None:
    async with opened(link) as (port, _):
        # No time passes, so nothing is stale; only the maximum size drops messages.
        written = 0
        for _ in range(100):
            assert port.write(b"x" * 1024)
            written += 1024
        assert not port.write(b"y" * (MAX_QUEUED_BYTES + 1))
        assert port.write(b"newest")
        kept = written + MAX_QUEUED_BYTES + 1 + 6 - port.dropped_bytes
        assert MAX_QUEUED_BYTES - 1024 <= kept <= MAX_QUEUED_BYTES + KERNEL_BYTES
        assert (await terminal.read(kept)).endswith(b"newest")


async def test_unsent_data_of_a_lost_port_is_counted(link: Path, terminal: Terminal) -> None:
    async with opened(link) as (port, watch):
        for _ in range(100):
            port.write(b"x" * 1024)
        dropped = port.dropped_bytes
        terminal.pull_out()
        await watch.until(lambda: not port.connected)
    # The kernel has the rest.
    assert dropped + MAX_QUEUED_BYTES - 1024 <= port.dropped_bytes <= dropped + MAX_QUEUED_BYTES + 1024


def boards(where: dict[str, str]) -> Callable[[], list[ListPortInfo]]:
    """This machine's ports, by the present content of `where`: device by serial number."""

    def ports() -> list[ListPortInfo]:
        found = []
        for number, device in where.items():
            port = ListPortInfo(device)
            port.vid, port.pid, port.serial_number = 0x16C0, 0x0483, number
            found.append(port)
        return found

    return ports


async def test_a_board_is_found_again_under_another_name() -> None:
    where: dict[str, str] = {}
    watch = Watch()
    board = UsbBoard(0x16C0, 0x0483, "1234560")
    host = FirmwareLink(board, watch.on_event, watch.on_state, ports=boards(where))
    async with running(host):
        await watch.until(lambda: len(watch.states) == 1)
        assert watch.states[0][1].startswith(f"{board} is not there")
        for opening in range(2):
            with PtyPhlosar(SimulatedPhlosar()) as other, PtyPhlosar(SimulatedPhlosar()) as one:
                # Its former name may be another board's now.
                where |= {"7654320": other.path, "1234560": one.path}
                async with running(one):
                    await watch.until(lambda: any(isinstance(event, Ready) for event in watch.events))
                    assert watch.states[-1] == (True, f"{board} ({one.path}) is open")
                    assert host.statistics.reconnects == opening
                where.clear()
            await watch.until(lambda: not host.port.connected)
            watch.events.clear()
    assert host.statistics.bad_frames <= 1


async def test_another_device_on_the_port_is_called_one(
    link: Path, terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(answer_check, "ANSWER_WITHIN_S", 0.2)
    watch = Watch()
    host = FirmwareLink(str(link), watch.on_event, watch.on_state)
    async with running(host):
        await watch.until(lambda: host.port.connected)
        os.write(terminal.device, b"$GNGGA,092725.00,4717.11399,N,00833.91590,E,1,08,1.01*45\r\n")
        await watch.until(lambda: len(watch.states) == 2)
        assert watch.states[1][0] is True
        assert "this is another device" in watch.states[1][1]


async def test_half_a_frame_of_an_earlier_program_does_not_damage_the_greeting(
    link: Path, terminal: Terminal
) -> None:
    watch = Watch()
    firmware = Firmware()
    firmware.step(0, 0.0, 690.0)
    firmware.receive(Codec().encode(Vent(1))[:-3])
    host = FirmwareLink(str(link), watch.on_event, watch.on_state)
    async with running(host):
        greeting = FRAME_END + Codec().encode(Hello(PROTOCOL_VERSION, 1))
        first = await terminal.read(len(greeting))
    assert first == greeting
    firmware.receive(first)
    answers = Codec().decode(firmware.take_output())
    assert [type(each) for each in answers if not isinstance(each, Telemetry)] == [Welcome]


async def test_a_port_is_opened_by_one_alone(link: Path, terminal: Terminal) -> None:
    first, second = Watch(), Watch()
    one = SerialPort(str(link), 115200, first.on_bytes, first.on_state)
    two = SerialPort(str(link), 115200, second.on_bytes, second.on_state)
    async with running(one):
        await first.until(lambda: one.connected)
        async with running(two):
            await second.until(lambda: bool(second.states))
            assert second.states[0][0] is False
            assert "in use by another program" in second.states[0][1]


async def test_no_permission_is_reported_with_a_remedy(
    link: Path, terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise serial.SerialException(13, "could not open port")

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    watch = Watch()
    port = SerialPort(str(link), 115200, watch.on_bytes, watch.on_state)
    async with running(port):
        await watch.until(lambda: bool(watch.states))
    assert "dialout" in watch.states[0][1]


async def test_a_path_that_is_not_a_serial_port_gives_a_sentence(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"")
    watch = Watch()
    port = SerialPort(str(path), 115200, watch.on_bytes, watch.on_state)
    async with running(port):
        await watch.until(lambda: bool(watch.states))
    assert "could not be opened" in watch.states[0][1]


async def test_the_whole_link_regulates_and_outlives_a_reset(link: Path) -> None:
    watch = Watch()
    phlosar = SimulatedPhlosar()
    host = FirmwareLink(str(link), watch.on_event, watch.on_state)

    def bent() -> bool:
        latest = host.session.telemetry
        return latest is not None and latest.mode is Mode.REGULATE and latest.cv_kPa > 8.0

    with PtyPhlosar(phlosar, symlink=link) as board:
        async with running(board), running(host):
            await watch.until(lambda: any(isinstance(event, Ready) for event in watch.events))
            host.command(Regulate(target_kPa=10.0, rate_kPa_per_s=100.0))
            await watch.until(bent)
            phlosar.reset_firmware()
            await watch.until(lambda: any(isinstance(event, FirmwareReset) for event in watch.events))
            await watch.until(lambda: host.session.state is SessionState.READY)
            received = len(watch.events)
            await watch.until(lambda: len(watch.events) > received + 5)
            latest = watch.events[-1]
            assert isinstance(latest, TelemetryReceived)
            assert latest.telemetry.mode is Mode.VENT
            assert host.codec.bad_frames <= 1


async def test_ending_the_link_vents(link: Path) -> None:
    watch = Watch()
    phlosar = SimulatedPhlosar()
    host = FirmwareLink(str(link), watch.on_event, watch.on_state)
    with PtyPhlosar(phlosar, symlink=link) as board:
        async with running(board):
            async with running(host):
                await watch.until(lambda: any(isinstance(event, Ready) for event in watch.events))
                host.command(Regulate(target_kPa=10.0, rate_kPa_per_s=100.0))
                await watch.until(lambda: phlosar.firmware.mode is Mode.REGULATE)
            await eventually(lambda: phlosar.firmware.mode is Mode.VENT)
