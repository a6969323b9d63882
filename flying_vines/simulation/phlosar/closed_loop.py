"""The firmware's regulator and a plant in a closed loop, compiled: thousands of times faster than real time.

At 1 kHz the firmware's own regulator reads the sensors and commands the valves, as in `SimulatedPhlosar`. But
there is no serial protocol, and the firmware's faults are not simulated: the caller must check the table for
pressures that are too high. Needs numba, of the extra `analysis`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from flying_vines.physics.compiler import compiled, external, record
from flying_vines.physics.gas import STANDARD_TEMPERATURE_K
from flying_vines.physics.plant.ambient import air_between
from flying_vines.physics.plant.compiled import (
    CompiledRun,
    empty_table,
    floats_of,
    named,
    noise_of,
    weather_of,
)
from flying_vines.physics.plant.loops import NOT_INLINED, Table, read_both, weather_at, write
from flying_vines.physics.plant.numbers import PlantNumbers, numbers_of
from flying_vines.physics.plant.plant import Plant, State, at_rest
from flying_vines.physics.plant.rates import Floats, conditions
from flying_vines.physics.plant.sensors import Sensor, Transfer, rested
from flying_vines.physics.plant.simulator import TICK_S
from flying_vines.physics.plant.tick import memory_at_rest, tick
from flying_vines.simulation.phlosar.core_library import load
from flying_vines.simulation.phlosar.firmware import SAFE, Regulator, Tuning

regulator_begin = external(load().phlosar_regulator_begin, "void(intp, f8)")
regulator_step = external(load().phlosar_regulator_step, "void(intp, f8, f8, f8, f8, voidptr)")
"""For compiled loops, by `Regulator.address`. A step writes evp, dvp, solenoid (0/1), setpoint."""


class SetpointChange(NamedTuple):
    """A new target pressure from a time on, with its rate limit. NaN kPa: vent."""

    from_s: float
    target_kPa: float
    rate_kPa_per_s: float


def closed_loop(
    plant: Plant,
    setpoints: Sequence[SetpointChange],
    seconds: float,
    state: State | None = None,
    *,
    tuning: Tuning | None = None,
    cv_sensor: Sensor | None = None,
    reservoir_sensor: Sensor | None = None,
    seed: int | None = None,
    record_every: int = 10,
) -> CompiledRun:
    """Simulate the plant from `state` (default: `at_rest`) with the regulator for `seconds`.

    `setpoints` are in order of time; each lasts until the next one. Before the first one the plant is vented,
    as in the firmware. Default: perfect sensors. Without `seed` there is no noise. The table has one row for
    the start of every `record_every`-th tick of 1 ms; the default is the firmware's telemetry at 100 Hz.
    Times are rounded to ticks.
    """
    n_ticks = round(seconds / TICK_S)
    orders = np.array([tuple(setpoint) for setpoint in setpoints], np.float64).reshape(-1, 3)
    orders[:, 0] = np.round(orders[:, 0] / TICK_S)
    if (np.diff(orders[:, 0]) <= 0.0).any():
        raise ValueError("times of setpoints must increase by at least one tick")
    table = empty_table(n_ticks, record_every)
    regulator = Regulator(tuning)
    final = compiled(run_regulated, NOT_INLINED)(
        record(numbers_of(plant, TICK_S)),
        record((cv_sensor or Sensor()).numbers),
        record((reservoir_sensor or Sensor()).numbers),
        regulator.address,
        weather_of(plant, n_ticks, TICK_S),
        noise_of(seed, n_ticks),
        orders,
        floats_of(at_rest(plant) if state is None else state),
        np.empty((n_ticks, 4)),
        record_every,
        table,
    )
    return CompiledRun(named(table), State(*final))


def run_regulated(
    numbers: PlantNumbers,
    cv_sensor: Transfer,
    reservoir_sensor: Transfer,
    regulator: int,
    weather: Table,
    noise: Table,
    orders: Table,
    state: Floats,
    drives: Table,
    every: int,
    table: Table,
) -> Floats:
    """Returns the final state. `drives` stores EVP, DVP, solenoid and setpoint of each tick: delayed valves
    need the earlier ones.

    EVP: inflation valve. DVP: the Venturi's supply valve. The other parameters are as in `run_openings`.
    """
    s0, s1, s2, s3, s4, s5, s6, s7, s8, s9 = state
    now: Floats = (s0, s1, s2, s3, s4, s5, s6, s7, s8, s9)
    air = weather_at(weather, 0)
    memory = memory_at_rest(False, air.ratio * STANDARD_TEMPERATURE_K)
    found = conditions(numbers, air, now)
    cv_seen, reservoir_seen = rested(found.line_kPa), rested(found.reservoir_kPa)
    evp_delay, dvp_delay = numbers.evp.delay_ticks, numbers.dvp.delay_ticks
    regulating = False
    target_kPa, rate_kPa_per_s = np.nan, 0.0
    cv_kPa = 0.0
    due = row = order = 0
    for index in range(len(drives)):
        cv_before_kPa = cv_kPa
        found = conditions(numbers, air, now)
        cv_seen, cv_kPa, reservoir_seen, reservoir_kPa = read_both(
            cv_sensor, reservoir_sensor, cv_seen, reservoir_seen, found, numbers.tick_s, noise, index
        )
        while order < len(orders) and orders[order, 0] <= index:
            target_kPa, rate_kPa_per_s = orders[order, 1], orders[order, 2]
            order += 1
            # As in the firmware, the regulator starts at the reading of the tick before.
            if not regulating:
                regulator_begin(regulator, cv_kPa if index == 0 else cv_before_kPa)
            regulating = target_kPa == target_kPa
        drive = drives[index]
        if regulating:
            regulator_step(regulator, target_kPa, rate_kPa_per_s, cv_kPa, reservoir_kPa, drive.ctypes)
        else:
            drive[0], drive[1], drive[2], drive[3] = SAFE.evp, SAFE.dvp, 1.0, np.nan
        solenoid = drive[2] > 0.0
        if index == due:
            write(
                table, row, index * numbers.tick_s, target_kPa, drive[3], cv_kPa, reservoir_kPa,
                drive[0], drive[1], solenoid, found, now,
            )  # fmt: skip
            due += every
            row += 1
        evp = drives[index - evp_delay, 0] if index >= evp_delay else SAFE.evp
        dvp = drives[index - dvp_delay, 1] if index >= dvp_delay else SAFE.dvp
        later = weather_at(weather, index + 1)
        memory, now = tick(numbers, air_between(air, later, numbers.tick_s), memory, now, evp, dvp, solenoid)
        air = later
    return now
