"""Runs many ticks and fills a table. `compiled` compiles these functions; plain Python runs them slowly.

Each tick: read both sensors, get the valve commands, write a row, advance the plant.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flying_vines.physics.gas import STANDARD_TEMPERATURE_K
from flying_vines.physics.plant.ambient import Air, air_between
from flying_vines.physics.plant.numbers import PlantNumbers
from flying_vines.physics.plant.plant import Conditions
from flying_vines.physics.plant.rates import Floats, conditions, rates
from flying_vines.physics.plant.sensors import SensorMemory, Transfer, reading, rested
from flying_vines.physics.plant.tick import memory_at_rest, runge_kutta, tick

Table = NDArray[np.float64]

NOT_INLINED = (rates, conditions, runge_kutta, tick)
"""Not inlined by the compiler, because they are called from several places."""

COLUMNS = (
    "time_s",
    "target_kPa",
    "setpoint_kPa",
    "cv_reading_kPa",
    "reservoir_reading_kPa",
    "evp",
    "dvp",
    "solenoid",
    *Conditions._fields,
    "vented_SL",
    "evp_opening",
    "dvp_opening",
)
"""Values at the start of a tick: time, target and setpoint (NaN: none), readings, commands, true values."""


def run_openings(
    numbers: PlantNumbers,
    cv_sensor: Transfer,
    reservoir_sensor: Transfer,
    weather: Table,
    noise: Table,
    start: tuple[float, float, float],
    commands: Table,
    state: Floats,
    every: int,
    table: Table,
) -> Floats:
    """The final state. Each row of `commands` (EVP, DVP, solenoid) is one tick.

    At the start, sensors are settled, backlash is that of a shut valve, and coils are at ambient temperature.
    `start` are the commands before the run, for the solenoid and for valves with a delay. A row of `table` is
    filled every `every` ticks.

    `weather` (kPa absolute, temperature ratio) has a row for the start of each tick, and one for the end of
    the last tick. `noise` (CV, reservoir) has a row for each tick. Constant weather and no noise have a
    single row.
    """
    s0, s1, s2, s3, s4, s5, s6, s7, s8, s9 = state
    now: Floats = (s0, s1, s2, s3, s4, s5, s6, s7, s8, s9)
    air = weather_at(weather, 0)
    memory = memory_at_rest(start[2] > 0.5, air.ratio * STANDARD_TEMPERATURE_K)
    found = conditions(numbers, air, now)
    cv_seen, reservoir_seen = rested(found.line_kPa), rested(found.reservoir_kPa)
    evp_delay, dvp_delay = numbers.evp.delay_ticks, numbers.dvp.delay_ticks
    due = row = 0
    for index in range(len(commands)):
        found = conditions(numbers, air, now)
        cv_seen, cv_kPa, reservoir_seen, reservoir_kPa = read_both(
            cv_sensor, reservoir_sensor, cv_seen, reservoir_seen, found, numbers.tick_s, noise, index
        )
        solenoid = commands[index, 2] > 0.5
        if index == due:
            write(
                table, row, index * numbers.tick_s, np.nan, np.nan, cv_kPa, reservoir_kPa,
                commands[index, 0], commands[index, 1], solenoid, found, now,
            )  # fmt: skip
            due += every
            row += 1
        evp = commands[index - evp_delay, 0] if index >= evp_delay else start[0]
        dvp = commands[index - dvp_delay, 1] if index >= dvp_delay else start[1]
        later = weather_at(weather, index + 1)
        memory, now = tick(numbers, air_between(air, later, numbers.tick_s), memory, now, evp, dvp, solenoid)
        air = later
    return now


def weather_at(weather: Table, index: int) -> Air:
    """The air at the start of a tick."""
    row = min(index, len(weather) - 1)
    return Air(weather[row, 0], 0.0, weather[row, 1], 0.0)


def read_both(
    cv_sensor: Transfer,
    reservoir_sensor: Transfer,
    cv_seen: SensorMemory,
    reservoir_seen: SensorMemory,
    true: Conditions,
    dt_s: float,
    noise: Table,
    index: int,
) -> tuple[SensorMemory, float, SensorMemory, float]:
    """Memory and reading of both sensors. The sensor of the control volume is at the valves."""
    row = min(index, len(noise) - 1)
    cv_seen, cv_kPa = reading(cv_sensor, cv_seen, true.line_kPa, dt_s, noise[row, 0])
    reservoir_seen, reservoir_kPa = reading(
        reservoir_sensor, reservoir_seen, true.reservoir_kPa, dt_s, noise[row, 1]
    )
    return cv_seen, cv_kPa, reservoir_seen, reservoir_kPa


def write(
    table: Table,
    row: int,
    time_s: float,
    target_kPa: float,
    setpoint_kPa: float,
    cv_kPa: float,
    reservoir_kPa: float,
    evp: float,
    dvp: float,
    solenoid: bool,
    true: Conditions,
    state: Floats,
) -> None:
    """Fill one row, in the order of COLUMNS."""
    table[row, 0] = time_s
    table[row, 1] = target_kPa
    table[row, 2] = setpoint_kPa
    table[row, 3] = cv_kPa
    table[row, 4] = reservoir_kPa
    table[row, 5] = evp
    table[row, 6] = dvp
    table[row, 7] = 1.0 if solenoid else 0.0
    for column in range(8):
        table[row, 8 + column] = true[column]
    table[row, 16] = state[9]
    table[row, 17] = state[7]
    table[row, 18] = state[8]
