"""Compares the paper's three discharges with the baseline, and finds the causes that explain the readings.

A case has one rig, but the paper has bottles of 4 and 2 litres, and a valve in two settings. Only flow over
volume matters in a discharge: a run with 4 litres is a run with 2 litres and half the opening. Heat and leaks
are per bottle of 2 litres. So openings are not commands here, and causes that change how a valve follows a
command are not tested: the paper's valve did not move.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import log
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from flying_vines.identification.case import Case, RecordedRun
from flying_vines.identification.fit import FitPoint
from flying_vines.identification.verdict import NONE, ParameterEstimate
from flying_vines.physics.arrays import Array
from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.effects import catalogue
from flying_vines.physics.rig import Rig
from flying_vines.studies.paper.compare import HIGH_RESISTANCE, HIGH_RESISTANCE_RATIO
from flying_vines.studies.paper.data import DISCHARGES, curve
from flying_vines.studies.paper.diagnosis.correlated import RESERVOIR, Correlated
from flying_vines.studies.paper.diagnosis.evidence import Noise, UnexplainedLevel, Worth, worth
from flying_vines.studies.paper.diagnosis.rivals import RESERVOIR_WALL, SENSOR_LINE, VALVE_SETTLES

BOTTLE_L = 2.0
VOLUME_L = {"4L_highRv": 4.0, "4L_lowRv": 4.0, "2L_lowRv": 2.0}
FLOW = "evp.flow_resistance_kPa_s_per_SL"
COARSEST_KPA, FINEST_KPA = 3.0, 0.5
"""Range of possible steps of a logger's readings."""

DISCREPANCY_KPA = (1.5, 3.0, 6.0, 12.0, 24.0)
LENGTH_S = (5.0, 20.0, 80.0, 320.0)
BETWEEN_SERIES = (0.01, 0.03, 0.1)
"""Scatter of the valve's flow between series: from 1 % up to the data sheet's hysteresis of 10 %."""
NOISES = ("rough", "smooth", "from anywhere")
"""Three kinds of model error: rough and 0 at the start, smooth, and present from the first reading on."""
LEAST_SQUARES = UnexplainedLevel(5.0, 1e-3, 0.0)
"""Independent errors: a least-squares fit through the first readings."""
PINNED_KPA = 0.01
"""Standard deviation with which such a fit passes the first readings."""
_FIRST_LEVEL = UnexplainedLevel(6.0, 80.0, 0.03)

_TYPICAL = {
    "evp_restriction": (0.0, 0.25),  # a rating, a setting and a seat: 25 %
    "reservoir_volume": (0.0, 0.05),  # a bottle is as large as it says to 5 %
    "reservoir_cooling": (log(10.0), 0.8),  # natural convection: 10 s, within a factor of 2 or so
    "reservoir_leak": (log(1e5), 2.0),  # from 1/10 of the valve's flow to nothing to speak of
    "reservoir_sensor_offset": (0.0, 11.0),  # total error band ±22.5 kPa
    "reservoir_sensor_gain": (0.0, 0.015),  # total error band ±1.5 %
}
"""Prior mean and standard deviation of each parameter, on the search scale."""

SETS = (
    (),
    ("evp_restriction",),
    ("compressible_flow",),
    ("reservoir_cooling",),
    ("reservoir_wall",),
    ("reservoir_leak",),
    ("reservoir_volume",),
    ("reservoir_sensor_gain",),
    ("reservoir_sensor_offset",),
    ("sensor_line",),
    ("valve_settles",),
    ("evp_restriction", "compressible_flow"),
    ("evp_restriction", "reservoir_sensor_offset"),
    ("evp_restriction", "reservoir_cooling"),
    ("evp_restriction", "reservoir_wall"),
    ("evp_restriction", "sensor_line"),
    ("evp_restriction", "valve_settles"),
    ("reservoir_cooling", "compressible_flow"),
    ("reservoir_leak", "reservoir_cooling"),
    ("reservoir_leak", "reservoir_wall"),
    ("evp_restriction", "reservoir_cooling", "compressible_flow"),
    ("evp_restriction", "reservoir_wall", "compressible_flow"),
    ("evp_restriction", "reservoir_wall", "reservoir_sensor_offset"),
    ("evp_restriction", "reservoir_cooling", "sensor_line"),
    ("evp_restriction", "reservoir_wall", "sensor_line"),
    ("evp_restriction", "valve_settles", "sensor_line"),
)
"""The tested sets: none, every cause that can act in a discharge, and physically likely combinations."""
ALIKE = 9.2
"""2 ln 100. A candidate nearer than this to the best, for any kind of noise, is not separated from it."""
HEAT = ("reservoir_cooling", "reservoir_wall")
"""Causes with a gas temperature in the reservoir."""
MORE_AIR = ("evp_restriction", "reservoir_volume", "reservoir_leak")
"""Causes with more flow out of the reservoir, or less air in it."""


