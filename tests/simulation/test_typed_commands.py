"""Typed lines that fly the simulated autopilot and inject faults into the simulated phloSAR."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

import pytest

from flying_vines.physics.plant.effects import Effects
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.phlosar.mishaps import Drifting, Hole, HoseOff, MishapKind, Mishaps, Unpowered
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.simulation.typed_commands import HELP, MISHAPS, inject_typed, obey, type_to


def test_lines_fly_the_vehicle() -> None:
    autopilot = FakeAutopilot("ardupilot")
    autopilot.advance(0.0)
    for line in ("rc 9 2000", "takeoff 10", ""):
        assert obey(autopilot, line) == ""
    autopilot.advance(10.0)
    assert autopilot.armed
    assert autopilot.flight.height_m == pytest.approx(10.0)
    obey(autopilot, "land")
    autopilot.advance(40.0)
    assert not autopilot.armed


@pytest.mark.parametrize("line", ["help", "takeoff", "rc 9", "land now"])
def test_an_unknown_line_gets_the_list(line: str) -> None:
    assert obey(FakeAutopilot("ardupilot"), line) == HELP


@pytest.mark.parametrize("line", ["takeoff high", "rc nine 1500", "mode NONSENSE"])
def test_an_error_is_reported(line: str) -> None:
    assert obey(FakeAutopilot("ardupilot"), line).startswith(line.split()[0] + ": ")


@pytest.mark.parametrize(
    ("line", "place", "kind"),
    [
        ("cv_sensor drifting -2", "cv_sensor", Drifting(-2.0)),
        ("hose off", "hose", HoseOff()),
        ("actuator hole 0.3", "actuator", Hole(0.3)),
        ("board unpowered", "board", Unpowered()),
    ],
)
def test_lines_inject_faults_and_end_them(line: str, place: str, kind: MishapKind) -> None:
    phlosar = SimulatedPhlosar(effects=Effects())
    for mending in (f"{place} well", "well"):
        assert inject_typed(phlosar, line) == ""
        assert phlosar.mishaps == Mishaps(**{place: kind})  # type: ignore[arg-type]
        assert inject_typed(phlosar, mending) == ""
        assert phlosar.mishaps == Mishaps()


def test_lines_fill_the_reservoir() -> None:
    phlosar = SimulatedPhlosar(effects=Effects())
    assert inject_typed(phlosar, "reservoir filled 300") == inject_typed(phlosar, "") == ""
    assert phlosar.reservoir_kPa == pytest.approx(300.0)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("help", MISHAPS),
        ("evp", "evp may have: stuck opening"),
        ("hose burst", "hose may have: off, kinked [flow_resistance_kPa_s_per_SL]"),
        ("evp stuck", "evp takes: stuck opening"),
        ("hose off 3", "hose takes: off"),
        ("evp stuck 7", "an opening must be in 0…1"),
        ("evp stuck nan", "stuck nan: numbers must be finite"),
        ("evp stuck open", "stuck open: could not convert string to float: 'open'"),
    ],
)
def test_an_impossible_fault_is_reported(line: str, said: str) -> None:
    phlosar = SimulatedPhlosar(effects=Effects())
    assert inject_typed(phlosar, line) == said
    assert phlosar.mishaps == Mishaps()


def test_without_a_terminal_nothing_is_waited_for(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    with Path("/dev/null").open() as nobody:
        monkeypatch.setattr(sys, "stdin", nobody)
        asyncio.run(type_to(lambda line: line))
    assert capfd.readouterr() == ("", "")
