"""The outcome of a case as one line of JSON: the hidden effects, the verdict, and the cost of the verdict."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

import msgspec

from flying_vines.identification.verdict import NONE, UNEXPLAINED

DIAGNOSE = "diagnose"
"""Name of this project's method, as opposed to its peers."""
Key = tuple[str, str, int]


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
    """The scored part of a verdict. A peer fills only a part of it."""

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


class Fresh(msgspec.Struct, frozen=True):
    """Cost of the command in a process of its own, start and compiling included."""

    cpu_s: float
    wall_s: float
    peak_MB: float


class Outcome(msgspec.Struct, frozen=True):
    """The outcome of one case with one method."""

    by: str
    engine: str
    """Digest of the sources. Outcomes of different sources must not be counted together."""
    truth: Truth
    said: Said | None
    """None if the method failed."""
    error: str
    cpu_s: float | None = None
    wall_s: float | None = None
    fresh: Fresh | None = None

    @property
    def key(self) -> Key:
        return self.by, self.truth.tier, self.truth.seed


_BEGINS = '{"by": '
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
