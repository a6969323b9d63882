"""The page on the doctor says what the code says: each line with what to do, what to set for a stream."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from doctor.known_lines import CHECKS, lines_of, with_blanks
from flying_vines.config import config
from flying_vines.doctor.checks.vehicle import USES
from flying_vines.doctor.finding import Line
from flying_vines.vehicle.autopilots.ardupilot import STREAM_GROUPS
from flying_vines.vehicle.streams import Streams

PAGE = (Path(__file__).parents[2] / "docs" / "doctor.md").read_text(encoding="utf-8")
SIGNS = {"good": "✓", "warning": "!", "bad": "✗", "skipped": "–"}


def row(line: Line) -> str:
    cells = (SIGNS[line.verdict], line.check, line.what, line.do)
    return "| " + " | ".join(map(with_blanks, cells)) + " |"


def table(check: ModuleType) -> str:
    """What is to stand on the page of one file of checks."""
    heading = ["| | looked at | says | do |", "| --- | --- | --- | --- |"]
    return "\n".join([*heading, *map(row, lines_of(check))])


def stream_table() -> str:
    rows = ["| message | a second | needed for | on ArduPilot |", "| --- | --- | --- | --- |"]
    for name, wanted in Streams(config.default().vehicle.rc_rate_Hz).wanted(0.0).items():
        need = f"{'**' if wanted.essential else ''}{USES[name]}{'**' if wanted.essential else ''}"
        rows.append(f"| {name} | {wanted.rate_Hz:g} | {need} | `SRn_{STREAM_GROUPS[name]}` |")
    return "\n".join(rows)


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__.rpartition(".")[2])
def test_every_line_is_on_the_page(check: ModuleType) -> None:
    assert table(check) in PAGE, f"docs/doctor.md should have:\n{table(check)}"


def test_every_stream_is_on_the_page() -> None:
    assert stream_table() in PAGE, f"docs/doctor.md should have:\n{stream_table()}"


def test_no_other_line_is_on_the_page() -> None:
    signs = tuple(f"| {sign} |" for sign in SIGNS.values())
    said = {text for text in PAGE.splitlines() if text.startswith(signs)}
    assert said == {row(line) for check in CHECKS for line in lines_of(check)}
