"""Programs that some computers lack: a test that needs one is skipped, and says what to install."""

from __future__ import annotations

import shutil

import pytest

from flying_vines.simulation.phlosar.core_library import WHAT_TO_INSTALL, compiler

ARM_TOOLS = (
    "sudo apt install gcc-arm-none-eabi libnewlib-arm-none-eabi libstdc++-arm-none-eabi-newlib "
    "qemu-system-arm make"
)

needs_compiler = pytest.mark.skipif(compiler() is None, reason=f"needs {WHAT_TO_INSTALL}")


def host_compiler() -> str:
    """Path of the C++ compiler; without one the test is skipped."""
    command = compiler()
    if command is None:
        pytest.skip(f"needs {WHAT_TO_INSTALL}")
    return command


def need(program: str, how: str) -> str:
    """Path of the program; without it the test is skipped with a line that says how to get it."""
    path = shutil.which(program)
    if path is None:
        pytest.skip(f"needs {program}: {how}")
    return path
