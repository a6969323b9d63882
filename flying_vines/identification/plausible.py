"""Checks before any fit that the recorded columns can be what their names say.

A recording is only refused if no rig can give it, not even a worn one. A possible rig has a reservoir of 20
to 900 kPa and a control volume of -60 to 210 kPa; both may be evacuated. Its sensors have offsets up to 25
kPa (reservoir) and 5 kPa (control volume), gains wrong by a fifth, and another noise than the rig file says.
It is at any altitude, and its valves may be blocked.

Numbers in psi, bar or MPa are often also possible in kPa. They are refused only if their noise shows the
other unit; if only one column looks wrong, the air flow must show it too. EVP is the inflation valve, DVP the
valve that supplies the Venturi.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from flying_vines.identification.importing.units import parse_unit
from flying_vines.identification.noise import resolution
from flying_vines.identification.recording import CaseError, RecordedRun
from flying_vines.physics.arrays import Array, BoolArray
from flying_vines.physics.gas import ALPHA_KPA, STANDARD_PRESSURE_KPA
from flying_vines.physics.rig import Rig

_MAX_OFFSET_KPA = 25.0
_GLITCHES = 3
"""Up to this many impossible readings are recording errors; more mean another unit."""
_MIN_READINGS = 8
_MIN_FOR_NOISE = 30
"""Minimum readings to estimate the noise."""
_WIDE = 0.9
"""A valve with this command is open, whatever its dead zone or backlash."""


class _Channel(NamedTuple):
    """A pressure column, and the range of its readings."""

    column: str
    field: str
    lowest_kPa: float
    highest_kPa: float
    min_top_kPa: float
    """A run whose highest pressure is lower is not tested for psi, bar and MPa: it is probably a weak run in
    kPa."""

    def of(self, run: RecordedRun) -> Array:
        """The readings of a run, with NaN where there is none."""
        readings: Array = getattr(run, self.field)
        return readings

    def noise_kPa(self, rig: Rig) -> float:
        """Standard deviation in the rig file."""
        return rig.sensors.cv_noise_std_kPa if self is _CV else rig.sensors.reservoir_noise_std_kPa


_CV = _Channel("cv_pressure_kPa", "cv_kPa", -130.0, 280.0, 0.0)
_RESERVOIR = _Channel("reservoir_pressure_kPa", "reservoir_kPa", -130.0, 1200.0, 200.0)
_CHANNELS = (_CV, _RESERVOIR)
_CYLINDER_KPA = 40_000.0
"""Highest pressure of gas cylinders and rockets' tanks."""


class _Noise(NamedTuple):
    """Estimated standard deviation, in the unit of the readings, and an upper bound for it."""

    std: float
    upper: float


class _Unit(NamedTuple):
    name: str
    per_kPa: float
    noise_within: float
    """Maximum factor between the measured noise and the noise expected in this unit."""
    otherwise: str = ", or correct the noise in the rig file if this is kPa"


_LARGE = (_Unit("hPa (mbar)", 10.0, np.inf, ""), _Unit("Pa", 1000.0, np.inf, ""))
_PSI = _Unit("psi", 1.0 / parse_unit("psi").factor, 1.33)
_SMALL = (_PSI, _Unit("bar", 0.01, 3.0), _Unit("MPa", 0.001, 3.0))


def check(rig: Rig, runs: Mapping[Path, RecordedRun]) -> list[str]:
    """Remarks about the runs. CaseError for the first run that cannot be from such a rig."""
    for path, run in runs.items():
        _check_swapped(path, run)
        _check_levels(path, run, rig)
        _check_ambient(path, run)
    _check_small_units(rig, runs)
    _check_cv_absolute(rig, runs)
    for path, run in runs.items():
        _check_time_unit(path, run, rig)
        _check_reservoir_absolute(path, run, rig)
        _check_stuck(path, run, rig)
    return _check_anything_moves(rig, runs)


