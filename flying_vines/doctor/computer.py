"""This computer: system, memory, a Raspberry Pi's supply and temperature, load, folders and clock.

Each subject has its facts, how they are read, all lines that can be printed, and the check.
"""

from __future__ import annotations

import asyncio
import os
import platform
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryFile
from typing import Literal

from flying_vines.doctor.finding import DoctorFinding, Subject
from flying_vines.doctor.processes import text_of
from flying_vines.record.flight_metadata import version_of
from flying_vines.service.host_clock import synchronised
from flying_vines.vehicle.mavlink.signing import CLOCK_SET_UNIX_S, NEW_STREAM_MAY_LAG, UNITS_PER_S

# System, memory, supply, temperature.

MIN_FREE_MB = 200.0
"""The service needs less than 120 MB."""
MAX_C = 80.0
"""A Raspberry Pi slows down from this temperature."""
MEMORY_TABLE = Path("/proc/meminfo")
THROTTLED = Path("/sys/devices/platform/soc/soc:firmware/get_throttled")
TEMPERATURES = Path("/sys/class/thermal")
TIMEOUT_S = 2.0

_NOW = {0: "under-voltage", 1: "a capped CPU clock", 2: "throttling", 3: "the soft temperature limit"}
"""Present state, by bit of `get_throttled`. Bit n + 16: state n has occurred since the start."""


@dataclass(frozen=True, slots=True)
class MachineFacts:
    version: str
    python: str
    system: str
    machine: str
    free_MB: float | None = None
    throttled: int | None = None
    """A Raspberry Pi's `get_throttled`; None on other computers."""
    hottest_C: float | None = None


_COMPUTER = Subject("computer")
LINUX = _COMPUTER.good("flying-vines {version}, Python {python}, {system} on {machine}")
NOT_LINUX = _COMPUTER.warning(
    "flying-vines {version}, Python {python}, {system} on {machine}: made for Linux",
    "fly with a Linux companion; here ports, processes and clock cannot be checked fully",
)
_MEMORY = Subject("memory")
MEMORY = _MEMORY.good("{free_MB:.0f} MB free")
LITTLE_MEMORY = _MEMORY.warning("{free_MB:.0f} MB free; the service needs up to 120", "end other programs")
_SUPPLY = Subject("supply")
SUPPLY = _SUPPLY.good("no under-voltage and no throttling since the start")
SUPPLY_NOW = _SUPPLY.bad(
    "the Raspberry Pi reports {what} now", "supply 5 V at 3 A or more through a short thick wire, and cool it"
)
SUPPLY_BEFORE = _SUPPLY.warning(
    "the Raspberry Pi reports {what} since its start",
    "check whether it happens when motors or valves draw current; use a better supply or a shorter wire",
)
NO_SUPPLY = _SUPPLY.skipped("only a Raspberry Pi reports its supply")
_TEMPERATURE = Subject("temperature")
COOL = _TEMPERATURE.good("{hottest_C:.0f} °C")
HOT = _TEMPERATURE.warning("{hottest_C:.0f} °C; it slows down from {limit:.0f} °C", "cool the computer")


def machine_facts() -> MachineFacts:
    return MachineFacts(
        version=version_of("flying-vines"),
        python=platform.python_version(),
        system=f"{platform.system()} {platform.release()}",
        machine=platform.machine(),
        free_MB=_free_MB(),
        throttled=_throttled(),
        hottest_C=max(_temperatures_C(), default=None),
    )


def _free_MB() -> float | None:
    rows = text_of(MEMORY_TABLE).splitlines()
    return next((int(row.split()[1]) / 1024 for row in rows if row.startswith("MemAvailable:")), None)


def _throttled() -> int | None:
    """From the kernel if it provides the value, else from the firmware's program vcgencmd."""
    with suppress(OSError, ValueError):
        return int(THROTTLED.read_text(), 16)
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


def _temperatures_C() -> Iterator[float]:
    for zone in TEMPERATURES.glob("thermal_zone*/temp"):
        try:
            yield int(zone.read_text()) / 1000
        except (OSError, ValueError):
            continue


