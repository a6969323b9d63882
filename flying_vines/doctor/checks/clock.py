"""Checks this computer's clock: it gives the logs' times and decides which signed messages are accepted."""

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
    """The kernel's answer; None if it gives none."""
    jumped_s: float = 0.0
    """Clock jump during the examination."""
    ahead_s: float | None = None
    """Lead over the autopilot's clock; None if the autopilot does not know the time."""
    signing: bool = False


SYNCHRONISED = FindingText("clock", "good", "synchronised")
NOT_SYNCHRONISED = FindingText(
    "clock",
    "warning",
    "not synchronised: the logs' times may be wrong",
    "connect it to a network before the flight, or use a real-time clock or GPS time (chrony)",
)
NOT_SET = FindingText(
    "clock", "warning", "not set: it shows {when}", "set it (sudo date -s …), or connect it to a network"
)
JUMPED = FindingText(
    "clock",
    "warning",
    "it jumped by {by:+.1f} s during this check",
    "wait until it is synchronised, then start the service",
)
AGREES = FindingText("clock", "good", "{by:+.2f} s from the autopilot's")
APART = FindingText(
    "clock",
    "warning",
    "{by:+.1f} s from the autopilot's",
    "set this computer's clock, otherwise its logs do not match the autopilot's",
)
APART_AND_SIGNED = FindingText(
    "clock",
    "bad",
    "{by:+.0f} s from the autopilot's, and messages are signed",
    "set this computer's clock: signed messages more than a minute old are refused",
)
VEHICLE_WITHOUT = FindingText("clock", "skipped", "the autopilot does not know the time yet (no GPS fix)")


def check(facts: ClockFacts, when: str) -> list[DoctorFinding]:
    """`when` is `facts.unix_s` as a date and time."""
    found = []
    if facts.unix_s < CLOCK_SET_UNIX_S:
        found.append(NOT_SET(when=when))
    elif facts.synchronised is not None:
        found.append((SYNCHRONISED if facts.synchronised else NOT_SYNCHRONISED)())
    if abs(facts.jumped_s) > JUMP_S:
        found.append(JUMPED(by=facts.jumped_s))
    return found


def against_vehicle(facts: ClockFacts) -> DoctorFinding:
    """Compares the clock with the autopilot's, if the autopilot knows the time."""
    by = facts.ahead_s
    if by is None:
        return VEHICLE_WITHOUT()
    if facts.signing and abs(by) > SIGNED_APART_S:
        return APART_AND_SIGNED(by=by)
    return (AGREES if abs(by) <= APART_S else APART)(by=by)
