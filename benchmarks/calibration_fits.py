"""Calibration's own fits against the fit of `identification`, on the same recording of the same random rig.

    python benchmarks/calibration_fits.py --rigs 8

Each rig is calibrated in simulation as in `calibrate.py`. The whole recording then goes to

- own: the estimators of `flying_vines.calibration`, which need numpy only;
- plant: `FitProblem` of `flying_vines.identification`, which simulates the plant. Starts from the profile
  and adds the causes below one at a time, each from all of its seeds, as `diagnose` does;
- plant, from own: the same model with all causes at once, started at the results of `own`.

Time is CPU time of one evaluation of the whole recording, after the compiler has run. Memory is the peak of a
fresh process that does the evaluation alone.
"""

from __future__ import annotations

import argparse
import resource
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
from flying_vines.supply.belief import nominal_rig

Found = dict[str, tuple[float, float, float]]
"""Value and 95 % interval by the quantity's name."""
READING_MS = 5
"""As `diagnose` reads a flight."""
EVP = "evp_flow_resistance_kPa_s_per_SL"
TOLERANCES = {
    "reservoir.volume_L": 0.5,
    "cv.volume_L": 60.0,
    "evp.flow_resistance_kPa_s_per_SL": 60.0,
    "dvp.flow_resistance_kPa_s_per_SL": 60.0,
    "solenoid.flow_resistance_kPa_s_per_SL": 80.0,
}
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
"""What a random rig has and the catalogue knows: the cause, and the result of `own` at which it may start."""
NO_LEAK = 3e5
"""kPa·s/SL; a leak with a higher resistance counts as none."""


def own(recording: StageRecording) -> Found:
    """By calibration's estimators."""
    findings = recording.findings.with_result(recording.result()).findings
    return {f.name: (f.value, f.low, f.high) for f in findings if f.value is not None}


