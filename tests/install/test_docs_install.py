"""docs/install.md agrees with the command and its unit."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import pytest

from flying_vines.cli import install as command
from flying_vines.install import files

PAGE = (Path(__file__).parents[2] / "docs" / "install.md").read_text(encoding="utf-8")
UNIT = files.unit(("flying-vines",), files.USER, files.CONFIGURATION, (), files.STATE).text


def test_every_option_has_its_row() -> None:
    commands = argparse.ArgumentParser().add_subparsers()
    command.add(commands)
    options = set(re.findall(r"--[a-z-]+", commands.choices["install-service"].format_help())) - {"--help"}
    assert set(re.findall(r"^\| `(--[a-z-]+)", PAGE, re.MULTILINE)) == options


@pytest.mark.parametrize("path", [files.CONFIGURATION, files.UNIT, files.RULE, files.USERS, files.STATE])
def test_every_file_has_its_row(path: Path) -> None:
    assert re.search(rf"^\| `{path}/?` \|", PAGE, re.MULTILINE)


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("WatchdogSec=4", "After 4 s of silence systemd aborts it"),
        ("RestartSec=1", "a new start after a second"),
        ("StartLimitIntervalSec=0", "however often"),
        ("RestartPreventExitStatus=2", "(exit status 2)"),
        ("MemoryMax=384M", "at most 384 MB"),
        ("TasksMax=64", "64 threads"),
        ("StateDirectory=flying-vines", "read-only except `/var/lib/flying-vines`"),
        ("SupplementaryGroups=dialout", "the group dialout"),
    ],
)
def test_the_unit_has_the_settings_that_the_page_states(setting: str, said: str) -> None:
    assert f"\n{setting}\n" in UNIT
    assert said in " ".join(PAGE.split())
