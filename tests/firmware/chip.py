"""The chip of a Teensy LC, as far as the firmware's image touches it: Unicorn's processor, our registers.

The registers are a model of what NXP's manual says; a mistake in reading it may be on both sides. What runs
is the image to its last byte: vectors, startup, interrupts, commands to the flash.

Time goes by with what the firmware waits for, not with its instructions: 20 µs with each look at the clock,
17 µs with each conversion, 14 ms and 65 µs with each sector erased and each word programmed.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from typing import Any

import pytest

FLASH_SIZE = 0x10000
SETTINGS_BEGIN = 62 * 1024
RAM_BEGIN, RAM_SIZE = 0x1FFFF800, 0x2000
STACK_SIZE = 2048
EVP, DVP, SOLENOID = 1 << 3, 1 << 4, 1 << 6
POWER_UP, BY_WATCHDOG = 0x80, 0x20

PORTC_PCR3, PORTC_PCR4 = 0x4004B00C, 0x4004B010
GPIOC_PSOR, GPIOC_PCOR, GPIOC_PDDR = 0x400FF084, 0x400FF088, 0x400FF094
TPM0_C2V, TPM0_C3V = 0x40038020, 0x40038028
SIM_COPC, SIM_SRVCOP = 0x40048100, 0x40048104
MCG_C1, MCG_C6, MCG_S = 0x40064000, 0x40064005, 0x40064006
RCM_SRS0 = 0x4007F000
PIT_CVAL1 = 0x40037114
ADC0_SC1A, ADC0_RA, ADC0_SC3 = 0x4003B000, 0x4003B010, 0x4003B024
FTFA_FSTAT, FTFA_COMMAND, FTFA_DATA = 0x40020000, 0x40020004, 0x40020008
USB0_ISTAT, USB0_INTEN, USB0_STAT, USB0_CTL = 0x40072080, 0x40072084, 0x40072090, 0x40072094
USB0_ADDR, USB0_ENDPT0, USB0_CONTROL = 0x40072098, 0x400720C0, 0x40072108
USB0_BDTPAGE = (0x4007209C, 0x400720B0, 0x400720B4)
NVIC_ISER = 0xE000E100
STALL, TOKDNE, USBRST = 0x80, 0x08, 0x01
ERASE_SECTOR, PROGRAM_WORD, READ_ONCE = 0x09, 0x06, 0x41

_PERIPHERALS = ((0x40000000, 0x80000), (0x400FF000, 0x1000), (0xE000E000, 0x1000), (0xF0003000, 0x1000))
_UNTOUCHED = b"\xa5"
_RETURNED = 0xFFF0
_USB_VECTOR = 16 + 24
_TEMPERATURE = 26
_TEENSYS_NUMBER = 123456
_SLICE = 1000


class Chip:
    """From power-up on. `flash` is what an earlier one left behind."""

    def __init__(
        self, image: bytes, *, flash: bytes | None = None, reset: int = POWER_UP, seed: int = 1
    ) -> None:
        self._unicorn: Any = pytest.importorskip(
            "unicorn", reason="needs unicorn: pip install 'unicorn>=2.1'"
        )
        arm = self._arm = self._unicorn.arm_const
        self._random = random.Random(seed)
        self.uc = self._unicorn.Uc(
            self._unicorn.UC_ARCH_ARM, self._unicorn.UC_MODE_THUMB | self._unicorn.UC_MODE_MCLASS
        )
        self.uc.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M0)
        self.uc.mem_map(0, FLASH_SIZE)
        self.uc.mem_write(0, flash or image.ljust(FLASH_SIZE, b"\xff"))
        self.uc.mem_map(RAM_BEGIN & ~0xFFF, 0x3000)
        self.uc.mem_write(RAM_BEGIN, _UNTOUCHED * STACK_SIZE)
        self.uc.mem_write(RAM_BEGIN + STACK_SIZE, self._random.randbytes(RAM_SIZE - STACK_SIZE))
        for base, size in _PERIPHERALS:
            self.uc.mmio_map(base, size, self._read, base, self._write, base)
        self.uc.hook_add(self._unicorn.UC_HOOK_INTR, self._exception)

        self.now_us = 0.0
        self.readings = {12: 5958, 13: 30000, 14: 59578}
        self.pins = 0
        self.fed = 0
        self.written: list[int] = []
        """Addresses of registers, in order of their first writing."""
        self.flash_commands: list[tuple[int, int]] = []
        self.dies_after: int | None = None
        """Power goes with this one of the flash's commands."""
        self.stopped: str | None = None
        self.registers = {RCM_SRS0: reset}
        self.status_queue: list[int] = []
        self.interrupts = 0
        self.turns: dict[tuple[int, bool], int] = {}
        self.setup_waits = False
        self._on_read: dict[int, Callable[[], int]] = {
            PIT_CVAL1: self._clock,
            ADC0_SC1A: self._conversion_complete,
            ADC0_RA: self._conversion,
            ADC0_SC3: lambda: self.registers[ADC0_SC3] & ~0x80,
            MCG_S: self._clock_status,
            FTFA_FSTAT: lambda: 0x80,
            USB0_ISTAT: self._pending,
            USB0_STAT: lambda: self.status_queue[0] if self.status_queue else 0,
        }
        self._on_write: dict[int, Callable[[int], object]] = {
            SIM_COPC: lambda value: self.registers.setdefault(SIM_COPC, value),
            SIM_SRVCOP: self._watchdog,
            GPIOC_PSOR: self._set_pins,
            GPIOC_PCOR: self._clear_pins,
            FTFA_FSTAT: self._flash_command,
            USB0_ISTAT: self._acknowledge,
            USB0_CTL: self._usb_control,
        }
        self._vectors = struct.unpack("<48I", self.uc.mem_read(0, 192))
        self._pc = self._vectors[1]
        self.uc.reg_write(arm.UC_ARM_REG_SP, self._vectors[0])

    @property
    def flash(self) -> bytes:
        return bytes(self.uc.mem_read(0, FLASH_SIZE))

    @property
    def valves(self) -> tuple[int, int, bool]:
        """The duty cycles of the EVP and the DVP, of 2400, and whether the outlet is open."""
        timer = [self.registers.get(pcr) == 4 << 8 for pcr in (PORTC_PCR3, PORTC_PCR4)]
        evp = self.registers.get(TPM0_C2V, 0) if timer[0] else 2400 * (self.pins & EVP != 0)
        dvp = self.registers.get(TPM0_C3V, 0) if timer[1] else 2400 * (self.pins & DVP != 0)
        return evp, dvp, self.pins & SOLENOID != 0

    @property
    def stack_used(self) -> int:
        stack = bytes(self.uc.mem_read(RAM_BEGIN, STACK_SIZE))
        return len(stack.lstrip(_UNTOUCHED))

    def run(self, ms: float) -> None:
        end_us = self.now_us + 1000 * ms
        while self.now_us < end_us and self.stopped is None:
            self.uc.emu_start(self._pc | 1, 0xFFFFFFFE, count=_SLICE)
            self._pc = self.uc.reg_read(self._arm.UC_ARM_REG_PC)
            if self.stopped is None:
                self._interrupt()

    def raise_exception(self, number: int) -> None:
        """What the processor does when one of its own faults happens."""
        self._pc = self._vectors[number]

    def _interrupt(self) -> None:
        if (
            not self._pending() & self.registers.get(USB0_INTEN, 0)
            or not self.registers.get(NVIC_ISER, 0) >> 24 & 1
        ):
            return
        arm, uc = self._arm, self.uc
        if uc.reg_read(arm.UC_ARM_REG_PRIMASK) & 1:
            return
        names = [
            getattr(arm, f"UC_ARM_REG_{name}") for name in (*(f"R{n}" for n in range(13)), "LR", "PC", "XPSR")
        ]
        saved = [uc.reg_read(name) for name in names]
        stack = uc.reg_read(arm.UC_ARM_REG_SP)
        # Eight registers, and perhaps a gap; what is in them does not matter here.
        frame = (stack - 32) & ~7
        uc.mem_write(frame, bytes(32))
        uc.reg_write(arm.UC_ARM_REG_SP, frame)
        uc.reg_write(arm.UC_ARM_REG_LR, _RETURNED | 1)
        uc.emu_start(self._vectors[_USB_VECTOR] | 1, _RETURNED, count=100_000)
        assert uc.reg_read(arm.UC_ARM_REG_PC) == _RETURNED, "the interrupt does not end"
        assert uc.reg_read(arm.UC_ARM_REG_SP) == frame
        uc.reg_write(arm.UC_ARM_REG_SP, stack)
        for name, value in zip(names, saved, strict=True):
            uc.reg_write(name, value)

    def _exception(self, uc: Any, number: int, data: Any) -> None:
        self._stop(f"exception {number}")

    def _stop(self, why: str) -> None:
        self.stopped = why
        self.uc.emu_stop()

    def _read(self, uc: Any, offset: int, size: int, base: int) -> int:
        special = self._on_read.get(base + offset)
        return self.registers.get(base + offset, 0) if special is None else special()

    def _write(self, uc: Any, offset: int, size: int, value: int, base: int) -> None:
        address = base + offset
        if address not in self.written:
            self.written.append(address)
        special = self._on_write.get(address)
        if special is None:
            self.registers[address] = value
        else:
            special(value)

    def _clock(self) -> int:
        self.now_us += 20
        return ~int(self.now_us) & 0xFFFFFFFF

    def _conversion_complete(self) -> int:
        self.now_us += 17
        return self.registers[ADC0_SC1A] | 0x80

    def _conversion(self) -> int:
        channel = self.registers[ADC0_SC1A] & 0x1F
        return self._random.randrange(20000, 20064) if channel == _TEMPERATURE else self.readings[channel]

    def _pending(self) -> int:
        return self.interrupts | (TOKDNE if self.status_queue else 0)

    def _acknowledge(self, value: int) -> None:
        if value & TOKDNE and self.status_queue:
            self.status_queue.pop(0)
        self.interrupts &= ~value

    def _usb_control(self, value: int) -> None:
        if value & 0x02:
            self.turns.clear()
        self.setup_waits = False

    def _watchdog(self, value: int) -> None:
        if value == 0xAA:
            self.fed += 1
        elif value != 0x55:
            self._stop("reset by the watchdog")

    def _set_pins(self, value: int) -> None:
        self.pins |= value

    def _clear_pins(self, value: int) -> None:
        self.pins &= ~value

    def _clock_status(self) -> int:
        c1, pll = self.registers.get(MCG_C1, 0x04), self.registers.get(MCG_C6, 0) & 0x40
        selected = 0x08 if c1 >> 6 == 2 else 0x0C if c1 >> 6 == 0 and pll else 0
        return 0x02 | (0x60 if pll else 0) | (0x10 if c1 & 0x04 else 0) | selected

    def _flash_command(self, value: int) -> None:
        if not value & 0x80:
            return
        assert self.uc.reg_read(self._arm.UC_ARM_REG_PC) >= RAM_BEGIN, (
            "the flash cannot be read while it works"
        )
        assert self.uc.reg_read(self._arm.UC_ARM_REG_PRIMASK) & 1, "nor can an interrupt's code"
        command, address = self.registers[FTFA_COMMAND] >> 24, self.registers[FTFA_COMMAND] & 0xFFFFFF
        self.flash_commands.append((command, address))
        if self.dies_after == len(self.flash_commands):
            self._stop("without power")
            return
        if command == ERASE_SECTOR:
            assert address % 1024 == 0 and address >= SETTINGS_BEGIN
            self.now_us += 14_000
            self.uc.mem_write(address, b"\xff" * 1024)
        elif command == PROGRAM_WORD:
            assert address % 4 == 0 and address >= SETTINGS_BEGIN
            assert bytes(self.uc.mem_read(address, 4)) == b"\xff" * 4, "a word is programmed once"
            self.now_us += 65
            self.uc.mem_write(address, struct.pack("<I", self.registers[FTFA_DATA]))
        else:
            assert (command, address >> 16) == (READ_ONCE, 15)
            self.registers[FTFA_DATA] = _TEENSYS_NUMBER
