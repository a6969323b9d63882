"""The flash, memory and stack that the sketch needs on each board.

    stack.py [--json] teensy40/phlosar.elf ...

The stack's bound comes from the machine code, so it also covers Teensy's core and the compiler's library. A
function's frame is all the stack that the function itself uses. The program needs the deepest chain of frames
from `setup` or `loop`. Each interrupt adds its own chain and the registers that the processor saves, as if
every interrupt occurred during the one before. Code without a bound is refused: recursion, frames of unknown
size, and calls through a register to functions that are not listed here.

Needs the standard library and the cross compiler's binutils.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

_CROSS = "arm-none-eabi-"
_PROGRAM = ("phlosar::setup()", "phlosar::loop()")
_INTERRUPTS = ("pit_isr", "usb_isr")
_SYSTICK = ("(anonymous namespace)::guard()", "systick_isr")
"""The first one that exists is used. On a Teensy 4 it calls the second one."""
_SAVED = {"v6S-M": 36, "v7E-M": 108}
"""Bytes of registers that an interrupt saves, plus 4 for the stack's alignment, by architecture (M0+, M7)."""
_THROUGH_A_REGISTER = {
    r"^pit_isr|every_millisecond|beginCycles|^teensy::inplace_function<": (r"vtable<void>.*_FUN",),
    r"vtable<void>.*_FUN": (r"::step\(\)$",),
    r"^usb_isr|^run_callbacks": ("^rx_event$", "^usb_serial_flush_callback$"),
    r"EventResponder::runFromInterrupt": (),  # the sketch has no events
    r"^flash_write|^eeprom_write_byte": (),  # code that it copied to the stack and that pushes nothing
    r"^__aeabi_|^__gnu_": (),  # jumps within the routine
}
"""Patterns of the functions that a call through a register can reach, by a pattern of the caller's name."""

_LAST = "_reboot_Teensyduino_"
"""Starts the bootloader and never returns, so its stack does not matter."""
_ONCE = ("usb_rx_memory", "usb_free")
"""`usb_free` may call `usb_rx_memory`, which may call `usb_free` again. The recursion ends there, because
`usb_rx_memory` has cleared the condition for the next call."""

_FUNCTION = re.compile(r"^([0-9a-f]{8}) <(.+)>:$")
_INSTRUCTION = re.compile(r"^\s*([0-9a-f]+):\t(\S+)(?:\t(.*))?$")
_BRANCH = re.compile(r"^b(l|eq|ne|cs|cc|mi|pl|vs|vc|hi|ls|ge|lt|gt|le|al)?(\.[nw])?$")
_VENEER = re.compile(r"_veneer$")


class ImageError(Exception):
    """The stack has no bound, or the file is not a sketch for a Teensy. One sentence for the user."""


@dataclass
class ImageFunction:
    name: str
    address: int
    frame: int = 0
    calls: set[int] = field(default_factory=set)
    branches: set[int] = field(default_factory=set)
    """Within the function, or out of it as a tail call."""
    through_register: bool = False
    unknown_frame: bool = False
    end: int = 0


@dataclass(frozen=True)
class Chain:
    """The deepest chain of frames from one function on, in bytes, and the functions in it."""

    size: int
    names: tuple[str, ...]


class Image:
    """The functions of a program."""

    def __init__(self, listing: str) -> None:
        self.functions = _functions(listing)
        self._chains: dict[int, Chain] = {}

    def named(self, name: str) -> Chain:
        for function in self.functions.values():
            if function.name in (name, f"{name}()"):
                return self.chain(function.address)
        raise ImageError(f"no function {name}: is this the sketch for a Teensy?")

    def chain(self, address: int) -> Chain:
        return self._chain(address & ~1, ())

    def _chain(self, address: int, above: tuple[ImageFunction, ...]) -> Chain:
        function = self._holding(address)
        if function in above:
            loop = (*above[above.index(function) :], function)
            names = " → ".join(one.name for one in loop)
            raise ImageError(f"recursion, so that the stack has no bound: {names}")
        if function.name == _LAST:
            return Chain(0, (function.name,))
        if function.unknown_frame:
            raise ImageError(f"the frame of {function.name} has no fixed size")
        known = self._chains.get(function.address)
        if known is not None:
            return known
        above = (*above, function)
        targets = {t for t in function.branches if not function.address <= t < function.end}
        targets |= function.calls
        once = 0
        if function.name == _ONCE[0]:
            again = {target for target in targets if self._holding(target).name == _ONCE[1]}
            once = sum(self._holding(target).frame for target in again)
            targets -= again
        if function.through_register:
            targets |= self._through_register(function)
        called = [self._chain(target, above) for target in sorted(targets)]
        deepest = max(called, key=lambda chain: chain.size, default=Chain(0, ()))
        chain = Chain(function.frame + once + deepest.size, (function.name, *deepest.names))
        self._chains[function.address] = chain
        return chain

    def _through_register(self, caller: ImageFunction) -> set[int]:
        for pattern, names in _THROUGH_A_REGISTER.items():
            if re.search(pattern, caller.name):
                return {
                    function.address
                    for function in self.functions.values()
                    if any(re.search(name, function.name) for name in names)
                }
        raise ImageError(f"{caller.name} calls through a register, so that the stack has no bound")

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
    board: str
    flash: int
    static: int
    """Variables, buffers, and on a Teensy 4 the code that runs from memory."""
    room: int
    """Bytes between the variables and the end of their memory, for the stack."""
    program: Chain
    interrupts: tuple[Chain, ...]
    saved: int

    @property
    def stack(self) -> int:
        return self.program.size + sum(self.saved + chain.size for chain in self.interrupts)


