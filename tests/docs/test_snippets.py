"""Every Python snippet of README.md and docs/ runs in a folder with the files that it reads."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from docs.commands_said import PAGES, ROOT
from docs.shelf import maker

pytestmark = pytest.mark.long
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LITERAL = re.compile(r'"([\w./-]+)"')
ELSEWHERE = "import clr"
"""A script for Mission Planner's own Python."""


def blocks(page: Path) -> list[str]:
    """The page's snippets, which may build on those before."""
    return [block for block in BLOCK.findall(page.read_text(encoding="utf-8")) if ELSEWHERE not in block]


WITH_SNIPPETS = [page for page in PAGES if blocks(page)]


@pytest.mark.parametrize("page", WITH_SNIPPETS, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_snippets_of_a_page_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "snippet"}
    for block in blocks(page):
        for word in LITERAL.findall(block):
            if not Path(word).exists() and (make := maker(word)) is not None:
                (tmp_path / word).parent.mkdir(parents=True, exist_ok=True)
                make(tmp_path / word)
        exec(compile(block, str(page), "exec"), names)
