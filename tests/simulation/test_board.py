"""Which board runs where the real firmware cannot be built, kept or loaded."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from needed import needs_compiler

_SAY = """
from flying_vines.simulation.phlosar.board import best_board, why_emulated
print(type(best_board()).__name__, why_emulated())
"""


def _said(**environment: str) -> str:
    """By a fresh process: what is loaded once stays loaded."""
    return subprocess.run(
        [sys.executable, "-c", _SAY], capture_output=True, text=True, check=True, env=os.environ | environment
    ).stdout


def test_without_a_compiler_the_emulated_board_runs(tmp_path: Path) -> None:
    said = _said(PATH=str(tmp_path), CXX="", XDG_CACHE_HOME=str(tmp_path))
    assert said.startswith("Firmware the firmware cannot be built here without a C++ compiler")


@needs_compiler
def test_a_cache_that_is_no_folder_is_no_traceback(tmp_path: Path) -> None:
    (tmp_path / "flying-vines").write_text("in the way")
    said = _said(XDG_CACHE_HOME=str(tmp_path))
    assert said.startswith("Firmware the firmware cannot be kept in ")


@needs_compiler
def test_a_library_that_does_not_load_is_no_traceback(tmp_path: Path) -> None:
    assert _said(XDG_CACHE_HOME=str(tmp_path)).startswith("CompiledFirmware")
    (library,) = (tmp_path / "flying-vines").glob("*.so")
    library.write_bytes(b"not a library")
    assert _said(XDG_CACHE_HOME=str(tmp_path)).startswith("Firmware the firmware cannot be built and loaded")
