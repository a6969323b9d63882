"""All lines that the doctor can print."""

from __future__ import annotations

import re

from flying_vines.doctor import computer, configuration, firmware, network, ports, processes, radio, vehicle
from flying_vines.doctor.finding import DoctorFinding, FindingText

_BLANK = re.compile(r"\{(\w+)[^}]*\}")


def every_line() -> list[FindingText]:
    modules = (configuration, computer, network, ports, processes, firmware, vehicle, radio)
    return [value for module in modules for value in vars(module).values() if isinstance(value, FindingText)]


def matches(line: FindingText, finding: DoctorFinding) -> bool:
    """True if a finding is this line, with its gaps filled."""
    templates, texts = (line.check, line.what, line.do), (finding.check, finding.what, finding.do)
    return line.verdict == finding.verdict and all(map(_fits, templates, texts))


def _fits(template: str, text: str) -> bool:
    fixed = _BLANK.split(template)[::2]
    return re.fullmatch(".*".join(map(re.escape, fixed)), text, re.DOTALL) is not None
