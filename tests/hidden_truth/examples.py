"""One short truth with a given effect and variant, for tests that need no draw."""

from __future__ import annotations

import math

import numpy as np

from hidden_truth import plans
from hidden_truth.effects import EFFECTS, Hidden
from hidden_truth.plans import FOUR_RUNS
from hidden_truth.rig import Noise, Rig
from hidden_truth.truth import Truth

_LONG_S = 15.0
_NOISE = Noise()


def example(name: str, variant: str = "", stated: Noise = _NOISE) -> Truth:
    """The middle of the effect's clear range in the default rig, four runs of 15 s or one discharge."""
    effect = EFFECTS[name]
    rig = Rig(cv_L=None if variant == "discharge" else 0.5)
    rng = np.random.default_rng(11)
    value = math.sqrt(effect.low * effect.high)
    hidden = Hidden(name, effect.value(value, rig))
    if variant == "discharge":
        runs: tuple[plans.Plan, ...] = (plans.discharge(rng),)
    else:
        even = plans.steady_time(_LONG_S)
        time_s = plans.uneven_time(rng, _LONG_S) if variant == "uneven" else even
        runs = tuple(kind(rng, time_s, variant != "without_dvp") for kind in FOUR_RUNS)
    return Truth("clear", 0, variant, (hidden,), rig, rig, 1.0, _NOISE, stated, runs, (7,))
