"""This computer's clock: logs carry its time, and signed messages are believed by it."""

from __future__ import annotations

from dataclasses import dataclass

from flying_vines.doctor.finding import DoctorFinding, FindingText
from flying_vines.vehicle.mavlink.signing import CLOCK_SET_UNIX_S, NEW_STREAM_MAY_LAG, UNITS_PER_S

APART_S = 2.0
JUMP_S = 0.5
SIGNED_APART_S = NEW_STREAM_MAY_LAG / UNITS_PER_S


@dataclass(frozen=True, slots=True)
class ClockFacts:
    unix_s: float
    synchronised: bool | None = None
    """What the kernel says; None where it says nothing."""
    jumped_s: float = 0.0
    """While the doctor looked."""
    ahead_s: float | None = None
    """Before the autopilot's; None where that does not tell the time."""
    signing: bool = False


SYNCHRONISED = FindingText("clock", "good", "synchronised")
NOT_SYNCHRONISED = FindingText(
    "clock",
    "warning",
    "not synchronised: the logs' times may be off",
    "let it meet a network before the flight, or have a real-time clock or GPS time (chrony)",
)
NOT_SET = FindingText(
    "clock", "warning", "not set: it says {when}", "set it (sudo date -s …), or let it meet a network"
)
JUMPED = FindingText(
    "clock",
    "warning",
    "it jumped by {by:+.1f} s while it was looked at",
    "wait until it is synchronised; only then start the service",
)
AGREES = FindingText("clock", "good", "{by:+.2f} s against the autopilot's")
APART = FindingText(
    "clock",
    "warning",
    "{by:+.1f} s against the autopilot's",
    "set this computer's clock: logs of both do not match otherwise",
)
APART_AND_SIGNED = FindingText(
    "clock",
    "bad",
    "{by:+.0f} s against the autopilot's, and messages are signed",
    "set this computer's clock: signed messages more than a minute old are not believed",
)
VEHICLE_WITHOUT = FindingText("clock", "skipped", "the autopilot does not know the time yet (no GPS fix)")


def check(facts: ClockFacts, when: str) -> list[DoctorFinding]:
    """`when` is how people write `facts.unix_s`."""
    found = []
    if facts.unix_s < CLOCK_SET_UNIX_S:
        found.append(NOT_SET(when=when))
    elif facts.synchronised is not None:
        found.append((SYNCHRONISED if facts.synchronised else NOT_SYNCHRONISED)())
    if abs(facts.jumped_s) > JUMP_S:
        found.append(JUMPED(by=facts.jumped_s))
    return found


def against_vehicle(facts: ClockFacts) -> DoctorFinding:
    """Once an autopilot was heard."""
    by = facts.ahead_s
    if by is None:
        return VEHICLE_WITHOUT()
    if facts.signing and abs(by) > SIGNED_APART_S:
        return APART_AND_SIGNED(by=by)
    return (AGREES if abs(by) <= APART_S else APART)(by=by)
