"""The whole sketch on a simulated Teensy: the guarantees of the board layer on each board."""

from __future__ import annotations

import ctypes
import itertools
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest
from required_programs import host_compiler

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
    Welcome,
)

from .native import (
    AT_REST,
    FIRMWARE,
    HALF_FULL,
    STRICT,
    SUPPLY_COUNTS,
    Mistake,
    assert_found,
    fields,
    with_mistake,
)
from .once import made_once

SKETCH = FIRMWARE / "phlosar"
STUB = Path(__file__).with_name("arduino_stub")
EVP, DVP, SOLENOID, LIGHT = 9, 6, 11, 13
CV, RESERVOIR, SUPPLY = 19, 18, 15


class Model(NamedTuple):
    name: str
    define: str
    watchdog_us: int
    erase_us: int
    """Maximum time to write the memory."""


BOARDS = (
    Model("teensy40", "-DARDUINO_TEENSY40", 500_000, 400_000),
    Model("teensy41", "-DARDUINO_TEENSY41", 500_000, 400_000),
    Model("teensylc", "-D__MKL26Z64__", 256_000, 228_000),
)


class Pin(ctypes.Structure):
    _fields_ = fields(
        """
        u8 level output pwm
        u16 pwm_value
        float pwm_Hz
        """
    )


class State(ctypes.Structure):
    _fields_ = fields(
        """
        u32 now_us
        Pin pins[40]
        u16 analog[40] noise
        u32 conversion_us
        u8 was_reset
        u32 watchdog_us fed_us feeds
        u8 watchdog_on memory[1080]
        u32 memory_writes memory_us timer_us
        u8 priority step_hangs
        u32 systicks idles
        u8 off_while_idle dtr usb_stalled
        u32 baud waited_for_host_us incoming_size outgoing_size in_flight unsent
        u8 incoming[4096] outgoing[65536]
        char order[64]
        """,
        Pin=Pin,
    )


class Teensy:
    """A board, from its reset on."""

    def __init__(self, model: Model, built: ctypes.CDLL) -> None:
        for name in ("sim_early_hook", "sim_setup", "sim_run", "sim_hang", "sim_crash"):
            getattr(built, name).restype = ctypes.c_bool
        self.model = model
        self._built = built
        self.state = State.in_dll(built, "sim")
        self.state.memory[:] = b"\xff" * 1080
        self.state.conversion_us = 5
        self.state.memory_us = 1000
        self.state.noise = 15
        self.state.dtr = 1
        self.state.baud = 9600
        self.state.analog[CV], self.state.analog[RESERVOIR] = AT_REST, HALF_FULL
        self.state.analog[SUPPLY] = SUPPLY_COUNTS
        for pin in (EVP, DVP, SOLENOID):
            self.state.pins[pin].level = 1 if pin != SOLENOID else 0  # the worst levels after a reset
            self.state.pins[pin].pwm = 1
        self.codec = Codec()

    def early_hook(self) -> bool:
        return bool(self._built.sim_early_hook())

    def start(self, *, by_watchdog: bool = False) -> None:
        assert not self.early_hook()
        if by_watchdog:
            self._built.sim_reset_cause_watchdog()
        assert not self._built.sim_setup()

    def run_until_reset(self, ms: int) -> bool:
        """True if the chip was reset."""
        return bool(self._built.sim_run(1000 * ms))

    def run(self, ms: int) -> list[Message]:
        assert not self.run_until_reset(ms)
        data = bytes(self.state.outgoing[: self.state.outgoing_size])
        self.state.outgoing_size = 0
        return self.codec.decode(data)

    def hang(self, ms: int, *, with_interrupts: bool) -> bool:
        """True if the chip was reset."""
        return bool(self._built.sim_hang(1000 * ms, with_interrupts))

    def crash(self) -> bool:
        return bool(self._built.sim_crash())

    def say(self, *messages: HostMessage) -> None:
        frames = b"".join(map(self.codec.encode, messages))
        self.state.incoming[: len(frames)] = list(frames)
        self.state.incoming_size = len(frames)

    def greet(self) -> Welcome:
        self.run(3)
        self.say(Hello(PROTOCOL_VERSION, 7))
        return next(message for message in self.run(10) if isinstance(message, Welcome))

    def regulate(self) -> None:
        self.greet()
        self.say(Setpoint(10.0, 100.0, 300, 1))
        self.run(60)
        assert self.state.pins[EVP].pwm and not self.state.pins[SOLENOID].level

    def is_off(self, pin: int) -> bool:
        """True if the pin is low by the port, independent of the timers."""
        one = self.state.pins[pin]
        return bool(one.output and not one.pwm and not one.level)

    @property
    def vented(self) -> bool:
        solenoid = self.state.pins[SOLENOID]
        return self.is_off(EVP) and self.is_off(DVP) and bool(solenoid.output and solenoid.level)

    def telemetry(self) -> Telemetry:
        return [message for message in self.run(25) if isinstance(message, Telemetry)][-1]


