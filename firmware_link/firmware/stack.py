"""What an image needs of the chip: flash, and memory with the deepest stack that can come to be.

    stack.py [--json] phlosar.elf

The stack is found in the machine code itself, so that it holds for the compiler's library of floating-point
routines as for our own: each function's frame is all that it ever pushes, its calls are its branches out
of itself, and the deepest chain of frames from the reset vector is what the program needs. An interrupt puts
eight registers and perhaps a gap on top, and then its handler's own chain; each handler is taken to interrupt
the one before. What would make such a bound wrong is refused: recursion, calls through a register, frames of
a size that is not known before.

Nothing but the standard library and the cross compiler's binutils is needed.
"""

from __future__ import annotations

import argparse
import json
import re
import struct
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

FLASH_LIMIT = 48 * 1024
RAM_LIMIT = 6 * 1024

_CROSS = "arm-none-eabi-"
_VECTORS = 48
_EXCEPTION_FRAME = 8 * 4 + 4
_IN_FLASH = (".text", ".init_array", ".data")
_IN_RAM = (".usb_table", ".data", ".bss")

_FUNCTION = re.compile(r"^([0-9a-f]{8}) <(.+)>:$")
_INSTRUCTION = re.compile(r"^\s*([0-9a-f]+):\t(\S+)(?:\t(.*))?$")
_BRANCH = re.compile(r"^b(l|eq|ne|cs|cc|mi|pl|vs|vc|hi|ls|ge|lt|gt|le|al)?(\.[nw])?$")
_VENEER = re.compile(r"_veneer$")


class ImageError(Exception):
    """The image cannot be bounded, or is no image; a sentence for people."""


@dataclass
class ImageFunction:
    name: str
    address: int
    frame: int = 0
    calls: set[int] = field(default_factory=set)
    """Of functions from their beginning."""
    branches: set[int] = field(default_factory=set)
    """To anywhere: within the function, or out of it as its last deed."""
    end: int = 0


@dataclass(frozen=True)
class Chain:
    """The deepest chain of frames from one function on, in bytes, and the functions on it."""

    size: int
    names: tuple[str, ...]


class Image:
    """The functions of an image."""

    def __init__(self, listing: str) -> None:
        self.functions = _functions(listing)
        self._chains: dict[int, Chain] = {}

    def chain(self, address: int) -> Chain:
        return self._chain(address & ~1, ())

    def _chain(self, address: int, above: tuple[ImageFunction, ...]) -> Chain:
        function = self._holding(address)
        if function in above:
            loop = (*above[above.index(function) :], function)
            names = " → ".join(one.name for one in loop)
            raise ImageError(f"recursion, so that the stack has no bound: {names}")
        known = self._chains.get(function.address)
        if known is not None:
            return known
        above = (*above, function)
        called = [
            self._chain(target, above)
            for target in sorted(function.calls | function.branches)
            if target in function.calls or not function.address <= target < function.end
        ]
        deepest = max(called, key=lambda chain: chain.size, default=Chain(0, ()))
        chain = Chain(function.frame + deepest.size, (function.name, *deepest.names))
        self._chains[function.address] = chain
        return chain

    def _holding(self, address: int) -> ImageFunction:
        if address in self.functions:
            return self.functions[address]
        # Some of the library's routines branch into the middle of their neighbours.
        for function in self.functions.values():
            if function.address <= address < function.end:
                return function
        raise ImageError(f"a branch to 0x{address:x}, where there is no code")


@dataclass(frozen=True)
class Needs:
    flash: int
    static: int
    program: Chain
    interrupts: tuple[Chain, ...]
    reserved: int

    @property
    def stack(self) -> int:
        return self.program.size + sum(_EXCEPTION_FRAME + chain.size for chain in self.interrupts)

    @property
    def ram(self) -> int:
        return self.static + self.stack

    def complaints(self) -> list[str]:
        found = []
        if self.flash > FLASH_LIMIT:
            found.append(f"{self.flash} bytes of flash are more than the {FLASH_LIMIT} that are to be used")
        if self.ram > RAM_LIMIT:
            found.append(f"{self.ram} bytes of memory are more than the {RAM_LIMIT} that are to be used")
        if self.stack > self.reserved:
            found.append(f"a stack of {self.stack} bytes outgrows the {self.reserved} that kl26.ld reserves")
        return found


