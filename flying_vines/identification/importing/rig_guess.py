"""Guesses a rig from its runs: pump and valve by rises of the pressure, outlets by its falls, the noise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import nnls

from flying_vines.identification.importing.answers_file import Answers
from flying_vines.identification.noise import MIN_KPA, measured_noise, rounded_noise, rounding_step
from flying_vines.physics.arrays import Array
from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.physics.rig import Pump, rig_from

PRESSURES = {"cv_pressure": "cv", "reservoir_pressure": "reservoir"}
_OUTLET_TOLERANCE_PERCENT = 50.0
"""Tolerance of the flow resistance of a vessel's outlet, estimated from the fall of the pressure."""
_CHAMBER_TOLERANCE_PERCENT = 80.0
"""Tolerance of guesses about what fills and empties a chamber. Leaks, hoses, the sensor and the gas's
temperature change rise and fall as well."""
_SPAN_S = 0.3
"""Time over which a rise is measured: longer than a sample, so that noise matters less."""
_MAX_STALL = 3.0
"""Maximum stall pressure, as a multiple of the highest recorded pressure."""

Run = dict[str, Array]
"""Converted columns of a run, by meaning."""


class _Rise(NamedTuple):
    """Means over a time in which the outlet is shut, and the rise of the chamber's pressure."""

    opening: float
    cv_kPa: float
    reservoir_kPa: float
    """NaN if it was not recorded."""
    rate_kPa_per_s: float


def guessed_pump(runs: Sequence[Run], volume_L: float) -> dict[str, float]:
    """The numbers of `[pump]`, from runs with `time`, `cv_pressure` and `evp_opening` (the pump's signal).

    Least squares of dP/dt = a u − b u P while the pump runs, a = α Q_max/V, b = a/P_max. A leak lowers both;
    the tolerance covers this. Without a rise the numbers are those of a small pump.
    """
    rises = list(_rises(runs))
    top_kPa = max(float(np.sort(p[np.isfinite(p)])[-5:].mean()) for p in (run["cv_pressure"] for run in runs))
    default = Pump()
    numbers = default.free_flow_SL_per_s, max(default.stall_pressure_kPa, top_kPa)
    if rises and top_kPa > 0.0:
        rows = [(rise.opening, -rise.opening * rise.cv_kPa) for rise in rises]
        (a, b), _ = nnls(np.array(rows), np.array([rise.rate_kPa_per_s for rise in rises]))
        if a > 0.0:
            stall_kPa = a / b if b > 0.0 else np.inf
            numbers = a * volume_L / ALPHA_KPA, min(max(stall_kPa, top_kPa), _MAX_STALL * top_kPa)
    flow, stall_kPa = (float(f"{number:.3g}") for number in numbers)
    return {"free_flow_SL_per_s": flow, "stall_pressure_kPa": stall_kPa}


def guessed_valve(runs: Sequence[Run], volume_L: float) -> dict[str, float]:
    """The flow resistance of the inflation valve, from runs that also have `reservoir_pressure`.

    It is empty if the pressure never rises.

    Least squares of dP_cv/dt = α u (P_r − P_cv) / (R V).
    """
    rises = [rise for rise in _rises(runs) if np.isfinite(rise.reservoir_kPa)]
    drives = np.array([rise.opening * (rise.reservoir_kPa - rise.cv_kPa) for rise in rises])
    rates = np.array([rise.rate_kPa_per_s for rise in rises])
    if not drives.any() or not drives @ rates > 0.0:
        return {}
    R = ALPHA_KPA / volume_L * float(drives @ drives) / float(drives @ rates)
    return {"flow_resistance_kPa_s_per_SL": float(f"{R:.4g}")}


def _rises(runs: Sequence[Run]) -> Iterator[_Rise]:
    for run in runs:
        use = np.isfinite(run["cv_pressure"])
        t, p, u = run["time"][use], run["cv_pressure"][use], np.nan_to_num(run["evp_opening"])[use]
        shut = np.nan_to_num(run.get("solenoid", np.zeros_like(run["time"])))[use] < 0.5
        reservoir = run.get("reservoir_pressure", np.full_like(run["time"], np.nan))[use]
        for first in np.searchsorted(t, np.arange(t[0], t[-1] - _SPAN_S, _SPAN_S)):
            last = int(np.searchsorted(t, t[first] + _SPAN_S))
            if last < len(t) and t[last] < t[first] + 3.0 * _SPAN_S and shut[first:last].all():
                yield _Rise(
                    float(u[first:last].mean()),
                    float(p[first : last + 1].mean()),
                    float(reservoir[first : last + 1].mean()),
                    float(p[last] - p[first]) / float(t[last] - t[first]),
                )


