"""Tests a folder by writing a small temporary file."""

from __future__ import annotations

import os
import shutil
import time
from pathlib import Path
from tempfile import TemporaryFile
from typing import Literal

from flying_vines.doctor.checks.disk import DiskFacts

SOME_BYTES = 8192


def facts(use: Literal["flight logs", "state"], folder: Path, least_free_MB: float) -> DiskFacts:
    """Tests `folder`, or its nearest existing parent, because the service creates a missing folder."""
    there = folder.absolute()
    while not there.exists() and there != there.parent:
        there = there.parent
    try:
        began_s = time.monotonic()
        with TemporaryFile(dir=there, prefix=".flying-vines-doctor.") as file:
            file.write(os.urandom(SOME_BYTES))
            file.flush()
            os.fsync(file.fileno())
        took_s = time.monotonic() - began_s
        free_MB = shutil.disk_usage(there).free / 1e6
    except OSError as error:
        return DiskFacts(use, str(folder), problem=error.strerror or str(error))
    return DiskFacts(use, str(folder), free_MB=free_MB, least_free_MB=least_free_MB, took_s=took_s)
