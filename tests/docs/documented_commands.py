r"""The commands in the guides, each with its place, as a person types them.

- A fenced block of `sh`: each line. A fenced block without a language: each line behind a `$ `.
- An indented block: each line that begins with a program. A span of code: that which begins with a program.
- Text after ` # ` is a comment. `\` at a line's end continues the line.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))

PROGRAMS = "flying-vines|make|python3?|pip|sudo|printf|mkdir"
"""Other programs are not run."""
BEGINS = re.compile(rf"(?:\S*/)?(?:{PROGRAMS}) \S")
FENCE = re.compile(r"\s*```(.*)")
SPAN = re.compile(r"`([^`]+)`")
OURS = re.compile(r"(?<!\S)(?:\S*/)?flying-vines (.*)")


@dataclass(frozen=True, slots=True)
class DocumentedCommand:
    """A command on a page: its text without comment and without the path of the environment."""

    page: Path
    line: int
    text: str
    given: str
    """The original text, without comment."""

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}: {self.given}"

    @property
    def ours(self) -> list[str]:
        """The words after `flying-vines`, if only `sudo` stands before it."""
        found = OURS.fullmatch(self.text.removeprefix("sudo "))
        return shlex.split(found[1]) if found and not needs_a_shell(self.text) else []


def needs_a_shell(text: str) -> bool:
    """True if the text has characters with a meaning for a shell."""
    bare = re.sub(r"'[^']*'", "", text)
    return bool(re.search(r"[|&;<>$*]", bare))


def blocks_and_spans(page: Path) -> tuple[list[DocumentedCommand], list[DocumentedCommand]]:
    """The commands in a page's blocks, and all its spans of code, in the order of the page."""
    text = page.read_text(encoding="utf-8")
    given = [_documented(page, line, given) for line, given in _in_blocks(text)]
    spans = [_documented(page, line, given) for line, given in _in_spans(text)]
    return given, spans


def _documented(page: Path, line: int, given: str) -> DocumentedCommand:
    given = re.sub(r"\s+# .*$", "", given).strip()
    text = re.sub(r"(?<!\S)(?:\.venv|/opt/flying-vines)/bin/", "", given)
    return DocumentedCommand(page, line, text, given)


def _in_blocks(text: str) -> Iterator[tuple[int, str]]:
    lines = text.splitlines()
    fence: str | None = None
    at = 0
    while at < len(lines):
        number, line = at + 1, lines[at]
        if mark := FENCE.match(line):
            fence = None if fence is not None else mark[1].strip()
        elif (command := _command(line, fence)) is not None:
            while command.endswith("\\"):
                at += 1
                command = f"{command[:-1].rstrip()} {lines[at].strip()}"
            yield number, command
        at += 1


def _command(line: str, fence: str | None) -> str | None:
    words = line.strip()
    if fence in ("sh", "bash", "shell"):
        return words.removeprefix("$ ") if words and not words.startswith("#") else None
    if fence in ("", "console"):
        return words.removeprefix("$ ") if words.startswith("$ ") else None
    if fence is None and line.startswith("    ") and BEGINS.match(words):
        return words
    return None


def _in_spans(text: str) -> Iterator[tuple[int, str]]:
    """Spans may continue on the next line; blocks have none."""
    blank = re.sub(r"^\s*```.*?^\s*```", lambda block: "\n" * block[0].count("\n"), text, flags=re.M | re.S)
    blank = re.sub(r"^    .*$", "", blank, flags=re.M)
    for span in SPAN.finditer(blank):
        yield blank.count("\n", 0, span.start()) + 1, " ".join(span[1].split())
