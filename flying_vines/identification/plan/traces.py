"""Traces: the effect of each cause on the readings of a run, and their inner products.

Each cause is simulated by the model of the diagnosis at several strengths, with the inputs of the run on the
nominal rig. The difference from the baseline, in units of the sensors' noise, is its trace. The inner
products of the traces contain everything that readings with independent noise can show. Those of a plan are
sums over its runs:

    G = Σ traces · tracesᵀ

The two initial pressures of each run are free, so their effect is projected out of G run by run. The rig
numbers and the parameters of known causes are the same in all runs. Each of them has a row in G: its effect
if it moves by its standard deviation.

A plan must separate causes at the strengths of real rigs: typical leaks, valves, walls and sensors, from the
same sources as the ranges of the parameters. A cause that imitates another may have any strength. So its
trace is computed from almost no effect to many times the typical strength, and interpolated linearly.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf, isinf
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flying_vines.identification.case import Case
from flying_vines.identification.noise import Noise, stated_noise
from flying_vines.identification.plan.library import CandidateRun, nominal_run
from flying_vines.identification.recording import RecordedRun
from flying_vines.identification.simulate import Simulation, prior_std, rig_number_keys
from flying_vines.physics.arrays import Array
from flying_vines.physics.cause import Cause, Parameter, Values
from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.physics.rig import Rig, number
from flying_vines.simulation.scenario.scenario import RunKind

Causes = Sequence[tuple[Cause, Values]]

NO_VALUES: Mapping[str, Values] = {}
_RESERVOIR_KPA, _CV_KPA = 1.0, 0.1
"""Finite-difference steps of the initial pressures."""
TYPICAL = {
    "ambient_drop": 0.07,
    "compressible_flow": 0.3,
    "cv_compliance": 0.005,
    "cv_heating": 2.0,
    "cv_leak": 550.0,
    "cv_sensor_drift": 1.5,
    "cv_sensor_gain": 1.04,
    "cv_sensor_lag": 0.03,
    "cv_sensor_offset": 1.5,
    "evp_dead_zone": 0.2,
    "evp_heating": 0.15,
    "evp_hysteresis": 0.1,
    "evp_lag": 0.017,
    "evp_restriction": 1.18,
    "hose": 30.0,
    "line_delay": 0.03,
    "orifice_leak": 3e-4,
    "reservoir_cooling": 9.0,
    "reservoir_leak": 8000.0,
    "reservoir_orifice_leak": 1e-4,
    "reservoir_sensor_drift": 11.0,
    "reservoir_sensor_gain": 1.04,
    "reservoir_sensor_offset": 11.0,
    "reservoir_viscous_leak": 6e6,
    "reservoir_volume": 1.11,
    "solenoid_slow_close": 0.03,
    "venturi_stall": 440.0,
    "viscous_leak": 1.1e5,
}
"""Typical value of each cause's first parameter, in its unit."""
DEAD_SHARE = 0.18
"""Typical dead volume of tubing and fittings, as a share of the control volume."""
_ONE_SIDED = (0.02, 0.06, 0.15, 0.3, 0.5, 0.75, 1.0, 1.4, 2.0, 3.0, 5.0, 10.0, 25.0)
_TWO_SIDED = (-6.0, -3.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 3.0, 6.0)
_EVENLY = 16


def typical(cause: Cause, rig: Rig) -> float:
    """Typical value of the cause's first parameter."""
    if cause.name == "dead_volume" and rig.cv is not None:
        return DEAD_SHARE * rig.cv.volume_L
    if cause.name in TYPICAL:
        return TYPICAL[cause.name]
    # Unknown for this cause: use a seed of its fits.
    parameter = cause.parameters[0]
    return parameter.with_effect(parameter.seeds[len(parameter.seeds) // 2])


def strengths(cause: Cause, usual: float) -> tuple[float, ...]:
    """Values of the first parameter, dense enough for linear interpolation; the typical one is among them."""
    parameter = cause.parameters[0]
    neutral = parameter.neutral
    if neutral is None or _is_threshold(parameter):
        steps = [parameter.low + i / _EVENLY * (parameter.high - parameter.low) for i in range(_EVENLY + 1)]
        return tuple(sorted({*steps, usual}))
    if parameter.low < neutral < parameter.high:
        zero = parameter.to_search(neutral)
        values = [parameter.to_model(zero + s * (parameter.to_search(usual) - zero)) for s in _TWO_SIDED]
        return _within(parameter, values)
    values = [usual / share if isinf(neutral) else share * usual for share in _ONE_SIDED]
    return (neutral, *_within(parameter, values))


def _within(parameter: Parameter, values: Sequence[float]) -> tuple[float, ...]:
    return tuple(dict.fromkeys(min(max(value, parameter.low), parameter.high) for value in values))


def _is_threshold(parameter: Parameter) -> bool:
    """True if the parameter is a threshold on a scale, not a size: such parameters have many seeds."""
    return len(parameter.seeds) > 8


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
    fitted: Mapping[str, Values] = NO_VALUES,
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

    def readings(causes: Causes, initial: Array = start, moved: Mapping[str, float] | None = None) -> Array:
        return np.stack(simulation.readings(0, moved or {}, causes, initial))

    known = list(layout.known)
    baseline = readings(known)
    rows = [
        readings([*known, (cause, (value, *rest))])
        for cause, values, rest in zip(layout.causes, layout.values, layout.rest, strict=True)
        for value in values
    ]
    for key in layout.keys:
        moved = number(layout.rig, key) * (1.0 + prior_std(layout.rig, key))
        rows.append(readings(known, moved={key: moved}))
    rows += [readings(others) for others in _moved(known)]
    rows += [readings(known, start + move) for move in ((_RESERVOIR_KPA, 0.0), (0.0, _CV_KPA))]
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
