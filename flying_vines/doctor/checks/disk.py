"""Checks the folders of logs and state: writable, free space, speed of the card."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from flying_vines.doctor.finding import DoctorFinding, FindingText

SLOW_S = 0.5
"""Limit for writing and syncing a few kilobytes. The recorder does this twice a second."""


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


GOOD = FindingText("disk", "good", "{folder} for {use}: {free:.0f} MB free, a write takes {took:.0f} ms")
NO_LOGS = FindingText(
    "disk",
    "bad",
    "{folder}: no flight log can be written there: {why}",
    "use another folder (--out), or correct its permissions",
)
NO_STATE = FindingText(
    "disk",
    "warning",
    "{folder}: parameters and disarming cannot be saved there: {why}",
    "set state.folder to a folder that the service's user may write",
)
FULL = FindingText(
    "disk",
    "warning",
    "{folder} for {use}: {free:.0f} MB free; below {least:.0f} nothing is recorded",
    "delete old flights; the recorder deletes nothing",
)
SLOW = FindingText(
    "disk",
    "warning",
    "{folder} for {use}: writing a few kilobytes takes {took:.0f} ms",
    "use a faster card: data that is not yet written is lost when the power fails",
)


def check(facts: DiskFacts) -> DoctorFinding:
    if facts.problem:
        return (NO_LOGS if facts.use == "flight logs" else NO_STATE)(folder=facts.folder, why=facts.problem)
    if facts.free_MB < facts.least_free_MB:
        return FULL(folder=facts.folder, use=facts.use, free=facts.free_MB, least=facts.least_free_MB)
    line = SLOW if facts.took_s > SLOW_S else GOOD
    return line(folder=facts.folder, use=facts.use, free=facts.free_MB, took=facts.took_s * 1e3)
