"""The simulated phloSAR regulates, is deterministic, and survives its hosts."""

from __future__ import annotations

import asyncio
import contextlib
import subprocess
import sys
import time
from pathlib import Path
from statistics import median

import command_line
import pytest
import serial
from still_board import StillBoard
from waiting import until

from firmware_link.host import VENTING, HostCommand, HostSession, Regulate, SessionState
from firmware_link.protocol import Codec, Fault, Mode, Telemetry
from flying_vines.physics.baseline import Inputs
from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.true_rig import TrueRig
from flying_vines.physics.rig import ControlVolume, Rig, Sensors
from flying_vines.simulation.phlosar.firmware import SAFE
from flying_vines.simulation.phlosar.phlosar import PtyPhlosar, SimulatedPhlosar


class Flight:
    """A host session and a simulated phloSAR on a perfect wire, in simulated time."""

    def __init__(self, phlosar: SimulatedPhlosar) -> None:
        self.phlosar = phlosar
        self.session = HostSession()
        self.codec = Codec()
        self.t = 0.0
        self.pressures: list[float] = []
        self.session.opened(0.0)
        self.fly(0.1)
        assert self.session.state is SessionState.READY

    def command(self, command: HostCommand) -> None:
        for message in self.session.command(self.t, command):
            self.phlosar.receive(self.codec.encode(message))

    def fly(self, seconds: float) -> None:
        for _ in range(round(seconds * 100)):
            self.t += 0.01
            for message in self.codec.decode(self.phlosar.advance(self.t)):
                self.session.receive(self.t, message)
            for due in self.session.tick(self.t):
                self.phlosar.receive(self.codec.encode(due))
            self.pressures.append(self.phlosar.cv_kPa)


@pytest.mark.parametrize(("volume_L", "effects"), [(0.1, None), (0.5, Effects()), (1.0, None)])
def test_it_reaches_the_setpoint_and_stays_there(volume_L: float, effects: Effects | None) -> None:
    flight = Flight(SimulatedPhlosar(Rig(cv=ControlVolume(volume_L=volume_L)), effects=effects))
    flight.command(Regulate(20.7, 20.0))
    # A pouch fills before its pressure rises.
    flight.fly(1.5 + 3.0 * volume_L)
    assert max(flight.pressures) < 21.5
    flight.pressures.clear()
    flight.fly(1.0)
    assert 20.2 < min(flight.pressures) <= max(flight.pressures) < 21.2
    flight.command(Regulate(5.0, 20.0))
    flight.fly(2.0)
    # Vented air cools the rest, so a last vent may come at any time. The pressure dips, and is corrected.
    assert median(flight.pressures[-60:]) == pytest.approx(5.0, abs=0.6)
    flight.command(VENTING)
    flight.fly(0.1)
    assert flight.phlosar.drive == SAFE
    assert flight.codec.bad_frames == flight.codec.lost_frames == flight.session.telemetry_gaps == 0


def test_the_same_seed_is_the_same_flight_however_it_is_cut() -> None:
    def sent(pieces: int, seed: int) -> bytes:
        phlosar = SimulatedPhlosar(seed=seed)
        return b"".join(phlosar.advance(at / pieces) for at in range(1, pieces + 1))

    assert sent(1, seed=1) == sent(40, seed=1) == sent(333, seed=1)
    assert sent(1, seed=1) != sent(1, seed=2)


def test_time_does_not_go_back() -> None:
    phlosar = SimulatedPhlosar()
    phlosar.advance(0.5)
    assert phlosar.advance(0.2) == b""
    assert phlosar.now_s == 0.5


def test_a_reset_keeps_the_air() -> None:
    flight = Flight(SimulatedPhlosar())
    flight.command(Regulate(20.0, 50.0))
    flight.fly(1.0)
    flight.phlosar.reset_firmware()
    assert flight.phlosar.cv_kPa > 19.0
    assert flight.phlosar.drive == SAFE
    flight.fly(1.0)
    assert flight.session.state is SessionState.READY
    assert flight.phlosar.firmware.mode is Mode.VENT
    assert flight.session.welcome is not None
    assert flight.session.welcome.boot_id == 2


def test_any_firmware_may_run_it() -> None:
    board = StillBoard(Inputs(0.5, 0.0, False))
    phlosar = SimulatedPhlosar(Rig(sensors=Sensors(0.0, 0.0)), board, effects=Effects())
    phlosar.receive(b"hello")
    assert set(phlosar.advance(0.1)) == set(b".")
    phlosar.reset_firmware(watchdog=True)
    assert board.received == b"hello"
    assert [now_us for now_us, _, _ in board.steps] == [*range(0, 101_000, 1000), 100_000]
    assert board.steps[100][1:] == (phlosar.cv_kPa, phlosar.reservoir_kPa)
    assert 10.0 < phlosar.cv_kPa < 690.0 > phlosar.reservoir_kPa
    assert board.resets == [True]


def readings(phlosar: SimulatedPhlosar) -> list[float]:
    messages = Codec().decode(phlosar.advance(1.0))
    return [message.cv_kPa for message in messages if isinstance(message, Telemetry)]


