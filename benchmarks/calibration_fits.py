"""Compares calibration's own fits with the fit of `identification`, on the same recordings of random rigs.

    python benchmarks/calibration_fits.py --rigs 4

Each rig is calibrated in simulation as in `calibrate.py`. The whole recording then goes to

- own: the estimators of `flying_vines.calibration`, which need numpy only;
- plant: `FitProblem` of `flying_vines.identification`, which simulates the plant. It starts from the
  configuration and adds the causes in `CAUSES` one at a time, each from all of its start values, as
  `diagnose` does;
- plant, from own: as `plant`, but started at the results of `own`. A leak or compliance that `own` did not
  find is left out.

Each evaluation runs in a new process. Its CPU time includes imports and loading; its peak memory is
measured too.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter, defaultdict
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from flying_vines.calibration.evaluation import StageRecording
from flying_vines.calibration.findings import Findings
from flying_vines.physics.constants import STANDARD_PRESSURE_KPA
from flying_vines.supply.rig_prior import nominal_rig

Found = dict[str, tuple[float, float, float]]
"""Value and 95 % interval by the quantity's name."""
METHODS = ("own", "plant", "plant, from own")
READING_MS = 5
"""Time between readings, as `diagnose` reads a flight."""
EVP = "evp_flow_resistance_kPa_s_per_SL"
TOLERANCES = {"reservoir.volume_L": 0.5, "cv.volume_L": 60.0, "solenoid.flow_resistance_kPa_s_per_SL": 80.0}
TOLERANCES |= {f"{valve}.flow_resistance_kPa_s_per_SL": 60.0 for valve in ("evp", "dvp")}
CAUSES = {
    "cv_sensor_offset": "cv_zero_kPa",
    "compressible_flow": "",
    "reservoir_cooling": "",
    "reservoir_leak": "bottle_leak_kPa_s_per_SL",
    "cv_leak": "vine_leak_kPa_s_per_SL",
    "evp_dead_zone": "evp_start",
    "evp_lag": "",
    "cv_heating": "",
    "cv_compliance": "cv_compliance_per_kPa",
    "evp_hysteresis": "",
    "solenoid_slow_close": "",
}
"""The causes that the random rigs can have and the catalogue knows. Each has the name of the result of `own`
at which the fit may start, or an empty text."""
NO_LEAK = 3e5
"""kPa·s/SL; a leak with a higher resistance counts as none."""


def measured(method: str, recording: StageRecording) -> tuple[Found, float, float]:
    """The results of a method, its CPU time in s, and the peak memory of this process in MB."""
    began = time.process_time()
    if method == "own":
        findings = recording.result().findings
        found: Found = {f.name: (f.value, f.low, f.high) for f in findings if f.value is not None}  # type: ignore[misc]
        zero = recording.findings.get("cv_zero_kPa")
        found["cv_zero_kPa"] = (zero.value, zero.low, zero.high)  # type: ignore[union-attr,assignment]
    else:
        found = plant(recording, recording.findings if method == METHODS[2] else Findings())
    spent_s = time.process_time() - began
    # Not ru_maxrss, which contains the memory of the process that started this one.
    peak_kB = Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]
    return found, spent_s, float(peak_kB) / 1024.0


