"""Instructions and estimated cycles of the firmware's control step on its chips.

The core is compiled with the Arduino IDE's options for each board. It runs the golden run (tests/firmware) on
QEMU's Cortex-M0 and Cortex-M7. The emulator's clock counts the instructions.

For the Cortex-M0+ of a Teensy LC, a trace of every instruction counts them again; both counts must agree up
to a constant. The trace distinguishes loads, stores and branches from instructions of one cycle. The estimate
uses the times of the Cortex-M0+ (load or store 2, branch taken 2, call 3, multiplication 1) and memory
without wait states. The flash runs at 24 MHz and the core at 48 MHz, so each word costs a wait cycle unless
it is cached or prefetched. "uncached" assumes neither: the true number is between "cycles" and "uncached".
Interrupts are not included.

The Cortex-M7 of a Teensy 4 runs from memory without wait states and starts up to two instructions in a cycle.
One cycle for each instruction is a safe estimate.

    python benchmarks/firmware_cycles.py            # three minutes
    python benchmarks/firmware_cycles.py --check    # exit status 1 if a control step takes 20 % or more
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from firmware_link.framing import FrameDecoder
from firmware_link.protocol import (
    ClearFaults,
    GetSetting,
    Hello,
    Mode,
    Ping,
    ProtocolError,
    Setpoint,
    SetSetting,
    Vent,
    decode,
)

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from firmware.emulated import CHIPS, Instructions, Program, build, run, trace
from firmware.golden_run import FULL_EVP_DUTY, PACKET, Done, Part, Step, difference, read

CORE_HZ = {"m0plus": 48e6, "m7": 600e6}
STEP_HZ = 1000
BUDGET = 0.2
"""Maximum share of a step's time."""
TRACED = ("handshake", "inflation", "telemetry at 1000 Hz", "a busy line", "watchdog")
OPERATIONS = Instructions._fields
"""The operations of a step, in this order."""


class Cost(NamedTuple):
    instructions: int
    cycles: int
    uncached_cycles: int


class Ticked(NamedTuple):
    """A step, and the cost of each of its operations."""

    step: Step
    done: Done
    telemetry: bool
    """True if the step sent telemetry."""
    costs: tuple[Cost, ...]

    @property
    def together(self) -> Cost:
        return Cost(*(sum(column) for column in zip(*self.costs, strict=True)))


