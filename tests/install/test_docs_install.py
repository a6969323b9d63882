"""docs/install.md agrees with the command and its unit."""

from __future__ import annotations

import argparse
import re
from importlib.metadata import distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from flying_vines.cli import install as command
from flying_vines.install import files

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "install.md").read_text(encoding="utf-8")
MAKEFILE = dict(re.findall(r"^(\w+) := (.*)", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
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


def needed_by(name: str, extras: set[str], python: str) -> set[str]:
    """The distributions that an installer brings for this Python, with all their dependencies."""
    found: set[str] = set()
    environment = {"python_version": python, "python_full_version": f"{python}.0"}
    for requirement in map(Requirement, distribution(name).requires or []):
        marker = requirement.marker
        if marker and not any(marker.evaluate({**environment, "extra": extra}) for extra in extras | {""}):
            continue
        if (needed := canonicalize_name(requirement.name)) not in found:
            found |= {needed} | needed_by(needed, requirement.extras, python)
    return found


def test_wheels_for_a_drone_without_network_are_those_of_each_python() -> None:
    """pip evaluates the conditions of dependencies with the Python that it runs on."""
    pythons = (*MAKEFILE["PYTHONS"].split(), "3.12", "3.14")
    needed = [needed_by("flying-vines", set(MAKEFILE["EXTRAS"].split(",")), python) for python in pythons]
    of_all = needed[0].intersection(*needed)
    assert needed[0].union(*needed) - of_all <= set(MAKEFILE["IN_ADDITION"].split())
    assert {"msgspec", "numba", "mavsdk"} < of_all


def test_the_page_names_the_pythons_and_the_machine_of_make_wheels() -> None:
    first, last = MAKEFILE["PYTHONS"].split()
    assert f"Python {first} and {last} on 64-bit ARM" in " ".join(PAGE.split())
    assert MAKEFILE["MACHINE"] == "aarch64"
