"""Simulates the runs of a case with some causes in the rig, several simulations at a time in threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import replace
from functools import cache, lru_cache
from math import floor, log2, sqrt
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from flying_vines.identification.case import Case, RecordedRun
from flying_vines.identification.model import NOT_INLINED, SensorPair, run
from flying_vines.physics.arrays import Array
from flying_vines.physics.cause import Cause, ModelReadings, Values
from flying_vines.physics.compiler import compiled, record
from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.physics.plant.commands import Commands, followed, steps_of, together
from flying_vines.physics.plant.compiled import batch, weather_at
from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.flow import Opening
from flying_vines.physics.plant.leak import Leak
from flying_vines.physics.plant.numbers import PlantNumbers, heat_per_s, numbers_of
from flying_vines.physics.plant.plant import Setup, perfect
from flying_vines.physics.plant.sensors import Sensor, Transfer
from flying_vines.physics.plant.simulator import TICK_S
from flying_vines.physics.plant.valve_response import SolenoidTiming, ValveMotion
from flying_vines.physics.rig import ControlVolume, Rig, with_numbers

T = TypeVar("T")
R = TypeVar("R")

THREADS: ContextVar[int] = ContextVar("THREADS", default=0)
"""Threads for one case; 0 means one for each core. With many cases, each process gets its share of cores."""
MAX_STEP_S = 0.05
MAX_SMOOTH_S = 0.25
"""Maximum step from sample to sample, and over several samples between which no valve moves."""
QUICK_S = 0.002
_STEP = 0.25
"""Length of a step over the fastest time constant. Fourth-order Runge-Kutta then errs by 1e-5 of the change
that remains."""
_STEEP = 6.0
"""The flow through a valve by ISO 6358 is steep near equal pressures: steps resolve this many times its
conductance. At the linear end of `compressible_flow` the slope is about 50 times the conductance; such steps
are still stable."""

GAP = 8.0
"""A longer time between samples, in median sampling intervals, is a gap."""
MISSING = 1.7
"""A longer time between samples, in median sampling intervals, means a missing row if sampling is regular."""
BUSY = 3
"""The valves are busy if one moves within this many samples, before or after."""
ON_TIME, ON_TIME_SHARE = 0.1, 0.8
"""Sampling is regular if 80 % of the intervals differ from the median by less than 10 %."""

RIG_NUMBERS = (
    "reservoir.volume_L",
    "cv.volume_L",
    "evp.flow_resistance_kPa_s_per_SL",
    "dvp.flow_resistance_kPa_s_per_SL",
    "solenoid.flow_resistance_kPa_s_per_SL",
    "venturi.full_vacuum_kPa",
    "venturi.rated_supply_kPa",
    "pump.free_flow_SL_per_s",
    "pump.stall_pressure_kPa",
    "hose.volume_L",
    "hose.flow_resistance_kPa_s_per_SL",
)
"""Keys of the rig file's numbers that a fit may move within their tolerances."""


def rig_number_keys(rig: Rig) -> tuple[str, ...]:
    """Keys of the numbers that this rig has."""
    return tuple(key for key in RIG_NUMBERS if rig.has(key.partition(".")[0]))


def prior_std(rig: Rig, key: str) -> float:
    """Relative standard deviation of a rig number: that of a uniform distribution within its tolerance."""
    return rig.tolerance(key) / 100.0 / sqrt(3.0)


class RunInputs(NamedTuple):
    """What a run gives the model."""

    time_s: Array
    commands: Commands
    weather: Array
    to_atmosphere: bool
    start: NDArray[np.intp]
    """Samples with unknown initial pressures; see `_starts`."""


class CompiledRig(NamedTuple):
    """A rig with causes in it, as the compiled model takes it."""

    numbers: np.void
    sensors: np.void
    effects: Effects
    drifting: tuple[Transfer, Transfer]
    """Sensors of control volume and reservoir, with their drift and limits."""
    longest_s: tuple[float, float, float]
    """Maximum step with the solenoid shut, with it open, and over several samples."""


