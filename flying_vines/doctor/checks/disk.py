"""Where logs and state go: can it be written, is there room, how long does the card take?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from flying_vines.doctor.finding import DoctorFinding, FindingText

SLOW_S = 0.5
"""To put a few kilobytes on the disk for good. The recorder does so twice a second."""


@dataclass(frozen=True, slots=True)
class DiskFacts:
    """One folder."""

    use: Literal["flight logs", "state"]
    folder: str
    problem: str = ""
    """Why nothing can be written there."""
    free_MB: float = 0.0
    least_free_MB: float = 0.0
    """Below which nothing more is recorded."""
    took_s: float = 0.0


GOOD = FindingText("disk", "good", "{folder} for {use}: {free:.0f} MB free, on the disk within {took:.0f} ms")
NO_LOGS = FindingText(
    "disk",
    "bad",
    "{folder}: no flight log can be written there: {why}",
    "run from another folder, or give another one with --out; or mend its rights",
)
NO_STATE = FindingText(
    "disk",
    "warning",
    "{folder}: parameters and disarming cannot be kept there: {why}",
    "set state.folder to one that the service's user may write",
)
FULL = FindingText(
    "disk",
    "warning",
    "{folder} for {use}: {free:.0f} MB free; below {least:.0f} nothing is recorded",
    "take old flights away; nothing is deleted by itself",
)
SLOW = FindingText(
    "disk",
    "warning",
    "{folder} for {use}: the disk takes {took:.0f} ms for a few kilobytes",
    "use another card: when the power goes, what has not arrived is lost",
)


def check(facts: DiskFacts) -> DoctorFinding:
    if facts.problem:
        return (NO_LOGS if facts.use == "flight logs" else NO_STATE)(folder=facts.folder, why=facts.problem)
    if facts.free_MB < facts.least_free_MB:
        return FULL(folder=facts.folder, use=facts.use, free=facts.free_MB, least=facts.least_free_MB)
    line = SLOW if facts.took_s > SLOW_S else GOOD
    return line(folder=facts.folder, use=facts.use, free=facts.free_MB, took=facts.took_s * 1e3)
