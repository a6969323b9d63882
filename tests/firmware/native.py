"""Parts of the firmware as a library for this machine, so that a test can be their surroundings."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path

from needed import host_compiler

from flying_vines.simulation.phlosar.core_library import SOURCES

FIRMWARE = SOURCES
STACK_TOOL = FIRMWARE / "stack.py"
LIBRARY = "firmware.so"
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
