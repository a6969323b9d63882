"""Findings, the lines that a check can print, and how they look. docs/doctor.md lists what is checked."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from rich.console import Console
from rich.table import Table
from rich.text import Text

FindingLevel = Literal["good", "warning", "bad", "skipped"]
"""Only "bad" means "do not fly"."""

LABEL_WIDTH = 20
_SYMBOLS: dict[FindingLevel, tuple[str, str, str]] = {
    "good": ("✓", "ok", "green"),
    "warning": ("!", "look", "bold yellow"),
    "bad": ("✗", "BAD", "bold red"),
    "skipped": ("–", "-", "dim"),
}
"""The symbol on a terminal, the word in a pipe, and the style."""


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
        """The finding. Values that the line does not name are left out."""
        check, what, do = (text.format(**found) for text in (self.check, self.what, self.do))
        return DoctorFinding(check, self.verdict, what, do)


@dataclass(frozen=True, slots=True)
class Subject:
    """What is checked, and its lines. A line about a fault has a remedy."""

    check: str

    def good(self, what: str) -> FindingText:
        return FindingText(self.check, "good", what)

    def skipped(self, what: str) -> FindingText:
        return FindingText(self.check, "skipped", what)

    def warning(self, what: str, do: str) -> FindingText:
        return FindingText(self.check, "warning", what, do)

    def bad(self, what: str, do: str) -> FindingText:
        return FindingText(self.check, "bad", what, do)


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


def show(findings: Sequence[DoctorFinding], console: Console) -> None:
    """One line each, and what to do. Readable without colours, too."""
    for finding in findings:
        console.print(_row(finding, console.is_terminal), soft_wrap=not console.is_terminal)


def _row(finding: DoctorFinding, terminal: bool) -> Table | Text:
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


def last_line(findings: Sequence[DoctorFinding], text: str) -> Text:
    return Text(f"\n{text}" if text else "", style="bold green" if may_fly(findings) else "bold red")


def as_json(findings: Sequence[DoctorFinding]) -> dict[str, Any]:
    return {"may_fly": may_fly(findings), "summary": summary(findings), "findings": [*map(asdict, findings)]}
