"""Proposes an experiment of one minute that separates the explanations of the paper's discharges.

Each possible explanation is simulated in each experiment, with its parameters from the paper's readings, and
with the paper's sensor and logger. Each other explanation is then fitted to that record, with all its
parameters free. The χ² of its best fit is the separation of the two: once with the rounding of the readings
alone, and once with the unexplained error of the paper's series. The best experiment has the largest
separation of its worst pair.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from flying_vines.identification.case import Case, RecordedRun
from flying_vines.identification.fit import FitPoint, FitProblem
from flying_vines.identification.noise import independent_noise
from flying_vines.physics.arrays import Array
from flying_vines.physics.cause import Cause
from flying_vines.physics.rig import ControlVolume, Reservoir, Rig
from flying_vines.studies.paper.data import curve
from flying_vines.studies.paper.diagnosis.correlated import RESERVOIR, Correlated
from flying_vines.studies.paper.diagnosis.discharge import (
    BOTTLE_L,
    LEAST_SQUARES,
    DischargeModel,
    Discharges,
    best_fit,
    causes,
    discharge_run,
    seeded,
    start_of,
)
from flying_vines.studies.paper.diagnosis.evidence import Noise, UnexplainedLevel
from flying_vines.studies.paper.diagnosis.rivals import sensor_line

MINUTE_S = 60.0
RIVALS = (
    ("evp_restriction", "reservoir_cooling"),
    ("evp_restriction", "reservoir_cooling", "compressible_flow"),
    ("evp_restriction", "valve_settles", "sensor_line"),
    ("reservoir_leak", "reservoir_cooling"),
)
"""Possible explanations: heat with either law of flow, an imitation of heat, a leak."""


@dataclass(frozen=True)
class Experiment:
    """One minute with the 2 litre bottle, with the paper's filling pressure and valve opening."""

    name: str
    how: str
    open_s: tuple[tuple[float, float], ...]
    """Intervals in which the valve is open."""

    def run(self, period_s: float) -> tuple[Array, Array]:
        """Times of the logger's readings, and the opening from each time on."""
        time_s = np.arange(0.0, MINUTE_S, period_s)
        opening = np.zeros(len(time_s))
        for begins, ends in self.open_s:
            opening[(time_s >= begins - 1e-9) & (time_s < ends - 1e-9)] = 1.0
        return time_s, opening


EXPERIMENTS = (
    Experiment("open", "Leave the valve open, as the paper did.", ((0.0, 60.0),)),
    Experiment("stop", "Open the valve for 20 s, shut it, and go on recording for 40 s.", ((0.0, 20.0),)),
    Experiment(
        "two pauses",
        "Open the valve for 25 s, shut it for 10 s, open it for 20 s, shut it for 5 s.",
        ((0.0, 25.0), (35.0, 55.0)),
    ),
)


@dataclass(frozen=True)
class RivalPair:
    """The best fit of one explanation if another is true."""

    true: tuple[str, ...]
    fitted: tuple[str, ...]
    delta_chi2_rounding: float
    """χ² with the rounding of the readings alone."""
    delta_chi2: float
    """χ² with the unexplained error of the paper's series."""


@dataclass(frozen=True)
class ExperimentOutcome:
    """The separations of all pairs in an experiment."""

    experiment: Experiment
    time_s: Array
    expected_kPa: dict[tuple[str, ...], Array]
    """Expected readings for each explanation."""
    pairs: tuple[RivalPair, ...]

    @property
    def worst(self) -> RivalPair:
        return min(self.pairs, key=lambda pair: pair.delta_chi2)


@dataclass(frozen=True)
class Sharing:
    """Reservoir and vessel connected: separates a larger valve flow from a smaller reservoir."""

    reservoir_kPa: float
    vessel_L: float
    delta_chi2_rounding: float
    """Δχ² if the valve is the cause and the volume is fitted, with the rounding of both sensors."""
    ends_kPa: tuple[float, float]
    """Final reading of the reservoir if the valve is the cause, and if the volume is."""
    discharge_delta_chi2: float
    """The same Δχ² in the best discharge experiment."""


@dataclass(frozen=True)
class ExperimentProposal:
    """The proposed experiments."""

    outcomes: tuple[ExperimentOutcome, ...]
    sharing: Sharing

    @property
    def best(self) -> ExperimentOutcome:
        return max(self.outcomes, key=lambda outcome: outcome.worst.delta_chi2)


def propose(
    found: Discharges,
    progress: Callable[[str], None] = lambda step: None,
    experiments: Sequence[Experiment] = EXPERIMENTS,
) -> ExperimentProposal:
    """Simulate the experiments with all explanations of `RIVALS`, which `found` must contain."""
    level = found.candidates[0].problem.level
    rounding = found.candidates[0].problem.correlated.rounding
    noise = Noise(rounding, (level.discrepancy,), (level.length,), (0.0,))
    with threadpool_limits(1):
        outcomes = []
        for experiment in experiments:
            progress(f"experiment: {experiment.name}")
            outcomes.append(
                _outcome(experiment, found, noise, UnexplainedLevel(level.discrepancy, level.length, 0.0))
            )
        best = max(outcomes, key=lambda outcome: outcome.worst.delta_chi2)
        sharing = _sharing(found, best.experiment, noise)
    return ExperimentProposal(tuple(outcomes), sharing)


