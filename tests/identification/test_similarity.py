"""Similarity of causes: equal effects are similar, and rig numbers' effects are no evidence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flying_vines.identification.case import Case, read_case
from flying_vines.identification.evidence import Similarity, similarity
from flying_vines.identification.fit import FitProblem
from flying_vines.identification.noise import SensorNoise
from flying_vines.identification.simulate import rig_number_keys
from flying_vines.physics.cause import Cause
from flying_vines.physics.effects import catalogue

BY_NAME = {cause.name: cause for cause in catalogue()}


def found(case: Case, *causes: Cause, there: str | None = None) -> Similarity:
    problem = FitProblem(case, (SensorNoise(0.15), SensorNoise(1.2)))
    start = problem.start()
    if there is not None:
        start = start.with_cause(BY_NAME[there], BY_NAME[there].seeds()[0])
    return similarity(problem, problem.fit(start, 2), causes, rig_number_keys(case.rig))


def with_tolerance(case: Case, key: str, percent: float) -> Case:
    return replace(case, rig=replace(case.rig, tolerance_percent={key: percent}))


def test_equal_causes_are_similar_and_different_ones_are_not(short_case: Case) -> None:
    lag = BY_NAME["evp_lag"]
    alike = found(short_case, lag, replace(lag, name="twin"), BY_NAME["reservoir_leak"])
    assert alike.causes == ("evp_lag", "twin", "reservoir_leak")
    assert alike.cosine[0, 1] == pytest.approx(1.0, abs=1e-6)
    assert alike.cosine[0, 2] < 0.5
    assert np.allclose(alike.cosine, alike.cosine.T) and (alike.seen > 5.0).all()


def test_changes_within_the_tolerance_of_a_number_are_no_evidence(short_case: Case) -> None:
    scale, key = BY_NAME["evp_restriction"], "evp.flow_resistance_kPa_s_per_SL"
    sure, unsure = (
        found(with_tolerance(short_case, key, percent), scale).seen[0] for percent in (0.1, 100.0)
    )
    assert sure > 10.0 and sure > 3.0 * unsure


def test_present_causes_are_removed(short_case: Case) -> None:
    cause = BY_NAME["dead_volume"]
    weaker = replace(cause.parameters[0], seeds=(1e-5,))
    assert found(short_case, cause, there="dead_volume").seen[0] > 10.0
    assert found(short_case, replace(cause, parameters=(weaker,))).seen[0] < 1.0


def test_a_cause_that_nothing_shows_has_no_trace(tmp_path: Path) -> None:
    time_s = np.arange(0.0, 6.0, 0.1)
    rows = "\n".join(f"{t:.2f},{600.0 - 3.0 * t:.2f}" for t in time_s)
    (tmp_path / "rig.toml").write_text("")
    (tmp_path / "reservoir.csv").write_text(f"time_s,reservoir_pressure_kPa\n{rows}\n")
    alike = found(read_case(tmp_path), BY_NAME["cv_leak"], BY_NAME["reservoir_leak"])
    assert alike.seen[0] == 0.0 and alike.cosine[0, 1] == 0.0
    assert alike.seen[1] > 0.0
