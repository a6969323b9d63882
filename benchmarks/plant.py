"""How fast the plant is: the compiled closed loop, a batch of rigs, and the fake in real time.

All times are CPU time on one core, so that other work on the machine has little influence. Results are ratios
to a peer in the same run. The peers of the closed loop are a plain loop over the `Simulator`, and scipy's
`solve_ivp` with the same right-hand side and about the same accuracy. `solve_ivp` runs with one call a tick,
as a closed loop needs it, and with one call for all ticks with given valve openings, which is easier. Its
right-hand side is compiled. The error is the largest difference of a pressure from Radau's at rtol 1e-9.

    python benchmarks/plant.py            # about two minutes; needs pip install 'flying-vines[analysis]'
    python benchmarks/plant.py --check    # exit status 1 if a goal is missed
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import platform
import random
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.integrate import solve_ivp

from flying_vines.physics.baseline import Inputs
from flying_vines.physics.compiler import compiled, record
from flying_vines.physics.plant.ambient import Air, air_at
from flying_vines.physics.plant.compiled import batch, floats_of
from flying_vines.physics.plant.effects import Effects, likely_effects
from flying_vines.physics.plant.numbers import PlantNumbers
from flying_vines.physics.plant.plant import Conditions, Held, Plant
from flying_vines.physics.plant.rates import conditions, rates
from flying_vines.physics.plant.sensors import HONEYWELL_15BAR, HONEYWELL_30PSI, Adc, read, rested
from flying_vines.physics.plant.simulator import TICK_S, Simulator
from flying_vines.physics.rig import ControlVolume, Evp, Reservoir, Rig
from flying_vines.simulation.phlosar.closed_loop import SetpointChange, closed_loop
from flying_vines.simulation.phlosar.firmware import SAFE, Regulator

SECONDS = 60.0
SETPOINTS = [SetpointChange(0.1 + 6.0 * cycle, 20.7, 60.0) for cycle in range(10)]
SETPOINTS += [SetpointChange(1.2 + 6.0 * cycle, 0.0, 60.0) for cycle in range(10)]
SETPOINTS.sort()
CV_SENSOR = dataclasses.replace(HONEYWELL_30PSI, adc=Adc(12))
RESERVOIR_SENSOR = dataclasses.replace(HONEYWELL_15BAR, adc=Adc(12))
PEERS = (
    ("LSODA, one call a tick", "LSODA", 1e-5),
    ("Radau, one call a tick", "Radau", 1e-3),
    ("LSODA, one call for all", "LSODA", 1e-7),
    ("Radau, one call for all", "Radau", 1e-6),
)
"""The tolerances are about the loosest that give the required accuracy."""
ACCURACY_KPA = 0.01
BATCH = 1000
BATCH_SECONDS = 6.0

GOALS = {
    "real_time": (2000.0, "one high-fidelity closed loop against the clock"),
    "solve_ivp": (50.0, "the same against the fastest solve_ivp of the same accuracy"),
    "batch": (10.0, "a batch of rigs against a loop over the Simulator, for each core"),
    "fake": (10.0, "one core against the processor time of a real-time fake without numba"),
}
"""Minimum values."""


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--window", type=float, default=2.0, help="seconds for solve_ivp (2)")
    parser.add_argument("--check", action="store_true", help="exit status 1 if a goal is missed")
    parser.add_argument(
        "--json", action="store_true", help="print JSON with all numbers instead of the tables"
    )
    arguments = parser.parse_args()
    console = Console(stderr=arguments.json)
    plants = {"baseline": Plant(Rig(), Effects()), "high fidelity": Plant(Rig(), likely_effects())}
    first_call_s = cpu_s(lambda: run(plants["baseline"], 0.01))
    speeds = {name: measure(plant, arguments.window) for name, plant in plants.items()}
    batches = measure_batch()
    fake = {"cpu_share": fake_cpu_share()}

    high = speeds["high fidelity"]
    quickest = max(
        row["real_time"]
        for name, row in high.items()
        if "solve_ivp" in name and row["error_kPa"] < ACCURACY_KPA
    )
    ratios = {
        "real_time": high["compiled"]["real_time"],
        "solve_ivp": high["compiled"]["real_time"] / quickest,
        "batch": batches["batch"] / batches["loop over the Simulator"],
        "fake": 1.0 / fake["cpu_share"],
    }
    found = {
        "machine": machine(),
        "first_call_s": first_call_s,
        "closed_loop": speeds,
        "batch_real_time": batches,
        "fake": fake,
        "ratios": ratios,
        "goals": {key: least for key, (least, _) in GOALS.items()},
    }
    if arguments.json:
        print(json.dumps(found, indent=1))
    else:
        show(console, found)
    missed = [key for key, (least, _) in GOALS.items() if ratios[key] < least]
    if arguments.check and missed:
        print(f"plant: below the goal: {', '.join(missed)}", file=sys.stderr)
        return 1
    return 0


def cpu_s(work: Callable[[], object], repeats: int = 1) -> float:
    """Minimum CPU time of several runs."""
    least = float("inf")
    for _ in range(repeats):
        began_s = time.process_time()
        work()
        least = min(least, time.process_time() - began_s)
    return least


def run(plant: Plant, seconds: float, seed: int = 1, record_every: int = 10) -> NDArray[np.void]:
    return closed_loop(
        plant,
        SETPOINTS,
        seconds,
        cv_sensor=CV_SENSOR,
        reservoir_sensor=RESERVOIR_SENSOR,
        seed=seed,
        record_every=record_every,
    ).table


def loop_over_simulator(plant: Plant, seconds: float, seed: int = 1) -> float:
    """The same closed loop in plain Python. Returns the last pressure."""
    simulator, rng = Simulator(plant), random.Random(seed)
    found = simulator.conditions
    seen_cv, seen_reservoir = rested(found.line_kPa), rested(found.reservoir_kPa)
    orders, aim = iter(SETPOINTS), (0.0, 0.0)
    regulator: Regulator | None = None
    order = next(orders, None)
    for tick in range(round(seconds / TICK_S)):
        found = simulator.conditions
        seen_cv, cv_kPa = read(CV_SENSOR, seen_cv, found.line_kPa, TICK_S, rng.gauss(0.0, 1.0))
        seen_reservoir, reservoir_kPa = read(
            RESERVOIR_SENSOR, seen_reservoir, found.reservoir_kPa, TICK_S, rng.gauss(0.0, 1.0)
        )
        while order is not None and order.from_s <= tick * TICK_S:
            regulator = regulator or Regulator(cv_kPa=cv_kPa)
            aim = order.target_kPa, order.rate_kPa_per_s
            order = next(orders, None)
        drive = SAFE
        if regulator is not None:
            drive = regulator.step(*aim, cv_kPa, reservoir_kPa)
        simulator.advance(Inputs(*drive))
    return simulator.conditions.cv_kPa


def measure(plant: Plant, window_s: float) -> dict[str, dict[str, float]]:
    """For each method: multiple of real time, and error in kPa over the window."""
    ticked = [*course(plant, window_s)]
    truth = tick_by_tick(plant, ticked, "Radau", 1e-9)
    ours = np.array([found[:3] for _, found in ticked])

    def row(seconds: float, took_s: float, found: NDArray[np.float64]) -> dict[str, float]:
        return {"real_time": seconds / took_s, "error_kPa": float(np.abs(found - truth).max())}

    rows = {
        "compiled": row(SECONDS, cpu_s(lambda: run(plant, SECONDS), 7), ours),
        "loop over the Simulator": row(10.0, cpu_s(lambda: loop_over_simulator(plant, 10.0)), ours),
    }
    for name, method, rtol in PEERS:
        way = at_once if name.endswith("all") else tick_by_tick
        began_s = time.process_time()
        found = way(plant, ticked, method, rtol)
        rows[f"solve_ivp {name}"] = row(window_s, time.process_time() - began_s, found)
    return rows


Ticked = tuple[Held, Conditions]


def course(plant: Plant, seconds: float) -> Iterator[Ticked]:
    """For each tick of the closed loop: the commands, and the true state after it."""
    simulator = Simulator(plant)
    for row in run(plant, seconds, record_every=1):
        simulator.advance(Inputs(row["evp"], row["dvp"], bool(row["solenoid"])))
        yield simulator.held, simulator.conditions


def change(
    numbers: PlantNumbers, air: Air, state: NDArray[np.float64], held: Held, out: NDArray[np.float64]
) -> None:
    """The right-hand side for arrays."""
    found = rates(
        numbers,
        air,
        0.0,
        (
            state[0], state[1], state[2], state[3], state[4],
            state[5], state[6], state[7], state[8], state[9],
        ),
        held,
    )  # fmt: skip
    for index in range(10):
        out[index] = found[index]


def right_hand_side(plant: Plant) -> tuple[Callable[[Any, Held], NDArray[np.float64]], Simulator]:
    simulator = Simulator(plant)
    numbers, air, quick = record(simulator.numbers), air_at(plant.ambient, 0.0), compiled(change)

    def of(state: Any, held: Held) -> NDArray[np.float64]:
        out = np.empty(10)
        quick(numbers, air, state, held, out)
        return out

    of(np.array(floats_of(simulator.state)), Held(0.0, 0.0, False))
    return of, simulator


def tick_by_tick(plant: Plant, ticked: list[Ticked], method: str, rtol: float) -> NDArray[np.float64]:
    """Pressures after each tick, with one call a tick."""
    of, simulator = right_hand_side(plant)
    air, state = air_at(plant.ambient, 0.0), np.array(simulator.state)
    rows = []
    for held, _ in ticked:
        solution = solve_ivp(
            lambda t, y, held: of(y, held), (0.0, TICK_S), state, method, args=(held,), rtol=rtol, atol=rtol
        )
        state = solution.y[:, -1]
        state[7:9] = _openings(state, held, simulator.numbers)
        rows.append(conditions(simulator.numbers, air, tuple(state.tolist()))[:3])
    return np.array(rows)


def at_once(plant: Plant, ticked: list[Ticked], method: str, rtol: float) -> NDArray[np.float64]:
    """Pressures after each tick, with one call for all."""
    of, simulator = right_hand_side(plant)
    air = air_at(plant.ambient, 0.0)
    last = len(ticked) - 1
    solution = solve_ivp(
        lambda t, y: of(y, ticked[min(last, int(t / TICK_S))][0]),
        (0.0, len(ticked) * TICK_S),
        np.array(simulator.state),
        method,
        t_eval=(np.arange(len(ticked)) + 1) * TICK_S,
        rtol=rtol,
        atol=rtol,
        max_step=TICK_S,
    )
    return np.array([conditions(simulator.numbers, air, tuple(state))[:3] for state in solution.y.T.tolist()])


def _openings(state: NDArray[np.float64], held: Held, numbers: PlantNumbers) -> tuple[float, float]:
    """The openings. A valve without lag is at its target and is not integrated."""
    return (
        float(state[7]) if numbers.evp.lag_per_s else held.evp_target,
        float(state[8]) if numbers.dvp.lag_per_s else held.dvp_target,
    )


def random_plant(seed: int) -> Plant:
    """A rig with every effect and random numbers."""
    rng = random.Random(seed)
    rig = Rig(
        reservoir=Reservoir(rng.uniform(1.0, 4.0)),
        cv=ControlVolume(rng.uniform(0.05, 0.5)),
        evp=Evp(rng.uniform(1500.0, 3000.0)),
    )
    return Plant(rig, likely_effects(pouch=rng.random() < 0.5))


def measure_batch() -> dict[str, float]:
    """Simulated seconds for each second of one core."""
    plants = [random_plant(seed) for seed in range(BATCH)]

    def one(plant: Plant) -> object:
        return run(plant, BATCH_SECONDS)

    few = plants[:4]
    took_s = {
        "loop over the Simulator": cpu_s(lambda: [loop_over_simulator(p, BATCH_SECONDS) for p in few])
        / len(few),
        "loop over compiled runs": cpu_s(lambda: [one(plant) for plant in plants], 2) / BATCH,
        "batch": cpu_s(lambda: batch(one, plants), 2) / BATCH,
        "batch on 2 threads": cpu_s(lambda: batch(one, plants, threads=2), 2) / BATCH,
    }
    return {name: BATCH_SECONDS / each_s for name, each_s in took_s.items()}


FAKE = """
import sys, time
sys.modules["numba"] = sys.modules["scipy"] = sys.modules["numpy"] = None
from firmware_link.protocol import PROTOCOL_VERSION, Codec, Hello, Setpoint
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
fake, host = SimulatedPhlosar(), Codec()
fake.receive(host.encode(Hello(PROTOCOL_VERSION, 1)))
host.decode(fake.advance(0.0))
began_s = time.process_time()
for step in range(1, 1001):
    target_kPa = 20.7 if step % 400 < 200 else 0.0
    fake.receive(host.encode(Setpoint(target_kPa, 60.0, 250, step)))
    host.decode(fake.advance(step * 0.02))