def test_the_converter_has_steps() -> None:
    lsb_kPa = 206.84 * 3.3 / 4 / 4096
    codes = [(kPa + 206.84 / 8) / lsb_kPa for kPa in readings(SimulatedPhlosar(cv_kPa=5.0))]
    assert len(set(codes)) > 5
    for code in codes:
        assert code == pytest.approx(round(code), abs=0.06)  # the board's own converter has 16 bits


def test_sensors_may_be_wrong() -> None:
    rig = Rig(sensors=Sensors(0.0, 0.0))
    true = TrueRig(rig, causes={"cv_sensor_offset": {"offset_kPa": -0.75}})
    (read_kPa,) = set(readings(SimulatedPhlosar(true)))
    assert read_kPa == pytest.approx(-0.75, abs=0.003)


@pytest.mark.parametrize("command", [["fake", "phlosar"], ["demo"]])
def test_a_rig_file_that_is_wrong_is_one_line(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text("[cv]\n[causes.evp_dead_zone]\nopening = 2\n")
    ended, out, err = command_line.run(capsys, *command, "--rig", rig)
    assert (ended, out) == (2, "")
    assert err == f"flying-vines: {rig}:2: causes.evp_dead_zone: a dead zone must be in 0…1.\n"


# The serial port.


def test_a_computer_without_pseudo_terminals_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def out_of_ptys() -> tuple[int, int]:
        raise OSError("out of pty devices")

    monkeypatch.setattr("os.openpty", out_of_ptys)
    ended, _, err = command_line.run(capsys, "fake", "phlosar")
    assert (ended, err) == (2, "flying-vines: the pseudo-terminal: out of pty devices\n")


class FakeClock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def telemetry_through(path: str) -> int:
    """Open the port like another program, and count whole telemetry frames for a moment."""
    codec = Codec()
    with serial.Serial(path, 115200, timeout=0.1, exclusive=True) as port:
        messages = [message for _ in range(3) for message in codec.decode(port.read(300))]
    return sum(isinstance(message, Telemetry) for message in messages)


def test_the_command_breaks_by_typing(tmp_path: Path) -> None:
    link = tmp_path / "vine"
    command = [sys.executable, "-m", "flying_vines", "fake", "phlosar", "--link", str(link)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as fake:
        assert fake.stdin is not None
        assert fake.stdout is not None
        try:
            assert fake.stdout.readline() == f"{link}\n"
            fake.stdin.write("evp stuck wide\ncv_sensor shorted\n")
            fake.stdin.flush()
            assert fake.stdout.readline().startswith("stuck wide: ")
            codec, faults = Codec(), Fault.NONE
            deadline_s = time.monotonic() + 10.0
            with serial.Serial(str(link), timeout=0.1, exclusive=True) as port:
                while not faults and time.monotonic() < deadline_s:
                    for message in codec.decode(port.read(300)):
                        if isinstance(message, Telemetry):
                            faults = message.faults
            assert faults == Fault.CV_SENSOR
        finally:
            fake.terminate()


async def test_hosts_may_come_and_go() -> None:
    with PtyPhlosar(SimulatedPhlosar()) as board:
        task = asyncio.create_task(board.run())
        for _ in range(3):
            assert await asyncio.to_thread(telemetry_through, board.path) > 5
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


async def test_an_hour_of_not_being_read_is_dropped_not_kept() -> None:
    clock = FakeClock()
    with PtyPhlosar(SimulatedPhlosar(), clock=clock) as board:
        for minute in range(20):
            board._turn(minute * 0.5)
        # A terminal holds some tens of kilobytes at most; then everything is dropped.
        full = board.dropped_bytes
        assert full > 0
        board._turn(11.0)
        assert board.dropped_bytes - full > 3000
        assert len(board.phlosar.firmware.take_output()) == 0


async def test_after_a_stall_time_goes_on_from_where_it_stood() -> None:
    clock = FakeClock()
    with PtyPhlosar(SimulatedPhlosar(), clock=clock) as board:
        task = asyncio.create_task(board.run())
        await asyncio.sleep(0)
        clock.now_s = 3600.0
        await until(lambda: board.phlosar.now_s > 0.0, "it lives")
        assert board.phlosar.now_s <= 0.5
        clock.now_s += 0.1
        await until(lambda: board.phlosar.now_s > 0.5, "it lives on")
        assert board.phlosar.now_s == pytest.approx(0.6)
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


def test_the_link_has_a_stable_name_and_goes_with_the_board(tmp_path: Path) -> None:
    link = tmp_path / "vine"
    link.symlink_to("/dev/pts/leftover")
    board = PtyPhlosar(SimulatedPhlosar(), symlink=link)
    assert board.path == str(link)
    assert link.is_char_device()
    board.close()
    assert not link.is_symlink()
    board.close()


def open_descriptors() -> int:
    return len(list(Path("/dev/fd").iterdir()))


def test_a_file_that_is_no_link_is_left_alone(tmp_path: Path) -> None:
    file = tmp_path / "precious"
    file.write_text("data")
    before = open_descriptors()
    with pytest.raises(FileExistsError):
        PtyPhlosar(SimulatedPhlosar(), symlink=file)
    assert file.read_text() == "data"
    assert open_descriptors() == before
