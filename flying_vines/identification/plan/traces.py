"""Traces: the effect of each cause on the readings of a run, and their inner products.

Each cause is simulated by the model of the diagnosis at several strengths, with the inputs of the run on the
nominal rig. The difference from the baseline, in units of the sensors' noise, is its trace. The inner
products of the traces contain everything that readings with independent noise can show. Those of a plan are
sums over its runs:

    G = Σ traces · tracesᵀ

The two initial pressures of each run are free, so their effect is projected out of G run by run. The rig
numbers and the parameters of known causes are the same in all runs. Each of them has a row in G: its effect
if it moves by its standard deviation.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flying_vines.identification.case import Case
from flying_vines.identification.noise import Noise, stated_noise
from flying_vines.identification.plan.library import CandidateRun
from flying_vines.identification.plan.nominal_run import nominal_run
from flying_vines.identification.plan.strengths import strengths, typical
from flying_vines.identification.recording import RecordedRun
from flying_vines.identification.simulate import Simulation, prior_std, rig_number_keys
from flying_vines.physics.arrays import Array
from flying_vines.physics.cause import Cause, Values
from flying_vines.physics.constants import ALPHA_KPA
from flying_vines.physics.rig import Rig, number
from flying_vines.simulation.scenario.scenario import RunKind

Causes = Sequence[tuple[Cause, Values]]

_NOMINAL: Mapping[str, float] = {}
_NOTHING: Mapping[str, Values] = {}
_RESERVOIR_KPA, _CV_KPA = 1.0, 0.1
"""Finite-difference steps of the initial pressures."""


@dataclass(frozen=True)
class Layout:
    """The rows of G: each cause at its strengths, then the rig numbers and the parameters of known causes."""

    rig: Rig
    causes: tuple[Cause, ...]
    values: tuple[tuple[float, ...], ...]
    first: NDArray[np.intp]
    """Row of each cause's first strength."""
    usual: NDArray[np.intp]
    """Row of each cause at its typical strength."""
    rest: tuple[Values, ...]
    """Values of each cause's further parameters."""
    keys: tuple[str, ...]
    noise: Noise
    known: Causes
    """Causes that are certainly in the rig. `Parameter.typical` is the prior of their parameters."""

    @property
    def traces(self) -> int:
        """Number of rows before those of the rig numbers."""
        return sum(map(len, self.values))

    @property
    def nothing(self) -> Array:
        """G of no run at all."""
        known = sum(len(values) for _, values in self.known)
        return np.zeros((self.traces + len(self.keys) + known,) * 2)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(cause.name for cause in self.causes)


@dataclass(frozen=True, eq=False)
class CandidatePart:
    """The first `count` parts of a candidate."""

    candidate: CandidateRun
    count: int
    seconds: float
    air_SL: float
    """Air that leaves the reservoir on the nominal rig."""
    gram: Array

    @cached_property
    def kind(self) -> RunKind:
        """The run in a scenario."""
        return self.candidate.make(self.count)


def layout_of(
    rig: Rig,
    causes: Sequence[Cause],
    known: Causes = (),
    fitted: Mapping[str, Values] = _NOTHING,
    noise: Noise | None = None,
) -> Layout:
    """The layout for these causes.

    Args:
        known: see `Layout.known`.
        fitted: typical parameter values by cause; default: those of real rigs.
        noise: of both sensors; default: the rig's.
    """
    typical_of = [fitted[c.name][0] if c.name in fitted else typical(c, rig) for c in causes]
    values = tuple(strengths(cause, usual) for cause, usual in zip(causes, typical_of, strict=True))
    first = np.cumsum([0, *map(len, values)])[:-1]
    # Not `index`: on a logarithmic scale the value comes back with a rounding error.
    usual = [
        int(np.argmin(np.abs(np.array(row) - value))) for row, value in zip(values, typical_of, strict=True)
    ]
    return Layout(
        rig=rig,
        causes=tuple(causes),
        values=values,
        first=first,
        usual=first + np.array(usual),
        rest=tuple(fitted.get(cause.name, cause.seeds()[0])[1:] for cause in causes),
        keys=rig_number_keys(rig),
        noise=stated_noise(rig) if noise is None else noise,
        known=tuple(known),
    )


