"""Residuals of a fit: noise, or a pattern that depends on a feature."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flying_vines.identification.candidate import STRUCTURE
from flying_vines.identification.case import Case, RecordedRun
from flying_vines.identification.fit import Fit, FitProblem
from flying_vines.identification.intervals import blocks
from flying_vines.identification.noise import SensorNoise
from flying_vines.identification.residuals import excess, patterns
from flying_vines.identification.simulate import Simulation
from flying_vines.physics.arrays import Array
from flying_vines.physics.rig import ControlVolume, Rig

NOISE_KPA = (0.15, 1.2)
NOISE = SensorNoise(NOISE_KPA[0]), SensorNoise(NOISE_KPA[1])


def fitted(seed: int) -> tuple[FitProblem, Fit]:
    """A nominal rig in a room that warms in the first half of the run and cools again."""
    random = np.random.default_rng(seed)
    time_s = np.arange(0.0, 30.0, 0.02)
    phase = (time_s // 1.5) % 4
    evp = np.where(
        phase == 0, random.choice((0.2, 0.5, 1.0), len(time_s) // 75)[(time_s // 1.5).astype(int)], 0.0
    )
    shut, solenoid = np.zeros(len(time_s)), (phase >= 2).astype(float)
    ambient_C = 20.0 + 5.0 * np.sin(np.pi * time_s / 30.0)
    rig = Rig(cv=ControlVolume(0.25))
    run = RecordedRun("run", time_s, None, evp, shut, solenoid, shut, shut, None, ambient_C, False)
    clean = Simulation(Case(Path("memory"), rig, (run,), ())).readings(0, {}, [], np.array([(640.0, 0.0)]))
    run = replace(
        run,
        cv_kPa=clean.cv_kPa + random.normal(0.0, NOISE_KPA[0], len(time_s)),
        reservoir_kPa=clean.reservoir_kPa + random.normal(0.0, NOISE_KPA[1], len(time_s)),
    )
    problem = FitProblem(Case(Path("memory"), rig, (run,), ()), NOISE)
    return problem, problem.fit(problem.start())


def with_left(fit: Fit, row: int, left: Array) -> Fit:
    residual = fit.residuals[0].copy()
    residual[row] += left
    return replace(fit, residuals=(residual,))


@pytest.mark.parametrize("seed", range(10))
def test_noise_is_noise(seed: int) -> None:
    strongest = patterns(*fitted(seed))[0]
    assert strongest.log_p < STRUCTURE
    assert np.sum(strongest.count) > 100


def test_a_dependence_on_the_temperature_is_found() -> None:
    problem, fit = fitted(0)
    (run,) = problem.case.runs
    assert run.ambient_C is not None
    found = patterns(problem, with_left(fit, 1, 0.4 * (run.ambient_C - 22.5)))
    assert (found[0].channel, found[0].feature, found[0].unit) == ("reservoir", "ambient temperature", "°C")
    assert np.corrcoef(found[0].centre, found[0].mean)[0, 1] > 0.9
    assert found[0].log_p > STRUCTURE


def test_a_dependence_on_the_opening_is_found() -> None:
    problem, fit = fitted(1)
    (run,) = problem.case.runs
    before = np.concatenate((run.evp_opening[:1], run.evp_opening[:-1]))
    found = patterns(problem, with_left(fit, 0, np.where(before == 0.5, 0.7, 0.0)))
    # The opening determines the rate, so either one may be the strongest.
    strongest = [(pattern.channel, pattern.feature) for pattern in found[:3]]
    assert ("control volume", "opening of the inflation valve") in strongest
    assert found[2].log_p > STRUCTURE


def test_a_rounding_error_that_stays_is_no_pattern() -> None:
    """Readings in steps of three standard deviations: at a constant pressure the error is constant."""
    problem, fit = fitted(3)
    step_kPa = 3.0 * NOISE_KPA[0]
    (data,) = problem.data
    rounded = data.copy()
    rounded[0] = np.round(rounded[0] / step_kPa) * step_kPa
    problem.data = [rounded]
    left = with_left(fit, 0, (rounded[0] - data[0]) / NOISE_KPA[0])
    assert patterns(problem, left)[0].log_p > STRUCTURE
    cv, reservoir = problem.noise
    std_kPa = np.hypot(NOISE_KPA[0], step_kPa / np.sqrt(12.0))
    problem.noise = cv._replace(std_kPa=float(std_kPa), step_kPa=step_kPa), reservoir
    problem.noise_kPa = float(std_kPa), NOISE_KPA[1]
    in_its_noise = replace(left, residuals=(left.residuals[0] * [[NOISE_KPA[0] / std_kPa], [1.0]],))
    assert patterns(problem, in_its_noise)[0].log_p < STRUCTURE


def test_the_excess_of_the_residuals_is_that_of_the_channel() -> None:
    problem, fit = fitted(4)
    assert max(excess(patterns(problem, fit))) < 1.5
    slow = 3.0 * np.sin(np.arange(1500) / 100.0)
    cv, reservoir = excess(patterns(problem, with_left(fit, 0, slow)))
    assert cv > 100.0 and reservoir < 1.5


def test_without_a_thermometer_there_is_no_such_pattern() -> None:
    problem, fit = fitted(2)
    (run,) = problem.case.runs
    case = replace(problem.case, runs=(replace(run, ambient_C=None),))
    features = {pattern.feature for pattern in patterns(FitProblem(case, NOISE), fit)}
    assert "ambient temperature" not in features and "opening of the inflation valve" in features


def test_a_slow_logger_has_patterns_in_time_too() -> None:
    time_s = np.arange(0.0, 240.0, 7.0)
    shut = np.zeros(len(time_s))
    unread_kPa = np.full(len(time_s), np.nan)
    reservoir_kPa = 690.0 * np.exp(-time_s / 100.0) + 10.0 * np.sin(time_s / 40.0)
    run = RecordedRun(
        "run", time_s, None, shut + 1.0, shut, shut + 1.0, unread_kPa, reservoir_kPa, None, None, True
    )
    case = Case(Path("memory"), Rig(cv=None), (run,), ())
    problem = FitProblem(case, NOISE)
    assert excess(patterns(problem, problem.fit(problem.start())))[1] > 10.0


def test_blocks_have_several_readings_of_a_slow_logger() -> None:
    (slow,) = blocks([np.arange(0.0, 140.0, 7.0)])
    assert np.bincount(slow).tolist() == [4] * 5
    (long,) = blocks([np.arange(0.0, 150.0, 0.5)])
    assert np.bincount(long).tolist() == [8] * 37 + [4]


def test_a_short_recording_has_short_blocks() -> None:
    """A discharge misfits for one second of twelve. With few blocks, the error is in one or two of them."""
    (short,) = blocks([np.arange(0.0, 12.0, 0.05)])
    assert max(short) >= 23
    assert [max(run) for run in blocks([np.arange(0.0, 45.0, 0.05)] * 4)] == [11] * 4