print((time.process_time() - began_s) / fake.now_s)
"""


def fake_cpu_share() -> float:
    """Share of one core that the fake needs in real time, without numba, numpy and scipy."""
    ran = subprocess.run([sys.executable, "-c", FAKE], capture_output=True, text=True, check=True)
    return float(ran.stdout)


def machine() -> dict[str, str]:
    return {
        "processor": f"{os.cpu_count()} x {platform.processor() or platform.machine()}",
        "python": platform.python_version(),
        **{name: version(name) for name in ("numba", "numpy", "scipy")},
        "load": f"{os.getloadavg()[0]:.1f}",
    }


def show(console: Console, found: dict[str, Any]) -> None:
    told = ", ".join(f"{key} {value}" for key, value in found["machine"].items())
    console.print(told, highlight=False, style="dim")
    for plant, rows in found["closed_loop"].items():
        table = Table(box=None, pad_edge=False, header_style="bold")
        for heading in (f"closed loop at 1 kHz, {plant}", "x real time", "compiled is", "error kPa"):
            table.add_column(heading, justify="left" if plant in heading else "right")
        ours = rows["compiled"]["real_time"]
        for name, row in rows.items():
            table.add_row(
                name,
                f"{row['real_time']:,.2f}" if row["real_time"] < 10 else f"{row['real_time']:,.0f}",
                f"{ours / row['real_time']:,.0f} x",
                f"{row['error_kPa']:.1e}",
            )
        console.print(table, "")
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in (f"{BATCH} rigs, {BATCH_SECONDS:g} s each", "x real time, a core", "the batch is"):
        table.add_column(heading, justify="left" if "rigs" in heading else "right")
    batches = found["batch_real_time"]
    for name, real_time in batches.items():
        table.add_row(name, f"{real_time:,.0f}", f"{batches['batch'] / real_time:,.2f} x")
    console.print(table, "")
    console.print(f"the fake phloSAR in real time: {100 * found['fake']['cpu_share']:.1f} % of one core")
    console.print(f"the first call: {found['first_call_s']:.1f} s (compiles, or reads the cache)\n")
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("goal", "at least", "found", "met"):
        table.add_column(heading, justify="left" if heading == "goal" else "right")
    for key, (least, what) in GOALS.items():
        ratio = found["ratios"][key]
        table.add_row(what, f"{least:,.0f} x", f"{ratio:,.0f} x", "yes" if ratio >= least else "NO")
    console.print(table)


if __name__ == "__main__":
    sys.exit(main())