def check_shut(path: Path, name: str, run: RecordedRun, rig: Rig) -> None:
    """CaseError if a valve that was not recorded must have been open."""
    time_s, cv_kPa = _readings(run, _CV)
    if len(time_s) == 0 or rig.cv is None:
        return
    if name == "evp_opening":
        # Below ambient pressure, the control volume may also fill through the solenoid or a leak.
        seen = bool(np.any(cv_kPa - np.maximum(np.minimum.accumulate(cv_kPa), 0.0) > 15.0))
        what = "the control volume fills"
    elif name == "dvp_opening":
        seen = bool((cv_kPa < -15.0).sum() > _GLITCHES)
        what = "the control volume is sucked below ambient pressure"
    else:
        # Nothing else empties the control volume as fast.
        soon = np.searchsorted(time_s, time_s + 3.0 * _vent_s(rig, rig.cv.volume_L), side="right") - 1
        seen = bool(((cv_kPa > 20.0) & (cv_kPa[soon] < 0.25 * cv_kPa)).sum() > _GLITCHES)
        what = "the control volume empties as fast as through the open solenoid"
    if seen:
        raise CaseError(f"{path}: {what}, but {name} was not recorded; add the column")


def _check_swapped(path: Path, run: RecordedRun) -> None:
    """The reservoir has the higher pressure, and its pressure falls while the control volume fills."""
    both = np.isfinite(run.cv_kPa) & np.isfinite(run.reservoir_kPa)
    if not both.any() or np.median((run.cv_kPa - run.reservoir_kPa)[both]) < 40.0:
        return
    never_low = _bottom(run.cv_kPa) > -_CV.lowest_kPa
    exchanged = _CV.highest_kPa < _top(run.cv_kPa) < _RESERVOIR.highest_kPa and never_low
    fills = (run.evp_opening > 0.0) & (run.solenoid == 0.0)
    slack_kPa = 10.0 + 6.0 * np.nan_to_num(_noise(run, _RESERVOIR).std) * np.sqrt(2 * len(_spells(fills)))
    falls = _change(run.cv_kPa, fills) < 0.0 and _change(run.reservoir_kPa, fills) > slack_kPa
    if falls or (exchanged and _top(run.reservoir_kPa) <= _CV.highest_kPa):
        raise CaseError(
            f"{path}: {_CV.column} and {_RESERVOIR.column} look swapped: the reservoir's pressure is the "
            "higher one, and it falls when the inflation valve opens; exchange the two names"
        )


def _check_levels(path: Path, run: RecordedRun, rig: Rig) -> None:
    for channel in _CHANNELS:
        time_s, readings = _readings(run, channel)
        highest_kPa = channel.highest_kPa
        noise_kPa = channel.noise_kPa(rig)
        if highest_kPa < _top(readings) <= _CYLINDER_KPA and _noise(run, channel).std < 3.0 * noise_kPa:
            # Such low noise means kPa: a chamber at 300 kPa, or a cylinder. In hPa the noise would be larger.
            highest_kPa = _CYLINDER_KPA
        beyond = (readings > highest_kPa) | (readings < channel.lowest_kPa - 5.0 * noise_kPa)
        if not beyond.any():
            continue
        where = f"{path}: {channel.column}"
        if beyond.sum() <= _GLITCHES and len(readings) > 4 * _GLITCHES:
            at = int(np.argmax(beyond))
            raise CaseError(
                f"{where}: reads {readings[at]:g} at {time_s[at]:.6g} s, which such a sensor cannot give; "
                "leave the cell empty if it is a recording error"
            )
        top, bottom = _top(readings), _bottom(readings)
        for unit in _LARGE:
            if channel.highest_kPa < top <= channel.highest_kPa * unit.per_kPa:
                raise _other_unit(where, f"reads up to {top:.4g}", unit)
        raise CaseError(
            f"{where}: reads {bottom:.4g} to {top:.4g}; gauge pressures of such a rig are "
            f"{channel.lowest_kPa:g} to {channel.highest_kPa:g} kPa; check the unit and the column's name"
        )