def parts_of(layout: Layout, candidate: CandidateRun, max_s: float = inf) -> list[CandidatePart]:
    """A candidate at each of its lengths up to `max_s`: on a rig that fills slowly, runs can take hours."""
    counts = [count for count in candidate.counts if candidate.make(count).length_s <= max_s]
    if not counts:
        return []
    whole = candidate.make(counts[-1])
    run = nominal_run(layout.rig, whole)
    rows, reservoir_kPa = _traces(layout, run, whole.reservoir_kPa)
    parts, gram, done = [], np.zeros((len(rows), len(rows))), 0
    for count in counts:
        seconds = candidate.make(count).length_s
        end = min(len(run.time_s), round(seconds * whole.sample_rate_Hz))
        piece = rows[:, :, done:end].reshape(len(rows), -1)
        gram, done = gram + piece @ piece.T, end
        air_SL = layout.rig.reservoir.volume_L * (reservoir_kPa[0] - reservoir_kPa[end - 1]) / ALPHA_KPA
        parts.append(CandidatePart(candidate, count, seconds, float(air_SL), _without_initial(gram)))
    return parts


def _traces(layout: Layout, run: RecordedRun, reservoir_kPa: float) -> tuple[Array, Array]:
    """(rows, 2, n): traces of G's rows, then of both initial pressures; and the reservoir's baseline, kPa."""
    simulation = Simulation(Case(Path(run.name), layout.rig, (run,), ()))
    start = np.array([[reservoir_kPa, 0.0]])
    noise = np.array([sensor.slow_std_kPa for sensor in layout.noise])[:, None]
    if run.to_atmosphere:
        noise[0] = np.inf

    def readings(moved: Mapping[str, float] = _NOMINAL, causes: Causes = (), initial: Array = start) -> Array:
        return np.stack(simulation.readings(0, moved, causes, initial))

    known = list(layout.known)
    baseline = readings(causes=known)
    rows = [
        readings(causes=[*known, (cause, (value, *rest))])
        for cause, values, rest in zip(layout.causes, layout.values, layout.rest, strict=True)
        for value in values
    ]
    for key in layout.keys:
        moved = number(layout.rig, key) * (1.0 + prior_std(layout.rig, key))
        rows.append(readings({key: moved}, known))
    rows += [readings(causes=others) for others in _moved(known)]
    rows += [readings(causes=known, initial=start + move) for move in ((_RESERVOIR_KPA, 0.0), (0.0, _CV_KPA))]
    traces = (np.array(rows) - baseline) / noise
    return np.nan_to_num(traces, nan=0.0, posinf=0.0, neginf=0.0), baseline[1]


def _moved(known: Causes) -> Iterator[Causes]:
    """The known causes, with each of their parameters in turn moved by its standard deviation."""
    for index, (cause, values) in enumerate(known):
        for at, parameter in enumerate(cause.parameters):
            assert parameter.typical is not None
            mean, sd = parameter.typical
            inside = mean + sd <= parameter.to_search(parameter.high)
            moved = parameter.to_model(mean + sd if inside else mean - sd)
            there = (*values[:at], moved, *values[at + 1 :])
            yield [*known[:index], (cause, there), *known[index + 1 :]]


def _without_initial(gram: Array) -> Array:
    """G with its last two rows, the initial pressures, projected out."""
    free, shared = gram[-2:, -2:], gram[:-2, -2:]
    left: Array = gram[:-2, :-2] - shared @ np.linalg.pinv(free, hermitian=True) @ shared.T
    return left
