"""Checks this computer: system and memory; on a Raspberry Pi, its supply and temperature."""

from __future__ import annotations

from dataclasses import dataclass, replace

from flying_vines.doctor.finding import DoctorFinding, FindingText

MIN_FREE_MB = 200.0
"""The service needs less than 120 MB."""
MAX_C = 80.0
"""A Raspberry Pi slows down from this temperature."""

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


GOOD = FindingText("computer", "good", "flying-vines {version}, Python {python}, {system} on {machine}")
NOT_LINUX = FindingText(
    "computer",
    "warning",
    "flying-vines {version}, Python {python}, {system} on {machine}: made for Linux",
    "fly with a Linux companion; here ports, processes and clock cannot be checked fully",
)
MEMORY = FindingText("memory", "good", "{free:.0f} MB free")
LITTLE_MEMORY = FindingText(
    "memory", "warning", "{free:.0f} MB free; the service needs up to 120", "end other programs"
)
SUPPLY = FindingText("supply", "good", "no under-voltage and no throttling since the start")
SUPPLY_NOW = FindingText(
    "supply",
    "bad",
    "the Raspberry Pi reports {what} now",
    "supply 5 V at 3 A or more through a short thick wire, and cool it",
)
SUPPLY_BEFORE = FindingText(
    "supply",
    "warning",
    "the Raspberry Pi reports {what} since its start",
    "check whether it happens when motors or valves draw current; use a better supply or a shorter wire",
)
NO_SUPPLY = FindingText("supply", "skipped", "only a Raspberry Pi reports its supply")
COOL = FindingText("temperature", "good", "{celsius:.0f} °C")
HOT = FindingText(
    "temperature",
    "warning",
    "{celsius:.0f} °C; it slows down from {limit:.0f} °C",
    "cool the computer",
)

ON_TIME = FindingText("load", "good", "this computer was late by {late:.0f} ms at most")
BUSY = FindingText(
    "load",
    "warning",
    "this computer is too busy: late by {late:.0f} ms",
    "end other programs (top shows them), then repeat this check",
)
TOO_BUSY = FindingText(
    "load",
    "bad",
    "this computer is too busy: late by {late:.0f} ms; after {limit:.0f} ms telemetry is stale and it vents",
    "end other programs (top shows them), then repeat this check",
)
BUSY_S = 0.05
"""The period of RC_CHANNELS. A loop that wakes up later than this, several times, shows a busy computer."""


def load(late_s: float, stale_s: float) -> DoctorFinding:
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


def check(facts: MachineFacts) -> list[DoctorFinding]:
    known = GOOD if facts.system.startswith("Linux") else NOT_LINUX
    found = [known(version=facts.version, python=facts.python, system=facts.system, machine=facts.machine)]
    if facts.free_MB is not None:
        found.append((MEMORY if facts.free_MB >= MIN_FREE_MB else LITTLE_MEMORY)(free=facts.free_MB))
    found.append(_supply(facts.throttled))
    if facts.hottest_C is not None:
        found.append((COOL if facts.hottest_C < MAX_C else HOT)(celsius=facts.hottest_C, limit=MAX_C))
    return found


def _supply(throttled: int | None) -> DoctorFinding:
    if throttled is None:
        return NO_SUPPLY()
    if now := _named(throttled):
        return SUPPLY_NOW(what=now)
    if before := _named(throttled >> 16):
        return SUPPLY_BEFORE(what=before)
    return SUPPLY()


def _named(bits: int) -> str:
    return ", ".join(name for bit, name in _NOW.items() if bits >> bit & 1)