def check_machine(facts: MachineFacts) -> list[DoctorFinding]:
    values = asdict(facts)
    found = [(LINUX if facts.system.startswith("Linux") else NOT_LINUX)(**values)]
    if facts.free_MB is not None:
        found.append((MEMORY if facts.free_MB >= MIN_FREE_MB else LITTLE_MEMORY)(**values))
    found.append(_supply(facts.throttled))
    if facts.hottest_C is not None:
        found.append((COOL if facts.hottest_C < MAX_C else HOT)(limit=MAX_C, **values))
    return found


def _supply(throttled: int | None) -> DoctorFinding:
    if throttled is None:
        return NO_SUPPLY()
    for line, bits in ((SUPPLY_NOW, throttled), (SUPPLY_BEFORE, throttled >> 16)):
        if named := [name for bit, name in _NOW.items() if bits >> bit & 1]:
            return line(what=", ".join(named))
    return SUPPLY()


# Load.

TICK_S = 0.02
HICCUPS = 5
BUSY_S = 0.05
"""The period of RC_CHANNELS. A loop that wakes up later than this, several times, shows a busy computer."""

_LOAD = Subject("load")
ON_TIME = _LOAD.good("this computer was late by {late:.0f} ms at most")
BUSY = _LOAD.warning(
    "this computer is too busy: late by {late:.0f} ms",
    "end other programs (top shows them), then repeat this check",
)
TOO_BUSY = _LOAD.bad(
    "this computer is too busy: late by {late:.0f} ms; after {limit:.0f} ms telemetry is stale and it vents",
    "end other programs (top shows them), then repeat this check",
)


async def lateness_s(seconds: float) -> float:
    """Listen for `seconds`, and return by how much the fifth latest tick of our own loop was late.

    A few late ticks are hiccups, such as the first use of a module; on a busy computer there are many.
    """
    loop, late_s = asyncio.get_running_loop(), [0.0] * HICCUPS
    ends_s = loop.time() + seconds
    while (now_s := loop.time()) < ends_s:
        await asyncio.sleep(TICK_S)
        late_s.append(loop.time() - now_s - TICK_S)
    return sorted(late_s)[-HICCUPS]


def check_load(late_s: float, stale_s: float) -> DoctorFinding:
    """By the lateness of our own loop; `stale_s` is losses.telemetry_s."""
    if late_s < BUSY_S:
        return ON_TIME(late=1e3 * late_s)
    return (TOO_BUSY if late_s >= stale_s else BUSY)(late=1e3 * late_s, limit=1e3 * stale_s)


def excused(finding: DoctorFinding, late_s: float) -> DoctorFinding:
    """A finding about rates and silence: if this computer was late, the other end may be without fault."""
    if late_s < BUSY_S or finding.verdict == "good":
        return finding
    remedy = "repeat it on a computer that is not busy: its lateness (see load) alone can be the cause"
    return replace(finding, verdict="warning", do=remedy)


# The folders of logs and state: writable, free space, speed of the card.

SLOW_S = 0.5
"""Limit for writing and syncing a few kilobytes. The recorder does this twice a second."""
SOME_BYTES = 8192


@dataclass(frozen=True, slots=True)
class DiskFacts:
    """One folder."""

    use: Literal["flight logs", "state"]
    folder: str
    problem: str = ""
    """Why the folder cannot be written; else empty."""
    free_MB: float = 0.0
    least_free_MB: float = 0.0
    """The recorder stops below this."""
    took_s: float = 0.0


_DISK = Subject("disk")
DISK = _DISK.good("{folder} for {use}: {free_MB:.0f} MB free, a write takes {took_ms:.0f} ms")
NO_LOGS = _DISK.bad(
    "{folder}: no flight log can be written there: {problem}",
    "use another folder (--out), or correct its permissions",
)
NO_STATE = _DISK.warning(
    "{folder}: parameters and disarming cannot be saved there: {problem}",
    "set state.folder to a folder that the service's user may write",
)
FULL = _DISK.warning(
    "{folder} for {use}: {free_MB:.0f} MB free; below {least_free_MB:.0f} nothing is recorded",
    "delete old flights; the recorder deletes nothing",
)
SLOW = _DISK.warning(
    "{folder} for {use}: writing a few kilobytes takes {took_ms:.0f} ms",
    "use a faster card: data that is not yet written is lost when the power fails",
)


