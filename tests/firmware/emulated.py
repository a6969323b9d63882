"""Runs the core's object code on QEMU's processors through a golden run and counts its instructions."""

from __future__ import annotations

import os
import struct
import subprocess
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from .golden_run import BoardInput, Done, PowerUp

MADE = "emulated.elf"
_PROGRAM = Path(__file__).parents[2] / "firmware_link" / "firmware" / "qemu"
_EMULATOR = (
    *("qemu-system-arm", "-nographic", "-monitor", "none", "-serial", "none"),
    *("-semihosting-config", "enable=on,target=native"),
)
_COUNTING = ("-icount", "shift=8")
"""256 ns for each instruction: see firmware_link/firmware/qemu/instructions.h."""
_HANGS_S = 120
_RECORD = struct.Struct("<IIIHHBBHHHH")


class Chip(NamedTuple):
    """A processor that QEMU emulates."""

    name: str
    machine: str
    ticks_per_instruction: float
    """Ticks of SysTick, which runs with the machine's clock."""


CHIPS = (Chip("m0plus", "microbit", 4.096), Chip("m7", "mps2-an500", 6.4))
"""The processors of a Teensy LC and a Teensy 4. QEMU's microbit has a Cortex-M0, with the same
instructions."""


class Program(NamedTuple):
    chip: Chip
    path: Path


class Instructions(NamedTuple):
    """The instructions of a step. Each number includes up to six instructions of the call and its
    counting."""

    receive: int
    step: int
    take: int

    @property
    def together(self) -> int:
        return sum(self)


class Ticked(NamedTuple):
    done: Done
    instructions: Instructions


def build(chip: Chip, folder: Path) -> Program:
    """Build the program for the chip in `folder`."""
    subprocess.run(
        ["make", "--silent", "-C", str(_PROGRAM), f"CHIP={chip.name}", f"BUILD={folder}"],
        check=True,
        capture_output=True,
        text=True,
        env={**os.environ, "MAKEFLAGS": ""},
    )
    return Program(chip, folder / MADE)


class Run(NamedTuple):
    thousand: int
    """The counted ticks of a thousand instructions."""
    ticked: list[Ticked]


def run(program: Program, inputs: Iterable[BoardInput], folder: Path) -> Run:
    """The chip's outputs, step by step. The first of `inputs` is a power-up. `folder` is for its files."""
    _prepare(inputs, folder)
    subprocess.run([*_command(program), *_COUNTING], cwd=folder, check=True, timeout=_HANGS_S)
    return results(program.chip, folder)


def trace(program: Program, inputs: Iterable[BoardInput], folder: Path) -> Iterator[tuple[str, list[int]]]:
    """A slow run. Yields for each counted operation its name and the addresses of its instructions."""
    _prepare(inputs, folder)
    options = ("-singlestep", "-d", "exec,nochain", "-D", "/dev/stdout")
    with subprocess.Popen([*_command(program), *options], cwd=folder, stdout=subprocess.PIPE) as emulator:
        assert emulator.stdout is not None
        operation = ""
        addresses: list[int] = []
        before = back = 0
        # A line is "Trace 0: 0x7f… [flags/address/…] function".
        for line in emulator.stdout:
            address = int(line.split(b"/", 2)[1], 16)
            if operation:
                if address == back:
                    yield operation, addresses
                    operation = ""
                else:
                    addresses.append(address)
            elif b" counted_" in line:
                operation, addresses = line.rpartition(b"_")[2].decode().strip(), [address]
                # A call takes four bytes.
                back = before + 4
            before = address
    if emulator.returncode != 0:
        raise subprocess.CalledProcessError(emulator.returncode, emulator.args)


def results(chip: Chip, folder: Path) -> Run:
    """The results of a run. The counts are valid only if the emulator ran with `_COUNTING`."""
    data = (folder / "outputs").read_bytes()
    one, two = struct.unpack_from("<II", data)
    return Run(_instructions(chip, two - one), list(_read(chip, data, 8)))


def _command(program: Program) -> list[str]:
    """The command; it must run in the folder of its files."""
    return [*_EMULATOR, "-M", program.chip.machine, "-kernel", str(program.path)]


def _prepare(inputs: Iterable[BoardInput], folder: Path) -> None:
    (folder / "inputs").write_bytes(b"".join(map(_record, inputs)))


def _record(one: BoardInput) -> bytes:
    if isinstance(one, PowerUp):
        build, stored = one.build.encode("ascii"), one.stored
        return b"P" + struct.pack("<IB16sB", one.boot_id, one.by_watchdog, build, len(stored)) + stored
    return b"S" + struct.pack("<IHHHHH", *one[:5], len(one.received)) + one.received


def _read(chip: Chip, data: bytes, at: int) -> Iterator[Ticked]:
    while at < len(data):
        *ticks, evp, dvp, solenoid, mode, faults, number, kept, sent = _RECORD.unpack_from(data, at)
        at += _RECORD.size
        between, end = at + kept, at + kept + sent
        done = Done(evp, dvp, solenoid == 1, mode, faults, number, data[at:between], data[between:end])
        at = end
        yield Ticked(done, Instructions(*(_instructions(chip, count) for count in ticks)))


def _instructions(chip: Chip, ticks: int) -> int:
    return round(ticks / chip.ticks_per_instruction)