class Simulation:
    """The runs of a case."""

    def __init__(self, case: Case) -> None:
        self.rig = case.rig
        self.runs = tuple(_inputs(run) for run in case.runs)
        # Derivatives by initial pressures use the same rig many times.
        self._compiled_rig = lru_cache(64)(self._compile)
        self._switchings = lru_cache(64)(self._switch)

    def readings(
        self, index: int, moved: Mapping[str, float], causes: Sequence[tuple[Cause, Values]], initial: Array
    ) -> ModelReadings:
        """Simulated readings of a run.

        Args:
            index: number of the run.
            moved: rig numbers that are not nominal, by key.
            causes: causes in the rig, with their parameter values.
            initial: (starts, 2) gauge pressures of reservoir and CV at each start of the run, kPa.
        """
        run = self.runs[index]
        made = self._compiled_rig(tuple(moved.items()), tuple(causes), run.to_atmosphere)
        own = tuple((cause.commands, x) for cause, x in causes if cause.commands is not None)
        e = made.effects
        switch_s, openings = self._switchings(index, e.evp_motion, e.dvp_motion, e.solenoid_timing, own)
        weather = run.weather
        if made.effects.ambient is not None:
            change = weather_at(made.effects.ambient, run.time_s - run.time_s[0])
            weather = weather + change - (ALPHA_KPA, 1.0)
        out = np.empty((len(run.time_s), 2))
        _compiled()(
            made.numbers,
            made.sensors,
            run.time_s,
            switch_s,
            openings,
            weather,
            run.start,
            initial,
            made.longest_s,
            out,
        )
        for column, sensor in zip(out.T, made.drifting, strict=True):
            if sensor.drift_kPa_per_s:
                column += sensor.gain * sensor.drift_kPa_per_s * (run.time_s - run.time_s[0])
            np.clip(column, sensor.lowest_kPa, sensor.highest_kPa, out=column)
        readings = ModelReadings(out[:, 0], out[:, 1])
        for cause, x in causes:
            if cause.readings is not None:
                readings = cause.readings(readings, x)
        return readings

    def _switch(
        self,
        index: int,
        evp: ValveMotion | None,
        dvp: ValveMotion | None,
        solenoid: SolenoidTiming | None,
        own: tuple[tuple[Callable[[Commands, Values], Commands], Values], ...],
    ) -> tuple[Array, Array]:
        """Switching times of a run's valves, and the openings from each time on."""
        commands = followed(self.runs[index].commands, evp, dvp, solenoid, self.runs[index].time_s[-1])
        for change, values in own:
            commands = change(commands, values)
        return together(commands)

    def _compile(
        self,
        moved: tuple[tuple[str, float], ...],
        causes: tuple[tuple[Cause, Values], ...],
        to_atmosphere: bool,
    ) -> CompiledRig:
        rig = with_numbers(self.rig, dict(moved))
        # A discharge has no control volume. Causes that need one are applied to a default, without effect.
        setup = perfect(rig if rig.cv is not None else replace(rig, cv=ControlVolume()))
        for cause, values in causes:
            names = [parameter.name for parameter in cause.parameters]
            setup = cause.put_into(setup, dict(zip(names, values, strict=True)))
        if to_atmosphere:
            setup = setup.with_rig(cv=None)
        effects = setup.plant.effects
        if effects.evp_coil is not None or effects.dvp_coil is not None:
            raise ValueError("a fit takes openings as recorded, and cannot simulate a coil")
        numbers = numbers_of(setup.plant, TICK_S)
        shut_s, open_s = (
            _STEP / _quickest_per_s(numbers, setup, law) for law in (Opening(), numbers.solenoid)
        )
        # The number of samples in a step must not change with each small change of a parameter.
        smooth_s = 2.0 ** floor(log2(min(MAX_SMOOTH_S, shut_s)))
        longest_s = min(MAX_STEP_S, shut_s), min(MAX_STEP_S, open_s), smooth_s
        drifting = setup.cv_sensor.numbers, setup.reservoir_sensor.numbers
        steady = record(SensorPair(_steady(setup.cv_sensor), _steady(setup.reservoir_sensor)))
        return CompiledRig(record(numbers), steady, effects, drifting, longest_s)


@cache
def _compiled() -> Callable[..., None]:
    simulate: Callable[..., None] = compiled(run, NOT_INLINED)
    return simulate


