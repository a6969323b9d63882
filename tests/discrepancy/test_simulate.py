"""The extended simulation, with each cause in it, against the truth that shares no code with it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hidden_truth.effects import EFFECTS, Hidden, with_effects
from hidden_truth.recording import replay
from hidden_truth.rig import Rig as TrueRig

from flying_vines.discrepancy.case import Case, Run
from flying_vines.discrepancy.cause import Cause
from flying_vines.discrepancy.causes import catalogue
from flying_vines.discrepancy.simulate import Simulation, numbers_of
from flying_vines.pneumatics.baseline import Inputs, State, step
from flying_vines.pneumatics.rig import ControlVolume, Rig

RIG = Rig(cv=ControlVolume(0.25))
START_KPA = (640.0, 0.0)
STARTS = np.array([START_KPA])
LENGTH_S = 12.0


def random_run(seed: int) -> Run:
    """Openings at random, with the Venturi, down to a reservoir in which it stalls."""
    random = np.random.default_rng(seed)
    time_s = np.arange(0.0, LENGTH_S, 0.02)
    evp, dvp, solenoid = np.zeros((3, len(time_s)))
    at = 0
    while at < len(time_s):
        length = int(random.integers(3, 60))
        what = random.choice(("in", "hold", "out", "suck"))
        evp[at : at + length] = random.uniform(0.1, 1.0) if what == "in" else 0.0
        solenoid[at : at + length] = what in ("out", "suck")
        dvp[at : at + length] = random.uniform(0.5, 1.0) if what == "suck" else 0.0
        at += length
    nothing = np.full(len(time_s), np.nan)
    return Run("random", time_s, None, evp, dvp, solenoid, nothing, nothing, None, None, False)


def case_of(run: Run, rig: Rig = RIG) -> Case:
    return Case(Path("memory"), rig, (run,), ())


def strength(name: str) -> float:
    """Between the weakest and the strongest of the clear ones."""
    effect = EFFECTS[name]
    if name == "venturi_stall":
        # These runs are short: their reservoirs stay full.
        return 610.0
    return effect.value(math.sqrt(effect.low * effect.high), TrueRig(cv_L=0.25))


@pytest.mark.parametrize("cause", catalogue(), ids=lambda cause: cause.name)
@pytest.mark.parametrize("seed", (1, 2))
def test_a_cause_is_what_the_truth_says_it_is(cause: Cause, seed: int) -> None:
    run = random_run(seed)
    value = strength(cause.name)
    physics = with_effects(TrueRig(cv_L=0.25), [Hidden(cause.name, value)])
    truth = replay(
        physics, np.column_stack((run.evp_opening, run.dvp_opening, run.solenoid)), run.time_s, START_KPA
    )
    ours = Simulation(case_of(run)).readings(0, numbers_of(RIG), [(cause, (value,))], STARTS)
    plain = Simulation(case_of(run)).readings(0, numbers_of(RIG), [], STARTS)
    # A fiftieth of the sensors' noise at most.
    assert ours.cv_kPa == pytest.approx(truth[:, 0], abs=0.003)
    assert ours.reservoir_kPa == pytest.approx(truth[:, 1], abs=0.003)
    moved = max(
        float(np.abs(ours.cv_kPa - plain.cv_kPa).max()) / 0.15,
        float(np.abs(ours.reservoir_kPa - plain.reservoir_kPa).max()) / 1.2,
    )
    assert moved > 1.0, "the cause does nothing in this run"


@pytest.mark.parametrize("cause", catalogue(), ids=lambda cause: cause.name)
def test_a_neutral_cause_does_nothing(cause: Cause) -> None:
    neutral = cause.parameters[0].neutral
    if neutral is None:
        assert cause.name == "compressible_flow"
        return
    simulation = Simulation(case_of(random_run(1)))
    plain = simulation.readings(0, numbers_of(RIG), [], STARTS)
    ours = simulation.readings(0, numbers_of(RIG), [(cause, (neutral,))], STARTS)
    assert ours.cv_kPa == pytest.approx(plain.cv_kPa, abs=1e-9)
    assert ours.reservoir_kPa == pytest.approx(plain.reservoir_kPa, abs=1e-9)


def test_without_causes_it_is_the_baseline() -> None:
    run = random_run(3)
    readings = Simulation(case_of(run)).readings(0, numbers_of(RIG), [], STARTS)
    state = State(*START_KPA)
    for i, inputs in enumerate(zip(run.evp_opening, run.dvp_opening, run.solenoid, strict=True)):
        assert readings.cv_kPa[i] == pytest.approx(state.cv_kPa, abs=1e-4)
        assert readings.reservoir_kPa[i] == pytest.approx(state.reservoir_kPa, abs=1e-4)
        for _ in range(20):
            state = step(RIG, state, Inputs(inputs[0], inputs[1], bool(inputs[2])), 0.001)


def test_all_causes_together_are_what_the_truth_says_they_are() -> None:
    """In the order in which one part's effects act on each other."""
    names = [cause.name for cause in catalogue() if cause.name not in ("compressible_flow", "venturi_stall")]
    run = random_run(4)
    hidden = [Hidden(name, strength(name)) for name in names]
    physics = with_effects(TrueRig(cv_L=0.25), hidden)
    truth = replay(
        physics, np.column_stack((run.evp_opening, run.dvp_opening, run.solenoid)), run.time_s, START_KPA
    )
    by_name = {cause.name: cause for cause in catalogue()}
    causes = [(by_name[one.name], (one.value,)) for one in hidden]
    ours = Simulation(case_of(run)).readings(0, numbers_of(RIG), causes, STARTS)
    assert ours.cv_kPa == pytest.approx(truth[:, 0], abs=0.01)
    assert ours.reservoir_kPa == pytest.approx(truth[:, 1], abs=0.01)


def test_a_discharge_to_atmosphere_is_an_exponential() -> None:
    rig = Rig(cv=None)
    time_s = np.arange(0.0, 30.0, 0.5)
    shut = np.zeros(len(time_s))
    run = Run("discharge", time_s, None, shut + 1.0, shut, shut, shut, shut, None, None, True)
    readings = Simulation(case_of(run, rig)).readings(0, numbers_of(rig), [], np.array([[690.0, 0.0]]))
    tau_s = rig.evp.flow_resistance_kPa_s_per_SL * rig.reservoir.volume_L / 101.325
    assert readings.reservoir_kPa == pytest.approx(690.0 * np.exp(-time_s / tau_s), rel=1e-6)
