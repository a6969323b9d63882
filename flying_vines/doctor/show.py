"""Prints findings: one line each, and what to do. Readable without colours, too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from flying_vines.doctor.finding import DoctorFinding, FindingLevel, may_fly, summary
from flying_vines.doctor.vehicle_probe import SwitchFacts

LABEL_WIDTH = 20
_SYMBOLS: dict[FindingLevel, tuple[str, str, str]] = {
    "good": ("✓", "ok", "green"),
    "warning": ("!", "look", "bold yellow"),
    "bad": ("✗", "BAD", "bold red"),
    "skipped": ("–", "-", "dim"),
}
"""The symbol on a terminal, the word in a pipe, and the style."""


def show(findings: Sequence[DoctorFinding], console: Console) -> None:
    for finding in findings:
        console.print(row(finding, console.is_terminal), soft_wrap=not console.is_terminal)


def row(finding: DoctorFinding, terminal: bool) -> Table | Text:
    """One finding. In a pipe, finding and remedy are one line each, of any length."""
    symbol, word, style = _SYMBOLS[finding.verdict]
    if not terminal:
        text = f"{word:<5}{finding.check + ':':<{LABEL_WIDTH + 1}} {finding.what}"
        return Text(f"{text}\n     → {finding.do}" if finding.do else text)
    table = Table.grid(padding=(0, 1))
    table.add_column(width=1, style=style)
    table.add_column(width=LABEL_WIDTH, style="dim" if finding.verdict == "skipped" else "bold")
    table.add_column(overflow="fold")
    what = Text(finding.what, style="" if finding.verdict == "good" else style.removeprefix("bold "))
    if finding.do:
        what.append(f"\n→ {finding.do}", style="default not bold not dim")
    table.add_row(symbol, finding.check, what)
    return table


def last_line(findings: Sequence[DoctorFinding]) -> Text:
    style = "bold green" if may_fly(findings) else "bold red"
    return Text(f"\n{summary(findings)}", style=style)


def as_json(findings: Sequence[DoctorFinding]) -> dict[str, Any]:
    return {"may_fly": may_fly(findings), "summary": summary(findings), "findings": [*map(asdict, findings)]}


def asking(radio: SwitchFacts, channel: int, positions: Sequence[str]) -> str:
    """The prompt while the user moves the switch."""
    if radio.problem is not None:
        now = radio.problem
    else:
        now = f"{radio.pulse_us} µs"
        if radio.position is not None:
            now += f", position {radio.position + 1}"
    seen = " ".join(f"{i + 1} ✓" if i in radio.seen else f"{i + 1} …" for i in range(len(positions)))
    return f"Move the switch (channel {channel}) through its positions: {seen}  now {now}"
