"""The outcome of a case as one line of JSON: what was hidden, the verdict, and its cost."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

import msgspec

from flying_vines.identification.verdict import NONE, UNEXPLAINED

DIAGNOSE = "diagnose"
"""Who says it: this project, as against its peers."""
Key = tuple[str, str, int]


class Hidden(msgspec.Struct, frozen=True):
    """An effect in a rig."""

    effect: str
    parameters: dict[str, float]
    share: float | None = None
    """Of the baseline's misfit, what comes back without it; None in results from before it was asked."""


class Truth(msgspec.Struct, frozen=True):
    """As `hidden_truth.answer` gives it."""

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
        """Of each hidden cause of the catalogue, the largest first, where shares are known."""
        every = {self.effect: self.share} | {one.effect: one.share for one in self.also}
        known = {name: share for name, share in every.items() if share is not None and not _outside(name)}
        return dict(sorted(known.items(), key=lambda one: -one[1]))

    @property
    def outside(self) -> bool:
        """Whether the catalogue lacks all that is hidden."""
        return all(map(_outside, self.hidden)) and bool(self.hidden)

    @property
    def partly_outside(self) -> bool:
        """Whether the catalogue lacks something that is hidden beside what it holds."""
        return any(map(_outside, self.hidden)) and not self.outside


def _outside(effect: str) -> bool:
    return effect.startswith("x_")


class Interval(msgspec.Struct, frozen=True):
    """Of 95 %."""

    estimate: float
    low: float
    high: float


class Named(msgspec.Struct, frozen=True):
    """A cause and what it measures."""

    cause: str
    parameters: dict[str, Interval] = {}
    share: float | None = None


class HeldOut(msgspec.Struct, frozen=True):
    """Errors on unseen data, over the range of what was measured."""

    nrmse_before: float
    nrmse_after: float
    noise_floor: float


class Said(msgspec.Struct, frozen=True):
    """A verdict, as far as it is scored; of a peer what it gives of one."""

    cause: str
    confidence: float | None = None
    indistinguishable: tuple[str, ...] = ()
    parameters: dict[str, Interval] = {}
    share: float | None = None
    """Of the first cause: of the misfit that all remove, what comes back without it."""
    also: tuple[Named, ...] = ()
    held_out: HeldOut | None = None

    @property
    def named(self) -> dict[str, dict[str, Interval]]:
        """The causes that it claims, with their parameters."""
        first = {} if self.cause in (NONE, UNEXPLAINED) else {self.cause: self.parameters}
        return first | {one.cause: one.parameters for one in self.also}

    @property
    def candidates(self) -> tuple[str, ...]:
        """What its confidence is about."""
        return (self.cause, *self.indistinguishable)


class Fresh(msgspec.Struct, frozen=True):
    """What the command takes in a process of its own, start and compiling included."""

    cpu_s: float
    wall_s: float
    peak_MB: float


class Outcome(msgspec.Struct, frozen=True):
    """One case, by one way of looking at it."""

    by: str
    engine: str
    """Which version of the sources spoke: outcomes of two are not to be counted together."""
    truth: Truth
    said: Said | None
    """None where it failed."""
    error: str
    cpu_s: float | None = None
    wall_s: float | None = None
    fresh: Fresh | None = None

    @property
    def key(self) -> Key:
        return self.by, self.truth.tier, self.truth.seed


_BEGINS = '{"by": '
"""Every line."""


class ResultsError(ValueError):
    """A file that holds something else than outcomes; its text is one line."""


def as_outcome(row: object) -> Outcome:
    """A row as the worker makes it and the file keeps it. msgspec.ValidationError where it is none."""
    return msgspec.convert(row, Outcome)


def read_outcomes(path: Path) -> list[Outcome]:
    """All of a file but a last line that was cut off: the run was killed while it was written."""
    *whole, cut_off = _text(path).split("\n")
    if not cut_off.startswith(_BEGINS[: len(cut_off)]):
        whole.append(cut_off)
    return list(_outcomes(path, whole))


def begun(path: Path) -> list[Outcome]:
    """The outcomes of a file that is to be gone on with; one that is not there is made."""
    try:
        path.touch()
        found = read_outcomes(path)
        text = _text(path)
        path.write_text(text[: text.rfind("\n") + 1], encoding="utf-8")
    except OSError as error:
        raise ResultsError(f"{path}: cannot be written: {error.strerror}") from None
    return found


def append(path: Path, row: object) -> None:
    """At once, so that nothing is lost of a run that is stopped."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise ResultsError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ResultsError(f"{path}: is no text; give the file that --results wrote") from None


def _outcomes(path: Path, lines: Iterable[str]) -> Iterator[Outcome]:
    for number, line in enumerate(lines, start=1):
        try:
            # Not msgspec's own reader: what Python writes of NaN and infinity is not JSON to it.
            yield as_outcome(json.loads(line))
        except (json.JSONDecodeError, msgspec.ValidationError) as error:
            raise ResultsError(f"{path}:{number}: is no outcome of this benchmark: {error}") from None
