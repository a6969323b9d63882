"""Cases of another simulator: with the parameters of their answers, only noise remains."""

from __future__ import annotations

import json
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hidden_truth.effects import Hidden, with_effects
from hidden_truth.gap import gap
from hidden_truth.kernel import Array, Physics
from hidden_truth.recording import Recording, replay
from hidden_truth.rig import KEYS, TOLERANCE_PERCENT, Noise, Rig
from hidden_truth.truth import Truth

CASES = Path(__file__).parents[1] / "data" / "cases"
ANSWERS: dict[str, dict[str, Any]] = json.loads((CASES / "answers.json").read_text(encoding="utf-8"))
IN_TABLE = sorted(name for name, answer in ANSWERS.items() if not answer["effect"].startswith("x_"))
"""Effects outside the catalogue have a name, but no equation here."""
NOISE = Noise()
SIGMA = (NOISE.cv_kPa, NOISE.reservoir_kPa)


@cache
def true_physics(case: str) -> Physics:
    answer = ANSWERS[case]
    n = answer["nominal"]
    rig = Rig(n["Vr"], n["Vcv"], n["R_evp"], n["R_dvp"], n["R_sol"], n["Pvac"], n["Pven"])
    hidden = [Hidden(answer["effect"], value) for value in answer["parameters"].values()]
    return with_effects(rig, hidden)


def settled(p: Physics, path: Path) -> Recording:
    """The run with the best initial pressures, and the readings of the truth."""
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    time_s, command, read = table[:, 0].copy(), table[:, 1], table[:, 5:7]
    inputs = table[:, 2:5].copy()
    start = np.array([read[:5, 1].mean(), 0.0])

    def misfit(at: Array) -> Array:
        return ((read - replay(p, inputs, time_s, (float(at[0]), float(at[1])))) / SIGMA).ravel()

    for _ in range(3):
        now = misfit(start)
        jacobian = np.column_stack([misfit(start + nudge) - now for nudge in 0.1 * np.eye(2)]) / 0.1
        start -= np.linalg.lstsq(jacobian, now, rcond=None)[0]
    at = (float(start[0]), float(start[1]))
    clean = replay(p, inputs, time_s, at)
    kept = np.ones(time_s.size, dtype=bool)
    return Recording(path.stem, time_s, command, inputs, clean, read, kept, frozenset(), at)


@cache
def recordings(case: str) -> tuple[Recording, ...]:
    return tuple(settled(true_physics(case), path) for path in sorted((CASES / case).glob("*.csv")))


@pytest.mark.parametrize("case", IN_TABLE)
def test_only_noise_is_left(case: str) -> None:
    left = [((run.read - run.clean) / SIGMA) ** 2 for run in recordings(case)]
    assert len(left) == 4
    for one in left:
        spread = np.sqrt(2.0 / len(one))
        assert one.mean(axis=0) == pytest.approx([1.0, 1.0], abs=4.5 * spread)
    every = np.concatenate(left)
    print(f"{case} {ANSWERS[case]['effect']}: chi-square per reading {every.mean():.3f}")
    assert every.mean() == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / every.size))
    assert abs(np.mean(np.concatenate([run.read - run.clean for run in recordings(case)]) / SIGMA)) < 0.04


@pytest.mark.parametrize("case", IN_TABLE)
def test_without_the_effect_the_fit_is_worse(case: str) -> None:
    """A fit of the baseline's numbers is worse than the truth, but not worse than the nominal baseline."""
    with (CASES / case / "rig.toml").open("rb") as file:
        toml = tomllib.load(file)
    numbers = {name: toml[key.split(".")[0]][key.split(".")[1]] for name, key in KEYS.items()}
    assumed = Rig(**numbers)
    tolerance = max(toml.get("tolerance_percent", {"": TOLERANCE_PERCENT}).values())
    truth = Truth("", 0, "", (), assumed, assumed, tolerance, NOISE, NOISE, (), ())
    found, claimed = gap(truth, recordings(case)), ANSWERS[case]["gap"]
    print(f"{case} {ANSWERS[case]['effect']}: claimed {claimed:.0f}, best fit {found:.0f}")
    if claimed == 0.0:
        assert -60.0 < found < 30.0
    else:
        assert 300.0 < found < claimed + 100.0
