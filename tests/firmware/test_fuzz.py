"""Random and mutated bytes for both ends of the line, for seconds; benchmarks/fuzz.py does it for longer."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from fuzz import FuzzError, drive, driver, listen
from required_programs import host_compiler, needs_compiler

from flying_vines.simulation.phlosar.core_library import SOURCES

from .native import Mistake, with_mistake

pytestmark = pytest.mark.long

WORSE = {
    "no dead-man": Mistake("firmware.cpp", "now_us - commanded_us_ >= holds_us_", "false"),
    "no handshake": Mistake(
        "firmware.h", "return greeted_ && settings_told_ && setpoint.session == session_", "return true"
    ),
    "a session that is as good as another": Mistake("firmware.h", " && setpoint.session == session_", ""),
    "a repeat that holds the dead-man off": Mistake(
        "firmware.cpp", "if (setpoint.count <= setpoint_count_) return true;", ""
    ),
    "damaged settings that anybody clears": Mistake("firmware.cpp", "(damaged ? kSettings : kNoFault)", "0"),
    "faults that regulate on": Mistake("firmware.cpp", "faults);\n    regulating_ = false;", "faults);"),
    "a limit that nobody minds": Mistake("firmware.cpp", "if (present != kNoFault) latch(present);", ""),
    "openings beyond the full current": Mistake("valves.cpp", "settings[SettingId::kEvpFullDuty]", "Real(1)"),
    "settings without ends": Mistake("settings.cpp", "!(value >= row->least && value <= row->most)", "false"),
    "only wrong readings in a row count": Mistake(
        "firmware.h", "(seen_ << 1 | (now ? 1 : 0))", "(now ? seen_ << 1 | 1 : 0)"
    ),
    "a relief that a low reading starts anew": Mistake(
        "firmware.cpp", "if ((latched_ & kCvOverpressure) == 0) {", "if (!above_limit_) {"
    ),
    "readings that nobody doubts": Mistake("firmware.cpp", "if (cv_good) cv_kPa_ = ", "cv_kPa_ = "),
}
"""Mistakes in the core's files."""


@needs_compiler
@pytest.mark.parametrize("seed", [1, 2])
def test_the_core_withstands_what_comes(seed: int) -> None:
    fuzzed = drive(seed, 300_000)
    assert fuzzed.received_bytes >= 300_000
    assert fuzzed.steps_regulating > 1000
    # This includes the sanitizer. The core has no heap, and the harness frees its memory.
    assert 10.0 < fuzzed.peak_MB < 500.0


def compiled(source: Path, to: Path) -> Path:
    subprocess.run([host_compiler(), "-std=c++17", "-c", "-o", to, source], check=True)
    return to


@pytest.fixture(scope="module")
def objects(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Core, harness and driver, each compiled without sanitizers, because the checks do not need them."""
    folder = tmp_path_factory.mktemp("objects")
    sources = [*(SOURCES / "phlosar" / "src" / "core").glob("*.cpp"), *(SOURCES / "fuzz").glob("*.cpp")]
    return {source.name: compiled(source, folder / f"{source.name}.o") for source in sources}


@needs_compiler
@pytest.mark.parametrize("what", WORSE)
def test_a_worse_core_is_found_out(what: str, objects: dict[str, Path], tmp_path: Path) -> None:
    name = WORSE[what].file.replace("firmware.h", "firmware.cpp")  # no other file uses what is changed there
    core = with_mistake(SOURCES / "phlosar" / "src" / "core", WORSE[what], tmp_path / "core")
    worse = objects | {name: compiled(core / name, tmp_path / "worse.o")}
    program = tmp_path / "fuzz"
    subprocess.run([host_compiler(), "-o", program, *worse.values()], check=True)
    with pytest.raises(FuzzError, match="does not hold"):
        drive(1, 1_000_000, program)


@needs_compiler
def test_the_driver_is_built_once() -> None:
    made_at = driver().stat().st_mtime_ns
    assert driver().stat().st_mtime_ns == made_at


def test_the_host_withstands_what_comes() -> None:
    received = listen(1, 300_000)
    assert received.fed_bytes >= 300_000
    assert received.messages > 3000
    assert received.ready > 100
    assert len(received.memory.looks) == 10
