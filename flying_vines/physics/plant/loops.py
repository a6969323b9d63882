"""Many ticks at once, written down in a table: what `compiled` runs, and Python runs as well, slowly.

One run is: read both sensors, decide what the valves are told, write a row, live for a tick.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flying_vines.physics.constants import STANDARD_TEMPERATURE_K
from flying_vines.physics.plant.ambient import Air, air_between
from flying_vines.physics.plant.numbers import PlantNumbers
from flying_vines.physics.plant.plant import Conditions
from flying_vines.physics.plant.rates import Floats, conditions, rates
from flying_vines.physics.plant.sensors import SensorMemory, Transfer, reading, rested
from flying_vines.physics.plant.tick import memory_at_rest, runge_kutta, tick

Table = NDArray[np.float64]

APART = (rates, conditions, runge_kutta, tick)
"""Called from several places: what the compiler is to keep in one."""

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
"""Of a row, which tells of the start of a tick: when; where to and what is held (NaN: nothing); what the
sensors read; what the valves are told then; what is true."""


def run_openings(
    numbers: PlantNumbers,
    cv_sensor: Transfer,
    reservoir_sensor: Transfer,
    weather: Table,
    noise: Table,
    start: tuple[float, float, float],
    told: Table,
    state: Floats,
    every: int,
    table: Table,
) -> Floats:
    """The state after as many ticks as there are rows in `told` (EVP, DVP, solenoid), from rest.

    `start` is what the delays still hold of before. Every so many ticks a row of `table` is filled.
    `weather` (kPa, temperature ratio) has a row for the start of each tick and one for the end, `noise` (CV,
    reservoir) one for each tick; what stays as it is has one row in all.
    """
    s0, s1, s2, s3, s4, s5, s6, s7, s8, s9 = state
    now: Floats = (s0, s1, s2, s3, s4, s5, s6, s7, s8, s9)
    air = weather_at(weather, 0)
    memory = memory_at_rest(start[2] > 0.5, air.ratio * STANDARD_TEMPERATURE_K)
    found = conditions(numbers, air, now)
    cv_seen, reservoir_seen = rested(found.line_kPa), rested(found.reservoir_kPa)
    evp_delay, dvp_delay = numbers.evp.delay_ticks, numbers.dvp.delay_ticks
    due = row = 0
    for index in range(len(told)):
        found = conditions(numbers, air, now)
        cv_seen, cv_kPa, reservoir_seen, reservoir_kPa = read_both(
            cv_sensor, reservoir_sensor, cv_seen, reservoir_seen, found, numbers.tick_s, noise, index
        )
        solenoid = told[index, 2] > 0.5
        if index == due:
            write(
                table, row, index * numbers.tick_s, np.nan, np.nan, cv_kPa, reservoir_kPa,
                told[index, 0], told[index, 1], solenoid, found, now,
            )  # fmt: skip
            due += every
            row += 1
        evp = told[index - evp_delay, 0] if index >= evp_delay else start[0]
        dvp = told[index - dvp_delay, 1] if index >= dvp_delay else start[1]
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
    """What both sensors remember and read. That of the control volume sits at the valves."""
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
