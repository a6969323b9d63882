"""The page on the recorder names all topics, and only these."""

from __future__ import annotations

import re
from pathlib import Path

from flying_vines.record.topics import TOPICS

PAGE = (Path(__file__).parents[2] / "docs" / "recorder.md").read_text(encoding="utf-8")


def test_every_topic_is_in_the_table() -> None:
    rows = PAGE.partition("| topic | what | when |")[2].partition("\n\n")[0].splitlines()
    named = [name for row in rows for name in re.findall(r"`([^`]+)`", row.split("|")[1] if row else "")]
    assert sorted(named) == sorted(topic.name for topic in TOPICS)