def plant(recording: StageRecording, started: Findings | None) -> Found:
    """By the fit of `identification`."""
    from threadpoolctl import threadpool_limits

    from flying_vines.identification.case import Case, RecordedRun
    from flying_vines.identification.fit import FitProblem
    from flying_vines.physics.effects import cause_named
    from flying_vines.physics.rig import with_numbers

    plan, read = recording.plan, recording.readings
    numbers = {"reservoir.volume_L": plan.request.bottle_volume_L}
    for name, key in (("cv_volume_L", "cv.volume_L"), (EVP, "evp.flow_resistance_kPa_s_per_SL")):
        if started and (found := started.estimate(name)):
            numbers[key] = found.value
    rig = replace(with_numbers(nominal_rig(plan.believed.pneumatics), numbers), tolerance_percent=TOLERANCES)
    at = np.round(read.t_s * 1000.0).astype(int) // READING_MS
    counts = np.append(True, np.diff(at) > 0)
    valves = np.stack((read.evp, read.dvp, read.solenoid))
    kept = counts | np.append(True, np.any(np.diff(valves) != 0.0, axis=0))
    cv, reservoir = (np.where(counts, kPa, np.nan)[kept] for kPa in (read.cv_kPa, read.reservoir_kPa))
    command = np.where(read.regulating, read.setpoint_kPa, np.nan)[kept]
    run = RecordedRun("", read.t_s[kept], command, *valves[:, kept], cv, reservoir, None, None, False)
    noise = [recording.findings.estimate(f"{name}_noise_kPa").value for name in ("cv", "reservoir")]
    with threadpool_limits(1):
        problem = FitProblem(Case(Path(), rig, (run,), ()), (noise[0], noise[1]))
        point = problem.start().freed(tuple(TOLERANCES))
        for name, result in CAUSES.items():
            cause = cause_named(name)
            if started is None:
                point = problem.begun(point, cause).point
            else:
                found = started.estimate(result)
                point = point.with_cause(cause, (found.value,) if found else cause.seeds()[0])
        fit = problem.fit(point)
        covariance = problem.covariance(fit)
    keys, causes = list(fit.point.deviation), fit.point.causes
    place = [*fit.point.deviation.values()]
    place += [c.parameters[0].inner(v[0]) for c, v in zip(causes, fit.point.values, strict=True)]

    def quantities(place: list[float]) -> dict[str, float]:
        moved = problem.moved(replace(fit.point, deviation=dict(zip(keys, place, strict=False))))
        value = {c.name: c.parameters[0].outer(x) for c, x in zip(causes, place[len(keys) :], strict=True)}
        full_kPa = plan.believed.pneumatics.full_kPa
        start = value["evp_dead_zone"] + 0.5 * value["evp_hysteresis"]
        reference = (690.0 + STANDARD_PRESSURE_KPA) / 690.0 * full_kPa / (full_kPa + STANDARD_PRESSURE_KPA)
        growth = value["cv_compliance"] * (plan.top_kPa + STANDARD_PRESSURE_KPA)
        return {
            "cv_zero_kPa": value["cv_sensor_offset"],
            "cv_volume_L": moved["cv.volume_L"] * (1.0 + growth),
            "evp_start": start,
            EVP: moved[f"evp.{EVP[4:]}"] * reference * (1.0 - value["evp_dead_zone"]) / (1.0 - start),
            "outlet_flow_resistance_kPa_s_per_SL": moved["solenoid.flow_resistance_kPa_s_per_SL"],
            "bottle_leak_kPa_s_per_SL": value["reservoir_leak"],
            "vine_leak_kPa_s_per_SL": value["cv_leak"],
        }

    best = quantities(place)
    slopes = {name: np.zeros(len(place)) for name in best}
    for i in range(len(place)):
        there = quantities([x + 1e-5 * (i == k) for k, x in enumerate(place)])
        for name in best:
            slopes[name][i] = (there[name] - best[name]) / 1e-5
    sd = {name: float(np.sqrt(max(0.0, slope @ covariance @ slope))) for name, slope in slopes.items()}
    return {
        name: (value, value - 1.96 * sd[name], value + 1.96 * sd[name])
        for name, value in best.items()
        if not ("leak" in name and value > NO_LEAK)
    }


METHODS = ("own", "plant", "plant, from own")


def measured(method: str, recording: StageRecording) -> tuple[Found, float, float]:
    """What a method finds, its CPU time, and the peak memory of this process in MB."""
    began = time.process_time()
    if method == "own":
        found = own(recording)
    else:
        found = plant(recording, recording.findings if method == METHODS[2] else None)
    spent_s = time.process_time() - began
    return found, spent_s, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def main() -> None:
    """Print the table."""
    # Imports the compiler, whose memory must not be counted in the processes that evaluate.
    from calibrate import FIRST_SEED, ROWS, calibrated

    options = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    options.add_argument("--rigs", type=int, default=6)
    options.add_argument("--first", type=int, default=FIRST_SEED)
    given = options.parse_args()
    rigs: Counter[str] = Counter()
    errors = defaultdict(list)
    costs = defaultdict(list)
    for seed in range(given.first, given.first + given.rigs):
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
            middle, most = (number.format(f([error for error, _ in seen] or [0.0])) for f in (np.median, max))
            cells.append(f"{middle}, {most}; {sum(held for _, held in seen)} of {len(seen)}" if seen else "–")
        print(f"| {what} | {rigs[name]} | {' | '.join(cells)} |")
    for what, number in (("CPU time, median", np.median), ("CPU time, most", max)):
        times = (f"{number([s for s, _ in costs[method]]):.1f} s" for method in METHODS)
        print(f"| {what} | | {' | '.join(times)} |")
    memory = (f"{max(peak_MB for _, peak_MB in costs[method]):.0f} MB" for method in METHODS)
    print(f"| peak memory | | {' | '.join(memory)} |")


if __name__ == "__main__":
    main()
