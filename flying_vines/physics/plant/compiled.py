"""The compiled plant: a whole run in one call, for fits, benchmarks and batches of rigs.

`replay` runs a plant with given openings. The closed loop with the firmware's regulator is
`flying_vines.simulation.phlosar.closed_loop.closed_loop`. Both functions return a `CompiledRun` and
need numba, of the extra `analysis`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flying_vines.physics.baseline import Inputs
from flying_vines.physics.compiler import compiled, record
from flying_vines.physics.gas import STANDARD_TEMPERATURE_K
from flying_vines.physics.plant.ambient import HIGHEST_KPA, LOWEST_KPA, Ambient, Climb, Recorded, Steady
from flying_vines.physics.plant.loops import COLUMNS, NOT_INLINED, Table, run_openings
from flying_vines.physics.plant.numbers import numbers_of
from flying_vines.physics.plant.plant import Plant, State, at_rest
from flying_vines.physics.plant.sensors import Sensor
from flying_vines.physics.plant.simulator import SHUT, TICK_S

T = TypeVar("T")
R = TypeVar("R")


class CompiledRun(NamedTuple):
    """A table with the columns `loops.COLUMNS`, such as `table["cv_kPa"]`, and the final state."""

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
    record_every: int = 1,
) -> CompiledRun:
    """Run the plant from `state` (default: `at_rest`) with the commands `openings`.

    `openings` has a row for every tick of `TICK_S`: EVP 0…1, DVP 0…1, solenoid 0 or 1. Sensors are perfect by
    default, and have no noise without a `seed`. `initial` means the same as in `Simulator`, and the results
    are the same. The table has a row for the start of every `record_every`-th tick.
    """
    commands = np.ascontiguousarray(openings, np.float64)
    if commands.ndim != 2 or commands.shape[1] != 3:
        raise ValueError(
            f"openings need 3 columns (EVP, DVP, solenoid) and one row per tick, not {commands.shape}"
        )
    table = empty_table(len(commands), record_every)
    final = compiled(run_openings, NOT_INLINED)(
        record(numbers_of(plant, TICK_S)),
        record((cv_sensor or Sensor()).numbers),
        record((reservoir_sensor or Sensor()).numbers),
        weather_of(plant, len(commands), TICK_S),
        noise_of(seed, len(commands)),
        (float(initial.evp), float(initial.dvp), float(initial.solenoid)),
        commands,
        floats_of(at_rest(plant) if state is None else state),
        record_every,
        table,
    )
    return CompiledRun(named(table), State(*final))


def batch(run: Callable[[T], R], items: Iterable[T], *, threads: int = 1) -> list[R]:
    """Calls `run` for each item, in several threads: compiled runs release the GIL.

    batch(lambda plant: replay(plant, openings), plants, threads=4)
    """
    if threads == 1:
        return [run(item) for item in items]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(run, items))


def empty_table(n_ticks: int, record_every: int) -> Table:
    """An empty table for `n_ticks` ticks."""
    if record_every < 1:
        raise ValueError(f"record_every must be at least 1, not {record_every}")
    return np.empty((-(-n_ticks // record_every), len(COLUMNS)))


def named(table: Table) -> NDArray[np.void]:
    """The table with named columns."""
    return table.view([(name, np.float64) for name in COLUMNS])[:, 0]


def weather_of(plant: Plant, n_ticks: int, tick_s: float) -> Table:
    """Ambient air at the start of each tick and at the end of the last: kPa absolute, temperature ratio.

    Steady air has a single row.
    """
    ambient = plant.ambient
    if isinstance(ambient, Steady):
        return np.array([[ambient.pressure_kPa, ambient.temperature_K / STANDARD_TEMPERATURE_K]])
    return weather_at(ambient, np.arange(n_ticks + 1) * tick_s)


def weather_at(ambient: Ambient, times_s: NDArray[np.floating[Any]]) -> Table:
    """Ambient air at rising times: kPa absolute, temperature ratio."""
    if isinstance(ambient, Climb):
        falling = ambient.pressure_kPa - ambient.falls_kPa_per_s * times_s
        kPa, kelvin = np.clip(falling, LOWEST_KPA, HIGHEST_KPA), np.full(len(times_s), ambient.temperature_K)
    else:
        corners_s = ambient.time_s if isinstance(ambient, Recorded) else (times_s[0], times_s[-1])
        kPa, kelvin, _ = np.transpose([ambient.at(corner_s) for corner_s in corners_s])
        kPa, kelvin = np.interp(times_s, corners_s, kPa), np.interp(times_s, corners_s, kelvin)
    return np.column_stack([kPa, kelvin / STANDARD_TEMPERATURE_K])


def noise_of(seed: int | None, n_ticks: int) -> Table:
    """Standard normal numbers for the two sensors at each tick: CV, reservoir. None: no noise."""
    if seed is None:
        return np.zeros((1, 2))
    return np.random.default_rng(seed).standard_normal((n_ticks, 2))


def floats_of(state: State) -> tuple[float, ...]:
    """A state for a compiled function."""
    return tuple(map(float, state))
