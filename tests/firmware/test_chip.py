"""The complete image on a model of its chip: from the reset vector to a vine that is regulated over USB."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
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
    Pong,
    Setpoint,
    SetSetting,
    Setting,
    Telemetry,
    Welcome,
)

from . import chip as chips
from .chip import BY_WATCHDOG, Chip
from .native import STACK_TOOL
from .usb_host import Stalled, UsbHost

VENTING = (0, 0, True)


@pytest.fixture
def binary(image: Path) -> bytes:
    return image.with_suffix(".bin").read_bytes()


class Port:
    """An enumerated chip, and messages to and from it."""

    def __init__(self, chip: Chip) -> None:
        self.chip = chip
        self.codec = Codec()
        chip.run(40)
        self.usb = UsbHost(chip)
        self.serial_number = self.usb.enumerate()

    def run(self, ms: float) -> list[Message]:
        heard: list[Message] = []
        end_us = self.chip.now_us + 1000 * ms
        while self.chip.now_us < end_us and self.chip.stopped is None:
            self.chip.run(0.5)
            heard += self.codec.decode(self.usb.receive())
        return heard

    def ask(self, message: HostMessage, ms: float = 30) -> list[Message]:
        self.usb.send(self.codec.encode(message))
        return self.run(ms)

    def greet(self) -> Welcome:
        heard = self.ask(Hello(PROTOCOL_VERSION, 7))
        return next(message for message in heard if isinstance(message, Welcome))


def telemetry(heard: list[Message]) -> Telemetry:
    return [message for message in heard if isinstance(message, Telemetry)][-1]


def test_before_all_else_the_watchdog_is_set_and_the_valves_are_vented(binary: bytes) -> None:
    chip = Chip(binary)
    chip.run(1)
    first = chip.written[: chip.written.index(chips.MCG_C1)]
    assert first[0] == chips.SIM_COPC
    assert {chips.GPIOC_PCOR, chips.GPIOC_PSOR, chips.GPIOC_PDDR, chips.PORTC_PCR3, chips.PORTC_PCR4} <= set(
        first
    )
    # A pin gets its level before it is an output.
    assert first.index(chips.GPIOC_PSOR) < first.index(chips.GPIOC_PDDR)
    assert chip.registers[chips.SIM_COPC] == 0b1000
    assert chip.valves == VENTING


def test_a_host_sees_it_come_only_after_it_was_away(binary: bytes) -> None:
    chip = Chip(binary)
    while not chip.registers.get(chips.USB0_CONTROL):
        chip.run(0.5)
    assert 20_000 <= chip.now_us < 30_000
    chip.run(20)
    assert chip.fed > 5


def test_it_regulates_over_usb_and_its_dead_man_vents(binary: bytes) -> None:
    port = Port(Chip(binary))
    assert port.serial_number == "1234560"
    now = telemetry(port.run(30))
    assert (now.mode, now.faults) == (Mode.VENT, Fault.NONE)
    assert now.cv_kPa == pytest.approx(0.0, abs=0.01)
    assert now.reservoir_kPa == pytest.approx((30000 / 59578 - 0.1) / 0.8 * 1500.0, rel=1e-4)
    welcome = port.greet()
    assert welcome.firmware_build == "1.0 kl26"
    now = telemetry(port.ask(Setpoint(10.0, 100.0, 250, 3), ms=60))
    assert (now.mode, now.number) == (Mode.REGULATE, 3)
    evp, dvp, solenoid = port.chip.valves
    # The telemetry may be some steps old, and the valve is on its way up.
    assert 0.48 * 2400 * now.evp_opening - 1 <= evp <= 0.48 * 2400 + 1
    assert evp > 0 and dvp == 0 and not solenoid
    port.run(240)
    assert port.chip.valves == VENTING
    assert telemetry(port.run(30)).faults == Fault.DEAD_MAN
    now = telemetry(port.ask(ClearFaults(0xFFFF)))
    assert (now.mode, now.faults) == (Mode.VENT, Fault.NONE)
    assert port.codec.bad_frames == 0


def test_telemetry_at_every_step_for_a_diagnosis(binary: bytes) -> None:
    port = Port(Chip(binary))
    port.greet()
    port.ask(SetSetting(5, 1000.0), ms=60)
    times = [message.device_time_ms for message in port.run(200) if isinstance(message, Telemetry)]
    assert times == list(range(times[0], times[0] + len(times)))
    assert len(times) == pytest.approx(200, abs=3)


def test_a_wire_that_breaks_vents_within_three_steps(binary: bytes) -> None:
    port = Port(Chip(binary))
    port.greet()
    port.ask(Setpoint(10.0, 100.0, 250, 1))
    assert not port.chip.valves[2]
    port.chip.readings[12] = 0
    began_us = port.chip.now_us
    while port.chip.valves != VENTING:
        port.chip.run(0.1)
    assert port.chip.now_us - began_us <= 4000
    assert telemetry(port.run(30)).faults == Fault.CV_SENSOR


def test_settings_outlive_power_and_its_loss_at_any_moment_of_storing(binary: bytes) -> None:
    port = Port(Chip(binary))
    port.greet()
    for value in (25.0, 24.0, 23.0):
        assert Setting in map(type, port.ask(SetSetting(0, value), ms=60))
    erased = [address for command, address in port.chip.flash_commands if command == chips.ERASE_SECTOR]
    assert erased == [chips.SETTINGS_BEGIN, chips.SETTINGS_BEGIN + 1024, chips.SETTINGS_BEGIN]
    before, commands = port.chip.flash, len(port.chip.flash_commands)
    port.ask(SetSetting(0, 22.0), ms=60)
    a_store = len(port.chip.flash_commands) - commands
    assert a_store > 20
    for cut in (1, 2, a_store // 2, a_store - 1, a_store):
        dying = Port(Chip(binary, flash=before))
        dying.greet()
        dying.chip.dies_after = len(dying.chip.flash_commands) + cut
        dying.ask(SetSetting(0, 22.0), ms=60)
        assert dying.chip.stopped == "without power"
        again = Port(Chip(binary, flash=dying.chip.flash))
        assert again.greet().cv_limit_kPa == 23.0
        assert telemetry(again.run(30)).faults == Fault.NONE
    assert Port(Chip(binary, flash=port.chip.flash)).greet().cv_limit_kPa == 22.0


def test_each_start_has_its_own_number_and_the_watchdogs_is_told(binary: bytes) -> None:
    first = Port(Chip(binary, seed=1))
    second = Port(Chip(binary, reset=BY_WATCHDOG, seed=2))
    assert first.greet().boot_id != second.greet().boot_id
    assert telemetry(second.run(30)).faults == Fault.WATCHDOG_RESET


def test_a_crash_vents_and_resets_at_once(binary: bytes) -> None:
    port = Port(Chip(binary))
    port.greet()
    port.ask(Setpoint(10.0, 100.0, 250, 1))
    assert port.chip.valves[0] > 0
    port.chip.raise_exception(3)
    port.chip.run(1)
    assert port.chip.stopped == "reset by the watchdog"
    assert port.chip.valves == VENTING


def test_134_baud_vents_and_enters_the_bootloader(binary: bytes) -> None:
    port = Port(Chip(binary))
    port.greet()
    port.ask(Setpoint(10.0, 100.0, 250, 1))
    port.usb.write(0x21, 0x20, data=struct.pack("<IBBB", 134, 0, 0, 8))
    port.chip.run(2)
    assert port.chip.valves == VENTING
    assert port.chip.stopped is None, "the host's request is answered first"
    port.chip.run(30)
    assert port.chip.stopped == "exception 7"  # a breakpoint


def test_a_host_that_does_not_read_loses_whole_frames_and_is_heard_again(binary: bytes) -> None:
    port = Port(Chip(binary))
    port.greet()
    for number in range(300):
        port.usb.send(port.codec.encode(Ping(number)))
    fed = port.chip.fed
    port.chip.run(20)
    assert port.chip.fed > fed
    heard = port.run(100)
    assert port.codec.bad_frames == 0
    assert 10 < sum(isinstance(message, Pong) for message in heard) < 300
    assert telemetry(heard).mode == Mode.VENT
    # A halted endpoint says so, and goes on afterwards.
    port.usb.write(0x02, 3, 0, 0x83)
    with pytest.raises(Stalled):
        port.run(1)
    port.usb.restart_in()
    assert telemetry(port.run(50)).mode == Mode.VENT


def test_the_stack_stays_within_its_bound(binary: bytes, image: Path) -> None:
    """All messages, settings stored, a fault: what was used is less than stack.py says, and not by much."""
    port = Port(Chip(binary))
    port.greet()
    for message in (SetSetting(0, 25.0), SetSetting(99, 1.0), Setpoint(10.0, 100.0, 250, 1), Ping(1)):
        port.ask(message, ms=40)
    port.chip.readings[14] = 0
    port.run(30)
    port.ask(ClearFaults(0xFFFF))
    told = subprocess.run(
        [sys.executable, STACK_TOOL, "--json", image], capture_output=True, text=True, check=True
    )
    bound = json.loads(told.stdout)["stack"]
    assert bound / 2 < port.chip.stack_used <= bound