def made_in(folder: Path, model: Model) -> Path:
    return folder / f"{model.name}.so"


def compiled(model: Model, folder: Path, sketch: Path = SKETCH) -> Path:
    made = made_in(folder, model)
    sources = [*sorted((sketch / "src").rglob("*.cpp")), Path(__file__).with_name("simulated_teensy.cpp")]
    units = [*map(str, sources), "-x", "c++", str(sketch / "phlosar.ino")]
    flags = ["-std=gnu++17", "-O1", *STRICT, "-Wno-unused-function", "-DARDUINO=10819", model.define]
    command = [host_compiler(), *flags, "-I", str(STUB), "-include", str(STUB / "Arduino.h"), "-fPIC"]
    done = subprocess.run([*command, "-shared", *units, "-o", str(made)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return made


@pytest.fixture(scope="module", params=BOARDS, ids=lambda model: model.name)
def built(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Model, Path]:
    model: Model = request.param
    folder = made_once(tmp_path_factory, model.name, lambda folder: compiled(model, folder))
    return model, made_in(folder, model)


_COPIES = itertools.count()


def fresh(model: Model, made: Path, folder: Path) -> Teensy:
    return Teensy(model, ctypes.CDLL(str(shutil.copy(made, folder / f"copy{next(_COPIES)}.so"))))


@pytest.fixture
def teensy(built: tuple[Model, Path], tmp_path: Path) -> Teensy:
    return fresh(*built, tmp_path)


def test_the_valves_are_off_before_anything_else(teensy: Teensy) -> None:
    assert not teensy.early_hook()
    assert teensy.vented
    order = teensy.state.order.decode()
    # No pin becomes an output before its level is right.
    assert order == "ccs" + "ooo" + "mmm"
    assert teensy.state.watchdog_on


def test_the_watchdog_runs_from_the_reset_on(teensy: Teensy) -> None:
    """It also runs while Teensyduino starts."""
    assert not teensy.early_hook()
    assert teensy.hang(2500, with_interrupts=False)


def test_it_regulates_by_pwm_of_20_kHz_and_vents_by_plain_outputs(teensy: Teensy) -> None:
    teensy.start()
    assert teensy.vented
    teensy.regulate()
    evp = teensy.state.pins[EVP]
    assert 0.1 * 65536 < evp.pwm_value <= 0.481 * 65536
    assert evp.pwm_Hz == teensy.state.pins[DVP].pwm_Hz == 20_000.0
    assert teensy.is_off(DVP)
    teensy.run(400)  # the dead-man
    assert teensy.vented
    assert teensy.telemetry().faults == Fault.DEAD_MAN


def test_the_largest_duty_cycle_is_not_taken_for_none(teensy: Teensy) -> None:
    teensy.start()
    teensy.greet()
    teensy.say(SetSetting(11, 1.0))
    teensy.run(300)
    teensy.greet()
    for number in range(5):
        teensy.say(Setpoint(20.0, 500.0, 300, 1 + number))
        teensy.run(100)
    evp = teensy.state.pins[EVP]
    assert evp.pwm_value >= 65534 if evp.pwm else evp.level


@pytest.mark.parametrize("counts", [5958, 12345, 29789, 53600])
def test_the_converter_has_sixteen_bits(teensy: Teensy, counts: int) -> None:
    """A Teensy 4 adds 16 conversions of 12 bits."""
    teensy.start()
    teensy.greet()
    teensy.state.analog[RESERVOIR] = counts
    reading_kPa = teensy.telemetry().reservoir_kPa
    right = (counts / SUPPLY_COUNTS - 0.1) / 0.8 * 1500.0
    assert reading_kPa == pytest.approx(right, abs=1500 / 0.8 * 20 / SUPPLY_COUNTS)


@pytest.mark.parametrize(
    "pin, counts, fault",
    [
        (CV, 0, Fault.CV_SENSOR),  # open, or shorted to ground
        (CV, SUPPLY_COUNTS, Fault.CV_SENSOR),  # shorted to 5 V, or the sensor's ground open
        (CV, 65535, Fault.CV_SENSOR),  # the divider's lower resistor open
        (RESERVOIR, 0, Fault.RESERVOIR_SENSOR),
        (RESERVOIR, 65535, Fault.RESERVOIR_SENSOR),
        (SUPPLY, 0, Fault.SUPPLY),
        (SUPPLY, 65535, Fault.SUPPLY),
        (SUPPLY, round(4.4 / 5 * SUPPLY_COUNTS), Fault.SUPPLY),
    ],
)
def test_a_broken_wire_vents_within_five_steps(teensy: Teensy, pin: int, counts: int, fault: Fault) -> None:
    teensy.start()
    teensy.regulate()
    teensy.state.noise = 0
    teensy.state.analog[pin] = counts
    teensy.run(5)
    assert teensy.vented
    assert fault in teensy.telemetry().faults


def test_steps_come_from_a_timer_below_the_clocks_interrupt(teensy: Teensy) -> None:
    teensy.start()
    assert teensy.state.timer_us == 1000
    assert 32 < teensy.state.priority < 112


def test_a_main_loop_that_hangs_is_vented_and_then_reset(teensy: Teensy) -> None:
    teensy.start()
    teensy.regulate()
    assert not teensy.hang(250, with_interrupts=True)  # in addition to the time of the steps
    assert teensy.vented
    assert teensy.hang(400, with_interrupts=True)


def test_a_step_that_hangs_is_vented_or_reset_within_0p26_s(teensy: Teensy) -> None:
    """Interrupts are on: a Teensy 4 vents then, and its watchdog resets it later."""
    teensy.start()
    teensy.regulate()
    begin_us, ticks = teensy.state.now_us, teensy.state.systicks
    teensy.state.step_hangs = 1
    if teensy.model.name == "teensylc":
        assert teensy.run_until_reset(300)
        assert teensy.state.now_us - begin_us < 260_000
        return
    assert not teensy.run_until_reset(240)
    assert not teensy.vented
    assert teensy.state.systicks - ticks >= 239
    # After venting, it waits for the watchdog.
    assert teensy.run_until_reset(2000)
    assert teensy.vented
    assert teensy.state.now_us - begin_us < 510_000


def test_a_processor_that_hangs_is_reset_in_the_watchdogs_time(teensy: Teensy) -> None:
    teensy.start()
    teensy.regulate()
    begin_us = teensy.state.now_us
    assert teensy.hang(2000, with_interrupts=False)
    assert teensy.state.now_us - begin_us <= teensy.model.watchdog_us + 50


def test_the_watchdog_is_fed_for_as_long_as_all_is_well(teensy: Teensy) -> None:
    teensy.start()
    teensy.run(3000)
    assert teensy.state.watchdog_us == teensy.model.watchdog_us
    assert teensy.state.feeds > 2900


def test_a_crash_vents_at_once_and_resets(teensy: Teensy) -> None:
    teensy.start()
    teensy.regulate()
    assert teensy.crash()
    assert teensy.vented


def test_the_next_start_reports_that_the_watchdog_ended_the_last(teensy: Teensy) -> None:
    teensy.start(by_watchdog=True)
    assert teensy.telemetry().faults == Fault.WATCHDOG_RESET


def test_a_usual_start_has_no_fault(teensy: Teensy) -> None:
    teensy.start()
    telemetry = teensy.telemetry()
    assert (telemetry.mode, telemetry.faults) == (Mode.VENT, Fault.NONE)
    assert teensy.greet().firmware_build == f"1.1 {teensy.model.name}"


def test_boots_have_different_numbers(built: tuple[Model, Path], tmp_path: Path) -> None:
    ids = set()
    for extra in range(4):
        teensy = fresh(*built, tmp_path)
        teensy.state.analog[38] = extra  # a Teensy LC's temperature
        teensy.state.analog[SUPPLY] = SUPPLY_COUNTS + 16 * extra
        teensy.start()
        ids.add(teensy.greet().boot_id)
    assert len(ids) == 4


def test_a_host_that_does_not_read_costs_no_time_and_no_part_of_a_frame(teensy: Teensy) -> None:
    teensy.start()
    teensy.greet()
    teensy.state.usb_stalled = 1
    before = teensy.run(4000)
    assert teensy.state.waited_for_host_us == 0
    teensy.state.usb_stalled = teensy.state.in_flight = 0
    after = teensy.run(100)
    assert before and after
    assert teensy.codec.bad_frames == 0
    assert not teensy.telemetry().faults


def test_without_a_program_at_the_other_end_nothing_is_kept_for_the_next(teensy: Teensy) -> None:
    teensy.start()
    teensy.state.dtr = 0
    teensy.state.usb_stalled = 1
    assert not teensy.run_until_reset(2000)
    teensy.state.dtr = 1
    teensy.state.usb_stalled = teensy.state.in_flight = 0
    times = [message.device_time_ms for message in teensy.run(30) if isinstance(message, Telemetry)]
    assert min(times) > 1900


def test_settings_survive_the_power_and_the_slowest_memory(
    built: tuple[Model, Path], teensy: Teensy, tmp_path: Path
) -> None:
    teensy.start()
    teensy.greet()
    teensy.state.memory_us = 50_000
    teensy.say(SetSetting(0, 25.0))
    teensy.run(5000)
    teensy.state.memory_us = teensy.model.erase_us
    teensy.say(SetSetting(0, 24.0))
    teensy.run(8000)
    again = fresh(*built, tmp_path)
    again.state.memory[:] = teensy.state.memory[:]
    again.start()
    assert again.greet().cv_limit_kPa == 24.0
    assert not again.telemetry().faults
    assert teensy.state.watchdog_us == teensy.model.watchdog_us


def test_a_request_to_flash_vents_first_and_leaves_the_bootloader_its_time(teensy: Teensy) -> None:
    teensy.start()
    teensy.regulate()
    teensy.state.baud = 134
    assert teensy.run_until_reset(5000)  # no bootloader came
    # Teensyduino starts it after 10 ms (Teensy 4) or 15 ms.
    assert teensy.state.off_while_idle
    assert teensy.vented


MUTANTS = {
    "EVP high at reset": Mistake("board/chip.h", "CORE_PIN9_PORTCLEAR = CORE", "CORE_PIN9_PORTSET = CORE"),
    "outputs before their levels": Mistake(
        "board/chip.h",
        "        CORE_PIN9_PORTCLEAR = CORE_PIN9_BITMASK;     \\\n",
        "        CORE_PIN9_DDRREG |= CORE_PIN9_BITMASK;       \\\n"
        "        CORE_PIN9_PORTCLEAR = CORE_PIN9_BITMASK;     \\\n",
    ),
    "no watchdog at reset": Mistake("board/teensy4.cpp", "    WDOG1_WCR = PHLOSAR_WATCHDOG(kSlow);\n", ""),
    "a watchdog of 2 s": Mistake("board/teensy4.cpp", "kRunning = 0", "kRunning = 3"),
    "the watchdog not shortened again": Mistake(
        "board/teensy4.cpp",
        "end_slow_work() { set_watchdog(kRunning); }",
        "end_slow_work() {}",
    ),
    "nothing fed while storing": Mistake(
        "board/teensy4.cpp",
        "{ set_watchdog(kSlow); }\nvoid end_slow_work() { set_watchdog(kRunning); }",
        "{}\nvoid end_slow_work() {}",
    ),
    "a crash that keeps the valves": Mistake(
        "board/teensy4.cpp",
        "    __disable_irq();\n    PHLOSAR_VENT(kGpio);\n    board",
        "    __disable_irq();\n    board",
    ),
    "crashes that are Teensyduino's": Mistake(
        "board/teensy4.cpp", "_VectorsRam[fault] = crash;", "(void)crash;"
    ),
    "a full duty cycle that wraps": Mistake(
        "board/teensy4.cpp",
        "{ return duty; }",
        "{ return duty + (duty >> 15); }",
    ),
    "one conversion of 12 bits": Mistake("board/teensy4.cpp", "kConversions = 16", "kConversions = 1"),
    "off by PWM": Mistake("board/teensyduino.cpp", "if (duty > 0) {", "if (true) {"),
    "the usual PWM frequency": Mistake(
        "board/teensyduino.cpp", "    analogWriteFrequency(kEvpPin, kPwm_Hz);\n", ""
    ),
    "writing without room": Mistake(
        "board/teensyduino.cpp",
        "int room = Serial.availableForWrite();",
        "int room = 64;",
    ),
    "frames kept for nobody": Mistake("board/teensyduino.cpp", "    if (!Serial.dtr()) return size;\n", ""),
    "reading more than is there": Mistake(
        "board/teensyduino.cpp", "static_cast<size_t>(available) < size", "false"
    ),
    "steps not from a timer": Mistake(
        "board/teensyduino.cpp",
        "    timer->begin(step, kStep_us);\n",
        "    (void)step;\n",
    ),
    "valves kept while flashing": Mistake(
        "run.cpp",
        "        board::drive(outputs(firmware().settings(), kSafe));\n",
        "",
    ),
    "a watchdog that each step feeds": Mistake("run.cpp", "if (monitor.healthy()) board", "board"),
    "a loop that nobody watches": Mistake(
        "run.cpp",
        "monitor.step(now_us, turned)",
        "monitor.step(now_us, true || turned)",
    ),
    "the watchdog's reset not reported": Mistake("run.cpp", "board::reset_by_watchdog()", "false"),
    "settings not stored": Mistake("run.cpp", "        settings_memory::store(image);\n", ""),
    "no guard behind the watchdog": Mistake(
        "board/teensy4.cpp",
        "    _VectorsRam[kSysTick] = guard;\n",
        "    (void)guard;\n",
    ),
    "a guard that nobody feeds": Mistake("board/teensy4.cpp", "    unfed_ms = 0;\n", ""),
    "a guard that stops the clock": Mistake("board/teensy4.cpp", "    systick_isr();\n    if", "    if"),
    "LC: the usual hook, which ends the watchdog": Mistake(
        "board/teensy_lc.cpp",
        "    PHLOSAR_VENT(PORT_PCR_MUX(1));\n}\n\nextern",
        "    PHLOSAR_VENT(PORT_PCR_MUX(1));\n    SIM_COPC = 0;\n}\n\nextern",
    ),
    "LC: the watchdog left at a second": Mistake("board/teensy_lc.cpp", "    SIM_COPC = kCop_256_ms;\n", ""),
    "LC: a crash that keeps the valves": Mistake(
        "board/teensy_lc.cpp",
        "    PHLOSAR_VENT(PORT_PCR_MUX(1));\n    SIM_SRVCOP",
        "    SIM_SRVCOP",
    ),
    "LC: nothing fed while storing": Mistake(
        "board/teensy_lc.cpp",
        "void begin_slow_work() { feed_watchdog(); }\nvoid end_slow_work() { feed_watchdog(); }",
        "void begin_slow_work() {}\nvoid end_slow_work() {}",
    ),
    "LC: a lockup that is not reported": Mistake(
        "board/teensy_lc.cpp", "(RCM_SRS0 & RCM_SRS0_WDOG) != 0 || ", ""
    ),
}
"""Mistakes in the board layer that a lab would not notice. LC: on a Teensy LC."""


@pytest.mark.long
@pytest.mark.parametrize("what", MUTANTS)
def test_a_mistake_in_the_layer_is_found(what: str, tmp_path: Path) -> None:
    """At least one of the tests above fails, on a Teensy 4.0 or LC."""
    sketch = with_mistake(SKETCH, MUTANTS[what], tmp_path / "phlosar")
    model = BOARDS[2 if what.startswith("LC") else 0]
    made = compiled(model, tmp_path, sketch)
    tests = (
        test_the_valves_are_off_before_anything_else,
        test_the_watchdog_runs_from_the_reset_on,
        test_it_regulates_by_pwm_of_20_kHz_and_vents_by_plain_outputs,
        test_the_largest_duty_cycle_is_not_taken_for_none,
        lambda teensy: test_the_converter_has_sixteen_bits(teensy, 5958),
        test_a_main_loop_that_hangs_is_vented_and_then_reset,
        test_a_step_that_hangs_is_vented_or_reset_within_0p26_s,
        test_a_processor_that_hangs_is_reset_in_the_watchdogs_time,
        test_a_crash_vents_at_once_and_resets,
        test_the_next_start_reports_that_the_watchdog_ended_the_last,
        test_a_host_that_does_not_read_costs_no_time_and_no_part_of_a_frame,
        test_without_a_program_at_the_other_end_nothing_is_kept_for_the_next,
        lambda teensy: test_settings_survive_the_power_and_the_slowest_memory(
            (model, made), teensy, tmp_path
        ),
        test_a_request_to_flash_vents_first_and_leaves_the_bootloader_its_time,
    )
    assert_found(tests, lambda: fresh(model, made, tmp_path))