def causes() -> dict[str, Cause]:
    """The causes that can act in a discharge, with priors for their parameters."""
    known = {cause.name: cause for cause in catalogue()}
    chosen = {name: _with_typical(known[name], typical) for name, typical in _TYPICAL.items()}
    chosen["compressible_flow"] = known["compressible_flow"]
    return chosen | {cause.name: cause for cause in (SENSOR_LINE, VALVE_SETTLES, RESERVOIR_WALL)}


def _with_typical(cause: Cause, typical: tuple[float, float]) -> Cause:
    (parameter,) = cause.parameters
    return replace(cause, parameters=(replace(parameter, typical=typical),))


def paper_case(settings_ratio: float = HIGH_RESISTANCE_RATIO) -> Case:
    """The three runs, converted to 2 litre bottles and equivalent openings.

    Args:
        settings_ratio: ratio of the valve's resistances in its two settings.
    """
    return Case(Path("paper"), Rig(cv=None), tuple(_run(name, settings_ratio) for name in DISCHARGES), ())


def _run(name: str, settings_ratio: float) -> RecordedRun:
    measured = curve(f"discharge_{name}_measured")
    opening = BOTTLE_L / VOLUME_L[name] / (settings_ratio if name == HIGH_RESISTANCE else 1.0)
    return discharge_run(name, measured.x, np.full(len(measured.x), opening), measured.y)


def discharge_run(name: str, time_s: Array, opening: Array, reservoir_kPa: Array) -> RecordedRun:
    """A discharge to atmosphere."""
    shut, unread = np.zeros(len(time_s)), np.full(len(time_s), np.nan)
    return RecordedRun(name, time_s, None, opening, shut, shut + 1.0, unread, reservoir_kPa, None, None, True)


def step_kPa(case: Case) -> tuple[float, float]:
    """Step of the grid on which all readings lie, and how well they lie on it (1: exactly).

    Each reading is an angle, with one step as a full turn; the result is the length of the mean vector.
    """
    readings = np.concatenate([run.reservoir_kPa for run in case.runs])
    steps = np.linspace(FINEST_KPA, COARSEST_KPA, 5_001)
    fits = np.abs(np.exp(2j * np.pi * readings / steps[:, None]).mean(axis=1))
    best = int(np.argmax(fits))
    return float(steps[best]), float(fits[best])


def noises(rounding_kPa: float) -> tuple[Noise, Noise, Noise]:
    """The three kinds of `NOISES`."""
    rough = Noise(rounding_kPa, DISCREPANCY_KPA, LENGTH_S, BETWEEN_SERIES)
    return rough, replace(rough, smooth=True), replace(rough, from_start=False)


@dataclass(frozen=True)
class DischargeModel:
    """A model with some causes (or none), fitted to the readings."""

    names: tuple[str, ...]
    problem: Correlated
    """The problem at the best level of the first kind of noise."""
    point: FitPoint
    """The most likely point of this problem."""
    worths: tuple[Worth, ...]
    """For each kind of noise in `NOISES`."""
    estimates: dict[str, dict[str, ParameterEstimate]]
    """Averaged over all levels of the first kind of noise."""
    plain: Correlated
    """The least-squares problem."""
    nearest: FitPoint
    """The least-squares fit."""
    rms_kPa: float
    """Error of the least-squares fit."""
    nrmse_percent: tuple[float, ...]
    """Error of the least-squares fit for each run, relative to its first reading."""
    predicted_percent: tuple[float, ...]
    """Error of each run predicted by a fit to the two others, relative to its first reading."""

    @property
    def label(self) -> str:
        return " + ".join(self.names) or NONE


