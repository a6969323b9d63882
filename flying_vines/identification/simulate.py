"""A case's runs, simulated with some causes in the rig."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from math import inf, nan, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flying_vines.identification.case import Case, Run
from flying_vines.identification.cause import Cause, Readings, Values
from flying_vines.identification.causes import catalogue
from flying_vines.identification.chain import compiled_run
from flying_vines.identification.commands import Commands, steps_of, together
from flying_vines.identification.model import Array, Numbers
from flying_vines.physics.baseline import ALPHA_KPA
from flying_vines.physics.plant.gas import GAMMA
from flying_vines.physics.rig import Rig

LONGEST_STEP_S = 0.05
QUICK_WALL_S = 0.002
_STEP = 0.25
"""Of the quickest time constant: there Runge–Kutta of fourth order errs by 1e-5 of what is left to settle."""

GAP = 8.0
"""Of the usual time between samples: what is longer is a gap."""
MISSING = 1.7
"""Likewise: in between a row is missing, if the others come on time."""
BUSY = 3
"""Valves are busy if one was moved within so many samples."""
ON_TIME, ON_TIME_SHARE = 0.1, 0.8
"""They do if so many of the times between samples are as usual, but for this share."""

BELIEVED = {
    "reservoir.volume_L": "reservoir_volume_L",
    "cv.volume_L": "cv_volume_L",
    "evp.flow_resistance_kPa_s_per_SL": "evp_flow_resistance_kPa_s_per_SL",
    "dvp.flow_resistance_kPa_s_per_SL": "dvp_flow_resistance_kPa_s_per_SL",
    "solenoid.flow_resistance_kPa_s_per_SL": "solenoid_flow_resistance_kPa_s_per_SL",
    "venturi.full_vacuum_kPa": "full_vacuum_kPa",
    "venturi.rated_supply_kPa": "rated_supply_kPa",
}
"""What a rig file believes, by its key there, and the simulation's number that it is."""


def believed_keys(rig: Rig) -> tuple[str, ...]:
    """Of the numbers that a rig has."""
    return tuple(key for key in BELIEVED if rig.cv is not None or key != "cv.volume_L")


def believed_spread(rig: Rig, key: str) -> float:
    """Standard deviation of a number that is anywhere within its tolerance, as a share."""
    return rig.tolerance(key) / 100.0 / sqrt(3.0)


class Prepared(NamedTuple):
    """A run, ready to be simulated."""

    time_s: Array
    commands: Commands
    switchings: tuple[Array, Array]
    ambient_kPa: Array
    to_atmosphere: bool
    start: NDArray[np.intp]
    """Samples from which on the pressures are unknown: the first, and each after a gap in the record, in
    which nobody knows what the valves did."""


class Simulation:
    """The runs of a case."""

    def __init__(self, case: Case) -> None:
        self.believed = numbers_of(case.rig)
        self.runs = tuple(_prepared(run) for run in case.runs)
        self._flows = [cause for cause in catalogue() if cause.flows is not None]

    def readings(
        self,
        index: int,
        numbers: Numbers,
        causes: Sequence[tuple[Cause, Values]],
        initial: Array,
    ) -> Readings:
        """What the sensors would have read in a run.

        Args:
            index: of the run.
            numbers: of the rig, before the causes.
            causes: what is in the rig, with their parameters' values.
            initial: (starts, 2) gauge pressures of reservoir and CV at each of the run's starts, kPa.
        """
        run = self.runs[index]
        commands, ambient = run.commands, run.ambient_kPa
        present: dict[str, Values] = {}
        causes = sorted(causes, key=lambda item: item[0].order)
        for cause, x in causes:
            if cause.numbers is not None:
                numbers = cause.numbers(numbers, x)
            if cause.commands is not None:
                commands = cause.commands(commands, x)
            if cause.ambient is not None:
                ambient = cause.ambient(run.time_s, ambient, x)
            if cause.flows is not None:
                present[cause.name] = x
        if run.to_atmosphere:
            numbers = numbers._replace(cv_volume_L=inf, cv_time_constant_s=0.0, cv_compliance_per_kPa=0.0)
            initial = initial * (1.0, 0.0)
        switch_s, openings = run.switchings if commands is run.commands else together(commands)
        out = np.empty((len(run.time_s), 2))
        longest_s = min(LONGEST_STEP_S, _STEP / _quickest_per_s(numbers))
        parameters = self._parameters(present)
        _compiled()(
            numbers, run.time_s, switch_s, openings, ambient, run.start, initial, longest_s, parameters, out
        )
        readings = Readings(out[:, 0], out[:, 1])
        for cause, x in causes:
            if cause.readings is not None:
                readings = cause.readings(readings, x)
        return readings

    def _parameters(self, present: Mapping[str, Values]) -> Array:
        """Of all causes that bring flows; NaN for those that are not there."""
        values: list[float] = []
        for cause in self._flows:
            values.extend(present.get(cause.name, (nan,) * len(cause.parameters)))
        return np.array(values)


