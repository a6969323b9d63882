"""How noisy the sensors are: what the rig states, unless the data say otherwise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from flying_vines.discrepancy.model import Array
from flying_vines.discrepancy.recording import Run

BELIEVED_WITHIN = 0.08
"""The estimate is good to about 2 %; nearer than this what is stated is kept."""
_GAUSS = 1.4826
"""Standard deviation of a Gaussian over its median absolute deviation."""
_SECOND_DIFFERENCE = 6.0
"""Its variance over that of independent samples."""
_FEWEST = 100
STILL_S = 0.2
TURN = 0.1
"""Of full opening; a regulator's small corrections are none."""


def noise_kPa(residuals: Sequence[Array], stated_kPa: float) -> float:
    """Standard deviation of a sensor's noise, from what is left of its readings after a fit.

    What a simulation lacks hardly shows in second differences while no valve turns. Readings so coarse that
    most second differences vanish say nothing.

    Args:
        residuals: a run's each, (n,) kPa, NaN where nothing was read.
    """
    differences = np.concatenate([np.diff(r, 2) for r in residuals])
    differences = np.abs(differences[np.isfinite(differences)])
    if len(differences) < _FEWEST:
        return stated_kPa
    found = _GAUSS * float(np.median(differences)) / np.sqrt(_SECOND_DIFFERENCE)
    if found == 0.0 or (stated_kPa > 0.0 and abs(found / stated_kPa - 1.0) < BELIEVED_WITHIN):
        return stated_kPa
    return float(found)


def still(run: Run) -> NDArray[np.bool_]:
    """Samples at which no valve has moved for a while."""
    turned = np.zeros(len(run.time_s), dtype=np.bool_)
    for opening in (run.evp_opening, run.dvp_opening, run.solenoid):
        turned[1:] |= np.abs(np.diff(opening)) > TURN
    turns_s = run.time_s[turned]
    last = np.searchsorted(turns_s, run.time_s, side="right") - 1
    return (last < 0) | (run.time_s - turns_s[np.maximum(last, 0)] > STILL_S) if len(turns_s) else ~turned
