"""Which minute at the bench would settle what the paper's discharges leave open.

Each explanation that is still possible is simulated in each experiment, with the parameters that the paper's
readings give it, as the paper's sensor and logger would record it. Each other explanation is then fitted to
that record, all its parameters free. The χ² of its best fit is how well the experiment tells the two apart:
with the rounding of the readings alone, and with as much besides as no model explained in the paper's series.
The best experiment is the one whose worst pair is told apart best.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from flying_vines.identification.case import Case, RecordedRun
from flying_vines.identification.fit import FitPoint, FitProblem
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
"""What is still possible: heat with either law of flow, what could pass for heat, a leak."""


@dataclass(frozen=True)
class Experiment:
    """A minute with the 2 litre bottle, filled as the paper filled it, and the valve as far open."""

    name: str
    how: str
    open_s: tuple[tuple[float, float], ...]
    """When the valve is open."""

    def run(self, period_s: float) -> tuple[Array, Array]:
        """Times of the logger's readings, and openings from each on."""
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
    """If one explanation is true, the other's best fit."""

    true: tuple[str, ...]
    fitted: tuple[str, ...]
    delta_chi2_rounding: float
    """χ² with the rounding of the readings alone …"""
    delta_chi2: float
    """… and with what no model explained in the paper."""


@dataclass(frozen=True)
class ExperimentOutcome:
    """What an experiment tells apart."""

    experiment: Experiment
    time_s: Array
    expected_kPa: dict[tuple[str, ...], Array]
    """Explanation by explanation, what would be read."""
    pairs: tuple[RivalPair, ...]

    @property
    def worst(self) -> RivalPair:
        return min(self.pairs, key=lambda pair: pair.delta_chi2)


@dataclass(frozen=True)
class Sharing:
    """Bottle and vessel joined: tells a valve that passes more from a bottle that holds less."""

    reservoir_kPa: float
    vessel_L: float
    delta_chi2_rounding: float
    """If the valve is off and the volume is fitted, by the rounding of both sensors' readings."""
    ends_kPa: tuple[float, float]
    """The bottle's reading at the end, if it is the valve, and if it is the volume."""
    discharge_delta_chi2: float
    """The same for the best of the discharges."""


@dataclass(frozen=True)
class ExperimentProposal:
    """What to do next."""

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
    """Simulate the experiments with what the discharges left open; `found` has all of `RIVALS`."""
    level = found.candidates[0].problem.level
    rounding = found.candidates[0].problem.noise.rounding
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
    """What the sensor would read, if the candidate is true as it was fitted."""
    problem = Correlated(case, noise, LEAST_SQUARES)
    point = candidate.point
    initial = np.array([[case.runs[0].reservoir_kPa[0], 0.0]])
    acting = tuple(_here(cause, case) for cause in point.causes)
    return problem.pressures_kPa(replace(point, causes=acting, initial=initial))


def _starts(problem: Correlated, candidate: DischargeModel) -> list[FitPoint]:
    """Where a rival's fit begins: as the paper has it, and at its seeds."""
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
    """The cause as it acts in this experiment, in which air does not always flow."""
    if cause.name != "sensor_line":
        return cause
    (run,) = case.runs
    flows = (run.evp_opening > 0.0) & (np.arange(len(run.time_s)) > 0)
    return sensor_line(lambda count: flows)


def _case(time_s: Array, opening: Array, reservoir_kPa: Array) -> Case:
    run = discharge_run("experiment", time_s, opening, reservoir_kPa)
    return Case(Path("experiment"), Rig(cv=None), (run,), ())


def _period_s() -> float:
    """The logger's, where it was quickest."""
    return float(np.diff(curve("discharge_2L_lowRv_measured").x).min())


SHARED_KPA = 200.0
"""So little that the vessel's sensor can read where it ends."""
VESSEL_L = 1.0
VESSEL_STEP_KPA = 0.167
"""Of the vessel's 30 psi sensor, at 10 bits."""


def _sharing(found: Discharges, experiment: Experiment, noise: Noise) -> Sharing:
    """The bottle at a moderate pressure into the paper's vessel of 1 litre, both shut off from outside."""
    known = causes()
    scale = found.of("evp_restriction", "reservoir_cooling").estimates["evp_restriction"]["scale"].estimate
    valve, volume = known["evp_restriction"], known["reservoir_volume"]
    # However unlikely such a bottle is: the readings alone are to tell.
    volume = replace(volume, parameters=(replace(volume.parameters[0], typical=None),))
    time_s = np.arange(0.0, MINUTE_S, _period_s())
    zero, start = np.zeros(len(time_s)), np.array([[SHARED_KPA, 0.0]])
    rig = Rig(reservoir=Reservoir(BOTTLE_L), cv=ControlVolume(VESSEL_L))

    def problem(vessel_kPa: Array, bottle_kPa: Array) -> FitProblem:
        run = RecordedRun(
            "sharing", time_s, None, zero + 1.0, zero, zero, vessel_kPa, bottle_kPa, None, None, False
        )
        case = Case(Path("sharing"), rig, (run,), ())
        return FitProblem(case, (VESSEL_STEP_KPA / float(np.sqrt(12.0)), noise.rounding))

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
