"""A calibration as one page that opens offline: what was found, and the pictures that it rests on."""

from __future__ import annotations

from collections.abc import Mapping

from flying_vines.calibration.conductor import Conducted
from flying_vines.calibration.procedure import change, measured, notes
from flying_vines.identification.report.markup import (
    Html,
    Row,
    bullets,
    document,
    heading,
    joined,
    paragraph,
    picture,
    safe,
    table,
)
from flying_vines.identification.report.sheet import STYLE


def page(title: str, conducted: Conducted, pictures: Mapping[str, bytes]) -> str:
    """The whole page; `pictures` are SVG, by the charts' names."""
    findings, charts, sentence = conducted.findings, conducted.charts, conducted.ended.sentence
    rows = []
    for finding in findings.findings:
        believed = "" if finding.believed is None else f"{finding.believed:.4g}"
        rows.append(Row((finding.what, finding.unit, believed, *measured(finding), change(finding))))
    noted = notes(findings)
    body = (
        paragraph(title, kind="eyebrow"),
        Html(f"<h1>{safe(sentence)}</h1>\n"),
        table(("quantity", "unit", "believed>", "measured>", "95 % interval>", "change>"), rows),
        bullets(noted) if noted else "",
        heading("What it rests on"),
        *(picture(pictures[chart.name], chart.title, chart.note or chart.title) for chart in charts),
        Html("<footer>Pressures are gauge. This page holds all that it shows.</footer>\n"),
    )
    return document(title, STYLE, joined(part for part in body if part))