def needs_of(elf: Path) -> Needs:
    image = Image(_run("objdump", "-d", "-C", "--no-show-raw-insn", elf))
    sizes = _section_sizes(elf)
    symbols = _symbols(elf)
    attributes = re.search(r"Tag_CPU_arch: (\S+)", _run("readelf", "-A", elf))
    if attributes is None or attributes[1] not in _SAVED or "_estack" not in symbols:
        raise ImageError(f"{elf} is not a sketch for a Teensy")
    names = {function.name for function in image.functions.values()}
    systick = next((name for name in _SYSTICK if name in names), _SYSTICK[-1])
    return Needs(
        board=elf.parent.name,
        flash=sum(size for name, size in sizes.items() if name.startswith((".text", ".data"))),
        static=sum(
            size for name, size in sizes.items() if not name.startswith((".text.c", ".text.h", ".text.p"))
        )
        - (0 if ".text.itcm" in sizes else sizes[".text"]),
        room=symbols["_estack"] - symbols["_ebss"],
        program=max((image.named(name) for name in _PROGRAM), key=lambda chain: chain.size),
        interrupts=tuple(image.named(name) for name in (*_INTERRUPTS, systick)),
        saved=_SAVED[attributes[1]],
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
    """Add one instruction's share to the function's frame and branches."""
    veneer = _VENEER.search(function.name) is not None
    stem = mnemonic.removesuffix(".w")
    if stem in ("push", "vpush") or (stem in ("stmdb", "vstmdb") and operands.startswith("sp!")):
        function.frame += _pushed(operands[operands.index("{") :])
    elif size := re.match(r"(?:strd? .*\[sp, #-|subw? sp, (?:sp, )?#)(\d+)", f"{stem} {operands}"):
        function.frame += int(size[1])
    elif stem in ("add", "sub", "mov") and re.match(r"sp, (r\d|ip|sl|fp)", operands):
        function.unknown_frame = True
    elif _BRANCH.match(mnemonic):
        target = int(operands.split()[0], 16)
        # On an M0+ a `bl` into the middle of a function is a far branch, not a call.
        begins = "+0x" not in operands
        (function.calls if mnemonic == "bl" and begins else function.branches).add(target)
    elif veneer and mnemonic == ".word":
        # The target of the linker's veneer between two memories.
        function.branches.add(int(operands.split()[0], 16) & ~1)
    elif mnemonic == "blx" or (mnemonic == "bx" and operands != "lr" and not veneer):
        function.through_register = True


def _pushed(registers: str) -> int:
    """The bytes of a list like {r4, r5, lr}, {r4-r7, lr} or {d8-d9}."""
    size = 0
    for part in registers.strip("{}").split(","):
        first, _, last = part.strip().partition("-")
        count = int(last[1:]) - int(first[1:]) + 1 if last else 1
        size += count * (8 if first.startswith("d") else 4)
    return size


def _section_sizes(elf: Path) -> dict[str, int]:
    """Sizes of the sections in flash and in the variables' memory."""
    lines = _run("size", "-A", elf).splitlines()
    fields = [line.split() for line in lines if line.startswith(".")]
    without = (".debug", ".ARM.attributes", ".comment", ".bss.dma", ".bss.extram")
    return {name: int(size) for name, size, *_ in fields if not name.startswith(without)}


def _symbols(elf: Path) -> dict[str, int]:
    fields = [line.split() for line in _run("nm", elf).splitlines()]
    return {name: int(value, 16) for value, _, name in (f for f in fields if len(f) == 3)}


def _run(tool: str, *arguments: str | Path) -> str:
    try:
        done = subprocess.run([_CROSS + tool, *arguments], check=True, capture_output=True, text=True)
    except FileNotFoundError:
        raise ImageError(
            f"{_CROSS}{tool} is not installed; Debian's package is binutils-arm-none-eabi"
        ) from None
    except subprocess.CalledProcessError as error:
        raise ImageError(error.stderr.strip()) from None
    return done.stdout


def _show(needs: Needs) -> None:
    print(
        f"{needs.board}: flash {needs.flash}, variables {needs.static}, stack {needs.stack} of {needs.room}"
    )
    print(f"  program      {needs.program.size:5d}  {' → '.join(needs.program.names)}")
    for chain in needs.interrupts:
        print(f"  + interrupt  {needs.saved + chain.size:5d}  {' → '.join(chain.names)}")


def main() -> int:
    parser = argparse.ArgumentParser(
        description="Flash, memory and stack that the sketch needs on each board."
    )
    parser.add_argument("elf", type=Path, nargs="+")
    parser.add_argument("--json", action="store_true", help="one JSON object, for programs")
    arguments = parser.parse_args()
    try:
        every = [needs_of(elf) for elf in arguments.elf]
    except ImageError as error:
        print(f"stack.py: {error}", file=sys.stderr)
        return 1
    if arguments.json:
        fields = ("flash", "static", "room", "stack")
        print(json.dumps({one.board: {name: getattr(one, name) for name in fields} for one in every}))
    else:
        for one in every:
            _show(one)
    # Only half of the room may be used, as a margin for what this tool does not see.
    outgrown = [one for one in every if 2 * one.stack > one.room]
    for one in outgrown:
        print(f"stack.py: {one.board}: {one.stack} bytes of stack are too much", file=sys.stderr)
    return 1 if outgrown else 0


if __name__ == "__main__":
    sys.exit(main())