def _check_ambient(path: Path, run: RecordedRun) -> None:
    for column, values, lowest, highest, unit in (
        ("ambient_pressure_kPa", run.ambient_kPa, 40.0, 115.0, "kPa absolute"),
        ("ambient_temperature_C", run.ambient_C, -60.0, 80.0, "°C"),
    ):
        if values is not None and not lowest <= (level := float(np.nanmedian(values))) <= highest:
            raise CaseError(
                f"{path}: {column}: is about {level:.4g}; real values are {lowest:g} to {highest:g} {unit}; "
                "check the unit, or remove the column"
            )


def check_discharge(path: Path, run: RecordedRun, rig: Rig) -> None:
    """CaseError if only the reservoir's pressure was recorded and it does not fall as in a discharge."""
    time_s, readings = _readings(run, _RESERVOIR)
    tau_s = rig.evp.flow_resistance_kPa_s_per_SL * rig.reservoir.volume_L / ALPHA_KPA
    expected_kPa = readings[0] * -np.expm1((time_s[0] - time_s[-1]) / tau_s)
    if expected_kPa > 50.0 and _lost(readings) < 0.05 * expected_kPa:
        raise CaseError(
            f"{path}: only the reservoir's pressure was recorded, as in a discharge through the open valve, "
            "but it hardly falls; add evp_opening, dvp_opening and solenoid"
        )


def _check_small_units(rig: Rig, runs: Mapping[Path, RecordedRun]) -> None:
    """Numbers in psi, bar or MPa look like low pressures in kPa, but with too little noise."""
    noise_kPa = {channel: channel.noise_kPa(rig) for channel in _CHANNELS}
    for channel in _CHANNELS:
        # Readings that are too high for psi are in kPa. Their noise with shut valves replaces the rig file's.
        level = channel.highest_kPa * _PSI.per_kPa
        sure = [run for run in runs.values() if _top(channel.of(run)) > level]
        seen_kPa = [_noise(run, channel, only_quiet=True).std for run in sure]
        if np.isfinite(seen_kPa).any():
            noise_kPa[channel] = float(np.nanmedian(seen_kPa))
    for path, run in runs.items():
        cv, reservoir = (_small_unit(run, channel, noise_kPa[channel]) for channel in _CHANNELS)
        if np.isfinite(run.cv_kPa).any() and (cv is None) != (reservoir is None):
            # If only one column has the wrong unit, the air balance is wrong by the same factor.
            flow = _flow_ratio(run, rig)
            reservoir = reservoir if flow > 3.5 else None
            cv = cv if flow < 1.0 / 3.5 else None
        for channel, unit in ((_RESERVOIR, reservoir), (_CV, cv)):
            if unit:
                top, times = _top(channel.of(run)), 1.0 / unit.per_kPa
                what = f"reads up to {top:.3g}, with about {times:.3g} times less noise than in kPa"
                raise _other_unit(f"{path}: {channel.column}", what, unit)


def _small_unit(run: RecordedRun, channel: _Channel, noise_kPa: float) -> _Unit | None:
    top, noise = _top(channel.of(run)), _noise(run, channel)
    if not (top > 0.0 and noise.std > 0.0 and noise_kPa > 0.0):
        return None
    for unit in _SMALL:
        expected = noise_kPa * unit.per_kPa
        close = expected / unit.noise_within < noise.std and noise.upper < expected * unit.noise_within
        if close and channel.min_top_kPa * unit.per_kPa < top <= channel.highest_kPa * unit.per_kPa:
            return unit
    return None


