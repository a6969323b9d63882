"""Plans: their runs, simulated and diagnosed, separate the causes as predicted."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from io import StringIO
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
from command_line import refused
from command_line import run as run_command
from rich.console import Console

from flying_vines.config import config as configuration
from flying_vines.identification.plan import (
    CausePair,
    PlannedRun,
    Recommendation,
    Recording,
    RecordingPlan,
    RecordingPlanError,
    plan,
    recommend,
)
from flying_vines.identification.plan.choose import SETTLED, FullFits, cause_distances, gram_of
from flying_vines.identification.plan.library import CandidateRun, library, nominal_run
from flying_vines.identification.plan.show import profiles_text, scenario_text, show
from flying_vines.identification.plan.traces import (
    CandidatePart,
    Layout,
    _moved,
    layout_of,
    parts_of,
    strengths,
    typical,
)
from flying_vines.physics.arrays import Array
from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.effects import catalogue, cause_named, causes_of
from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.physics.rig import ControlVolume, Rig, Sensors, Venturi, load_rig
from flying_vines.simulation.scenario import load_scenario, parse_scenario, simulate, simulate_scenario
from flying_vines.simulation.scenario.scenario import BendsRun, ProfileRun, RunKind, StepsRun

HALF = Rig(cv=ControlVolume(0.5), venturi=Venturi(rated_supply_kPa=900.0))
"""Below the Venturi's rated supply everything is proportional to pressure: a gain g of one sensor looks like
a gain 1/g of the other one."""
GAINS = CausePair("cv_sensor_gain", "reservoir_sensor_gain")


@pytest.fixture(scope="module")
def made() -> RecordingPlan:
    return plan(HALF, minutes=0.6)


@pytest.fixture(scope="module")
def short() -> RecordingPlan:
    """A plan for the vine, for which commands alone are not enough."""
    return plan(Rig(), minutes=0.5, air_SL=11.0)


@pytest.fixture(scope="module")
def layout() -> Layout:
    return layout_of(HALF, causes_of(HALF))


def named(*names: str) -> list[Cause]:
    return [cause_named(name) for name in names]


def sigmas(found: Recommendation) -> float:
    """Separation of the worst pair."""
    return found.pairs[0][1]


def parts(layout: Layout, kinds: list[RunKind]) -> list[CandidatePart]:
    found = []
    for number, kind in enumerate(kinds):
        found += parts_of(layout, CandidateRun(f"{number}", "", partial(_same, kind), (1,), False))
    return found


def _same(kind: RunKind, count: int) -> RunKind:
    return kind


def worst(matrix: Array, but: CausePair | None = None) -> float:
    """Δχ² of the pair with the worst separation, without the pair `but`."""
    names = [cause.name for cause in causes_of(HALF)]
    counts = ~np.eye(*matrix.shape, dtype=np.bool_)
    for pair in (but, but[::-1]) if but else ():
        counts[names.index(pair[0]), names.index(pair[1])] = False
    return float(matrix[counts].min())


@pytest.mark.long
def test_a_plan_beats_what_one_would_record_without_it(made: RecordingPlan, layout: Layout) -> None:
    """For the worst separable pair, with the same length and maximum pressure."""
    seconds = made.best.seconds / 3
    bends: RunKind = BendsRun(cycles=int(seconds / 2.5), bend_kPa=20.7)
    stairs: RunKind = StepsRun(
        pressures_kPa=tuple([7.0, 14.0, 20.7, 14.0, 7.0, 0.0] * 2), hold_s=seconds / 12
    )
    hold: RunKind = StepsRun(pressures_kPa=(20.7,), hold_s=seconds)
    naive = parts(layout, [bends, stairs, hold])
    assert sum(part.seconds for part in naive) == pytest.approx(made.best.seconds, abs=2.5)
    planned = parts(layout, [run.kind for run in made.best.runs])
    least = worst(cause_distances(layout, gram_of(layout, planned)), but=GAINS)
    assert least > 4.0 * worst(cause_distances(layout, gram_of(layout, naive)), but=GAINS)
    assert least > SETTLED


@pytest.mark.long
def test_it_settles_what_the_example_scenario_leaves_open(short: RecordingPlan) -> None:
    """With a sixth of its three minutes and a third of its pressure. The two gains remain open."""
    layout = layout_of(short.rig, causes_of(short.rig))
    example = parts(layout, list(load_scenario("case").runs))
    assert worst(cause_distances(layout, gram_of(layout, example))) < 1.0
    assert set(short.best.open) <= {GAINS} and worst(short.matrix, but=GAINS) > SETTLED
    assert GAINS in short.by_commands.open


@pytest.mark.long
def test_a_plan_keeps_its_budgets(short: RecordingPlan) -> None:
    """Time and air agree with the simulated rig, including the air between the runs."""
    runs = simulate_scenario(short.rig, short.best.scenario, seed=4)
    assert {run.commanded for run in short.best.runs} == {True, False}
    assert sum(len(run.time_s) for run in runs) * 0.02 == pytest.approx(short.best.seconds, abs=0.2)
    assert short.best.seconds <= 60.0 * short.minutes
    left_kPa = runs[0].true_reservoir_kPa[0]
    used_kPa = 0.0
    for run in runs:
        start_kPa, end_kPa = run.true_reservoir_kPa[[0, -1]]
        used_kPa += max(0.0, left_kPa - start_kPa) + start_kPa - end_kPa
        left_kPa = end_kPa
    air_SL = used_kPa * short.rig.reservoir.volume_L / ALPHA_KPA
    assert air_SL <= short.air_SL
    assert air_SL == pytest.approx(short.best.air_SL, rel=0.02)


@pytest.mark.long
def test_pairs_that_no_run_separates_are_reported(made: RecordingPlan) -> None:
    assert made.never == made.best.open == (GAINS,)
    row, column = made.names.index(GAINS.first), made.names.index(GAINS.second)
    assert made.matrix[row, column] < 0.1 < SETTLED < made.matrix[row, -1]
    assert not sigmas(recommend(HALF, named(*GAINS))) > 1.0
    assert recommend(HALF, named(*GAINS)).in_words().startswith("No run")
    usual = recommend(replace(HALF, venturi=Venturi()), named(*GAINS))
    assert sigmas(usual) > sqrt(SETTLED) and usual.runs[0].name in usual.in_words()


@pytest.mark.long
def test_floors_hold_against_full_fits(made: RecordingPlan, layout: Layout) -> None:
    """Pairs that are hard to separate have a low distance."""
    runs = [part for run in made.best.runs[:2] for part in parts(layout, [run.kind])]
    floors, check = cause_distances(layout, gram_of(layout, runs)), FullFits(layout, runs)
    others = np.argwhere(~np.eye(*floors.shape, dtype=np.bool_))
    others = others[np.argsort(floors[tuple(others.T)])]
    fits = np.array([check.distance(*pair) for pair in others[:150:6]])
    there = floors[tuple(others[:150:6].T)]
    assert (there < 1.15 * fits + 1.0).all()
    assert np.median((there + 1.0) / (fits + 1.0)) > 0.5


def test_rehearsed_is_what_the_simulator_records() -> None:
    """Without noise the commands are identical: same regulator, and no opening ends early."""
    quiet = replace(HALF, sensors=Sensors(0.0, 0.0))
    for candidate in library(quiet):
        if candidate.name in ("bends_low", "random_full", "pulses", "vent_venturi_half"):
            kind = candidate.make(candidate.counts[0])
            ours, theirs = nominal_run(quiet, kind), simulate(quiet, kind)
            for name in ("time_s", "evp_opening", "dvp_opening", "solenoid"):
                assert np.array_equal(getattr(ours, name), getattr(theirs, name)), (candidate.name, name)


def test_parts_begin_alike() -> None:
    for candidate in library(HALF):
        short, whole = (
            nominal_run(HALF, candidate.make(n)) for n in (candidate.counts[0], candidate.counts[-1])
        )
        n = len(short.time_s) - 1
        assert n < len(whole.time_s)
        for name in ("evp_opening", "dvp_opening", "solenoid"):
            assert np.array_equal(getattr(short, name)[:n], getattr(whole, name)[:n]), candidate.name


@pytest.mark.long
def test_the_run_that_settles_a_doubt(layout: Layout) -> None:
    found = recommend(HALF, named("evp_lag", "line_delay"))
    (run,) = found.runs
    assert run.commanded and run.seconds <= 60.0
    assert sigmas(found) ** 2 > SETTLED
    assert {*found.pairs[0][0]} == {"evp_lag", "line_delay"}
    assert run.name in found.in_words()
    rest: RunKind = StepsRun(pressures_kPa=(0.0,), hold_s=run.seconds)
    names = [cause.name for cause in layout.causes]
    idle = cause_distances(layout, gram_of(layout, parts(layout, [rest])))
    assert idle[names.index("evp_lag"), names.index("line_delay")] < 0.01 * sigmas(found) ** 2
    assert sigmas(recommend(HALF, named("cv_leak", "none"))) > sqrt(SETTLED)
    with pytest.raises(RecordingPlanError, match="evp_lag"):
        recommend(HALF, named("evp_lag"))


def test_runs_that_would_take_hours_are_not_simulated() -> None:
    slow = replace(HALF, evp=replace(HALF.evp, flow_resistance_kPa_s_per_SL=1e7))
    layout = layout_of(slow, named("cv_leak"))
    hold = next(one for one in library(slow) if one.name == "fill_hold_fast_full")
    assert hold.make(1).length_s > 600.0
    assert parts_of(layout, hold, 60.0) == []
    stairs = next(one for one in library(slow) if one.name == "staircase")
    assert [part.count for part in parts_of(layout, stairs, 10.0)] == [4]


def test_a_known_cause_moves_inside_its_range() -> None:
    cause = cause_named("pump_flow")
    (parameter,) = cause.parameters
    high = parameter.to_search(parameter.high)
    unsure = replace(cause, parameters=(replace(parameter, typical=(high, parameter.range / 3.0)),))
    ((moved, (value,)),), *_ = _moved([(unsure, (parameter.high,))])
    assert moved is unsure and parameter.low < value < parameter.high


def test_every_cause_has_a_typical_strength() -> None:
    for cause in catalogue():
        usual, row = typical(cause, HALF), strengths(cause, typical(cause, HALF))
        parameter = cause.parameters[0]
        assert parameter.low <= usual <= parameter.high
        assert usual in row and usual != parameter.neutral


def test_a_new_cause_is_planned_for_without_more_ado() -> None:
    parameter = Parameter("share", low=-0.5, high=0.5, seeds=(0.0,), neutral=0.0, source="a test")
    new = Cause(
        "new", "x", (parameter,), "x", readings=lambda r, x: r._replace(cv_kPa=r.cv_kPa * (1.0 + x[0]))
    )
    laid = layout_of(HALF, [new])
    (part,) = parts(laid, [StepsRun(pressures_kPa=(20.0, 0.0), hold_s=3.0)])
    assert cause_distances(laid, part.gram)[0, -1] > 0.0


@pytest.mark.long
def test_the_scenario_and_the_profiles_are_readable(made: RecordingPlan) -> None:
    assert parse_scenario(scenario_text(made.best), "plan").runs == made.best.scenario.runs
    text = configuration.default_text() + profiles_text(made.by_commands)
    read = configuration.parse(text, "plan")
    for number, run in enumerate(made.by_commands.runs, start=101):
        name = f"plan-{number}-{run.name.replace('_', '-')}"
        assert isinstance(run.kind, ProfileRun)
        assert read.profiles[name].segments[: len(run.kind.segments)] == run.kind.segments
        assert read.profiles[name].rate_kPa_per_s == run.kind.rate_kPa_per_s
        assert [item.profile for item in read.items if item.match == {"param1": number}] == [name]


def test_one_run_is_printed_in_the_singular() -> None:
    kind = StepsRun(pressures_kPa=(20.0,), hold_s=9.0)
    runs = [PlannedRun("hold", "leaks", kind, 9.0, 0.5, commanded, ()) for commanded in (True, False)]
    best, by_commands = Recording((*runs,), 1.0, ()), Recording((runs[0],), 0.5, (GAINS,))
    made = RecordingPlan(HALF, 0.5, 11.0, best, by_commands, ("cv_leak",), np.array([[0.0, 30.0]]), ())
    show(made, Console(file=(printed := StringIO()), width=200))
    assert "2 runs, 18 of 30 s" in printed.getvalue()
    assert "The service alone can do 1 run, 9 s; not separated then: cv_sensor_gain" in printed.getvalue()


@pytest.mark.long
def test_planned_simulated_and_diagnosed(
    made: RecordingPlan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The diagnosis names the hidden cause."""
    truth, scenario, case = tmp_path / "truth.toml", tmp_path / "scenario.toml", str(tmp_path / "case")
    truth.write_text(
        "[cv]\nvolume_L = 0.5\n[venturi]\nrated_supply_kPa = 900\n[causes.evp_lag]\ntime_constant_s = 0.02\n"
    )
    scenario.write_text(scenario_text(made.best))
    assert (
        run_command(capsys, "simulate", "--rig", str(truth), "--scenario", str(scenario), "--out", case)[0]
        == 0
    )
    status, text, _ = run_command(capsys, "diagnose", case, "--json")
    assert status == 0
    verdict = json.loads(text)
    assert verdict["cause"] == "evp_lag" and verdict["indistinguishable"] == []
    estimate = verdict["parameters"]["time_constant_s"]
    assert estimate["low"] < 0.02 < estimate["high"]


