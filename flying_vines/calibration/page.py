"""A calibration as one page that opens offline: the findings, and the figures of data and fits."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from flying_vines.calibration.conductor import Conducted
from flying_vines.calibration.procedure import change, measured, notes
from flying_vines.identification.report.templates import filled


def page(title: str, conducted: Conducted, pictures: Mapping[str, bytes]) -> str:
    """The whole page; `pictures` are SVG, by the charts' names."""
    findings = conducted.findings
    return filled(
        Path(__file__).with_name("calibration.html"),
        pictures,
        title=title,
        sentence=conducted.ended.sentence,
        findings=[(finding, *measured(finding), change(finding)) for finding in findings.findings],
        notes=notes(findings),
        charts=conducted.charts,
    )