def plant(recording: StageRecording, started: Findings) -> Found:
    """The results of the fit of `identification`."""
    from threadpoolctl import threadpool_limits

    from flying_vines.identification.case import Case, RecordedRun
    from flying_vines.identification.fit import THEN_STEPS, FitProblem
    from flying_vines.identification.noise import SensorNoise
    from flying_vines.physics.effects import cause_named
    from flying_vines.physics.rig import with_numbers

    plan, read = recording.plan, recording.readings
    numbers = {"reservoir.volume_L": plan.request.bottle_volume_L or 0.0}
    for name, key in (("cv_volume_L", "cv.volume_L"), (EVP, f"evp.{EVP[4:]}")):
        if start := started.estimate(name):
            numbers[key] = start.value
    rig = replace(
        with_numbers(nominal_rig(plan.user_config.pneumatics), numbers), tolerance_percent=TOLERANCES
    )
    is_reading = np.append(True, np.diff(np.round(read.t_s * 1000.0).astype(int) // READING_MS) > 0)
    valves = np.stack((read.evp, read.dvp, read.solenoid))
    kept = is_reading | np.append(True, np.any(np.diff(valves) != 0.0, axis=0))
    cv, reservoir = (np.where(is_reading, kPa, np.nan)[kept] for kPa in (read.cv_kPa, read.reservoir_kPa))
    command = np.where(read.regulating, read.setpoint_kPa, np.nan)[kept]
    evp, dvp, solenoid = valves[:, kept]
    run = RecordedRun("", read.t_s[kept], command, evp, dvp, solenoid, cv, reservoir, None, None, False)
    noise = [recording.findings.get(f"{name}_noise_kPa").value for name in ("cv", "reservoir")]  # type: ignore[union-attr]
    with threadpool_limits(1):
        problem = FitProblem(Case(Path(), rig, (run,), ()), (SensorNoise(noise[0]), SensorNoise(noise[1])))  # type: ignore[arg-type]
        point = problem.start().freed(tuple(TOLERANCES))
        for name, result in CAUSES.items():
            if not started.findings or not result:
                point = problem.begun(point, cause_named(name)).point
            elif start := started.estimate(result):
                point = problem.fit(point.with_cause(cause_named(name), (start.value,)), THEN_STEPS).point
        fit = problem.fit(point)
        covariance = problem.covariance(fit)
    keys, causes = list(fit.point.deviation), fit.point.causes

    def quantities(place: np.ndarray) -> dict[str, float]:
        """The quantities as `calibrate.py` defines them; `place` holds the numbers that the fit changes."""
        moved = problem.moved(replace(fit.point, deviation=dict(zip(keys, place, strict=False))))
        value = {c.name: c.parameters[0].to_model(x) for c, x in zip(causes, place[len(keys) :], strict=True)}
        full_kPa, ambient_kPa = plan.user_config.pneumatics.full_kPa, STANDARD_PRESSURE_KPA
        growth = value.get("cv_compliance", 0.0) * (plan.top_kPa + ambient_kPa)
        start = value["evp_dead_zone"] + 0.5 * value["evp_hysteresis"]
        reference = (690.0 + ambient_kPa) / 690.0 * full_kPa / (full_kPa + ambient_kPa)
        return {
            "cv_zero_kPa": value["cv_sensor_offset"],
            "cv_volume_L": moved["cv.volume_L"] * (1.0 + growth),
            "evp_start": start,
            EVP: moved[f"evp.{EVP[4:]}"] * reference * (1.0 - value["evp_dead_zone"]) / (1.0 - start),
            "outlet_flow_resistance_kPa_s_per_SL": moved["solenoid.flow_resistance_kPa_s_per_SL"],
            "bottle_leak_kPa_s_per_SL": value.get("reservoir_leak", NO_LEAK),
            "vine_leak_kPa_s_per_SL": value.get("cv_leak", NO_LEAK),
        }

    values = [c.parameters[0].to_search(v[0]) for c, v in zip(causes, fit.point.values, strict=True)]
    place = np.array([*fit.point.deviation.values(), *values])
    best = quantities(place)
    beside = [quantities(place + step) for step in 1e-5 * np.eye(len(place))]
    found = {}
    for name, value in best.items():
        slope = np.array([(there[name] - value) / 1e-5 for there in beside])
        reach = 1.96 * float(np.sqrt(max(0.0, slope @ covariance @ slope)))
        if not ("leak" in name and value >= NO_LEAK):
            found[name] = (value, value - reach, value + reach)
    return found


def main() -> None:
    """Print the table."""
    # `calibrate` imports the compiler, whose memory must not be counted in the processes that evaluate. They
    # import this module, but do not call `main`.
    from calibrate import FIRST_SEED, ROWS, calibrated

    options = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    options.add_argument("--rigs", type=int, default=4)
    rigs: Counter[str] = Counter()
    errors, costs = defaultdict(list), defaultdict(list)
    for seed in range(FIRST_SEED, FIRST_SEED + options.parse_args().rigs):
        outcome = calibrated(seed)
        rigs.update(outcome.truth)
        recording = replace(outcome.recording, findings=outcome.findings)
        for method in METHODS:
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as fresh:
                found, *cost = fresh.submit(measured, method, recording).result()
            costs[method].append(cost)
            for name in found.keys() & outcome.truth.keys() & ROWS.keys():
                true, (value, low, high) = outcome.truth[name], found[name]
                scale = 100.0 / true if ROWS[name][1] == "%" else 1.0
                errors[name, method].append((abs(scale * (value - true)), low <= true <= high))
                print(f"{seed} {method}: {name} {true:.4g}, found {value:.4g} ({low:.4g} … {high:.4g})")
    print("\n| quantity | rigs | " + " | ".join(METHODS) + " |\n" + "| --- " * 5 + "|")
    for name, (what, unit) in ROWS.items():
        cells = []
        for seen in (errors[name, method] for method in METHODS):
            number = "{:.1f} %" if unit == "%" else ("{:.3f} kPa" if unit else "{:.4f}")
            median, most = (number.format(f([error for error, _ in seen] or [0.0])) for f in (np.median, max))
            cells.append(f"{median}, {most}; {sum(held for _, held in seen)} of {len(seen)}" if seen else "–")
        print(f"| {what} | {rigs[name]} | {' | '.join(cells)} |")
    for what, index, unit in (("CPU time", 0, "s"), ("memory", 1, "MB")):
        columns = [np.array(costs[method])[:, index] for method in METHODS]
        cells = [f"{np.median(column):.1f} {unit}, {column.max():.1f}" for column in columns]
        print(f"| {what} | | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
