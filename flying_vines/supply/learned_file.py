"""The file with the learned air and leaks of a rig, for the next run.

It is used only with exactly the same prior. With another rig, a changed rig file, or a version of the program
that computes another prior, everything is learned again.
"""

from __future__ import annotations

import hashlib
import math

import msgspec

from flying_vines.supply.cycles_left import Learned
from flying_vines.supply.reservoir_filter import RISE, SIZE
from flying_vines.supply.rig_prior import RigPrior

RATES = SIZE - RISE


class _File(msgspec.Struct, frozen=True):
    rig: str
    """Digest of the prior."""
    learned: Learned


def rig_digest(prior: RigPrior) -> str:
    """Equal for equal priors only."""
    return hashlib.sha256(repr(prior).encode()).hexdigest()[:16]


def text_of(prior: RigPrior, learned: Learned) -> str:
    """The file's text."""
    return msgspec.json.encode(_File(rig_digest(prior), learned)).decode() + "\n"


def learned_from(text: str, prior: RigPrior) -> tuple[Learned | None, str]:
    """The learned numbers, and a sentence if they cannot be used. An empty text gives neither."""
    if not text:
        return None, ""
    try:
        file = msgspec.json.decode(text, type=_File)
    except (ValueError, RecursionError):
        return None, "the stored use of air cannot be read: it is learned again"
    if file.rig != rig_digest(prior):
        return None, "another rig or changed numbers: air is learned again"
    if not _is_sound(file.learned):
        return None, "the stored use of air cannot be read: it is learned again"
    return file.learned, ""


def _is_sound(learned: Learned) -> bool:
    mean, covariance = learned.rates
    numbers = [*mean, *(number for line in covariance for number in line), learned.demand_ln]
    shape = len(mean) == len(covariance) == RATES and all(len(line) == RATES for line in covariance)
    variances = shape and all(covariance[i][i] > 0.0 for i in range(RATES))
    positive = learned.demand_variance > 0.0 and learned.mix.cycles > 0.0 and len(learned.mix.amounts) == 5
    return variances and positive and all(map(math.isfinite, numbers))
