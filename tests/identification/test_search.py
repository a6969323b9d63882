"""Fits of several causes reach their minimum, and a set has only one law for each leak."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hidden_truth import draw, write

from flying_vines.identification.case import Case, RecordedRun, read_case
from flying_vines.identification.diagnose import _confidence, _shares
from flying_vines.identification.fit import FitPoint, FitProblem
from flying_vines.identification.noise import stated_noise
from flying_vines.identification.search import Search
from flying_vines.physics.arrays import Array
from flying_vines.physics.effects import cause_named, causes_of
from flying_vines.physics.rig import Reservoir, Rig


def problem_of(case: Case) -> FitProblem:
    return FitProblem(
        case, stated_noise(case.rig, [np.stack((run.cv_kPa, run.reservoir_kPa)) for run in case.runs])
    )


class Counted(FitProblem):
    """Counts the simulations of a problem."""

    def __init__(self, problem: FitProblem) -> None:
        super().__init__(problem.case, problem.noise)
        self.simulations = 0

    def simulated(self, point: FitPoint, runs: Sequence[int] | None = None) -> list[Array]:
        self.simulations += 1
        return super().simulated(point, runs)


@pytest.mark.long
def test_a_fit_of_six_causes_reaches_the_noise_in_any_order(tmp_path: Path) -> None:
    """The reservoir starts near the pressure at which the Venturi stalls, so its initial pressure acts
    nonlinearly.

    A fit that shortens its steps there stops far above the minimum.
    """
    truth = draw("several", 7000)
    write(tmp_path / "case", truth)
    problem = problem_of(read_case(tmp_path / "case"))
    keys = Search(problem, ()).keys
    causes = [cause_named(hidden.effect.name) for hidden in truth.hidden]
    for order in (causes, causes[1:] + causes[:1]):
        point = problem.fit(problem.start().with_free(keys)).point
        for cause in order:
            point = problem.first_fit(point, cause).point
        assert problem.fit(point).chi2 < 1.05 * problem.readings


@pytest.mark.long
def test_a_number_without_effect_does_not_keep_the_others_from_their_minimum(tmp_path: Path) -> None:
    """The readings are the same for stalls of 416 to 421 kPa. Rounding errors once moved the parameter to its
    bound."""
    drawn = draw("several", 660_004)
    write(tmp_path / "case", drawn)
    problem = problem_of(read_case(tmp_path / "case"))
    start = problem.start()
    for hidden in drawn.hidden:
        start = start.with_cause(cause_named(hidden.name), (hidden.value,))
    best = problem.fit(start)
    names = [cause.name for cause in best.point.causes]
    values = [*best.point.values]
    values[names.index("venturi_stall")] = (421.0,)
    delay = names.index("line_delay")
    values[delay] = (1.01 * values[delay][0],)
    assert problem.fit(replace(best.point, values=tuple(values))).chi2 == pytest.approx(best.chi2, abs=2.0)


def test_a_set_has_one_law_of_each_leak() -> None:
    """Otherwise both laws would be fitted to a leak between them."""
    time_s = np.arange(0.0, 60.0)
    shut, unread_kPa = np.zeros(len(time_s)), np.full(len(time_s), np.nan)
    fall_kPa = 450.0 * np.exp(-time_s / 30.0) + 240.0 / (1.0 + time_s / 20.0)
    read_kPa = fall_kPa + np.random.default_rng(1).normal(0.0, 0.2, len(time_s))
    run = RecordedRun("run", time_s, None, shut, shut, shut, unread_kPa, read_kPa, None, None, True)
    rig = Rig(reservoir=Reservoir(2.0), cv=None)
    laws = tuple(cause for cause in causes_of(rig) if "leak" in cause.name)
    search = Search(problem_of(Case(Path("memory"), rig, (run,), ())), laws)
    found = search.best()
    leaks = [[name for name in candidate.names if "leak" in name] for candidate in found.tried]
    assert any(leaks)
    assert all(len(names) <= 1 for names in leaks)


def test_the_laws_of_a_leak_exclude_each_other() -> None:
    for vessel in ("cv_leak viscous_leak orifice_leak", "reservoir_leak reservoir_viscous_leak"):
        for one, other in pairwise(map(cause_named, vessel.split())):
            assert one.excludes(other) and one.excludes(one)
    assert not cause_named("cv_leak").excludes(cause_named("reservoir_leak"))


def test_a_lower_minimum_of_the_chosen_set_leaves_a_confidence() -> None:
    """The search may first have ended at a far higher minimum of the same causes."""
    higher, chosen, null = (
        SimpleNamespace(names=names, score=score, within_bounds=True)
        for names, score in ((("a", "b"), 5000.0), (("a", "b"), 0.0), ((), 9000.0))
    )
    found: Any = SimpleNamespace(
        tried=[higher], search=SimpleNamespace(null=null), score=lambda candidate: candidate.score
    )
    assert _confidence(cast("Any", chosen), "a", found, None) == pytest.approx(0.98)


def test_a_share_is_at_most_all_of_the_misfit() -> None:
    """Without the flow law, cooling alone fits worse than the baseline."""
    null, chosen, without_law, without_cooling = (
        SimpleNamespace(names=names, causes=names, fit=SimpleNamespace(chi2=chi2))
        for names, chi2 in (
            ((), 1100.0),
            (("law", "cooling"), 100.0),
            (("cooling",), 2500.0),
            (("law",), 350.0),
        )
    )
    found: Any = SimpleNamespace(
        chosen=chosen, search=SimpleNamespace(null=null), without=(without_law, without_cooling)
    )
    assert _shares(found) == {"law": 1.0, "cooling": 0.25}


def test_a_fit_with_known_derivatives_ends_at_the_same_cost_with_fewer_simulations(tmp_path: Path) -> None:
    truth = draw("short", 3)
    write(tmp_path / "case", truth)
    problem = problem_of(read_case(tmp_path / "case"))
    keys = Search(problem, ()).keys
    best = problem.fit(
        problem.first_fit(problem.start().with_free(keys), cause_named(truth.hidden[0].name)).point
    )
    (parameter, *_), (value, *_) = best.point.causes[0].parameters, best.point.values[0]
    pinned = best.point.pinned(0, 0, parameter.within(parameter.to_search(value) + 1e-3 * parameter.range))
    counted = Counted(problem)
    anew = counted.fit(pinned)
    whole, counted.simulations = counted.simulations, 0
    again = counted.fit(pinned, known=problem.jacobian(best))
    assert again.cost == pytest.approx(anew.cost, abs=0.1)
    assert counted.simulations < whole / 2


def test_derivatives_of_a_part_of_the_readings_are_a_part_of_the_derivatives(tmp_path: Path) -> None:
    write(tmp_path / "case", draw("short", 4))
    problem = problem_of(read_case(tmp_path / "case"))
    (run,) = problem.case.runs
    shown = FitProblem(problem.case, problem.noise, [run.time_s < 10.0])
    point = problem.start().with_free(Search(problem, ()).keys)
    part = problem.jacobian(problem.at(point)).where(shown.used)
    anew = shown.jacobian(shown.at(point))
    assert part.reduced == pytest.approx(anew.reduced)
    assert part.reduced_residuals == pytest.approx(anew.reduced_residuals)
