from __future__ import annotations

import asyncio
import sys
from pathlib import Path

import pytest

from flying_vines.fakes.autopilot import Autopilot
from flying_vines.fakes.console import HELP, obey, type_to


def test_lines_fly_the_vehicle() -> None:
    autopilot = Autopilot("ardupilot")
    autopilot.advance(0.0)
    for line in ("rc 9 2000", "takeoff 10", ""):
        assert obey(autopilot, line) == ""
    autopilot.advance(10.0)
    assert autopilot.armed
    assert autopilot.height_m == pytest.approx(10.0)
    obey(autopilot, "land")
    autopilot.advance(40.0)
    assert not autopilot.armed


@pytest.mark.parametrize("line", ["help", "takeoff", "rc 9", "land now"])
def test_what_is_not_understood_gets_the_list(line: str) -> None:
    assert obey(Autopilot("ardupilot"), line) == HELP


@pytest.mark.parametrize("line", ["takeoff high", "rc nine 1500", "mode NONSENSE"])
def test_what_is_wrong_is_said(line: str) -> None:
    assert obey(Autopilot("ardupilot"), line).startswith(line.split()[0] + ": ")


def test_where_nobody_can_type_nothing_is_waited_for(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    with Path("/dev/null").open() as nobody:
        monkeypatch.setattr(sys, "stdin", nobody)
        asyncio.run(type_to(Autopilot("ardupilot")))
    assert capfd.readouterr() == ("", "")
