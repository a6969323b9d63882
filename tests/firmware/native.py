"""Compiles parts of the firmware as a library, so that a test can simulate the hardware around them."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import pytest
from required_programs import host_compiler

from flying_vines.simulation.phlosar.core_library import SOURCES

FIRMWARE = SOURCES
STACK_TOOL = FIRMWARE / "stack.py"
LIBRARY = "firmware.so"
SUPPLY_COUNTS = 59578
"""3.0 V of 3.3 V: the sensors' 5 V through the divider."""
AT_REST = round(0.1 * SUPPLY_COUNTS)
HALF_FULL = round(0.5 * SUPPLY_COUNTS)
STRICT = ("-Wall", "-Wextra", "-Werror", "-Wconversion", "-Wshadow", "-fno-exceptions", "-fno-rtti")


def library(folder: Path, *sources: Path, flags: tuple[str, ...] = ()) -> ctypes.CDLL:
    """`sources` together, compiled into `folder`."""
    made = folder / LIBRARY
    checked = ("-std=c++17", "-O1", "-fsanitize=undefined", "-fno-sanitize-recover=undefined")
    command = [
        host_compiler(),
        *checked,
        *flags,
        *STRICT,
        "-fPIC",
        "-shared",
        *map(str, sources),
        "-o",
        str(made),
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(made))


_TYPES: dict[str, Any] = {
    "u8": ctypes.c_uint8,
    "u16": ctypes.c_uint16,
    "u32": ctypes.c_uint32,
    "char": ctypes.c_char,
    "float": ctypes.c_float,
}


def fields(text: str, **others: Any) -> list[tuple[str, Any]]:
    """The fields of a C structure. Each line is a type with its fields, as in `u8 dtr memory[1080]`."""
    found = []
    for kind, *names in map(str.split, text.strip().splitlines()):
        for name, _, size in (name.rstrip("]").partition("[") for name in names):
            one = (_TYPES | others)[kind]
            found.append((name, one * int(size) if size else one))
    return found


class Mistake(NamedTuple):
    """A mistake for the sources: file, right text, wrong text."""

    file: str
    right: str
    wrong: str


_Subject = TypeVar("_Subject")


def with_mistake(sources: Path, mistake: Mistake, to: Path) -> Path:
    """A copy of a folder of sources with the mistake, at `to`."""
    shutil.copytree(sources, to)
    (file,) = to.glob(f"**/{mistake.file}")
    text = file.read_text()
    assert mistake.right in text
    file.write_text(text.replace(mistake.right, mistake.wrong, 1))
    return to


def assert_found(tests: Iterable[Callable[[_Subject], object]], subject: Callable[[], _Subject]) -> None:
    """At least one of the tests fails on a fresh `subject`."""
    for test in tests:
        try:
            test(subject())
        except (AssertionError, StopIteration, IndexError, ValueError):
            return
    pytest.fail("no test finds the mistake")
