"""A text for the pilot, shown on the terminal and on the ground station."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class Severity(IntEnum):
    """Values of MAVLink's MAV_SEVERITY."""

    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6
    DEBUG = 7
    """Only logged, because there may be very many."""


@dataclass(frozen=True, slots=True)
class Notice:
    """A sentence for the pilot, at time `t`."""

    t: float
    severity: Severity
    text: str
    of_decision: bool = False
    """The text repeats a decision, for displays that do not show decisions."""
    source: str = ""
    """Whose request caused the text; empty for what the service itself finds, such as losses and faults."""
    condition: str = ""
    """The name of what was lost or is back, such as "RC"; empty for a text about something else."""
    ended: bool = False
    """The condition is good again."""