def disk_facts(use: Literal["flight logs", "state"], folder: Path, least_free_MB: float = 0.0) -> DiskFacts:
    """Writes a small temporary file into `folder`.

    If it is missing, into its nearest existing parent: the service creates a missing folder.
    """
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


def check_disk(facts: DiskFacts) -> DoctorFinding:
    if facts.problem:
        line = NO_LOGS if facts.use == "flight logs" else NO_STATE
    elif facts.free_MB < facts.least_free_MB:
        line = FULL
    else:
        line = SLOW if facts.took_s > SLOW_S else DISK
    return line(took_ms=1e3 * facts.took_s, **asdict(facts))


# The clock: it gives the logs' times and decides which signed messages are accepted.

APART_S = 2.0
JUMP_S = 0.5
SIGNED_APART_S = NEW_STREAM_MAY_LAG / UNITS_PER_S


@dataclass(frozen=True, slots=True)
class ClockFacts:
    unix_s: float
    synchronised: bool | None = None
    """The kernel's answer; None if it gives none."""
    jumped_s: float = 0.0
    """Clock jump during the examination."""
    ahead_s: float | None = None
    """Lead over the autopilot's clock; None if the autopilot does not know the time."""
    signing: bool = False


_CLOCK = Subject("clock")
SYNCHRONISED = _CLOCK.good("synchronised")
NOT_SYNCHRONISED = _CLOCK.warning(
    "not synchronised: the logs' times may be wrong",
    "connect it to a network before the flight, or use a real-time clock or GPS time (chrony)",
)
NOT_SET = _CLOCK.warning("not set: it shows {when}", "set it (sudo date -s …), or connect it to a network")
JUMPED = _CLOCK.warning(
    "it jumped by {by:+.1f} s during this check", "wait until it is synchronised, then start the service"
)
AGREES = _CLOCK.good("{by:+.2f} s from the autopilot's")
APART = _CLOCK.warning(
    "{by:+.1f} s from the autopilot's",
    "set this computer's clock, otherwise its logs do not match the autopilot's",
)
APART_AND_SIGNED = _CLOCK.bad(
    "{by:+.0f} s from the autopilot's, and messages are signed",
    "set this computer's clock: signed messages more than a minute old are refused",
)
VEHICLE_WITHOUT = _CLOCK.skipped("the autopilot does not know the time yet (no GPS fix)")


class Clock:
    """Make it at the start of the examination; call `facts` at the end."""

    def __init__(self) -> None:
        self._offset_s = time.time() - time.monotonic()

    def facts(self, ahead_s: float | None, signing: bool) -> ClockFacts:
        unix_s = time.time()
        jumped_s = unix_s - time.monotonic() - self._offset_s
        return ClockFacts(unix_s, synchronised(), jumped_s, ahead_s, signing)


def check_clock(facts: ClockFacts) -> list[DoctorFinding]:
    found = []
    if facts.unix_s < CLOCK_SET_UNIX_S:
        when = datetime.fromtimestamp(facts.unix_s).astimezone()
        found.append(NOT_SET(when=when.isoformat(" ", "seconds")))
    elif facts.synchronised is not None:
        found.append((SYNCHRONISED if facts.synchronised else NOT_SYNCHRONISED)())
    if abs(facts.jumped_s) > JUMP_S:
        found.append(JUMPED(by=facts.jumped_s))
    return found


def check_clock_against_vehicle(facts: ClockFacts) -> DoctorFinding:
    """Compares the clock with the autopilot's, if the autopilot knows the time."""
    by = facts.ahead_s
    if by is None:
        return VEHICLE_WITHOUT()
    if facts.signing and abs(by) > SIGNED_APART_S:
        return APART_AND_SIGNED(by=by)
    return (AGREES if abs(by) <= APART_S else APART)(by=by)
