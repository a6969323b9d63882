"""The main loop and the step on simulated hardware: timing, watchdog, and storing of settings."""

from __future__ import annotations

import ctypes
import itertools
import shutil
from pathlib import Path

import pytest

from firmware_link.protocol import (
    PROTOCOL_VERSION,
    ClearFaults,
    Codec,
    Fault,
    Hello,
    HostMessage,
    Message,
    Mode,
    Ping,
    Setpoint,
    SetSetting,
    Telemetry,
    Vent,
    Welcome,
)

from .native import (
    AT_REST,
    FIRMWARE,
    HALF_FULL,
    LIBRARY,
    SUPPLY_COUNTS,
    Mistake,
    assert_found,
    fields,
    library,
    with_mistake,
)
from .once import made_once

SOURCE = FIRMWARE / "phlosar" / "src"
TURN_US = 50
IMAGE_SIZE = 82


class Board(ctypes.Structure):
    _fields_ = fields(
        """
        u32 now_us read_us memory_us serial_us
        u8 timer_stopped
        u16 readings[3] evp_duty dvp_duty
        u8 solenoid light
        u32 steps fed memory_writes
        u8 memory[1080]
        u32 power_cut_after
        u8 regulated_while_writing bootloader_requested waiting_for_bootloader
        u32 incoming_size outgoing_size outgoing_room
        u8 incoming[4096] outgoing[4096]
        """
    )


class Running:
    """The main loop runs every 50 µs of the board's time; the step interrupts it each millisecond."""

    def __init__(self, built: ctypes.CDLL, memory: bytes = b"") -> None:
        built.run_light.restype = ctypes.c_bool
        self._built = built
        self.board = Board.in_dll(built, "fake_board")
        self.board.readings[:] = [AT_REST, HALF_FULL, SUPPLY_COUNTS]
        self.board.read_us = 300
        self.board.memory_us = 1000
        self.board.serial_us = 10
        self.board.memory[:] = memory or b"\xff" * 1080
        self.room = 64
        self.codec = Codec()
        built.run_setup()

    @property
    def outputs(self) -> tuple[int, int, int]:
        return self.board.evp_duty, self.board.dvp_duty, self.board.solenoid

    def run_turns(self, turns: int) -> list[Message]:
        """Run the main loop. Returns the messages to the host."""
        received: list[Message] = []
        for _ in range(turns):
            self.board.outgoing_room = self.room
            self._built.run_turn(TURN_US)
            received += self.codec.decode(bytes(self.board.outgoing[: self.board.outgoing_size]))
            self.board.outgoing_size = 0
        return received

    def run(self, ms: int) -> list[Message]:
        received: list[Message] = []
        end_us = self.board.now_us + 1000 * ms
        while self.board.now_us < end_us:
            received += self.run_turns(1)
        return received

    def hang(self, ms: int) -> None:
        """The main loop hangs; the timer continues."""
        self._built.run_hang(1000 * ms)

    def bring_near_wrap(self, ms: int) -> None:
        """Run until the clock wraps. Two pauses, because one beyond half of its range would look like going
        back."""
        for now_us in (2**31 - 1, 2**32 - 1000 * ms):
            self._built.run_jump(ctypes.c_uint32(now_us))
            self.run_turns(20)

    def say(self, *messages: HostMessage, after: bytes = b"") -> None:
        frames = after + b"".join(map(self.codec.encode, messages))
        self.board.incoming[: len(frames)] = list(frames)
        self.board.incoming_size = len(frames)

    def greet(self) -> Welcome:
        self.run(3)  # bytes before the first step are lost
        self.say(Hello(PROTOCOL_VERSION, 7))
        return next(message for message in self.run(8) if isinstance(message, Welcome))

    def light(self, mode: Mode, faults: Fault, now_ms: int) -> bool:
        return bool(self._built.run_light(int(mode), int(faults), now_ms))


def build(folder: Path, copies: int, source: Path = SOURCE) -> Path:
    files = [*sorted(source.glob("*.cpp")), *sorted((source / "core").glob("*.cpp"))]
    here = Path(__file__).with_name("fake_board.cpp")
    library(folder, here, *files, flags=("-I", str(source), f"-DFAKE_COPIES={copies}"))
    return folder / LIBRARY


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_once(tmp_path_factory, "run", lambda folder: build(folder, copies=2)) / LIBRARY


