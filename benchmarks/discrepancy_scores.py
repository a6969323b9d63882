"""Outcomes of cases, one a line of JSON, and their scores: verdicts, numbers, stated probabilities."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise
from math import inf, isinf, sqrt
from pathlib import Path
from statistics import fmean

import msgspec

from flying_vines.identification.verdict import NONE, UNEXPLAINED

Key = tuple[str, int]
"""Tier and seed."""
Neutral = Mapping[tuple[str, str], float | None]
"""The value at which a parameter has no effect."""

UNSURE = 0.9
"""`none` with a lower confidence leaves the cause open."""
CONFIDENT = 0.5
"""A cause that is named with a higher confidence counts as claimed."""
NEAR = 0.1
"""A parameter is right if its error is at most this share of the distance between true and neutral value."""
SEVERAL = ("several", "several_outside")
"""Tiers with three hidden effects or more. Their verdict must name the cause with the largest share first."""
LARGE = 0.1
"""A cause with a larger share of the misfit must be listed."""
NEAR_NOISE = 2.0
"""With several effects, the error on unseen data is low enough up to this multiple of the noise."""
AT_NOISE = 1.2
"""An error on unseen data is due to noise up to this multiple of the noise."""
BINS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 1.0)
_Z = 1.959964


class Hidden(msgspec.Struct, frozen=True):
    """An effect in a rig."""

    effect: str
    parameters: dict[str, float]
    share: float | None = None
    """Share of the baseline's misfit that comes back without this effect; None in older results."""


class Truth(msgspec.Struct, frozen=True):
    """The truth, as `hidden_truth.answer` returns it."""

    effect: str
    tier: str
    variant: str
    seed: int
    parameters: dict[str, float]
    also: tuple[Hidden, ...]
    gap: float
    share: float | None = None

    @property
    def hidden(self) -> dict[str, dict[str, float]]:
        """Everything that is hidden, with its parameters."""
        if self.effect == NONE:
            return {}
        return {self.effect: self.parameters} | {one.effect: one.parameters for one in self.also}

    @property
    def shares(self) -> dict[str, float]:
        """Share of each hidden cause of the catalogue, the largest first, if shares are known."""
        every = {self.effect: self.share} | {one.effect: one.share for one in self.also}
        known = {name: share for name, share in every.items() if share is not None and not _outside(name)}
        return dict(sorted(known.items(), key=lambda one: -one[1]))

    @property
    def outside(self) -> bool:
        """True if no hidden effect is in the catalogue."""
        return all(map(_outside, self.hidden)) and bool(self.hidden)

    @property
    def partly_outside(self) -> bool:
        """True if some of the hidden effects are in the catalogue, and others are not."""
        return any(map(_outside, self.hidden)) and not self.outside


def _outside(effect: str) -> bool:
    return effect.startswith("x_")


class Interval(msgspec.Struct, frozen=True):
    """A 95 % interval."""

    estimate: float
    low: float
    high: float


class Named(msgspec.Struct, frozen=True):
    """A named cause with its parameters."""

    cause: str
    parameters: dict[str, Interval] = {}
    share: float | None = None


class HeldOut(msgspec.Struct, frozen=True):
    """Errors on unseen data, divided by the measured range."""

    nrmse_before: float
    nrmse_after: float
    noise_floor: float


class Said(msgspec.Struct, frozen=True):
    """The scored part of a verdict."""

    cause: str
    confidence: float | None = None
    indistinguishable: tuple[str, ...] = ()
    parameters: dict[str, Interval] = {}
    share: float | None = None
    """Share of the misfit removed by all causes that comes back without the first cause."""
    also: tuple[Named, ...] = ()
    held_out: HeldOut | None = None

    @property
    def named(self) -> dict[str, dict[str, Interval]]:
        """The named causes with their parameters."""
        first = {} if self.cause in (NONE, UNEXPLAINED) else {self.cause: self.parameters}
        return first | {one.cause: one.parameters for one in self.also}

    @property
    def candidates(self) -> tuple[str, ...]:
        """The causes to which the confidence belongs."""
        return (self.cause, *self.indistinguishable)


