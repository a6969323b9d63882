"""The paper's three discharges as a case for `identification`, and their diagnosis.

A case has one rig, but the paper has reservoirs of 4 and 2 litres, and a valve in two settings. Only flow
over volume matters in a discharge: a run with 4 litres is equivalent to a run with 2 litres and half the
opening. So openings are not commands here, and causes that change how a valve follows a command are not
tested.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from flying_vines.identification.case import Case, RecordedRun
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.fit import FitPoint, FitProblem
from flying_vines.identification.held_out import Errors, errors, gain, nrmse, split
from flying_vines.identification.noise import stated_noise
from flying_vines.identification.plan import Recommendation, recommend
from flying_vines.identification.search import Progress, silent
from flying_vines.identification.simulate import rig_number_keys
from flying_vines.identification.verdict import Verdict
from flying_vines.physics.cause import Cause, ModelReadings, Parameter, Values
from flying_vines.physics.effects import causes_of
from flying_vines.physics.plant.commands import Commands, Steps
from flying_vines.physics.rig import Rig, Sensors
from flying_vines.studies.paper.compare import HIGH_RESISTANCE, HIGH_RESISTANCE_RATIO, rms
from flying_vines.studies.paper.data import DISCHARGES, curve

RESERVOIR = 1
"""Row of the reservoir in a run's readings."""
BOTTLE_L = 2.0
VOLUME_L = {"4L_highRv": 4.0, "4L_lowRv": 4.0, "2L_lowRv": 2.0}
STEP_KPA = 1.222
"""All 57 readings differ by multiples of this, about the step of a 15 bar sensor with a 10-bit converter."""
RIG = Rig(cv=None, sensors=Sensors(reservoir_noise_std_kPa=STEP_KPA / sqrt(12.0)))

_LIMITS = {
    "reservoir_sensor_offset": (-22.5, 22.5),
    "reservoir_sensor_gain": (0.985, 1.015),
}
"""Bounds from the total error band of the paper's sensor; those of the catalogue are wider."""
_OF_COMMANDS = (
    "evp_dead_zone",
    "evp_heating",
    "evp_hysteresis",
    "evp_lag",
    "line_delay",
    "solenoid_slow_close",
)
_ABSENT = ("venturi_stall", "ambient_drop")
"""The bench had no Venturi, and its ambient pressure was constant."""
SAME_AS_FLOW = "reservoir_volume"
"""This cause has the same effect on a discharge as the flow resistance. Only the resistance is tested."""

OHM = ("evp_restriction", "reservoir_cooling")
CHOKED = (*OHM, "compressible_flow")
BEST_FOR_CHOKED = 1.24
"""Ratio of the resistances of the valve's two settings that fits choked flow best; found to within 0.02."""
SECOND = (
    "reservoir_cooling",
    "sensor_line",
    "valve_settles",
    "compressible_flow",
    "reservoir_leak",
    "reservoir_sensor_offset",
)
"""Causes that are tested together with R_v. Each of them changes the slope at the start by another factor
than the slope at the end."""
_EXACT = 1e3
"""Weight of a first reading that is taken as exact."""


# Other causes of a discharge that is fast at first and slow later, which only this bench can have. They are
# not in the catalogue, because they assume a valve that is open from the first reading to the last.

SETTLED = 5.0
"""Number of time constants after which a valve has settled."""
_STAIRS = 40


def _less_in_the_flow(readings: ModelReadings, x: Values) -> ModelReadings:
    # The first reading was taken before the valve opened.
    flows = np.arange(len(readings.reservoir_kPa)) > 0
    return readings._replace(reservoir_kPa=readings.reservoir_kPa * (1.0 - x[0] * flows))


SENSOR_LINE = Cause(
    name="sensor_line",
    what="The sensor is in the flow, and its reading is lower by a share while air flows.",
    parameters=(
        Parameter(
            "share",
            low=0.0,
            high=0.06,
            seeds=(0.01,),
            neutral=0.0,
            source="a metre of 4 mm tube loses 2 kPa at 20 SLPM, a fitting more: 1 %, at most 6 %",
        ),
    ),
    experiment="Shut the valve during a discharge: the reading jumps back immediately.",
    readings=_less_in_the_flow,
)


def _settling(commands: Commands, x: Values) -> Commands:
    """The commands with an additional opening that decays from the start on, in steps."""
    share, time_constant_s = x
    evp = commands.evp
    stairs_s = np.linspace(0.0, SETTLED * time_constant_s, _STAIRS + 1)
    time_s = np.union1d(evp.time_s, evp.time_s[0] + stairs_s)
    opening = evp.value[np.searchsorted(evp.time_s, time_s, side="right") - 1]
    since_s = time_s - evp.time_s[0]
    more = share * np.exp(-(since_s + 0.5 * stairs_s[1]) / time_constant_s)
    return commands._replace(evp=Steps(time_s, opening * (1.0 + more * (since_s < stairs_s[-1]))))


VALVE_SETTLES = Cause(
    name="valve_settles",
    what="The valve has more flow at first and settles: its coil warms, its seat creeps.",
    parameters=(
        Parameter(
            "share",
            low=0.0,
            high=0.5,
            seeds=(0.1, 0.3),
            neutral=0.0,
            source="a coil on a fixed voltage loses 10 to 20 % of its current, so up to 40 % of its flow",
        ),
        Parameter(
            "time_constant_s",
            low=1.0,
            high=300.0,
            seeds=(10.0,),
            neutral=None,
            logarithmic=True,
            source="seats and coils: seconds to minutes",
        ),
    ),
    experiment="Shut the valve during a discharge, wait, and open it again: the flow is larger again.",
    commands=_settling,
)