@pytest.fixture(scope="module")
def built_with_one_copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_once(tmp_path_factory, "run-one-copy", lambda folder: build(folder, copies=1)) / LIBRARY


_COPIES = itertools.count()


def started(built: Path, folder: Path, memory: bytes = b"") -> Running:
    """A board at power-up. A library with another name has its own variables."""
    return Running(ctypes.CDLL(str(shutil.copy(built, folder / f"copy{next(_COPIES)}.so"))), memory)


@pytest.fixture
def running(built: Path, tmp_path: Path) -> Running:
    return started(built, tmp_path)


def test_a_step_each_millisecond_and_telemetry_in_between(running: Running) -> None:
    received = running.run(100)
    assert running.board.steps == 100
    telemetry = [message for message in received if isinstance(message, Telemetry)]
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


def test_a_setting_is_stored_once_and_not_while_regulating(running: Running) -> None:
    board = running.board
    running.greet()
    running.run(20)
    # Only an unchanged value, which an erased memory stores, lets the same session regulate.
    # A step takes 32 bytes: with the end of the first one comes the second, before the first is stored.
    running.say(SetSetting(0, 30.0), Setpoint(10.0, 100.0, 250, 1), after=bytes(25))
    running.run(50)
    assert (board.memory_writes, board.solenoid) == (0, 0)
    running.say(Vent(2))
    running.run(150)
    one_copy = board.memory_writes
    assert (one_copy, board.solenoid) == (IMAGE_SIZE + 4, 1)
    running.say(SetSetting(0, 24.0))
    running.run(150)
    assert board.memory_writes == 2 * one_copy


def test_a_setpoint_waits_until_the_settings_are_stored(running: Running) -> None:
    """Writing disables the interrupts, so no valve may be open meanwhile."""
    board = running.board
    running.greet()
    # In one packet and the next.
    running.say(SetSetting(0, 30.0), *[Ping(0)] * 5, Setpoint(10.0, 100.0, 250, 1))
    running.run(150)
    assert board.memory_writes == IMAGE_SIZE + 4
    assert not board.regulated_while_writing
    assert running.outputs != (0, 0, 1)


def test_nothing_is_stored_on_a_failing_supply(running: Running) -> None:
    board = running.board
    running.greet()
    board.readings[2] = round(0.8 * SUPPLY_COUNTS)
    running.run(10)
    running.say(SetSetting(0, 25.0))
    running.run(50)
    assert board.memory_writes == 0
    board.readings[2] = SUPPLY_COUNTS
    running.run(20)
    running.say(ClearFaults(0xFFFF))
    running.run(150)
    assert board.memory_writes == IMAGE_SIZE + 4


def with_limit(built: Path, folder: Path, memory: bytes, limit_kPa: float, power_cut_after: int = 0) -> bytes:
    """The board's memory after this limit was set, perhaps with a power cut while it was written."""
    running = started(built, folder, memory)
    running.greet()
    running.board.power_cut_after = power_cut_after
    running.say(ClearFaults(0xFFFF), SetSetting(0, limit_kPa))
    running.run(300)
    return bytes(running.board.memory)


def limit_and_faults(built: Path, folder: Path, memory: bytes) -> tuple[float, Fault]:
    running = started(built, folder, memory)
    limit_kPa = running.greet().cv_limit_kPa
    telemetry = [message for message in running.run(30) if isinstance(message, Telemetry)]
    return limit_kPa, telemetry[-1].faults


def test_settings_are_kept_over_many_power_cycles(built: Path, tmp_path: Path) -> None:
    memory = b"\xff" * 1080
    for limit_kPa in (25.0, 24.0, 23.0, 22.0, 21.0):
        memory = with_limit(built, tmp_path, memory, limit_kPa)
        assert limit_and_faults(built, tmp_path, memory) == (limit_kPa, Fault.NONE)


@pytest.mark.parametrize("written", [1, 7, 8, 29, 80, 82, 83, 84, 85])
def test_a_power_cut_while_storing_keeps_the_older_settings(
    built: Path, tmp_path: Path, written: int
) -> None:
    memory = with_limit(built, tmp_path, b"\xff" * 1080, 25.0)
    memory = with_limit(built, tmp_path, memory, 24.0)
    cut = with_limit(built, tmp_path, memory, 20.0, power_cut_after=written)
    assert (cut != memory) == (written > 6)  # the first bytes are equal
    assert limit_and_faults(built, tmp_path, cut) == (24.0, Fault.NONE)
    # The next change overwrites the damaged copy.
    again = with_limit(built, tmp_path, cut, 19.0)
    assert limit_and_faults(built, tmp_path, again) == (19.0, Fault.NONE)