def rig_tables(answers: Answers, runs: Sequence[Run]) -> dict[str, Any]:
    """The tables of rig.toml: the answers, the noise of the readings, and guesses about pump and valves.

    The valves of a rig with a Venturi have their defaults: its vacuum changes the fall.
    """
    tables: dict[str, Any] = {name: dict(table) for name, table in answers.rig.items()}
    if answers.setup.gas:
        tables.setdefault("gas", {"name": answers.setup.gas})
    if "tolerance_percent" in tables:
        tables["tolerance_percent"] = dict(rig_from(answers.rig).tolerance_percent)
    if answers.setup.source == "pump":
        _add_guess(tables, "pump", guessed_pump(runs, tables["cv"]["volume_L"]), _CHAMBER_TOLERANCE_PERCENT)
    sensors = tables.setdefault("sensors", {})
    for pressure, vessel in PRESSURES.items():
        readings = [run[pressure] for run in runs if pressure in run]
        if readings and f"{vessel}_noise_std_kPa" not in sensors:
            sensors[f"{vessel}_noise_std_kPa"] = float(f"{_noise_kPa(readings):.3g}")
    if all("cv_pressure" not in run for run in runs):
        tables.pop("cv", None)
        opening = [run.get("evp_opening", np.ones_like(run["time"])) for run in runs]
        falls = zip(runs, opening, strict=True)
        seconds = [fall_s(run["time"], run["reservoir_pressure"], opened) for run, opened in falls]
        _add_resistance(tables, "evp", seconds, "reservoir", _OUTLET_TOLERANCE_PERCENT)
    elif all("dvp_opening" not in run for run in runs):
        seconds = [fall_s(run["time"], run["cv_pressure"], _only_outlet(run)) for run in runs]
        _add_resistance(tables, "solenoid", seconds, "cv", _CHAMBER_TOLERANCE_PERCENT)
        if {"reservoir_pressure", "evp_opening"} <= set(runs[0]):
            guessed = guessed_valve(runs, tables["cv"]["volume_L"])
            _add_guess(tables, "evp", guessed, _CHAMBER_TOLERANCE_PERCENT)
    return tables


def _only_outlet(run: Run) -> Array:
    """Opening of a chamber's outlet while nothing fills the chamber; else 0."""
    shut = np.zeros_like(run["time"])
    outlet, inflation = (np.nan_to_num(run.get(valve, shut)) for valve in ("solenoid", "evp_opening"))
    return np.where(inflation > 0.0, 0.0, outlet)


def _add_resistance(
    tables: dict[str, Any], valve: str, seconds: Sequence[float | None], vessel: str, tolerance_percent: float
) -> None:
    """Add the flow resistance of a valve that empties a vessel, from the time constant of each run."""
    if known := [s for s in seconds if s is not None]:
        R = float(np.median(known)) * ALPHA_KPA / tables[vessel]["volume_L"]
        guessed = {"flow_resistance_kPa_s_per_SL": float(f"{R:.4g}")}
        _add_guess(tables, valve, guessed, tolerance_percent)


def _add_guess(
    tables: dict[str, Any], name: str, guessed: Mapping[str, float], tolerance_percent: float
) -> None:
    """Add guessed numbers to a table, with their tolerance. Known numbers stay."""
    known = tables.get(name, {})
    tolerance = {f"{name}.{key}": tolerance_percent for key in guessed if key not in known}
    tables[name] = {**guessed, **known}
    tables["tolerance_percent"] = {**tolerance, **tables.get("tolerance_percent", {})}


def _noise_kPa(readings: Sequence[Array]) -> float:
    """Standard deviation of a sensor's noise, at least that of its resolution."""
    least = rounded_noise(MIN_KPA, rounding_step(np.concatenate(readings)))
    return measured_noise(readings, least, may_correlate=False).std_kPa


def from_ambient(pressure_kPa: Array) -> Array:
    """The pressure; that of an evacuated vessel with the other sign, so that it also falls to ambient."""
    evacuated = -np.nanmin(pressure_kPa, initial=0.0) > np.nanmax(pressure_kPa, initial=0.0)
    return -pressure_kPa if evacuated else pressure_kPa


def fall_s(time_s: Array, pressure_kPa: Array, opening: Array) -> float | None:
    """Time constant through the fully open outlet; None if the outlet is shut or the fall is too short."""
    there = np.isfinite(pressure_kPa)
    time_s, p, opening = time_s[there], from_ambient(pressure_kPa[there]), opening[there]
    use = (opening > 0.0) & (p > 0.1 * np.max(p, initial=0.0))
    first_gap = np.flatnonzero(np.diff(use.astype(int)) < 0)
    if len(first_gap):
        use[first_gap[0] + 1 :] = False
    if use.sum() < 5 or p[use][-1] > 0.7 * p[use][0]:
        return None
    slope = float(np.polyfit(time_s[use], np.log(p[use]), 1)[0])
    return -float(opening[use].mean()) / slope if slope < 0.0 else None