def needs_of(elf: Path) -> Needs:
    program = Image(_run("objdump", "-d", "-C", "--no-show-raw-insn", elf).decode())
    stack_top, reset, *others = _vectors(elf)
    sizes = _section_sizes(elf)
    reserved = sizes.get(".stack", 0)
    if reserved == 0 or stack_top == 0:
        raise ImageError(f"{elf} reserves no stack: is it a complete image?")
    handlers = sorted(set(others) - {0})
    return Needs(
        flash=sum(sizes.get(name, 0) for name in _IN_FLASH),
        static=sum(sizes.get(name, 0) for name in _IN_RAM),
        program=program.chain(reset),
        interrupts=tuple(program.chain(handler) for handler in handlers),
        reserved=reserved,
    )


def _functions(listing: str) -> dict[int, ImageFunction]:
    functions: dict[int, ImageFunction] = {}
    current: ImageFunction | None = None
    for line in listing.splitlines():
        if begins := _FUNCTION.match(line):
            current = ImageFunction(begins[2], int(begins[1], 16))
            functions[current.address] = current
        elif (one := _INSTRUCTION.match(line)) and current is not None:
            current.end = int(one[1], 16) + 2
            _read(current, one[2], one[3] or "")
    return functions


def _read(function: ImageFunction, mnemonic: str, operands: str) -> None:
    """What one instruction adds to a function's frame and branches."""
    veneer = _VENEER.search(function.name) is not None
    if mnemonic == "push":
        function.frame += 4 * _registers(operands)
    elif mnemonic == "sub" and (size := re.match(r"sp, #(\d+)", operands)):
        function.frame += int(size[1])
    elif re.match(r"sp, (r\d|ip|sl|fp)", operands) and mnemonic in ("add", "sub", "mov"):
        raise ImageError(f"the frame of {function.name} has a size that is not known before")
    elif _BRANCH.match(mnemonic):
        target = int(operands.split()[0], 16)
        # A call into the middle of a function is how this processor goes far.
        begins = "+0x" not in operands
        (function.calls if mnemonic == "bl" and begins else function.branches).add(target)
    elif veneer and mnemonic == ".word":
        # Where the linker's way from flash to memory leads.
        function.branches.add(int(operands.split()[0], 16) & ~1)
    elif mnemonic == "blx" or (mnemonic == "bx" and operands != "lr" and not veneer):
        raise ImageError(f"{function.name} calls through a register, so that the stack has no bound")


def _registers(operands: str) -> int:
    """How many a list like {r4, r5, lr} or {r4-r7, lr} has."""
    count = 0
    for part in operands.strip("{}").split(","):
        first, _, last = part.strip().partition("-")
        count += int(last[1:]) - int(first[1:]) + 1 if last else 1
    return count


def _vectors(elf: Path) -> tuple[int, ...]:
    code = _run("objcopy", "-O", "binary", "-j", ".text", elf, "/dev/stdout")
    return struct.unpack_from(f"<{_VECTORS}I", code)


def _section_sizes(elf: Path) -> dict[str, int]:
    lines = _run("size", "-A", elf).decode().splitlines()
    fields = [line.split() for line in lines if line.startswith(".")]
    return {name: int(size) for name, size, *_ in fields}


def _run(tool: str, *arguments: str | Path) -> bytes:
    try:
        return subprocess.run([_CROSS + tool, *arguments], check=True, capture_output=True).stdout
    except FileNotFoundError:
        raise ImageError(
            f"{_CROSS}{tool} is not installed; Debian's package is binutils-arm-none-eabi"
        ) from None
    except subprocess.CalledProcessError as error:
        raise ImageError(error.stderr.decode().strip()) from None


def _show(needs: Needs) -> None:
    print(f"flash   {needs.flash:6d} of {FLASH_LIMIT} bytes")
    print(f"memory  {needs.ram:6d} of {RAM_LIMIT} bytes: {needs.static} of variables, {needs.stack} of stack")
    print(f"  program      {needs.program.size:5d}  {' → '.join(needs.program.names)}")
    for chain in needs.interrupts:
        print(f"  + interrupt  {_EXCEPTION_FRAME + chain.size:5d}  {' → '.join(chain.names)}")


def main() -> int:
    parser = argparse.ArgumentParser(description="What a firmware image needs of the chip.")
    parser.add_argument("elf", type=Path)
    parser.add_argument("--json", action="store_true", help="as one object, for programs")
    arguments = parser.parse_args()
    try:
        needs = needs_of(arguments.elf)
    except ImageError as error:
        print(f"stack.py: {error}", file=sys.stderr)
        return 1
    if arguments.json:
        summary = {"flash": needs.flash, "static": needs.static, "stack": needs.stack, "ram": needs.ram}
        print(json.dumps(summary))
    else:
        _show(needs)
    for complaint in needs.complaints():
        print(f"stack.py: {complaint}", file=sys.stderr)
    return 1 if needs.complaints() else 0


if __name__ == "__main__":
    sys.exit(main())
