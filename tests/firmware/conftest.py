"""Fixtures for several tests of the firmware."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from required_programs import ARM_TOOLS, need

from .native import FIRMWARE
from .once import made_once

BOARDS = ("teensy40", "teensy41", "teensylc")
HOW_TO_GET_CORES = "git clone https://github.com/PaulStoffregen/cores ../shared/teensy-cores"


@pytest.fixture(scope="session")
def cores() -> Path:
    """The board maker's core, which is not part of this project: $TEENSY_CORES, or shared/ beside a parent
    folder."""
    root = Path(__file__).parents[2]
    given = os.environ.get("TEENSY_CORES")
    beside = (parent / "shared" / "teensy-cores" for parent in root.parents)
    for folder in [Path(given)] if given else beside:
        if (folder / "teensy4" / "Arduino.h").is_file():
            return folder
    pytest.skip(f"needs the board maker's core: {HOW_TO_GET_CORES}")


@pytest.fixture(scope="session")
def images(cores: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the built sketch for each board."""
    need("make", ARM_TOOLS)
    need("arm-none-eabi-g++", ARM_TOOLS)

    def make(folder: Path) -> None:
        command = ["make", "--silent", "-C", str(FIRMWARE), "image", f"CORES={cores}", f"BUILD={folder}"]
        # Without the options of the make that runs the tests.
        done = subprocess.run(
            [*command, f"PYTHON={sys.executable}"],
            capture_output=True,
            text=True,
            env={**os.environ, "MAKEFLAGS": ""},
        )
        assert done.returncode == 0, done.stderr

    return made_once(tmp_path_factory, "firmware-images", make)
