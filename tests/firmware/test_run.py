"""The firmware's loop on a board of variables: its timing, its watchdog, what it stores and when."""

from __future__ import annotations

import ctypes
import itertools
import shutil
from pathlib import Path

import pytest

from firmware_link.protocol import (
    PROTOCOL_VERSION,
    Codec,
    Fault,
    Hello,
    HostMessage,
    Message,
    Mode,
    Setpoint,
    SetSetting,
    Telemetry,
    Vent,
    Welcome,
)

from .native import FIRMWARE, LIBRARY, library

SOURCE = FIRMWARE / "phlosar" / "src"
SUPPLY = 59578
"""3.0 V of 3.3 V: the sensors' 5 V through the divider."""
AT_REST = round(0.1 * SUPPLY)
HALF_FULL = round(0.5 * SUPPLY)
TURN_US = 50


class Board(ctypes.Structure):
    _fields_ = (
        ("now_us", ctypes.c_uint32),
        ("step_us", ctypes.c_uint32),
        ("readings", ctypes.c_uint16 * 3),
        ("evp_duty", ctypes.c_uint16),
        ("dvp_duty", ctypes.c_uint16),
        ("solenoid", ctypes.c_uint8),
        ("light", ctypes.c_uint8),
        ("steps", ctypes.c_uint32),
        ("fed", ctypes.c_uint32),
        ("stores", ctypes.c_uint32),
        ("stored_size", ctypes.c_uint32),
        ("stored", ctypes.c_uint8 * 128),
        ("bootloader_asked", ctypes.c_uint8),
        ("in_bootloader", ctypes.c_uint8),
        ("steps_at_bootloader", ctypes.c_uint32),
        ("outputs_at_bootloader", ctypes.c_uint16 * 3),
        ("incoming_size", ctypes.c_uint32),
        ("outgoing_size", ctypes.c_uint32),
        ("outgoing_room", ctypes.c_uint32),
        ("incoming", ctypes.c_uint8 * 4096),
        ("outgoing", ctypes.c_uint8 * 4096),
    )


class Running:
    """The loop, turned every 50 µs of its board's time."""

    def __init__(self, built: ctypes.CDLL) -> None:
        built.run_light.restype = ctypes.c_bool
        self._built = built
        self.board = Board.in_dll(built, "fake_board")
        self.board.readings[:] = [AT_REST, HALF_FULL, SUPPLY]
        self.board.step_us = 300
        self.room = 64
        self.codec = Codec()
        built.run_begin()

    @property
    def outputs(self) -> tuple[int, int, int]:
        return self.board.evp_duty, self.board.dvp_duty, self.board.solenoid

    @property
    def outputs_at_bootloader(self) -> tuple[int, ...]:
        return tuple(self.board.outputs_at_bootloader)

    def run_turns(self, turns: int) -> list[Message]:
        """What the host hears meanwhile."""
        heard: list[Message] = []
        for _ in range(turns):
            self.board.outgoing_room = self.room
            self._built.run_turn()
            self.board.now_us += TURN_US
            heard += self.codec.decode(bytes(self.board.outgoing[: self.board.outgoing_size]))
            self.board.outgoing_size = 0
        return heard

    def run(self, ms: int) -> list[Message]:
        """Turns until so much time has gone by."""
        heard: list[Message] = []
        end_us = self.board.now_us + 1000 * ms
        while self.board.now_us < end_us:
            heard += self.run_turns(1)
        return heard

    def bring_near_wrap(self, ms: int) -> None:
        """Until its clock wraps. Two pauses: one beyond half of its range looks as if it went back."""
        for now_us in (2**31 - 1, 2**32 - 1000 * ms):
            self.board.now_us = now_us
            self.run_turns(1)

    def say(self, *messages: HostMessage) -> None:
        frames = b"".join(map(self.codec.encode, messages))
        self.board.incoming[: len(frames)] = list(frames)
        self.board.incoming_size = len(frames)

    def greet(self) -> Welcome:
        self.run(2)  # what comes before the first step is lost
        self.say(Hello(PROTOCOL_VERSION, 7))
        return next(message for message in self.run(5) if isinstance(message, Welcome))

    def light(self, mode: Mode, faults: Fault, now_ms: int) -> bool:
        return bool(self._built.run_light(int(mode), int(faults), now_ms))


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    core = sorted((SOURCE / "core").glob("*.cpp"))
    library(folder, Path(__file__).with_name("fake_board.cpp"), *sorted(SOURCE.glob("*.cpp")), *core)
    return folder / LIBRARY


@pytest.fixture
def running(built: Path, tmp_path: Path) -> Running:
    """From power-up: a library of another name has variables of its own."""
    return Running(ctypes.CDLL(str(shutil.copy(built, tmp_path / "copy.so"))))


def test_a_step_each_millisecond_and_telemetry_in_between(running: Running) -> None:
    heard = running.run(100)
    assert running.board.steps == 100
    telemetry = [message for message in heard if isinstance(message, Telemetry)]
    assert len(telemetry) == 10
    assert (telemetry[-1].mode, telemetry[-1].faults) == (Mode.VENT, Fault.NONE)
    assert running.outputs == (0, 0, 1)


