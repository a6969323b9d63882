"""The cost of a process: processor time and memory from Linux's /proc, and the time of its imports."""

from __future__ import annotations

import os
import statistics
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

_CLOCK_HZ = os.sysconf("SC_CLK_TCK")
_TIMED_IMPORT = "import time; t = time.process_time(); {}; print(time.process_time() - t)"
"""Measured after a first import, when the bytecode is cached; other programs do not count."""


@dataclass(frozen=True, slots=True)
class Memory:
    now_MB: float
    peak_MB: float
    """Peak since the start of the process."""


def cpu_s(pid: int) -> float:
    """User and system time of all threads so far."""
    after_name = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    user, system = after_name[11:13]
    return (int(user) + int(system)) / _CLOCK_HZ


def memory(pid: int) -> Memory:
    sizes_MB = {}
    for line in Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines():
        key, _, value = line.partition(":")
        if key in ("VmRSS", "VmHWM"):
            sizes_MB[key] = int(value.split()[0]) / 1024
    return Memory(sizes_MB["VmRSS"], sizes_MB["VmHWM"])


def import_ms(python: str, statement: str, environment: Mapping[str, str], repeats: int) -> float:
    """The median CPU time of the imports in new interpreters, without their own start; bytecode is cached
    before."""
    command = [python, "-c", _TIMED_IMPORT.format(statement)]
    times_s = []
    for _ in range(repeats + 1):
        ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        times_s.append(float(ran.stdout))
    return 1e3 * statistics.median(times_s[1:])
