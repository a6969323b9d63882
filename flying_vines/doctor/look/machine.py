"""Facts about this computer."""

from __future__ import annotations

import platform
import shutil
import subprocess
from pathlib import Path

from flying_vines.doctor.checks.machine import MachineFacts
from flying_vines.record.flight_metadata import version_of

MEMORY = Path("/proc/meminfo")
THROTTLED = Path("/sys/devices/platform/soc/soc:firmware/get_throttled")
TEMPERATURES = Path("/sys/class/thermal")
TIMEOUT_S = 2.0


def facts() -> MachineFacts:
    return MachineFacts(
        version=version_of("flying-vines"),
        python=platform.python_version(),
        system=f"{platform.system()} {platform.release()}",
        machine=platform.machine(),
        free_MB=_free_MB(),
        throttled=_throttled(),
        hottest_C=_hottest_C(),
    )


def _free_MB() -> float | None:
    try:
        rows = MEMORY.read_text().splitlines()
    except OSError:
        return None
    free = [int(row.split()[1]) / 1024 for row in rows if row.startswith("MemAvailable:")]
    return free[0] if free else None


def _throttled() -> int | None:
    """From the kernel if it provides the value, else from the firmware's program vcgencmd."""
    try:
        return int(THROTTLED.read_text(), 16)
    except (OSError, ValueError):
        pass
    program = shutil.which("vcgencmd")
    if program is None:
        return None
    try:
        answer = subprocess.run(
            [program, "get_throttled"], capture_output=True, text=True, timeout=TIMEOUT_S, check=True
        )
        return int(answer.stdout.partition("=")[2], 16)
    except (OSError, ValueError, subprocess.SubprocessError):
        return None


def _hottest_C() -> float | None:
    found = []
    for zone in TEMPERATURES.glob("thermal_zone*/temp"):
        try:
            found.append(int(zone.read_text()) / 1000)
        except (OSError, ValueError):
            continue
    return max(found, default=None)
