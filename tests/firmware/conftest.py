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


@pytest.fixture(scope="session")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The ELF file of the complete image; built once, also when several processes run the tests."""
    need("make", ARM_TOOLS)
    need("arm-none-eabi-g++", ARM_TOOLS)
    ours = tmp_path_factory.getbasetemp()
    folder = (ours.parent if "PYTEST_XDIST_WORKER" in os.environ else ours) / "firmware-image"
    folder.mkdir(exist_ok=True)
    command = [
        "make",
        "--silent",
        "-C",
        str(FIRMWARE),
        f"BUILD={folder}",
        f"PYTHON={sys.executable}",
        "image",
    ]
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        # Of a make that runs the tests nothing is taken over.
        done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "MAKEFLAGS": ""})
    assert done.returncode == 0, done.stderr
    return folder / "phlosar.elf"