def test_no_two_copies_have_bytes_in_one_sector(built: Path, tmp_path: Path) -> None:
    """A Teensy 4.0 uses 4 bytes of 15 sectors in turn; erasing one must not destroy the other copy."""
    first = with_limit(built, tmp_path, b"\xff" * 1080, 25.0)
    second = with_limit(built, tmp_path, first, 24.0)
    sectors = [
        {at // 4 % 15 for at, (a, b) in enumerate(zip(before, after, strict=True)) if a != b}
        for before, after in itertools.pairwise((b"\xff" * 1080, first, second))
    ]
    assert sectors[0] and sectors[1]
    assert sectors[0].isdisjoint(sectors[1])


@pytest.mark.parametrize("written", [30, 84])
def test_with_room_for_one_copy_a_power_cut_is_a_fault(
    built_with_one_copy: Path, tmp_path: Path, written: int
) -> None:
    memory = with_limit(built_with_one_copy, tmp_path, b"\xff" * 1080, 25.0)
    assert limit_and_faults(built_with_one_copy, tmp_path, memory) == (25.0, Fault.NONE)
    cut = with_limit(built_with_one_copy, tmp_path, memory, 20.0, power_cut_after=written)
    limit_kPa, faults = limit_and_faults(built_with_one_copy, tmp_path, cut)
    assert (limit_kPa, faults) in ((30.0, Fault.SETTINGS), (20.0, Fault.NONE))
    assert (faults == Fault.SETTINGS) == (written < IMAGE_SIZE)


def test_damage_of_both_copies_is_a_fault(built: Path, tmp_path: Path) -> None:
    memory = bytearray(with_limit(built, tmp_path, with_limit(built, tmp_path, b"", 25.0), 24.0))
    memory[4] ^= 1
    memory[28 + 5] ^= 1
    assert limit_and_faults(built, tmp_path, bytes(memory)) == (30.0, Fault.SETTINGS)


def test_the_watchdog_is_fed_by_steps_once_eight_came_in_time(running: Running) -> None:
    board = running.board
    running.run(100)
    assert 7 <= board.steps - board.fed <= 9


def test_without_steps_the_watchdog_starves(running: Running) -> None:
    running.run(50)
    fed = running.board.fed
    running.board.timer_stopped = 1
    running.run(300)
    assert running.board.fed == fed


def test_a_main_loop_that_hangs_starves_the_watchdog_and_the_dead_man_vents(running: Running) -> None:
    board = running.board
    running.greet()
    running.say(Setpoint(10.0, 100.0, 300, 1))
    running.run(100)
    assert board.solenoid == 0
    steps, fed = board.steps, board.fed
    running.hang(400)
    assert board.steps - steps >= 399
    assert 50 <= board.fed - fed <= 101
    assert running.outputs == (0, 0, 1)


def test_late_steps_do_not_feed_the_watchdog(running: Running) -> None:
    """Missed steps are not repeated, and eight steps on time must follow."""
    board = running.board
    running.run(50)
    board.timer_stopped = 1
    running.run(20)
    steps, fed = board.steps, board.fed
    board.timer_stopped = 0
    running.run(1)
    assert board.steps <= steps + 2
    running.run(7)
    assert board.fed == fed
    running.run(6)
    assert board.fed > fed


@pytest.mark.parametrize("read_us", [1100, 1400, 3000])
def test_an_overloaded_board_starves_the_watchdog(running: Running, read_us: int) -> None:
    board = running.board
    running.run(50)
    board.read_us = read_us
    running.run(200)
    fed = board.fed
    running.run(300)
    assert board.fed == fed


def test_the_clock_may_wrap(running: Running) -> None:
    board = running.board
    running.bring_near_wrap(ms=50)
    running.run(20)
    steps = board.steps
    running.run_turns(1500)
    assert board.now_us < 2**31
    assert 100 <= board.steps - steps <= 150
    assert board.fed > 100


def test_the_light_flashes_on_when_the_clock_wraps(running: Running) -> None:
    """One flash more would mean another fault."""
    board = running.board
    running.bring_near_wrap(ms=5000)
    board.read_us = 0
    lit: list[int] = []
    for _ in range(5 * 2048):
        running.hang(1)
        lit.append(board.light)
    assert board.now_us < 2**31
    begins = [ms for ms, (before, now) in enumerate(itertools.pairwise(lit)) if now and not before]
    assert len(begins) >= 4
    assert {later - earlier for earlier, later in itertools.pairwise(begins)} == {2048}


def test_the_valves_are_safe_while_the_bootloader_is_awaited(running: Running) -> None:
    board = running.board
    running.greet()
    running.say(Setpoint(10.0, 100.0, 250, 1))
    running.run(30)
    assert board.solenoid == 0
    fed = board.fed
    board.bootloader_requested = 1
    running.run_turns(1)
    assert board.waiting_for_bootloader == 1
    assert board.fed == fed
    assert running.outputs == (0, 0, 1)


def test_output_that_no_host_reads_is_lost_in_whole_frames(running: Running) -> None:
    """A port that takes 7 bytes now and then gets no partial and no mixed frame."""
    running.room = 7
    received = running.run(3000)
    for stall_ms in (1000, 333, 777):
        running.room = 0
        running.run(50)
        running.say(Ping(0))  # a frame of another length
        running.run(stall_ms)
        running.room = 64
        received += running.run(100)
    assert len(received) > 300
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


MISTAKES = {
    "copies that nobody checks": Mistake(
        "settings_memory.cpp",
        "if (tail.u16() != crc16(bytes, kCrcAt))",
        "if (false)",
    ),
    "always the first copy": Mistake("settings_memory.cpp", "newest.copy == 0 && board", "false && board"),
    "the older copy is loaded": Mistake(
        "settings_memory.cpp",
        "(number - newest.number)) > 0",
        "(number - newest.number)) < 0",
    ),
    "copies side by side": Mistake(
        "settings_memory.cpp",
        "(i / layout.share) * layout.row + copy * size_t{layout.share} + i % layout.share",
        "copy * 100u + i + 0u * layout.row",
    ),
    "the newest is written over": Mistake(
        "settings_memory.cpp", "newest.copy == 0 &&", "newest.copy == 1 &&"
    ),
    "storing while regulating": Mistake("run.cpp", "firmware().mode() != Mode::kRegulate && ", ""),
    "storing on a failing supply": Mistake("run.cpp", "(firmware().faults() & kSupply) == 0", "true"),
    "setpoints while storing": Mistake("run.cpp", "if (!storing) firmware().receive", "firmware().receive"),
    "a step that is not on time feeds": Mistake("step_monitor.h", "on_time_ == kInARow && ", ""),
    "one step on time is enough": Mistake("step_monitor.h", "kInARow = 8", "kInARow = 1"),
    "lateness that is forgiven each time": Mistake(
        "step_monitor.h", "due_us_ += kPeriod_us;", "due_us_ = now_us;"
    ),
    "a ring without an end": Mistake("byte_ring.h", "kSize - 1 - used(begin_, end_)", "kSize"),
}
"""Mistakes in the step, in storing and in the rings, which all boards share."""


@pytest.mark.long
@pytest.mark.parametrize("what", MISTAKES)
def test_a_mistake_is_found(what: str, tmp_path: Path) -> None:
    made = build(tmp_path, 2, with_mistake(SOURCE, MISTAKES[what], tmp_path / "src"))
    tests = (
        test_a_step_each_millisecond_and_telemetry_in_between,
        test_a_setting_is_stored_once_and_not_while_regulating,
        test_a_setpoint_waits_until_the_settings_are_stored,
        test_nothing_is_stored_on_a_failing_supply,
        test_late_steps_do_not_feed_the_watchdog,
        lambda running: test_an_overloaded_board_starves_the_watchdog(running, 1100),
        test_output_that_no_host_reads_is_lost_in_whole_frames,
        lambda _: test_settings_are_kept_over_many_power_cycles(made, tmp_path),
        lambda _: test_a_power_cut_while_storing_keeps_the_older_settings(made, tmp_path, 84),
        lambda _: test_no_two_copies_have_bytes_in_one_sector(made, tmp_path),
    )
    assert_found(tests, lambda: started(made, tmp_path))