def _check_cv_absolute(rig: Rig, runs: Mapping[Path, RecordedRun]) -> None:
    """An absolute sensor reads ambient pressure when the vine is vented; a gauge sensor reads zero."""
    if rig.cv is None:
        return
    settled_s = 0.2 + 3.0 * _vent_s(rig, rig.cv.volume_L)
    begins: dict[Path, float] = {}
    never_below = True
    rises = False
    for path, run in runs.items():
        _, readings = _readings(run, _CV)
        if len(readings) < _MIN_READINGS:
            continue
        low_kPa = _bottom(readings)
        vented = run.cv_kPa[_held_for(run, (run.solenoid > 0.0) & (run.dvp_opening == 0.0), settled_s)]
        vented = vented[np.isfinite(vented)]
        if low_kPa > 20.0 and len(vented) > _GLITCHES and is_ambient(float(np.median(vented))):
            raise _absolute(path, _CV, f"rests at {np.median(vented):.4g} when it is vented")
        begins[path] = begin_kPa = float(np.min(readings[:5]))
        ambient_kPa = (
            STANDARD_PRESSURE_KPA if run.ambient_kPa is None else float(np.nanmedian(run.ambient_kPa))
        )
        min_kPa = 20.0 if run.dvp_opening.any() else begin_kPa - 4.0
        never_below &= abs(begin_kPa - ambient_kPa) < 6.0 and low_kPa > min_kPa
        rises |= _top(readings) > begin_kPa + 5.0
    if begins and never_below and rises:
        path, begin_kPa = next(iter(begins.items()))
        raise _absolute(path, _CV, f"begins at {begin_kPa:.4g} and hardly falls below that")


