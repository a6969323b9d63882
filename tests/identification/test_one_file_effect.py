"""One file adds an effect: to the plant, to the diagnosis, and to rig files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flying_vines.identification.case import Case, RecordedRun, read_case
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.verdict import extended_rig
from flying_vines.physics import effects
from flying_vines.physics.effects import catalogue, cause_named, setup
from flying_vines.physics.plant.true_rig import TrueRig, load_true_rig, true_rig_text
from flying_vines.physics.rig import ControlVolume, Reservoir, Rig
from flying_vines.simulation.scenario import parse_scenario, simulate_scenario, write_case

BELIEVED = replace(Rig(), reservoir=Reservoir(2.0), cv=ControlVolume(0.2))
FILE = '''
"""The solenoid chokes: it follows ISO 6358 with the flow of Ohm's law at 20 kPa."""

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.flow import iso6358_matching
from flying_vines.physics.plant.plant import Setup


def apply(base: Setup, critical_pressure_ratio: float) -> Setup:
    resistance = base.plant.rig.solenoid.flow_resistance_kPa_s_per_SL
    law = iso6358_matching(resistance, 20.0, critical_pressure_ratio=critical_pressure_ratio)
    return base.with_effects(solenoid_law=law)


CAUSE = Cause(
    name="solenoid_choked",
    what="The solenoid chokes.",
    parameters=(
        Parameter("critical_pressure_ratio", 0.0, 0.95, seeds=(0.3,), neutral=None, source="made up"),
    ),
    experiment="Vent the control volume from its highest pressure.",
    apply=apply,
)
'''
SCENARIO = """
[[runs]]
kind = "steps"
reservoir_kPa = 450
pressures_kPa = [40, 15, 30, 0]
hold_s = 3
[[runs]]
kind = "openings"
reservoir_kPa = 450
valves = [{ for_s = 2, evp = 1, until_kPa = 45 }, { for_s = 2, solenoid = true }]
"""
SUSPECTS = ("solenoid_choked", "cv_leak", "evp_lag", "dead_volume")


@pytest.fixture
def another_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    folder = tmp_path / "effects"
    folder.mkdir()
    (folder / "solenoid_choked.py").write_text(FILE, encoding="utf-8")
    monkeypatch.setattr(effects, "__path__", [*effects.__path__, str(folder)])
    catalogue.cache_clear()
    yield
    catalogue.cache_clear()


@pytest.mark.usefixtures("another_file")
def test_one_more_file_is_simulated_found_and_written(tmp_path: Path) -> None:
    hidden = TrueRig(BELIEVED, {"solenoid_choked": {"critical_pressure_ratio": 0.4}})
    assert hidden.setup == setup(BELIEVED, "solenoid_choked", critical_pressure_ratio=0.4)
    runs = simulate_scenario(hidden, parse_scenario(SCENARIO, "short"), seed=1)
    write_case(runs, true_rig_text(TrueRig(BELIEVED)).encode(), tmp_path / "case")

    case = read_case(tmp_path / "case")
    verdict = diagnose(case, [cause for cause in catalogue() if cause.name in SUSPECTS])
    assert verdict.cause == "solenoid_choked" and verdict.also == ()
    estimate = verdict.parameters["critical_pressure_ratio"]
    assert estimate.estimate == pytest.approx(0.4, abs=0.05)

    (tmp_path / "rig.toml").write_text(true_rig_text(extended_rig(case.rig, verdict)), encoding="utf-8")
    found = load_true_rig(tmp_path / "rig.toml")
    assert found.causes == {"solenoid_choked": {"critical_pressure_ratio": estimate.estimate}}
    assert found.setup.plant.effects.solenoid_law is not None


def test_without_the_file_its_name_is_unknown() -> None:
    assert "solenoid_choked" not in {cause.name for cause in catalogue()}


def test_the_next_experiment_separates_a_cause_from_elsewhere_too() -> None:
    """One discharge does not separate a wrong volume from a wrong flow of its valve; another valve does."""
    dented = replace(cause_named("reservoir_volume"), name="dented")
    time_s = np.arange(0.0, 60.0)
    shut, unread_kPa = np.zeros(len(time_s)), np.full(len(time_s), np.nan)
    read_kPa = 690.0 * np.exp(-time_s / 30.0) + np.random.default_rng(1).normal(0.0, 1.2, len(time_s))
    run = RecordedRun(
        "run", time_s, None, shut + 1.0, shut, shut + 1.0, unread_kPa, read_kPa, None, None, True
    )
    case = Case(Path("memory"), Rig(cv=None), (run,), ())
    verdict = diagnose(case, [cause_named("evp_restriction"), dented])
    assert {verdict.cause, *verdict.indistinguishable} == {"evp_restriction", "dented"}
    assert "discharge_dvp" in verdict.next_experiment
    assert "they separate dented from evp_restriction by" in verdict.next_experiment or (
        "they separate evp_restriction from dented by" in verdict.next_experiment
    )
