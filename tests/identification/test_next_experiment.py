"""If a verdict leaves something open, the next experiment is computed for the rig."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from hidden_truth import draw
from rich.console import Console

from flying_vines.identification import next_experiment
from flying_vines.identification.candidate import Candidate
from flying_vines.identification.case import Case
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.fit import FitProblem
from flying_vines.identification.noise import stated_noise
from flying_vines.identification.plan import recommend
from flying_vines.identification.plan.library import library
from flying_vines.identification.report import page
from flying_vines.identification.show import show
from flying_vines.physics.cause import Cause
from flying_vines.physics.effects import cause_named, causes_of
from flying_vines.physics.rig import Pump, Rig


@pytest.mark.long
def test_unexplained_data_ask_for_the_runs_that_separate_the_nearest_causes(
    short_case: Case, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def spy(rig: Rig, doubt: list[Cause], *more: object, **limits: float) -> object:
        asked.append((doubt, limits))
        return recommend(rig, doubt, *more, **limits)  # type: ignore[arg-type]

    monkeypatch.setattr(next_experiment, "recommend", spy)
    # Without the hidden cause, which is then an unknown effect.
    verdict = diagnose(short_case, [cause_named("evp_lag"), cause_named("line_delay")])
    assert verdict.cause == "unexplained"
    ((doubt, limits),) = asked
    assert {cause.name for cause in doubt} <= {"evp_lag", "line_delay", "none"}
    assert all(cause.name in verdict.next_experiment for cause in doubt)
    # The rig has already been at these pressures.
    assert limits["full_kPa"] == max(run.reservoir_kPa.max() for run in short_case.runs)
    assert limits["most_kPa"] == max(run.cv_kPa.max() for run in short_case.runs)

    printed = io.StringIO()
    show(verdict, Console(file=printed, width=2000))
    assert verdict.next_experiment in printed.getvalue()
    assert json.loads(json.dumps(verdict.as_json()))["next_experiment"] == verdict.next_experiment
    assert verdict.next_experiment in page(verdict, short_case, {})


def test_no_recommended_run_goes_above_the_pressures_of_the_rig() -> None:
    for most_kPa, full_kPa in ((20.7, 690.0), (150.0, 240.0), (300.0, 320.0)):
        runs = library(Rig(), most_kPa, full_kPa)
        assert {run.name for run in runs} >= {"staircase", "discharge_evp", "opening_stairs"}
        for run in runs:
            assert run.make(run.counts[-1]).reservoir_kPa <= full_kPa


def test_a_rig_with_a_pump_and_a_reservoir_alone_have_runs_of_their_own() -> None:
    pump = replace(Rig(), pump=Pump())
    assert {run.name for run in library(pump)} == {
        *("opening_stairs", "fill_hold_fast_full", "fill_hold_slow_full", "vent_solenoid", "pulses")
    }
    alone = library(replace(Rig(), cv=None), rest_s=400.0)
    rest = next(run for run in alone if run.name == "rest_low")
    assert rest.make(4).length_s == pytest.approx(400.0)
    shut = library(replace(Rig(), cv=None), outlets=())
    assert {run.name for run in shut} == {"rest_full", "rest_half", "rest_low"}


def test_leaks_of_two_laws_are_separated_by_what_the_pump_can_do() -> None:
    causes = [c for c in causes_of(Rig(pump=Pump())) if c.name in ("cv_leak", "dead_volume")]
    found = recommend(Rig(pump=Pump()), causes)
    assert found.pairs[0][1] > 5.0
    assert "kPa (" not in found.in_words() and "reservoir" not in found.in_words()


def test_the_error_of_a_known_parameter_is_at_most_that_of_its_range(short_case: Case) -> None:
    """A scale that the data do not determine once moved by e^18, and its simulation did not end."""
    hidden = draw("short", 1).hidden[0].name
    problem = FitProblem(short_case, stated_noise(short_case.rig))
    cause = cause_named(hidden)
    unsure = Candidate(problem, problem.at(problem.start().with_cause(cause, cause.seeds()[0])))
    huge = 1e6 * np.eye(len(cause.parameters))
    vars(unsure)["covariance"] = huge  # Instead of the cached property.
    known, _ = next_experiment._known(unsure, 0)
    for parameter in known.parameters:
        assert parameter.typical is not None
        assert parameter.typical[1] < parameter.range / 2.0