def causes() -> list[Cause]:
    """The causes that can act in these discharges, within the limits of this bench."""
    left_out = (*_OF_COMMANDS, *_ABSENT, SAME_AS_FLOW)
    known = [cause for cause in causes_of(RIG) if cause.name not in left_out]
    return [*map(_limited, known), SENSOR_LINE, VALVE_SETTLES]


def _limited(cause: Cause) -> Cause:
    if cause.name not in _LIMITS:
        return cause
    low, high = _LIMITS[cause.name]
    (parameter,) = cause.parameters
    return replace(cause, parameters=(replace(parameter, low=low, high=high),))


def paper_case(settings_ratio: float = HIGH_RESISTANCE_RATIO) -> Case:
    """The three runs, converted to 2 litre bottles and equivalent openings.

    Args:
        settings_ratio: ratio of the valve's resistances in its two settings.
    """
    return Case(Path("paper"), RIG, tuple(_run(name, settings_ratio) for name in DISCHARGES), ())


def _run(name: str, settings_ratio: float) -> RecordedRun:
    measured = curve(f"discharge_{name}_measured")
    shut, unread_kPa = np.zeros(len(measured.x)), np.full(len(measured.x), np.nan)
    opening = BOTTLE_L / VOLUME_L[name] / (settings_ratio if name == HIGH_RESISTANCE else 1.0)
    return RecordedRun(
        name, measured.x, None, shut + opening, shut, shut + 1.0, unread_kPa, measured.y, None, None, True
    )


@dataclass(frozen=True)
class LawFit:
    """Ohm's law and choked flow, each with its own R_v and with gas that cools, fitted to all series."""

    settings_ratio: float
    """Ratio of the valve's resistances in its two settings; the paper does not state it."""
    first_exact: bool
    """True if the fits go through the first reading of each series."""
    ohm_kPa: float
    """Root mean square error of Ohm's law."""
    choked_kPa: float
    choked_scale: float
    """R_v with choked flow, divided by the paper's R_v."""


class Second(NamedTuple):
    """A second cause beside R_v. Each series is predicted from the two others."""

    cause: str
    values: tuple[float, ...]
    """Its parameters, from all series."""
    unseen_nrmse: float
    """Error relative to the measured range."""
    gain: tuple[float, float]
    """95 % interval of the relative error reduction, compared with R_v alone."""


@dataclass(frozen=True)
class Discharges:
    """The diagnosis of the discharges."""

    case: Case
    verdict: Verdict
    scale_alone: dict[str, float]
    """R_v from each series alone, divided by the paper's R_v."""
    second: tuple[Second, ...]
    """The best prediction first."""
    laws: tuple[LawFit, ...]
    recommended: Recommendation
    """The recording that distinguishes best between the causes that these data leave undecided."""


def analyse(progress: Progress = silent) -> Discharges:
    """Diagnose the paper's discharges."""
    case = paper_case()
    verdict = diagnose(case, causes(), progress)
    with threadpool_limits(1):
        alone = {run.name: _scale_alone(replace(case, runs=(run,))) for run in case.runs}
        laws = tuple(
            flow_laws(ratio, exact)
            for ratio in (HIGH_RESISTANCE_RATIO, BEST_FOR_CHOKED)
            for exact in (True, False)
        )
        second = second_causes(case)
    open_causes = [cause for cause in causes() if cause.name in {*CHOKED, "reservoir_leak"}]
    return Discharges(case, verdict, alone, second, laws, recommend(RIG, open_causes))


def _scale_alone(case: Case) -> float:
    problem = FitProblem(case, stated_noise(case.rig))
    ((scale,),) = _fitted(problem, ("evp_restriction",), free=False).values
    return scale


def second_causes(case: Case) -> tuple[Second, ...]:
    """Compare the causes of `SECOND` on unseen series."""
    problem = FitProblem(case, stated_noise(case.rig))
    splits = []
    for unseen in case.runs:
        splits.append(split(problem, [np.full(len(run.time_s), run is unseen) for run in case.runs]))

    def predicted(names: Sequence[str]) -> Errors:
        return errors(problem, splits, [_fitted(part.shown, names) for part in splits])

    alone = predicted(OHM[:1])
    found = []
    for cause in SECOND:
        names = (OHM[0], cause)
        left = predicted(names)
        values = _fitted(problem, names).values[1]
        found.append(Second(cause, values, float(nrmse(problem, left)), gain(problem, alone, left)))
    return tuple(sorted(found, key=lambda second: second.unseen_nrmse))


def flow_laws(settings_ratio: float, first_exact: bool) -> LawFit:
    """Fit both laws of flow to the series; see `LawFit`."""
    case = paper_case(settings_ratio)
    problem = FitProblem(case, stated_noise(case.rig))
    if first_exact:
        for weight in problem.weights:
            weight[RESERVOIR, 0] *= _EXACT
    ohm, choked = (_fitted(problem, names) for names in (OHM, CHOKED))
    return LawFit(
        settings_ratio, first_exact, _rms_kPa(problem, ohm), _rms_kPa(problem, choked), choked.values[0][0]
    )


def _fitted(problem: FitProblem, names: Sequence[str], free: bool = True) -> FitPoint:
    known = {cause.name: cause for cause in causes()}
    point = problem.start().with_free(rig_number_keys(problem.case.rig) if free else ())
    for name in names:
        point = problem.first_fit(point, known[name]).point
    # Precise: predictions that differ by 0.01 % are compared.
    return problem.fit(point, min_gain=1e-4).point


def _rms_kPa(problem: FitProblem, point: FitPoint) -> float:
    simulated = zip(problem.data, problem.simulated(point), strict=True)
    return rms(np.concatenate([data[RESERVOIR] - kPa[RESERVOIR] for data, kPa in simulated]))
