"""Findings, and the lines that a check can print. docs/doctor.md lists what is checked."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

FindingLevel = Literal["good", "warning", "bad", "skipped"]
"""Only "bad" means "do not fly"."""


@dataclass(frozen=True, slots=True)
class DoctorFinding:
    """One line of the doctor: what was checked, the result, and what to do."""

    check: str
    verdict: FindingLevel
    what: str
    do: str = ""


@dataclass(frozen=True, slots=True)
class FindingText:
    """A line that a check can print, with `{names}` for its values."""

    check: str
    verdict: FindingLevel
    what: str
    do: str = ""

    def __call__(self, **found: object) -> DoctorFinding:
        return DoctorFinding(
            self.check.format(**found), self.verdict, self.what.format(**found), self.do.format(**found)
        )


def may_fly(findings: Iterable[DoctorFinding]) -> bool:
    return all(finding.verdict != "bad" for finding in findings)


def summary(findings: Iterable[DoctorFinding]) -> str:
    """The doctor's last line."""
    verdicts = [finding.verdict for finding in findings]
    bad, warnings = verdicts.count("bad"), verdicts.count("warning")
    to_check = f"{warnings} {'thing' if warnings == 1 else 'things'} to check"
    if bad:
        rest = f", and {to_check}" if warnings else ""
        return f"Do not fly: {bad} {'thing' if bad == 1 else 'things'} to correct{rest}."
    return f"You may fly; {to_check}." if warnings else "You may fly."
