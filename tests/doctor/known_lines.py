"""All lines that the doctor can print."""

from __future__ import annotations

import re
from types import ModuleType

from flying_vines.doctor.checks import (
    clock,
    configuration,
    disk,
    firmware,
    machine,
    mission,
    network,
    port,
    radio,
    receiver,
    service,
    vehicle,
)
from flying_vines.doctor.finding import DoctorFinding, FindingText

CHECKS: tuple[ModuleType, ...] = (
    configuration,
    machine,
    disk,
    network,
    port,
    service,
    firmware,
    vehicle,
    radio,
    mission,
    clock,
    receiver,
)
"""In the order of the report."""

_BLANK = re.compile(r"\{(\w+)[^}]*\}")


def lines_of(check: ModuleType) -> list[FindingText]:
    """The lines of one check. The two ports have the same lines, so only those of the phloSAR's port
    count."""
    if check is port:
        return list(port.LINES["phloSAR"].values())
    return [value for value in vars(check).values() if isinstance(value, FindingText)]


def every_line() -> list[FindingText]:
    return [line for check in CHECKS for line in lines_of(check)]


def matches(line: FindingText, finding: DoctorFinding) -> bool:
    """True if a finding is this line, with its gaps filled."""
    templates, texts = (line.check, line.what, line.do), (finding.check, finding.what, finding.do)
    return line.verdict == finding.verdict and all(map(_fits, templates, texts))


def _fits(template: str, text: str) -> bool:
    fixed = _BLANK.split(template)[::2]
    return re.fullmatch(".*".join(map(re.escape, fixed)), text, re.DOTALL) is not None