@dataclass(frozen=True)
class Discharges:
    """All tested models, the best first."""

    case: Case
    kinds: tuple[Noise, ...]
    step_kPa: float
    on_grid: float
    candidates: tuple[DischargeModel, ...]
    alike: tuple[Alike, ...]

    def of(self, *names: str) -> DischargeModel:
        """The candidate with these causes."""
        return next(c for c in self.candidates if set(c.names) == set(names))

    def above(self, candidate: DischargeModel) -> tuple[float, ...]:
        """−2 ln of its evidence relative to the best, for each kind of noise."""
        return tuple(
            w.minus_2_ln - min(c.worths[i].minus_2_ln for c in self.candidates)
            for i, w in enumerate(candidate.worths)
        )

    @property
    def null(self) -> DischargeModel:
        return self.of()

    @property
    def named(self) -> DischargeModel:
        """Of the candidates that are not separated from the best: the best with the fewest causes."""
        possible = self.open()
        fewest = min(len(c.names) for c in possible)
        return next(c for c in possible if len(c.names) == fewest)

    def open(self) -> tuple[DischargeModel, ...]:
        """The candidates that the readings do not separate from the best."""
        return tuple(c for c in self.candidates if min(self.above(c)) < ALIKE)

    def missed(self, has: Callable[[DischargeModel], bool]) -> tuple[float, ...]:
        """−2 ln of the evidence: best candidate without a property minus best with it, for each noise."""
        differences = []
        for i in range(len(NOISES)):
            without, with_it = (
                min(c.worths[i].minus_2_ln for c in self.candidates if has(c) is wanted)
                for wanted in (False, True)
            )
            differences.append(without - with_it)
        return tuple(differences)


@dataclass(frozen=True)
class Alike:
    """Similarity of two causes in these readings."""

    first: str
    second: str
    correlation: float
    """Correlation of their traces without the effect of initial pressures; NaN if nothing else is left."""


def analyse(
    progress: Callable[[str], None] = lambda step: None, sets: Sequence[tuple[str, ...]] = SETS
) -> Discharges:
    """Fit sets of causes to the paper's discharges; the first set is none."""
    with threadpool_limits(1):
        return _analyse(paper_case(), progress, sets)


def _analyse(case: Case, progress: Callable[[str], None], sets: Sequence[tuple[str, ...]]) -> Discharges:
    step, on_grid = step_kPa(case)
    kinds = noises(step / np.sqrt(12.0))
    known = causes()
    tried = []
    for names in sets:
        progress(" + ".join(names) or "baseline")
        tried.append(candidate(case, kinds, [known[name] for name in names]))
    null = tried[0]
    return Discharges(
        case=case,
        kinds=kinds,
        step_kPa=step,
        on_grid=on_grid,
        candidates=tuple(sorted(tried, key=lambda c: c.worths[0].minus_2_ln)),
        alike=tuple(_alike(null, [known[name] for name in _TYPICAL])),
    )