def _outcome(
    experiment: Experiment, found: Discharges, noise: Noise, level: UnexplainedLevel
) -> ExperimentOutcome:
    time_s, opening = experiment.run(_period_s())
    expected: dict[tuple[str, ...], Array] = {}
    pairs = []
    for true in RIVALS:
        case = _case(time_s, opening, np.full(len(time_s), found.case.runs[0].reservoir_kPa[0]))
        expected[true] = _expected_kPa(case, found.of(*true), noise)
    for true in RIVALS:
        case = _case(time_s, opening, expected[true])
        whole = Correlated(case, noise, level)
        rounded = Correlated(case, noise, UnexplainedLevel(0.0, level.length, 0.0))
        for rival in RIVALS:
            if set(rival) >= set(true):
                continue
            starts = _starts(rounded, found.of(*rival))
            at = best_fit(whole, starts)
            by_rounding = best_fit(rounded, [at, *starts])
            pairs.append(RivalPair(true, rival, rounded.chi2(by_rounding), whole.chi2(at)))
    return ExperimentOutcome(experiment, time_s, expected, tuple(pairs))


def _expected_kPa(case: Case, candidate: DischargeModel, noise: Noise) -> Array:
    """Expected readings if the candidate is true as fitted."""
    problem = Correlated(case, noise, LEAST_SQUARES)
    point = candidate.point
    initial = np.array([[case.runs[0].reservoir_kPa[0], 0.0]])
    acting = tuple(_here(cause, case) for cause in point.causes)
    return problem.pressures_kPa(replace(point, causes=acting, initial=initial))


def _starts(problem: Correlated, candidate: DischargeModel) -> list[FitPoint]:
    """Starting points of a rival's fit: as fitted to the paper, and at its seeds."""
    start = start_of(problem)
    acting = [_here(cause, problem.case) for cause in candidate.point.causes]
    as_fitted = replace(
        start,
        causes=tuple(acting),
        values=candidate.point.values,
        deviation=candidate.point.deviation,
    )
    return [as_fitted, *seeded(start, acting)]


def _here(cause: Cause, case: Case) -> Cause:
    """The cause for this experiment, in which air does not always flow."""
    if cause.name != "sensor_line":
        return cause
    (run,) = case.runs
    flows = (run.evp_opening > 0.0) & (np.arange(len(run.time_s)) > 0)
    return sensor_line(lambda count: flows)


def _case(time_s: Array, opening: Array, reservoir_kPa: Array) -> Case:
    run = discharge_run("experiment", time_s, opening, reservoir_kPa)
    return Case(Path("experiment"), Rig(cv=None), (run,), ())


def _period_s() -> float:
    """The shortest period of the paper's logger."""
    return float(np.diff(curve("discharge_2L_lowRv_measured").x).min())


SHARED_KPA = 200.0
"""Low enough that the final pressure is within the range of the vessel's sensor."""
VESSEL_L = 1.0
VESSEL_STEP_KPA = 0.167
"""Step of the vessel's 30 psi sensor at 10 bits."""


def _sharing(found: Discharges, experiment: Experiment, noise: Noise) -> Sharing:
    """The reservoir at a moderate pressure, connected to the paper's vessel of 1 litre; both are closed."""
    known = causes()
    scale = found.of("evp_restriction", "reservoir_cooling").estimates["evp_restriction"]["scale"].estimate
    valve, volume = known["evp_restriction"], known["reservoir_volume"]
    # No prior: only the readings shall decide, even if such a volume is unlikely.
    volume = replace(volume, parameters=(replace(volume.parameters[0], typical=None),))
    time_s = np.arange(0.0, MINUTE_S, _period_s())
    zero, start = np.zeros(len(time_s)), np.array([[SHARED_KPA, 0.0]])
    rig = Rig(reservoir=Reservoir(BOTTLE_L), cv=ControlVolume(VESSEL_L))

    def problem(vessel_kPa: Array, bottle_kPa: Array) -> FitProblem:
        run = RecordedRun(
            "sharing", time_s, None, zero + 1.0, zero, zero, vessel_kPa, bottle_kPa, None, None, False
        )
        case = Case(Path("sharing"), rig, (run,), ())
        return FitProblem(case, independent_noise(VESSEL_STEP_KPA / float(np.sqrt(12.0)), noise.rounding))

    def with_cause(cause: Cause) -> FitPoint:
        return FitPoint((cause,), ((scale,),), {}, start)

    blank = problem(zero, zero + SHARED_KPA)
    by_valve, by_volume = (blank.simulated(with_cause(cause))[0] for cause in (valve, volume))

    discharge_s, opening = experiment.run(_period_s())
    full = _case(discharge_s, opening, np.full(len(discharge_s), found.case.runs[0].reservoir_kPa[0]))
    rounded = UnexplainedLevel(0.0, noise.lengths[0], 0.0)
    emptied = Correlated(full, noise, rounded)
    truth = emptied.pressures_kPa(start_of(emptied).with_cause(valve, (scale,)))
    emptied = Correlated(_case(discharge_s, opening, truth), noise, rounded)
    return Sharing(
        reservoir_kPa=SHARED_KPA,
        vessel_L=VESSEL_L,
        delta_chi2_rounding=problem(*by_valve).fit(with_cause(volume)).chi2,
        ends_kPa=(float(by_valve[RESERVOIR, -1]), float(by_volume[RESERVOIR, -1])),
        discharge_delta_chi2=emptied.fit(start_of(emptied).with_cause(volume, (scale,))).chi2,
    )
