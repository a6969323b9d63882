"""clang-tidy's rules for bugs, safety and speed on the sketch's own files."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from required_programs import need

from .native import FIRMWARE

pytestmark = pytest.mark.long

STUB = Path(__file__).with_name("arduino_stub")
CHECKS = (
    "-*",
    *("bugprone-*", "-bugprone-easily-swappable-parameters", "-bugprone-reserved-identifier"),
    *("cert-*", "-cert-dcl37-c", "-cert-dcl51-cpp", "clang-analyzer-*", "performance-*"),
    *("misc-*", "-misc-non-private-member-variables-in-classes"),
    # Addresses of the emulated EEPROM are numbers.
    "-performance-no-int-to-ptr",
)


@pytest.mark.parametrize("define", ["-DARDUINO_TEENSY40", "-D__MKL26Z64__"])
def test_the_sketch_is_tidy(define: str) -> None:
    tidy = need("clang-tidy", "sudo apt install clang-tidy")
    sources = sorted(map(str, (FIRMWARE / "phlosar" / "src").rglob("*.cpp")))
    command = [tidy, "--quiet", f"--checks={','.join(CHECKS)}", "--warnings-as-errors=*", *sources]
    flags = ["-std=c++17", "-DARDUINO=10819", define, "-I", str(STUB)]
    done = subprocess.run([*command, "--", *flags], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