def test_it_regulates(running: Running) -> None:
    running.greet()
    running.say(Setpoint(10.0, 100.0, 250, 1))
    running.run(30)
    evp, dvp, solenoid = running.outputs
    assert evp > 0 and dvp == 0 and not solenoid
    assert running.board.light


def test_what_is_set_is_stored_once_and_not_while_regulating(running: Running) -> None:
    board = running.board
    running.greet()
    running.run(20)
    assert board.stores == 0
    running.say(SetSetting(0, 25.0))
    running.run(5)
    assert board.stores == 1
    # Two in one packet: the second comes before the first can be stored.
    running.say(SetSetting(0, 24.0), Setpoint(10.0, 100.0, 250, 1))
    running.run(50)
    assert (board.stores, board.solenoid) == (1, 0)
    running.say(Vent(2))
    running.run(50)
    assert (board.stores, board.solenoid) == (2, 1)


def test_what_was_stored_is_taken_up_at_the_next_start(running: Running, built: Path, tmp_path: Path) -> None:
    running.greet()
    running.say(SetSetting(0, 25.0))
    running.run(20)
    again = ctypes.CDLL(str(shutil.copy(built, tmp_path / "again.so")))
    board = Board.in_dll(again, "fake_board")
    board.stored[:], board.stored_size = running.board.stored[:], running.board.stored_size
    assert Running(again).greet().cv_limit_kPa == 25.0


def test_the_watchdog_is_fed_by_steps_once_eight_came_in_time(running: Running) -> None:
    board = running.board
    running.run(100)
    assert board.steps - board.fed == 7


def test_a_pause_is_not_caught_up_with(running: Running) -> None:
    """One late step, which does not feed the watchdog, nor do the next seven."""
    board = running.board
    running.run(50)
    steps, fed = board.steps, board.fed
    board.now_us += 20_000
    running.run(1)
    assert board.steps == steps + 1
    running.run(7)
    assert (board.steps, board.fed) == (steps + 8, fed)
    running.run(3)
    assert board.fed > fed


@pytest.mark.parametrize("step_us", [1100, 1400, 3000])
def test_a_loop_that_cannot_keep_up_starves_the_watchdog(running: Running, step_us: int) -> None:
    board = running.board
    running.run(50)
    board.step_us = step_us
    running.run(30)
    fed = board.fed
    running.run(300)
    assert board.fed == fed


def test_the_clock_may_wrap(running: Running) -> None:
    board = running.board
    running.bring_near_wrap(ms=50)
    running.run(20)
    steps = board.steps
    running.run_turns(2000)
    assert board.now_us < 2**31
    assert abs(board.steps - steps - 125) <= 25
    assert board.fed > steps


def test_the_light_flashes_on_when_the_clock_wraps(running: Running) -> None:
    """A flash too many would be another fault."""
    board = running.board
    running.bring_near_wrap(ms=5000)
    board.step_us = 0
    lit: list[int] = []
    for _ in range(5 * 2048):
        running.run_turns(1)
        lit.append(board.light)
        board.now_us += 1000 - TURN_US
    assert board.now_us < 2**31
    begins = [ms for ms, (before, now) in enumerate(itertools.pairwise(lit)) if now and not before]
    assert len(begins) >= 4
    assert {later - earlier for earlier, later in itertools.pairwise(begins)} == {2048}


def test_the_valves_are_safe_before_the_bootloader_is_entered(running: Running) -> None:
    board = running.board
    running.greet()
    running.say(Setpoint(10.0, 100.0, 250, 1))
    running.run(30)
    assert board.solenoid == 0
    board.bootloader_asked = 1
    running.run_turns(1)
    assert board.in_bootloader == 1
    assert board.steps_at_bootloader == board.steps
    assert running.outputs_at_bootloader == (0, 0, 1)


def test_what_no_host_takes_is_lost_frame_by_frame(running: Running) -> None:
    """A port that takes 7 bytes now and then: no frame comes in parts, or mixed with another."""
    running.room = 7
    heard = running.run(3000)
    running.room = 0
    running.run(1000)
    running.room = 64
    heard += running.run(100)
    assert len(heard) > 300
    assert running.codec.bad_frames == 0


def test_the_light(running: Running) -> None:
    def flashes(mode: Mode, faults: Fault, ms: int) -> int:
        lit = [running.light(mode, faults, t) for t in range(ms)]
        return sum(1 for before, now in zip([False, *lit], lit, strict=False) if now and not before)

    assert all(running.light(Mode.REGULATE, Fault.NONE, t) for t in range(0, 5000, 100))
    assert flashes(Mode.VENT, Fault.NONE, 20_480) == 10
    for place, fault in enumerate(Fault, start=1):
        assert flashes(Mode.FAULT, fault, 384 * place + 1280) == place
    both = Fault.CV_OVERPRESSURE | Fault.SETTINGS
    assert flashes(Mode.FAULT, both, 384 * 2 + 1280) == 2