class Outcome(msgspec.Struct, frozen=True):
    """The outcome of one case."""

    engine: str
    """Digest of the sources. Outcomes of different sources must not be counted together."""
    truth: Truth
    said: Said | None
    """None if the diagnosis failed."""
    error: str = ""
    cpu_s: float | None = None

    @property
    def key(self) -> Key:
        return self.truth.tier, self.truth.seed


_BEGINS = '{"engine": '
"""Every line begins like this."""


class ResultsError(ValueError):
    """A file that does not contain outcomes; the text is one line."""


def as_outcome(row: object) -> Outcome:
    """Convert a row of a worker or of the file. Raises msgspec.ValidationError if it is not valid."""
    return msgspec.convert(row, Outcome)


def read_outcomes(path: Path) -> list[Outcome]:
    """All lines of a file except a last line that was cut off because the run was killed."""
    *whole, cut_off = _text(path).split("\n")
    if not cut_off.startswith(_BEGINS[: len(cut_off)]):
        whole.append(cut_off)
    return list(_outcomes(path, whole))


def begun(path: Path) -> list[Outcome]:
    """The outcomes of a file that is continued; a missing file is created."""
    try:
        path.touch()
        found = read_outcomes(path)
        text = _text(path)
        path.write_text(text[: text.rfind("\n") + 1], encoding="utf-8")
    except OSError as error:
        raise ResultsError(f"{path}: cannot be written: {error.strerror}") from None
    return found


