"""What several tests of the firmware begin with."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from pathlib import Path

import pytest
from needed import ARM_TOOLS, need

from .native import FIRMWARE

BOARDS = ("teensy40", "teensy41", "teensylc")
HOW_TO_GET_CORES = "git clone https://github.com/PaulStoffregen/cores ../shared/teensy-cores"


@pytest.fixture(scope="session")
def cores() -> Path:
    """The board maker's core, which is no part of this project: $TEENSY_CORES, or shared/ beside a parent."""
    root = Path(__file__).parents[2]
    given = os.environ.get("TEENSY_CORES")
    beside = (parent / "shared" / "teensy-cores" for parent in root.parents)
    for folder in [Path(given)] if given else beside:
        if (folder / "teensy4" / "Arduino.h").is_file():
            return folder
    pytest.skip(f"needs the board maker's core: {HOW_TO_GET_CORES}")


@pytest.fixture(scope="session")
def images(cores: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sketch for each board; built once, also when several processes run the tests."""
    need("make", ARM_TOOLS)
    need("arm-none-eabi-g++", ARM_TOOLS)
    ours = tmp_path_factory.getbasetemp()
    folder = (ours.parent if "PYTEST_XDIST_WORKER" in os.environ else ours) / "firmware-images"
    folder.mkdir(exist_ok=True)
    command = ["make", "--silent", "-C", str(FIRMWARE), "image", f"CORES={cores}", f"BUILD={folder}"]
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        # Without the options of a make that runs the tests.
        done = subprocess.run(
            [*command, f"PYTHON={sys.executable}"],
            capture_output=True,
            text=True,
            env={**os.environ, "MAKEFLAGS": ""},
        )
    assert done.returncode == 0, done.stderr
    return folder
