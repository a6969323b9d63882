"""The compiled plant: whole runs as one call, for fits, benchmarks and batches of rigs.

`replay` runs a plant with openings that are given; the closed loop with the firmware's regulator is
`flying_vines.simulation.phlosar.closed_loop.closed_loop`. Both give a `CompiledRun`. Needs numba: pip install
'flying-vines[analysis]'.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flying_vines.physics.baseline import Inputs
from flying_vines.physics.compiler import compiled, record
from flying_vines.physics.constants import STANDARD_TEMPERATURE_K
from flying_vines.physics.plant.ambient import Ambient, Recorded, Steady
from flying_vines.physics.plant.loops import APART, COLUMNS, Table, run_openings
from flying_vines.physics.plant.numbers import numbers_of
from flying_vines.physics.plant.plant import Plant, State, at_rest
from flying_vines.physics.plant.sensors import Sensor
from flying_vines.physics.plant.simulator import SHUT, TICK_S

T = TypeVar("T")
R = TypeVar("R")


class CompiledRun(NamedTuple):
    """What happened: `table["cv_kPa"]` and so on for each of `loops.COLUMNS`, and the state at the end."""

    table: NDArray[np.void]
    state: State


def replay(
    plant: Plant,
    openings: ArrayLike,
    state: State | None = None,
    *,
    cv_sensor: Sensor | None = None,
    reservoir_sensor: Sensor | None = None,
    seed: int | None = None,
    initial: Inputs = SHUT,
    tick_s: float = TICK_S,
    record_every: int = 1,
) -> CompiledRun:
    """The plant from `state` (default: `at_rest`) with the valves told `openings`.

    `openings` has a row for every tick of `tick_s`: EVP 0…1, DVP 0…1, solenoid 0 or 1. Sensors are perfect
    unless given, and without noise unless there is a `seed`. `initial` as for the Simulator, whose numbers
    these are. A row of the table tells of the start of every `record_every`-th tick.
    """
    told = np.ascontiguousarray(openings, np.float64)
    if told.ndim != 2 or told.shape[1] != 3:
        raise ValueError(f"openings have 3 columns (EVP, DVP, solenoid) and a row a tick, not {told.shape}")
    table = empty_table(len(told), record_every)
    final = compiled(run_openings, APART)(
        record(numbers_of(plant, tick_s)),
        record((cv_sensor or Sensor()).numbers),
        record((reservoir_sensor or Sensor()).numbers),
        weather_of(plant, len(told), tick_s),
        noise_of(seed, len(told)),
        (float(initial.evp), float(initial.dvp), float(initial.solenoid)),
        told,
        floats_of(at_rest(plant) if state is None else state),
        record_every,
        table,
    )
    return CompiledRun(named(table), State(*final))


def batch(run: Callable[[T], R], items: Iterable[T], *, threads: int = 1) -> list[R]:
    """`run` of each, on so many cores: compiled runs let other threads work meanwhile.

    batch(lambda plant: replay(plant, openings), plants, threads=4)
    """
    if threads == 1:
        return [run(item) for item in items]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(run, items))


def empty_table(n_ticks: int, record_every: int) -> Table:
    """A table for so many ticks."""
    if record_every < 1:
        raise ValueError(f"a row every {record_every} ticks cannot be: 1 or more")
    return np.empty((-(-n_ticks // record_every), len(COLUMNS)))


def named(table: Table) -> NDArray[np.void]:
    """The same numbers by the columns' names."""
    return table.view([(name, np.float64) for name in COLUMNS])[:, 0]


def weather_of(plant: Plant, n_ticks: int, tick_s: float) -> Table:
    """The air around at the start of each tick and at the end of the last: kPa, temperature ratio."""
    ambient = plant.ambient
    if isinstance(ambient, Steady):
        return np.array([[ambient.pressure_kPa, ambient.temperature_K / STANDARD_TEMPERATURE_K]])
    return weather_at(ambient, np.arange(n_ticks + 1) * tick_s)


def weather_at(ambient: Ambient, times_s: NDArray[np.floating[Any]]) -> Table:
    """The air around at rising times: kPa, temperature ratio."""
    corners_s = ambient.time_s if isinstance(ambient, Recorded) else (times_s[0], times_s[-1])
    kPa, kelvin, _ = np.transpose([ambient.at(corner_s) for corner_s in corners_s])
    return np.column_stack(
        [
            np.interp(times_s, corners_s, kPa),
            np.interp(times_s, corners_s, kelvin) / STANDARD_TEMPERATURE_K,
        ]
    )


def noise_of(seed: int | None, n_ticks: int) -> Table:
    """Standard normal numbers for the two sensors at each tick: CV, reservoir. None: no noise."""
    if seed is None:
        return np.zeros((1, 2))
    return np.random.default_rng(seed).standard_normal((n_ticks, 2))


def floats_of(state: State) -> tuple[float, ...]:
    """A state as a compiled function takes it."""
    return tuple(map(float, state))