class Costs:
    """The cycles of each instruction of a program on the Cortex-M0+."""

    def __init__(self, path: Path) -> None:
        listing = _output("arm-none-eabi-objdump", "-d", "--no-show-raw-insn", str(path))
        lines = re.findall(r"^ +([0-9a-f]+):\t(\S+)(?:\t([^@\n]*))?", listing, re.MULTILINE)
        addresses = [int(address, 16) for address, _, _ in lines]
        halves = max(addresses) // 2 + 2
        self._cycles = np.zeros(halves, np.int64)
        self._branches = np.zeros(halves, np.bool_)
        self._from_flash = np.zeros(halves, np.bool_)
        for address, (_, name, operands) in zip(addresses, lines, strict=True):
            at = address // 2
            name = name.removesuffix(".n")
            self._cycles[at] = _cycles(name, operands.strip())
            self._branches[at] = (
                re.fullmatch(r"b(eq|ne|cs|cc|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)", name) is not None
            )
            self._from_flash[at] = name.startswith("ldr") and operands.lstrip().find("[pc") > 0
        symbols = re.findall(r"^([0-9a-f]+) <(\S+)>:", listing, re.MULTILINE)
        self._names = [name for _, name in symbols]
        self._begins = np.array([int(address, 16) for address, _ in symbols])

    def cost(self, addresses: list[int]) -> Cost:
        at = np.array(addresses)
        taken = self._branches[at[:-1] // 2] & (at[1:] != at[:-1] + 2)
        cycles = int(self._cycles[at // 2].sum() + taken.sum())
        words = 1 + int((at[1:] // 4 != at[:-1] // 4).sum())
        return Cost(len(at), cycles, cycles + words + int(self._from_flash[at // 2].sum()))

    def routines(self, addresses: list[int]) -> Counter[str]:
        at = np.searchsorted(self._begins, np.array(addresses), side="right") - 1
        return Counter(self._names[i] for i in at)


def _cycles(name: str, operands: str) -> int:
    """Cycles on a Cortex-M0+ with a multiplier of one cycle, for a conditional branch that is not taken."""
    registers = _registers(operands)
    if name == "pop" and "pc" in operands:
        return 3 + len(registers)
    if name in ("push", "pop", "stmia", "ldmia"):
        return 1 + len(registers)
    if name.startswith(("ldr", "str")):
        return 2
    if name == "bl":
        return 3
    if name in ("b", "bx", "blx") or (name in ("mov", "add") and operands.startswith("pc")):
        return 2
    return 1


def _registers(operands: str) -> list[str]:
    """The registers of a list in braces."""
    _, _, inside = operands.partition("{")
    return [one for one in inside.rstrip("}").split(", ") if one]


def _output(*command: str) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def traced(program: Program, part: Part, folder: Path) -> tuple[list[Ticked], Counter[str]]:
    """The cost of each step, and the instructions of the most expensive step by function, without the port's
    functions."""
    by_clock = run(program, part.inputs, folder).ticked
    if different := difference(part, (ticked.done for ticked in by_clock)):
        sys.exit(different)
    costs_of = Costs(program.path)
    costs: list[Cost] = []
    telemetry: list[bool] = []
    worst = Counter[str]()
    beyond: dict[str, set[int]] = defaultdict(set)
    counted = (count for ticked in by_clock for count in ticked.instructions)
    for (name, addresses), by_the_clock in zip(trace(program, part.inputs, folder), counted, strict=True):
        costs.append(costs_of.cost(addresses))
        beyond[name].add(by_the_clock - len(addresses))
        if name == "step":
            routines = costs_of.routines(addresses)
            telemetry.append(any("tell_telemetry" in routine for routine in routines))
            worst = max(worst, routines, key=Counter.total)
    if any(len(few) != 1 for few in beyond.values()):
        sys.exit(f"clock and trace do not agree in {part.name}: {dict(beyond)}")
    if not any(telemetry):
        sys.exit(f"{part.name} has no telemetry, or the compiler has inlined the function that makes it")
    triples = zip(costs[0::3], costs[1::3], costs[2::3], strict=True)
    return [Ticked(*one) for one in zip(part.steps, part.done, telemetry, triples, strict=True)], worst


def counted(program: Program, part: Part, folder: Path) -> list[Ticked]:
    """The cost of each step, with one cycle for each instruction."""
    by_clock = run(program, part.inputs, folder).ticked
    if different := difference(part, (ticked.done for ticked in by_clock)):
        sys.exit(different)
    return [
        Ticked(step, one.done, False, tuple(Cost(count, count, count) for count in one.instructions))
        for step, one in zip(part.steps, by_clock, strict=True)
    ]


def doing(done: Done) -> str:
    if done.mode != Mode.REGULATE:
        return "vent" if done.mode == Mode.VENT else "fault"
    if done.evp_duty >= FULL_EVP_DUTY:
        return "regulate: on-off, fully open"
    if done.evp_duty > 0:
        return "regulate: opening, or a puff"
    if done.solenoid:
        return "regulate: venting, Venturi" if done.dvp_duty else "regulate: venting, passive"
    return "regulate: all shut"


def frame_type(data: bytes) -> str:
    """The type of the only frame in `data`; empty if there is none or more than one."""
    kinds = (Hello, Setpoint, Vent, ClearFaults, Ping, GetSetting, SetSetting)
    payloads = FrameDecoder().feed(data)
    if len(payloads) != 1 or data.count(0) != 1:
        return ""
    try:
        message = decode(payloads[0])[0]
    except ProtocolError:
        return ""
    return type(message).__name__ if isinstance(message, kinds) else ""


def table(title: str, rows: dict[str, list[Cost]], core_Hz: float) -> Table:
    made = Table(title=title)
    made.add_column("")
    columns = (
        "times",
        "instructions, mean",
        "99 %",
        "most",
        "cycles, mean",
        "most",
        "most, uncached",
        "of 1 ms",
    )
    for column in columns:
        made.add_column(column, justify="right")
    for name, costs in sorted(rows.items()):
        instructions, cycles, uncached = np.array(costs).T
        made.add_row(
            *(name, str(len(costs)), f"{instructions.mean():.0f}", f"{_percentile(instructions):.0f}"),
            *(str(instructions.max()), f"{cycles.mean():.0f}", str(cycles.max()), str(uncached.max())),
            f"{uncached.max() / core_Hz * STEP_HZ:.1%}",
        )
    return made


def _percentile(numbers: NDArray[np.int64]) -> float:
    return float(np.percentile(numbers, 99.0))


def tables(ticked: Iterable[Ticked], core_Hz: float) -> list[Table]:
    steps: dict[str, list[Cost]] = defaultdict(list)
    frames: dict[str, list[Cost]] = defaultdict(list)
    packets: dict[str, list[Cost]] = defaultdict(list)
    whole: dict[str, list[Cost]] = defaultdict(list)
    for one in ticked:
        received, step, _ = one.costs
        steps[f"{doing(one.done)}{', telemetry' if one.telemetry else ''}"].append(step)
        if kind := frame_type(one.step.received):
            frames[kind].append(received)
        elif len(one.step.received) > PACKET // 2:
            packets[f"up to {PACKET}" if len(one.step.received) <= PACKET else "more"].append(received)
        if one.step.received.count(0) <= 1 and max(len(one.step.received), one.step.fetched) <= PACKET:
            whole["step, up to one frame in, up to a packet out"].append(one.together)
    return [
        table("A control step", steps, core_Hz),
        table("Receiving one frame", frames, core_Hz),
        table("Receiving many at once, by bytes", packets, core_Hz),
        table("All of a millisecond", whole, core_Hz),
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--check", action="store_true", help="exit status 1 if a control step takes too much")
    check = parser.parse_args().check
    console = Console(width=150)
    too_slow = False
    for chip in CHIPS:
        core_Hz = CORE_HZ[chip.name]
        console.print(f"{chip.name}, {core_Hz / 1e6:.0f} MHz", style="bold")
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            program = build(chip, folder)
            ticked: list[Ticked] = []
            worst = Counter[str]()
            for part in read():
                if part.name not in TRACED:
                    continue
                if chip.name == "m0plus":
                    more, worst_at = traced(program, part, folder)
                    worst = max(worst, worst_at, key=Counter.total)
                else:
                    more = counted(program, part, folder)
                ticked += more
        for one in tables(ticked, core_Hz):
            console.print(one)
        if worst:
            console.print(f"The costliest step has {worst.total()} instructions:")
        for routine, count in worst.most_common(12):
            console.print(f"{count:7}  {routine}", highlight=False)
        most = max(one.costs[OPERATIONS.index("step")].instructions for one in ticked)
        budget = BUDGET * core_Hz / STEP_HZ
        console.print(f"{most} instructions at most, of {budget:.0f} that a control step may have")
        too_slow |= most >= budget
    return int(check and too_slow)


if __name__ == "__main__":
    sys.exit(main())