def _check_reservoir_absolute(path: Path, run: RecordedRun, rig: Rig) -> None:
    """Through an open valve a gauge reading falls to zero, an absolute one to ambient pressure."""
    outlet = (run.to_atmosphere | (run.solenoid > 0.0)) & (run.evp_opening >= _WIDE)
    per_R = np.where(outlet, 1.0 / rig.evp.flow_resistance_kPa_s_per_SL, 0.0)
    per_R += np.where(run.dvp_opening >= _WIDE, 1.0 / rig.dvp.flow_resistance_kPa_s_per_SL, 0.0)
    for first, last in _spells(per_R > 0.0):
        read = np.flatnonzero(np.isfinite(run.reservoir_kPa[first:last])) + first
        if len(read) < 4 * 4:
            continue
        tail = read[-(len(read) // 4) :]
        begin_kPa, before_kPa, end_kPa = (
            float(np.median(run.reservoir_kPa[part])) for part in (read[:3], tail[:3], tail[-3:])
        )
        rate_per_s = ALPHA_KPA / rig.reservoir.volume_L * float(np.median(per_R[tail]))
        lost_kPa = -before_kPa * np.expm1(-rate_per_s * (run.time_s[tail[-2]] - run.time_s[tail[1]]))
        rests = lost_kPa > 30.0 and before_kPa - end_kPa < 0.2 * lost_kPa
        if rests and begin_kPa - end_kPa > 60.0 and is_ambient(end_kPa):
            raise _absolute(path, _RESERVOIR, f"comes to rest at {end_kPa:.4g} although a valve is open")


def _check_time_unit(path: Path, run: RecordedRun, rig: Rig) -> None:
    """If times in milliseconds are read as seconds, the valves would have let out far too much air."""
    step_s = float(np.median(np.diff(run.time_s)))
    _, readings = _readings(run, _RESERVOIR)
    if step_s < 0.5 or len(readings) < _MIN_READINGS:
        return
    # No air flows out of an empty reservoir, although its sensor may read an offset.
    surely_there = replace(run, reservoir_kPa=run.reservoir_kPa - _MAX_OFFSET_KPA)
    ratio = _lost_through_valves(surely_there, rig) / max(_lost(readings), 5.0)
    if ratio > 30.0:
        unit = "microseconds" if ratio > 30_000.0 else "milliseconds"
        raise CaseError(
            f"{path}: time_s: looks like {unit}: with {step_s:.3g} s a sample the valves would have let out "
            f"{ratio:.2g} times the air that the reservoir lost; write seconds"
        )


def _check_stuck(path: Path, run: RecordedRun, rig: Rig) -> None:
    """A stuck reading is exactly constant although the valves move, or although the pressure must change."""
    wide = run.evp_opening >= _WIDE
    has_to_move = {
        _CV: _filled_through_evp(run, rig, wide) > 20.0,
        _RESERVOIR: _lost_through_valves(run, rig, wide) > 30.0,
    }
    flat = {channel: np.ptp(readings) == 0.0 for channel, readings in _all_readings(run).items()}
    for channel, is_flat in flat.items():
        if is_flat and (has_to_move[channel] or (_moves(run) and all(flat.values()))):
            raise CaseError(
                f"{path}: {channel.column}: is stuck at {_readings(run, channel)[1][0]:g} while the valves "
                "move; check the sensor and record again, or remove the file"
            )


def _check_anything_moves(rig: Rig, runs: Mapping[Path, RecordedRun]) -> list[str]:
    still = [path for path, run in runs.items() if not _moves(run)]
    drifts = any(
        abs(_lost(readings)) > 5.0 * channel.noise_kPa(rig)
        for path in still
        for channel, readings in _all_readings(runs[path]).items()
    )
    if len(still) == len(runs) and not drifts:
        raise CaseError(
            f"{still[0].parent}: no valve ever opens, and no pressure changes; record a run that moves"
        )
    return [f"{path.name}: no valve ever opens" for path in still]


def _other_unit(where: str, what: str, unit: _Unit) -> CaseError:
    by = f"divide by {unit.per_kPa:g}" if unit.per_kPa > 1.0 else f"multiply by {1.0 / unit.per_kPa:.5g}"
    return CaseError(f"{where}: {what}, which looks like {unit.name}; write kPa: {by}{unit.otherwise}")


def _absolute(path: Path, channel: _Channel, what: str) -> CaseError:
    return CaseError(
        f"{path}: {channel.column}: {what}, which looks like absolute pressure; write gauge pressure: "
        "subtract the ambient pressure"
    )


def is_ambient(kPa: float) -> bool:
    """True if this can be absolute ambient pressure at an altitude below 5 km, with a sensor's offset."""
    return 50.0 < kPa < 127.0


def _readings(run: RecordedRun, channel: _Channel) -> tuple[Array, Array]:
    """Times and values where there is a reading."""
    values = channel.of(run)
    there = np.isfinite(values)
    return run.time_s[there], values[there]


def _all_readings(run: RecordedRun) -> dict[_Channel, Array]:
    """Readings of each recorded pressure."""
    return {
        channel: readings
        for channel in _CHANNELS
        if len(readings := _readings(run, channel)[1]) >= _MIN_READINGS
    }


def _top(values: Array) -> float:
    """Highest reading without recording errors; NaN if there are too few readings."""
    readings = np.sort(values[np.isfinite(values)])
    return float(readings[-1 - _GLITCHES]) if len(readings) > _GLITCHES else np.nan


def _bottom(values: Array) -> float:
    return -_top(-values)


def _lost(readings: Array) -> float:
    """Fall of the readings from start to end."""
    part = max(3, len(readings) // 20)
    return float(np.median(readings[:part]) - np.median(readings[-part:]))


def _moves(run: RecordedRun) -> bool:
    return bool(((run.evp_opening > 0.0) | (run.dvp_opening > 0.0) | (run.solenoid > 0.0)).any())


def _spells(mask: BoolArray) -> list[tuple[int, int]]:
    """Intervals [first, last) in which the mask is true."""
    edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]


def _held_for(run: RecordedRun, mask: BoolArray, min_s: float) -> BoolArray:
    """Samples at which the mask has been true for `min_s`."""
    held = np.zeros_like(mask)
    for first, last in _spells(mask):
        held[first:last] = run.time_s[first:last] - run.time_s[first] >= min_s
    return held


def _change(values: Array, mask: BoolArray) -> float:
    """Rise of a pressure, summed over the sample intervals that begin where the mask is true."""
    return float(np.nansum(np.diff(values)[mask[:-1]]))


def _noise(run: RecordedRun, channel: _Channel, *, only_quiet: bool = False) -> _Noise:
    """Noise of the readings about a straight line through their neighbours; NaN if there are too few.

    While all valves are shut, the pressure curve is straight. The estimate from all readings includes the
    curvature, but uses more readings. The estimate with the lower upper bound is returned.
    """
    t, x = _readings(run, channel)
    later = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    off = (x[1:-1] - x[:-2] * (1.0 - later) - x[2:] * later) / np.sqrt(1.0 + later**2 + (1.0 - later) ** 2)
    busy = (run.evp_opening + run.dvp_opening + run.solenoid)[np.isfinite(channel.of(run))] > 0.0
    quiet = off[~(busy[:-2] | busy[1:-1])]
    step = resolution(x)
    parts = (quiet,) if only_quiet else (quiet, off)
    noises = (_spread(part, step) for part in parts if len(part) >= _MIN_FOR_NOISE)
    return min(noises, key=lambda noise: noise.upper, default=_Noise(np.nan, np.nan))


def _spread(off: Array, step: float) -> _Noise:
    """Noise from deviations; `step` is the resolution of the readings."""
    size = np.abs(off)
    # The median alone would need twice as many readings for the same accuracy.
    std = float(np.sqrt(np.mean(np.minimum(size, 3.0 * 1.4826 * np.median(size)) ** 2)))
    # Neighbours share readings, so the relative error is 1 / sqrt(n), not 1 / sqrt(2 n). Noise below half a
    # step may not show at all.
    return _Noise(std, max(std * float(np.exp(2.0 / np.sqrt(len(off)))), 0.5 * step))


def _vent_s(rig: Rig, cv_L: float) -> float:
    """Time constant of the control volume emptying through the solenoid."""
    return rig.solenoid.flow_resistance_kPa_s_per_SL * cv_L / ALPHA_KPA


def _filled(run: RecordedRun, channel: _Channel) -> Array:
    """A pressure at every sample, linear between readings; zero if it was not recorded."""
    t, x = _readings(run, channel)
    return np.interp(run.time_s, t, x) if len(t) else np.zeros_like(run.time_s)


def _through_evp(run: RecordedRun, rig: Rig, where: BoolArray) -> Array:
    """Standard litres through the inflation valve in the baseline, from each sample to the next."""
    drop_kPa = np.maximum(_filled(run, _RESERVOIR) - _filled(run, _CV), 0.0)
    flow = np.where(where, run.evp_opening, 0.0) * drop_kPa / rig.evp.flow_resistance_kPa_s_per_SL
    volume: Array = flow * np.diff(run.time_s, append=run.time_s[-1])
    return volume


def _lost_through_valves(run: RecordedRun, rig: Rig, where: BoolArray | None = None) -> float:
    """Pressure loss of the reservoir in the baseline at the recorded pressures, kPa."""
    everywhere = np.ones(len(run.time_s), dtype=bool) if where is None else where
    motive = np.where(everywhere, run.dvp_opening, 0.0) * np.maximum(_filled(run, _RESERVOIR), 0.0)
    motive *= np.diff(run.time_s, append=run.time_s[-1]) / rig.dvp.flow_resistance_kPa_s_per_SL
    return float(ALPHA_KPA / rig.reservoir.volume_L * (_through_evp(run, rig, everywhere) + motive).sum())


def _filled_through_evp(run: RecordedRun, rig: Rig, where: BoolArray) -> float:
    """Pressure gain of the control volume in the baseline while the solenoid is shut, kPa."""
    if rig.cv is None:
        return 0.0
    return float(ALPHA_KPA / rig.cv.volume_L * _through_evp(run, rig, where & (run.solenoid == 0.0)).sum())


def _flow_ratio(run: RecordedRun, rig: Rig) -> float:
    """Measured over simulated gain of the control volume's pressure; NaN if both are small."""
    fills = (run.evp_opening > 0.0) & (run.solenoid == 0.0)
    gained, expected = _change(run.cv_kPa, fills), _filled_through_evp(run, rig, fills)
    if not np.isfinite(run.reservoir_kPa).any() or max(gained, expected) < 20.0:
        return float("nan")
    return gained / max(expected, 1e-9)