def candidate(case: Case, kinds: Sequence[Noise], causes: Sequence[Cause]) -> DischargeModel:
    """Fit one set of causes."""
    plain = Correlated(case, replace(kinds[0], rounding=PINNED_KPA), LEAST_SQUARES)
    starts = seeded(start_of(plain), causes)
    nearest = best_fit(plain, starts)
    starts, level = [nearest, starts[len(starts) // 2]], _FIRST_LEVEL
    # The level of the noise and the fit depend on each other; two iterations are enough.
    for _ in range(2):
        problem = Correlated(case, kinds[0], level)
        point = best_fit(problem, starts)
        starts = [point]
        linear = problem.linear(point)
        level = worth(kinds[0], linear).level
    worths = tuple(worth(kind, linear) for kind in kinds)
    errors = _errors_kPa(plain, nearest)
    return DischargeModel(
        names=tuple(cause.name for cause in causes),
        problem=problem,
        point=point,
        worths=worths,
        estimates=_estimates(point, worths[0]),
        plain=plain,
        nearest=nearest,
        rms_kPa=_rms(np.concatenate(errors)),
        nrmse_percent=tuple(
            100.0 * _rms(e) / float(run.reservoir_kPa[0]) for e, run in zip(errors, case.runs, strict=True)
        ),
        predicted_percent=_predicted_percent(plain, nearest),
    )


def start_of(problem: Correlated) -> FitPoint:
    """The nominal rig, with the first readings as initial pressures."""
    start = problem.start().freed((FLOW,))
    initial = start.initial.copy()
    initial[:, 0] = [data[RESERVOIR, 0] for data in problem.data]
    return replace(start, initial=initial)


def seeded(start: FitPoint, causes: Sequence[Cause]) -> list[FitPoint]:
    """Starting points of fits with these causes: all at their first seeds, all at their second seeds, …"""
    starts = []
    for number in range(max((len(cause.seeds()) for cause in causes), default=1)):
        point = start
        for cause in causes:
            point = point.with_cause(cause, cause.seeds()[min(number, len(cause.seeds()) - 1)])
        starts.append(point)
    return starts


def best_fit(problem: Correlated, starts: Sequence[FitPoint]) -> FitPoint:
    """The best of the fits from these points."""
    return min((problem.fit(start) for start in starts), key=lambda fit: fit.cost).point


def _predicted_percent(plain: Correlated, nearest: FitPoint) -> tuple[float, ...]:
    """Error of each run, predicted by a least-squares fit to the two others and its own first reading."""
    runs = plain.case.runs
    errors = []
    for index, run in enumerate(runs):
        used = [np.ones(len(other.time_s), dtype=np.bool_) for other in runs]
        used[index] = np.arange(len(run.time_s)) == 0
        point = type(plain)(plain.case, plain.correlated, plain.level, used).fit(nearest).point
        error = _errors_kPa(plain, point)[index]
        errors.append(100.0 * _rms(error[1:]) / float(run.reservoir_kPa[0]))
    return tuple(errors)


def _errors_kPa(problem: Correlated, point: FitPoint) -> list[Array]:
    return [
        data[RESERVOIR] - simulated[RESERVOIR]
        for data, simulated in zip(problem.data, problem.simulated(point), strict=True)
    ]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _estimates(point: FitPoint, found: Worth) -> dict[str, dict[str, ParameterEstimate]]:
    estimates: dict[str, dict[str, ParameterEstimate]] = {}
    at = len(point.deviation)
    for cause, values in zip(point.causes, point.values, strict=True):
        estimates[cause.name] = {}
        for parameter, value in zip(cause.parameters, values, strict=True):
            estimates[cause.name][parameter.name] = _estimate(parameter, value, found.shift[at], found.sd[at])
            at += 1
    return estimates


def _estimate(parameter: Parameter, value: float, shift: float, sd: float) -> ParameterEstimate:
    searched = parameter.to_search(value) + shift
    return ParameterEstimate(*(parameter.within(searched + move) for move in (0.0, -1.96 * sd, 1.96 * sd)))


def _alike(null: DischargeModel, causes: Sequence[Cause]) -> list[Alike]:
    """Correlations of the traces of single causes, around the baseline's least-squares fit."""
    problem = null.plain
    base = null.nearest.freed(())
    free = problem.linear(base).traces
    basis, _ = np.linalg.qr(free)

    def orthogonal_part(trace: Array) -> Array:
        return np.asarray(trace - basis @ (basis.T @ trace))

    raw = {cause.name: _trace(problem, base, cause) for cause in causes}
    own = {name: orthogonal_part(trace) for name, trace in raw.items()}
    pairs = []
    names = list(raw)
    for i, first in enumerate(names):
        for second in names[i + 1 :]:
            a, b = own[first], own[second]
            lengths = float(np.linalg.norm(a)), float(np.linalg.norm(b))
            seen = all(
                length > 1e-3 * float(np.linalg.norm(raw[name]))
                for length, name in zip(lengths, (first, second), strict=True)
            )
            correlation = float(a @ b) / (lengths[0] * lengths[1]) if seen else float("nan")
            pairs.append(Alike(first, second, correlation))
    return pairs


def _trace(problem: Correlated, base: FitPoint, cause: Cause) -> Array:
    """The effect of a weak cause on all readings."""
    (parameter,) = cause.parameters
    assert parameter.typical is not None
    mean, sd = parameter.typical
    searched = mean + 0.01 * sd
    with_it = problem.pressures_kPa(base.with_cause(cause, (parameter.to_model(searched),)))
    return with_it - problem.pressures_kPa(base)
