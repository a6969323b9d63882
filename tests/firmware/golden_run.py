"""The golden run: a recorded conversation with the firmware's core, with counts in and duty cycles out.

`golden_run.txt.xz` has what the core did when it was recorded (see `record_golden_run`). Every build of the
core must give the same outputs, to the last bit. The file is text, so that people can read a difference: one
line for each step, with the fields of `Step` and, after ">", of `Done`; bytes are hexadecimal, "-" means
none.
"""

from __future__ import annotations

import ctypes
import lzma
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from firmware_link.protocol import Mode
from flying_vines.simulation.phlosar.core_library import Outputs, load

GOLDEN_RUN = Path(__file__).with_name("golden_run.txt.xz")
HEADER = """\
# The golden run of the phloSAR's firmware. Made by: cd tests && python -m firmware.record_golden_run
# @ part   P boot_id by_watchdog build stored   S now_us cv reservoir supply fetched received > evp_duty \
dvp_duty solenoid mode faults number kept sent
"""
PACKET = 64
"""Bytes that a board's port receives or sends at a time."""
FULL_EVP_DUTY = 31457
"""Duty cycle of the fully open inflation valve with the default settings."""
_MOST_SENT = 1024


class PowerUp(NamedTuple):
    """A board starts; `stored` has the settings in its memory."""

    boot_id: int
    by_watchdog: bool
    build: str
    stored: bytes


class Step(NamedTuple):
    """The inputs of a board in a millisecond: first `received` from the host, then the converter's counts."""

    now_us: int
    cv: int
    reservoir: int
    supply: int
    fetched: int
    """Maximum number of bytes that its port sends."""
    received: bytes


class Done(NamedTuple):
    """The outputs of a board in a step, and its state after it."""

    evp_duty: int
    dvp_duty: int
    solenoid: bool
    mode: int
    faults: int
    number: int
    kept: bytes
    """Settings to be stored; empty if there are none."""
    sent: bytes


BoardInput = PowerUp | Step


class Part(NamedTuple):
    """A board's run from one power-up on, with one purpose."""

    name: str
    inputs: list[BoardInput]
    done: list[Done]
    """One entry for each of `steps`."""

    @property
    def steps(self) -> list[Step]:
        return [one for one in self.inputs if isinstance(one, Step)]


class HostBoard:
    """The core, built for this machine, with counts as input."""

    def __init__(self, power_up: PowerUp, library: ctypes.CDLL | None = None) -> None:
        self._library = library or load()
        self._build = power_up.build.encode("ascii")
        self._outputs = Outputs()
        self._image = ctypes.create_string_buffer(self._library.phlosar_image_size())
        self._buffer = ctypes.create_string_buffer(_MOST_SENT)
        self._memory = ctypes.create_string_buffer(self._library.phlosar_size())
        self._firmware = ctypes.addressof(self._memory)
        self._library.phlosar_start(
            self._firmware,
            self._build,
            power_up.boot_id,
            power_up.by_watchdog,
            power_up.stored,
            len(power_up.stored),
        )

    def step(self, step: Step) -> Done:
        library, firmware, outputs = self._library, self._firmware, self._outputs
        library.phlosar_receive(firmware, step.received, len(step.received))
        library.phlosar_step(firmware, step.now_us, step.cv, step.reservoir, step.supply, outputs)
        size = library.phlosar_take_output(firmware, self._buffer, min(_MOST_SENT, step.fetched))
        mode = library.phlosar_mode(firmware)
        # A real board, too, stores settings only while it does not regulate.
        unsaved = mode != Mode.REGULATE and library.phlosar_unsaved(firmware, self._image)
        return Done(
            outputs.evp_duty,
            outputs.dvp_duty,
            outputs.solenoid,
            mode,
            library.phlosar_faults(firmware),
            library.phlosar_number(firmware),
            self._image.raw if unsaved else b"",
            ctypes.string_at(self._buffer, size),
        )


def on_host(inputs: Iterable[BoardInput], library: ctypes.CDLL | None = None) -> Iterator[Done]:
    """The core's outputs on this machine, with this library or the usual one. `inputs` begins with a
    power-up."""
    board: HostBoard | None = None
    for one in inputs:
        if isinstance(one, PowerUp):
            board = HostBoard(one, library)
        else:
            assert board is not None
            yield board.step(one)


def write(path: Path, parts: Iterable[Part]) -> None:
    lines = [HEADER]
    for part in parts:
        lines.append(f"@ {part.name}\n")
        done = iter(part.done)
        for one in part.inputs:
            if isinstance(one, PowerUp):
                lines.append(f"P {_words(one)}\n")
            else:
                lines.append(f"S {_words(one)} > {_words(next(done))}\n")
    path.write_bytes(lzma.compress("".join(lines).encode("ascii"), preset=9 | lzma.PRESET_EXTREME))


def read(path: Path = GOLDEN_RUN) -> list[Part]:
    parts: list[Part] = []
    for line in lzma.decompress(path.read_bytes()).decode("ascii").splitlines():
        kind, _, rest = line.partition(" ")
        words = rest.split()
        match kind:
            case "@":
                parts.append(Part(rest, [], []))
            case "P":
                boot_id, by_watchdog, build, stored = words
                parts[-1].inputs.append(PowerUp(int(boot_id), by_watchdog == "1", build, _bytes(stored)))
            case "S":
                now_us, cv, reservoir, supply, fetched = map(int, words[:5])
                parts[-1].inputs.append(Step(now_us, cv, reservoir, supply, fetched, _bytes(words[5])))
                evp, dvp, solenoid, mode, faults, number = map(int, words[7:13])
                kept, sent = map(_bytes, words[13:])
                parts[-1].done.append(Done(evp, dvp, solenoid == 1, mode, faults, number, kept, sent))
    return parts


def difference(part: Part, done: Iterable[Done]) -> str:
    """The first difference from the golden run; empty if there is none."""
    others = list(done)
    for number, (step, right, other) in enumerate(zip(part.steps, part.done, others, strict=False)):
        for name, a, b in zip(Done._fields, right, other, strict=True):
            if a != b:
                return f"{part.name}, step {number} {step}: {name} is {b!r}, in the golden run {a!r}"
    if len(others) != len(part.done):
        return f"{part.name}: {len(others)} steps, in the golden run {len(part.done)}"
    return ""


def _words(fields: Iterable[object]) -> str:
    return " ".join(map(_word, fields))


def _word(field: object) -> str:
    match field:
        case bytes():
            return field.hex() or "-"
        case bool():
            return str(int(field))
        case _:
            return str(field)


def _bytes(word: str) -> bytes:
    return b"" if word == "-" else bytes.fromhex(word)