@cache
def _compiled() -> Callable[..., None]:
    return compiled_run([cause for cause in catalogue() if cause.flows is not None])


def numbers_of(rig: Rig) -> Numbers:
    """A rig's believed numbers."""
    return Numbers(
        reservoir_volume_L=rig.reservoir.volume_L,
        cv_volume_L=inf if rig.cv is None else rig.cv.volume_L,
        evp_flow_resistance_kPa_s_per_SL=rig.evp.flow_resistance_kPa_s_per_SL,
        dvp_flow_resistance_kPa_s_per_SL=rig.dvp.flow_resistance_kPa_s_per_SL,
        solenoid_flow_resistance_kPa_s_per_SL=rig.solenoid.flow_resistance_kPa_s_per_SL,
        full_vacuum_kPa=rig.venturi.full_vacuum_kPa,
        rated_supply_kPa=rig.venturi.rated_supply_kPa,
    )


def _prepared(run: Run) -> Prepared:
    time_s = run.time_s
    commands = Commands(
        steps_of(time_s, run.evp_opening),
        steps_of(time_s, run.dvp_opening),
        steps_of(time_s, run.solenoid),
    )
    ambient = np.full(len(time_s), ALPHA_KPA) if run.ambient_kPa is None else run.ambient_kPa
    return Prepared(time_s, commands, together(commands), ambient, run.to_atmosphere, _starts(run))


def _starts(run: Run) -> NDArray[np.intp]:
    """Where a run begins, and where it begins again: after a gap, and after a missing row in which valves may
    have been moved unseen: if they were busy, or a regulator was at work, which may open one for a row."""
    between = np.diff(run.time_s)
    usual = np.median(between)
    again = between > GAP * usual
    if np.mean(np.abs(between / usual - 1.0) < ON_TIME) > ON_TIME_SHARE:
        openings = (run.evp_opening, run.dvp_opening, run.solenoid)
        moved = np.any([np.diff(opening) != 0.0 for opening in openings], axis=0)
        busy = np.convolve(moved, np.ones(2 * BUSY + 1), mode="same") > 0.0
        if run.command_kPa is not None:
            busy |= np.isfinite(run.command_kPa[:-1])
        again |= (between > MISSING * usual) & busy
    return np.concatenate(([0], np.flatnonzero(again) + 1))


def _quickest_per_s(numbers: Numbers) -> float:
    """The inverse of the quickest time constant that an explicit integrator has to resolve."""
    n = numbers
    evp = 1.0 / n.evp_flow_resistance_kPa_s_per_SL
    into_cv = evp + 1.0 / n.solenoid_flow_resistance_kPa_s_per_SL
    out_of_reservoir = evp + 1.0 / n.dvp_flow_resistance_kPa_s_per_SL
    rates = [
        GAMMA * ALPHA_KPA * into_cv / n.cv_volume_L,
        GAMMA * ALPHA_KPA * out_of_reservoir / n.reservoir_volume_L,
    ]
    for wall_s in (n.reservoir_time_constant_s, n.cv_time_constant_s):
        if wall_s > 0.0:
            # Where heat comes and goes within milliseconds, gas hardly leaves the ambient temperature.
            rates.append(_STEP / max(_STEP * wall_s, min(wall_s, QUICK_WALL_S)))
    if n.cv_sensor_lag_s > 0.0:
        # A straight line over a step has to be near what the pressure does there.
        rates.append(10.0 * rates[0])
    return max(rates)