@pytest.mark.long
def test_the_command_on_a_rig_without_control_volume(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Such a rig can only discharge, and the service can do nothing."""
    rig, out = tmp_path / "rig.toml", tmp_path / "plan"
    rig.write_text("[reservoir]\nvolume_L = 2\n")
    status, text, _ = run_command(
        capsys, "diagnose", "--plan", str(rig), "--minutes", "0.7", "--out", str(out), "--json"
    )
    assert status == 0
    found = json.loads(text)
    assert {planned["name"].split("_")[0] for planned in found["best"]["runs"]} == {"discharge"}
    assert found["best"]["seconds"] <= 42.0 and not found["by_commands"]["runs"]
    assert ["solenoid_slow_close", "none"] in found["never"]
    assert not any("cv_leak" in pair for pair in found["never"])
    assert ["reservoir_leak", "none"] not in found["best"]["open"]
    assert (
        len(found["matrix"])
        == len(found["there"])
        == len(found["fitted"]) - 1
        == len(causes_of(load_rig(rig)))
    )
    names = {Path(file).name for file in found["files"] + found["figures"] if Path(file).stat().st_size}
    assert names == {"scenario.toml", "plan-matrix.png"}


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--plan", "{rig}", "--minutes", "nan"], "minutes"),
        (["--plan", "{rig}", "--air-SL", "-1"], "air_SL"),
        (["--plan", "{rig}.nowhere"], "nowhere"),
        (["--plan"], "CASE"),
        (["--plan", "{rig}", "--rig", "{rig}"], "--rig"),
        (["{rig}", "--minutes", "2"], "--minutes"),
    ],
)
def test_an_impossible_plan_gives_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], named: str
) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text("[cv]\nvolume_L = 0.1\n")
    assert named in refused(capsys, "diagnose", *(argument.format(rig=rig) for argument in arguments))
