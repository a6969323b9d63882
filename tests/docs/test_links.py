"""Every link of the guides leads to a file and heading that exist, and every guide is linked."""

from __future__ import annotations

import re
import runpy
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
ROOMS = (DOCS, ROOT / "missions", ROOT / "tests" / "data")
PAGES = sorted([ROOT / "README.md", *(page for room in ROOMS for page in room.rglob("*.md"))])
CODE = re.compile(r"^ *```.*?^ *```|^(?:    [^\n]*\n)+|`[^`\n]+`", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)|\bsrc=\"([^\"]+)\"")
HEADING = re.compile(r"^#+ +(.*?) *$", re.MULTILINE)
ELSEWHERE = ("http://", "https://", "mailto:")


def targets(page: Path) -> list[str]:
    """The targets of a page's links and pictures within the project."""
    text = CODE.sub("", page.read_text(encoding="utf-8"))
    found = (link or source for link, source in LINK.findall(text))
    return [target for target in found if not target.startswith(ELSEWHERE)]


@cache
def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as on GitHub."""
    text = re.sub(r"^ *```.*?^ *```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    seen: Counter[str] = Counter()
    made = set()
    for heading in HEADING.findall(text):
        shown = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        anchor = re.sub(r"[^\w\- ]", "", shown).replace(" ", "-")
        made.add(f"{anchor}-{seen[anchor]}" if seen[anchor] else anchor)
        seen[anchor] += 1
    return made


def dead(page: Path) -> list[str]:
    """The links of a page without a target."""
    found = []
    for target in targets(page):
        path, _, anchor = target.partition("#")
        there = (page.parent / path).resolve() if path else page
        if not there.exists() or (anchor and anchor not in anchors(there)):
            found.append(target)
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_somewhere(page: Path) -> None:
    assert not dead(page)


def test_every_picture_is_redrawn_by_one_command_or_by_hand() -> None:
    pytest.importorskip("PIL", reason="needs Pillow: pip install pillow")
    drawn = [name for names in runpy.run_path(str(DOCS / "redraw.py"))["SHEETS"] for name in names]
    assert sorted([*drawn, "architecture.svg", "wiring.svg"]) == sorted(
        picture.name for picture in (DOCS / "images").iterdir()
    )


def test_the_index_has_every_guide_once() -> None:
    index = DOCS / "README.md"
    listed = [target for target in targets(index) if target.endswith(".md") and "/" not in target]
    assert sorted(listed) == sorted(page.name for page in DOCS.glob("*.md") if page != index)


def test_every_picture_is_shown() -> None:
    shown = {(page.parent / target).resolve() for page in PAGES for target in targets(page)}
    assert not set((DOCS / "images").iterdir()) - shown


def test_a_dead_link_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "# One `two`\n\n[a](#one-two) [b](#three) [c](none.md) ![d](none.png) [e](page.md#one-two)\n"
    )
    assert dead(page) == ["#three", "none.md", "none.png"]