def append(path: Path, row: object) -> None:
    """Append a row. It is written at once, so that an interrupted run loses nothing."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise ResultsError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ResultsError(f"{path}: is not a text file; give the file that --results wrote") from None


def _outcomes(path: Path, lines: Iterable[str]) -> Iterator[Outcome]:
    for number, line in enumerate(lines, start=1):
        try:
            # Not msgspec's own reader: it does not accept NaN and infinity as Python writes them.
            yield as_outcome(json.loads(line))
        except (json.JSONDecodeError, msgspec.ValidationError) as error:
            raise ResultsError(f"{path}:{number}: is not an outcome of this benchmark: {error}") from None


class Judgement(Enum):
    """Judgement of a verdict against the truth."""

    RIGHT = "right"
    ALIKE = "among indistinguishable"
    OPEN = "left open"
    WRONG = "wrong"


def wilson(count: int, of: int) -> tuple[float, float]:
    """The 95 % interval of a share, estimated from a sample (Wilson 1927)."""
    if of == 0:
        return 0.0, 1.0
    share, z2 = count / of, _Z**2
    middle = (share + z2 / (2 * of)) / (1 + z2 / of)
    half = _Z / (1 + z2 / of) * sqrt(share * (1 - share) / of + z2 / (4 * of**2))
    # At either end, rounding must not exclude the observed share.
    return min(share, middle - half), max(share, middle + half)


def judge(truth: Truth, said: Said) -> Judgement:
    """Compare a verdict with the truth.

    RIGHT: `none` for a rig without hidden effects, `unexplained` for an effect that the catalogue lacks, else
    the hidden cause. Two causes must both be named, in any order. Of several causes the largest one must be
    first.
    """
    if truth.tier in SEVERAL:
        return _judge_first(truth, said)
    if truth.outside:
        return Judgement.RIGHT if said.cause == UNEXPLAINED else Judgement.WRONG
    hidden = set(truth.hidden)
    if not hidden:
        return Judgement.RIGHT if said.cause == NONE else Judgement.WRONG
    # A single hidden cause must be named first: the verdict must not say that another cause explains more.
    named = set(said.named) if len(hidden) > 1 else {said.cause}
    if hidden <= named:
        return Judgement.RIGHT
    if hidden <= named.union(said.indistinguishable):
        return Judgement.ALIKE
    if said.cause == UNEXPLAINED or (said.cause == NONE and said.confidence and said.confidence < UNSURE):
        return Judgement.OPEN
    return Judgement.WRONG


def _judge_first(truth: Truth, said: Said) -> Judgement:
    largest = next(iter(truth.shares))
    if said.cause == largest:
        return Judgement.RIGHT
    if largest in said.indistinguishable:
        return Judgement.ALIKE
    return Judgement.OPEN if said.cause == UNEXPLAINED else Judgement.WRONG


def judgement(outcome: Outcome) -> Judgement:
    """A failure counts as wrong."""
    return Judgement.WRONG if outcome.said is None else judge(outcome.truth, outcome.said)


def counts(outcome: Outcome) -> bool:
    """True if the case counts for the goal of its tier. In `short`, a verdict that leaves it open counts
    too."""
    enough = {Judgement.RIGHT, Judgement.ALIKE}
    if outcome.truth.tier == "short":
        enough.add(Judgement.OPEN)
    return judgement(outcome) in enough


def false_names(truth: Truth, said: Said) -> list[str]:
    """Causes that are named but not hidden."""
    return [name for name in said.named if name not in truth.hidden]


def large(truth: Truth) -> list[str]:
    """Causes of the catalogue that must be listed."""
    return [name for name, share in truth.shares.items() if share > LARGE]


def share_errors(truth: Truth, said: Said) -> list[float]:
    """Stated minus true share of each rightly named cause for which both are known."""
    stated = {said.cause: said.share} | {one.cause: one.share for one in said.also}
    return [share - truth.shares[n] for n, share in stated.items() if share is not None and n in truth.shares]


@dataclass(frozen=True)
class Measured:
    """A parameter of a rightly named cause."""

    cause: str
    name: str
    true: float
    interval: Interval

    @property
    def held(self) -> bool:
        return self.interval.low <= self.true <= self.interval.high


def measured(truth: Truth, said: Said) -> Iterator[Measured]:
    """Every parameter with a true and an estimated value."""
    for cause, parameters in truth.hidden.items():
        for name, true in parameters.items():
            interval = said.named.get(cause, {}).get(name)
            if interval is not None:
                yield Measured(cause, name, true, interval)


def off(one: Measured, neutral: Neutral) -> float:
    """The error divided by the distance of the true value from the neutral value.

    The neutral value is 1 for a scale or gain, and 0 for others. If it is infinite (leaks) or missing, the
    error is divided by the true value.
    """
    at = neutral.get((one.cause, one.name))
    distance = one.true if at is None or isinf(at) else one.true - at
    error = abs(one.interval.estimate - one.true)
    return error / abs(distance) if distance else inf


def holds(truth: Truth, said: Said) -> bool:
    """True if the claim that the confidence belongs to is right. Of two hidden causes, either is right."""
    if truth.outside or (truth.partly_outside and said.cause == UNEXPLAINED):
        return said.cause == UNEXPLAINED
    return not set(truth.hidden or {NONE}).isdisjoint(said.candidates)


@dataclass(frozen=True)
class Bin:
    """Verdicts of similar confidence."""

    low: float
    high: float
    stated: float
    """The mean of the confidences."""
    held: int
    of: int


def reliability(stated: Sequence[tuple[float, bool]]) -> list[Bin]:
    """Groups of verdicts by confidence, with the share that was right; empty groups are left out."""
    found = []
    for low, high in pairwise(BINS):
        inside = [(p, true) for p, true in stated if low < p <= high or p == low == 0.0]
        if inside:
            mean = fmean(p for p, _ in inside)
            found.append(Bin(low, high, mean, sum(true for _, true in inside), len(inside)))
    return found


def brier(stated: Sequence[tuple[float, bool]]) -> float:
    """Mean squared error of the stated probabilities: 0 is perfect, 0.25 is a coin toss."""
    return fmean((p - true) ** 2 for p, true in stated)


def over_noise(said: Said) -> float | None:
    """The error on unseen data divided by the noise, if it was measured."""
    error = said.held_out
    return error.nrmse_after / error.noise_floor if error is not None and error.noise_floor > 0.0 else None