def _steady(sensor: Sensor) -> Transfer:
    # The steps of an A/D converter have no derivative, and the noise hides them. The compiled model does not
    # know the time since the start of the run: `readings` adds the drift, and then applies the limits.
    plain = replace(sensor, adc=None, drift_kPa_per_min=0.0, lowest_share=None, highest_share=None)
    return plain.numbers


def _inputs(run: RecordedRun) -> RunInputs:
    time_s = run.time_s
    commands = Commands(
        steps_of(time_s, run.evp_opening), steps_of(time_s, run.dvp_opening), steps_of(time_s, run.solenoid)
    )
    ambient = np.full(len(time_s), ALPHA_KPA) if run.ambient_kPa is None else run.ambient_kPa
    weather = np.column_stack((ambient, np.ones(len(time_s))))
    return RunInputs(time_s, commands, weather, run.to_atmosphere, _starts(run))


def _starts(run: RecordedRun) -> NDArray[np.intp]:
    """Indices at which the pressures are unknown: the first sample, and those after a gap or a missing row.

    A missing row only counts if a valve may have moved in it: the valves were busy, or a regulator was on.
    The recording may name further samples: see `RecordedRun.after_gap`.
    """
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
    if run.after_gap is not None:
        again |= run.after_gap[1:] > 0.0
    return np.concatenate(([0], np.flatnonzero(again) + 1))


def _leak_SL_per_s_kPa(leak: Leak, sensor: Sensor) -> float:
    """Maximum change of a leak's flow per kPa, over the sensor's span."""
    viscous = 2.0 * (sensor.span_kPa + ALPHA_KPA) * leak.viscous_SL_per_s_kPa2
    through = _conductance_SL_per_s_kPa(leak.orifice) + leak.curve.steepest_SL_per_s_kPa
    return leak.ohmic_SL_per_s_kPa + viscous + through


def _conductance_SL_per_s_kPa(law: Opening) -> float:
    """The change of an opening's flow per kPa that an integrator must resolve."""
    return law.conductance_SL_per_s_kPa * (1.0 if law.ohmic else _STEEP)


def _quickest_per_s(numbers: PlantNumbers, setup: Setup, solenoid: Opening) -> float:
    """The inverse of the fastest time constant that an explicit integrator must resolve.

    It leaves out the exchange between a hose and the control volume: an exponential integrator computes that.
    """
    n = numbers
    evp = _conductance_SL_per_s_kPa(n.evp.law)
    at_the_valves = evp + _conductance_SL_per_s_kPa(solenoid)
    out_of_reservoir = evp + _conductance_SL_per_s_kPa(n.dvp.law)
    out_of_reservoir += _leak_SL_per_s_kPa(n.reservoir_leak, setup.reservoir_sensor)
    rates = [n.gamma * ALPHA_KPA * out_of_reservoir * n.reservoir_per_L]
    leak = _leak_SL_per_s_kPa(n.cv_leak, setup.cv_sensor)
    if n.has_tubing:
        line = n.line_SL_per_s_kPa
        through = line * at_the_valves / (line + at_the_valves)
        rates += [evp * n.line_kPa_per_SL, n.gamma * ALPHA_KPA * (through + leak) / n.cv.flat_L]
    elif n.has_cv:
        rates.append(n.gamma * ALPHA_KPA * (at_the_valves + leak) / n.cv.flat_L)
    reservoir_L = 1.0 / n.reservoir_per_L
    walls = ((n.reservoir_heat, reservoir_L, reservoir_L), (n.cv_heat, n.cv.flat_L, n.cv.full_L))
    for wall_per_s in (heat_per_s(*wall) for wall in walls):
        if wall_per_s > 0.0:
            rates.append(_resolved_heat_per_s(1.0 / wall_per_s))
    return max(rates)


def _resolved_heat_per_s(time_s: float) -> float:
    """The rate to resolve for a time constant of heat exchange.

    With a time constant of a few milliseconds at most, the gas stays near ambient temperature: then the step
    only has to be stable.
    """
    return _STEP / max(_STEP * time_s, min(time_s, QUICK_S))


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def mapped(function: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """The function of each item, in the order of the items, computed in threads.

    Compiled code takes most of the time, and it releases the GIL.
    """
    return batch(function, items, threads=THREADS.get() or cores())
