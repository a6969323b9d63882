"""Real recordings are read unchanged, even of a worn rig; other files are refused in one line.

The recordings come from a small simulator in this file: the baseline with a blocked valve, a leak, sensors
with offset, gain and coarse steps, noise of another size than stated, any altitude.
"""

from __future__ import annotations

import random
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from flying_vines.identification.case import Case, CaseError, read_case

Columns = dict[str, NDArray[np.float64]]
TIME, COMMAND, EVP, DVP, SOLENOID = "time_s", "command_kPa", "evp_opening", "dvp_opening", "solenoid"
CV, RESERVOIR = "cv_pressure_kPa", "reservoir_pressure_kPa"
PRESSURES = (CV, RESERVOIR)
INPUTS = (EVP, DVP, SOLENOID)
AMBIENT, TEMPERATURE = "ambient_pressure_kPa", "ambient_temperature_C"
KINDS = ("steps", "shaken", "bends", "hold")


@dataclass(frozen=True)
class Worn:
    """A rig with errors of the rig and of its sensors."""

    reservoir_L: float = 2.0
    cv_L: float | None = 0.25
    evp_R: float = 2042.0
    evp_scale: float = 1.0
    dead_zone: float = 0.0
    leak_R: float = 1e9
    offset_kPa: tuple[float, float] = (0.0, 0.0)
    """For the sensors of CV and reservoir, also below."""
    gain: tuple[float, float] = (1.0, 1.0)
    noise_kPa: tuple[float, float] = (0.15, 1.2)
    step_kPa: tuple[float, float] = (1e-3, 1e-2)
    noise_stated: float = 1.0
    ambient_kPa: float = 101.325

    def toml(self) -> str:
        cv = f"[cv]\nvolume_L = {self.cv_L}\n" if self.cv_L else ""
        noise = [self.noise_stated * std for std in self.noise_kPa]
        return (
            f"[reservoir]\nvolume_L = {self.reservoir_L}\n{cv}"
            f"[evp]\nflow_resistance_kPa_s_per_SL = {self.evp_R}\n"
            f"[sensors]\ncv_noise_std_kPa = {noise[0]}\nreservoir_noise_std_kPa = {noise[1]}\n"
        )


def drawn_commands(
    kind: str, time_s: float, cv_kPa: float, change: random.Random, last: tuple[float, ...]
) -> tuple[float, ...]:
    """Command, openings and solenoid of one sample."""
    nan = float("nan")
    match kind:
        case "discharge":
            return nan, 1.0, 0.0, 1.0
        case "hold":
            return nan, 0.6 * (time_s < 2.0 and cv_kPa < 30.0), 0.0, 0.0
        case "shaken":
            if change.random() > 0.06 and not (cv_kPa > 60.0 and last[1] > 0.0):
                return last
            if change.random() < 0.3 or cv_kPa > 60.0:
                return nan, 0.0, change.choice((0.0, 0.5, 1.0)), 1.0
            return nan, change.choice((0.0, 0.15, 0.3, 0.75, 1.0)), 0.0, 0.0
        case "steps":
            wanted_kPa = (50.0, 7.0, 35.0, 0.0)[int(time_s / 3.0) % 4]
        case _:
            wanted_kPa = 20.7 * (time_s % 3.0 < 1.5)
    if cv_kPa < wanted_kPa - 1.0:
        return wanted_kPa, min(1.0, 0.05 * (wanted_kPa - cv_kPa)), 0.0, 0.0
    return wanted_kPa, 0.0, 0.0, float(cv_kPa > wanted_kPa + 1.5)


def record(rig: Worn, kind: str, seed: int, reservoir_kPa: float = 600.0, seconds: float = 12.0) -> Columns:
    """A recorded run at 50 samples a second."""
    chance = random.Random(f"{kind} {seed}")
    cv = 0.0
    reservoir = reservoir_kPa
    step_s, parts = 0.02, 5
    last: tuple[float, ...] = (float("nan"), 0.0, 0.0, 0.0)
    rows = []
    for i in range(round(seconds / step_s)):
        readings = [
            round((gain * (chance.gauss(true, std) + offset)) / step) * step
            for true, gain, std, offset, step in zip(
                (cv, reservoir), rig.gain, rig.noise_kPa, rig.offset_kPa, rig.step_kPa, strict=True
            )
        ]
        last = drawn_commands(kind, i * step_s, readings[0] if rig.cv_L else 0.0, chance, last)
        _, evp, dvp, solenoid = last
        evp = max(0.0, (evp - rig.dead_zone) / (1.0 - rig.dead_zone))
        rows.append((i * step_s, *last, *readings))
        for _ in range(parts):
            inflow = evp * (reservoir - cv) / (rig.evp_R * rig.evp_scale)
            motive = dvp * reservoir / 618.0
            outflow = solenoid * (cv + 55.0 * dvp * min(1.0, reservoir / 600.0)) / 70.0
            reservoir -= 101.325 * (inflow + motive) / rig.reservoir_L * step_s / parts
            if rig.cv_L:
                cv += 101.325 * (inflow - outflow - cv / rig.leak_R) / rig.cv_L * step_s / parts
    names = (TIME, COMMAND, *INPUTS, *PRESSURES)
    run = dict(zip(names, np.round(np.array(rows).T, 4), strict=True))
    if rig.cv_L is None:
        del run[CV]
    return run


def text_of(run: Columns) -> str:
    rows = zip(*(values.tolist() for values in run.values()), strict=True)
    lines = (",".join("" if x != x else f"{x:.9g}" for x in row) for row in rows)
    return "\n".join([",".join(run), *lines, ""])


def case_of(rig: Worn, runs: Iterable[Columns]) -> Case:
    with TemporaryDirectory() as folder:
        Path(folder, "rig.toml").write_text(rig.toml())
        for number, run in enumerate(runs, start=1):
            Path(folder, f"run_{number}.csv").write_text(text_of(run))
        return read_case(folder)


def refused(rig: Worn, *runs: Columns) -> str:
    with pytest.raises(CaseError) as caught:
        case_of(rig, runs)
    line = str(caught.value)
    assert line.isprintable()
    assert "run_" in line or "rig.toml" in line or "no valve" in line
    return line


offsets = st.tuples(st.floats(-5.0, 5.0), st.floats(-25.0, 25.0))
gains = st.tuples(st.floats(0.8, 1.2), st.floats(0.8, 1.2))
logs = st.floats(-1.0, 1.0)
rigs = st.builds(
    Worn,
    reservoir_L=st.sampled_from((0.5, 2.0, 4.0)),
    cv_L=st.sampled_from((0.05, 0.1, 0.5, 2.0)),
    evp_scale=logs.map(lambda x: 3.0**x),
    dead_zone=st.floats(0.0, 0.35),
    leak_R=st.sampled_from((300.0, 3000.0, 1e9)),
    offset_kPa=offsets,
    gain=gains,
    noise_kPa=st.tuples(logs, logs).map(lambda x: (0.15 * 3.0 ** x[0], 1.2 * 3.0 ** x[1])),
    step_kPa=st.sampled_from(((1e-3, 1e-2), (0.04, 0.3), (0.167, 1.21))),
    noise_stated=logs.map(lambda x: 3.0**x),
    ambient_kPa=st.floats(60.0, 104.0),
)
plain_rigs = st.builds(Worn, cv_L=st.sampled_from((0.1, 0.25, 1.0)), offset_kPa=offsets)
seeds = st.integers(0, 10**6)


@settings(max_examples=25)
@given(
    rig=rigs,
    seed=seeds,
    reservoir_kPa=st.floats(20.0, 900.0),
    kinds=st.lists(st.sampled_from(KINDS), min_size=1, max_size=3, unique=True),
    without=st.sampled_from((CV, RESERVOIR, COMMAND)),
    around=st.booleans(),
    holes=st.floats(0.0, 0.3),
    gone=st.floats(0.0, 0.3),
)
@example(  # The noise of few readings, stated three times too large, looked like readings in psi.
    rig=Worn(
        reservoir_L=0.5, cv_L=0.05, leak_R=300.0, gain=(0.8125, 1.0), noise_stated=3.0, ambient_kPa=60.0
    ),
    seed=297878,
    reservoir_kPa=20.0,
    kinds=["steps", "bends"],
    without=COMMAND,
    around=False,
    holes=0.25,
    gone=0.1015625,
)
def test_a_real_recording_is_read_unchanged(
    rig: Worn,
    seed: int,
    reservoir_kPa: float,
    kinds: list[str],
    without: str,
    around: bool,
    holes: float,
    gone: float,
) -> None:
    chance = np.random.default_rng(seed)
    runs = []
    for kind in kinds:
        run = record(rig, kind, seed, reservoir_kPa, seconds=4.0)
        # The opening of a valve that never moves may be missing.
        recorded = [name for name in run if name != without and (name == EVP or run[name].any())]
        kept = chance.random(len(run[TIME])) >= gone
        run = {name: run[name][kept] for name in recorded}
        for name in PRESSURES:
            if name in run:
                run[name] = np.where(chance.random(kept.sum()) < holes, np.nan, run[name])
        if around:
            run |= {AMBIENT: np.full(kept.sum(), rig.ambient_kPa), TEMPERATURE: np.full(kept.sum(), -12.0)}
        runs.append(run)
    case = case_of(rig, runs)
    for run, read in zip(runs, case.runs, strict=True):
        nothing = np.full(len(run[TIME]), np.nan)
        shut = np.zeros(len(run[TIME]))
        assert np.array_equal(read.time_s, run[TIME])
        for name in INPUTS:
            assert np.array_equal(getattr(read, name), run.get(name, shut))
        assert np.array_equal(read.cv_kPa, run.get(CV, nothing), equal_nan=True)
        assert np.array_equal(read.reservoir_kPa, run.get(RESERVOIR, nothing), equal_nan=True)
        assert (read.ambient_kPa is not None) == (read.ambient_C is not None) == around
        assert not read.to_atmosphere
    expected = sum((RESERVOIR not in run) + sum(name not in run for name in INPUTS) for run in runs)
    assert len(case.remarks) == expected


@settings(max_examples=15)
@given(rig=rigs, seed=seeds, reservoir_kPa=st.floats(20.0, 900.0), seconds=st.floats(2.0, 300.0))
@example(  # A valve with three times the nominal resistance, and a large offset: the pressure falls slowly.
    rig=Worn(
        2.0, 0.05, 2042.0, 3.0, 0.0, 300.0, (0.0, 21.0), (1.0, 1.0), (0.15, 1.2), (0.001, 0.01), 1.0, 60.0
    ),
    seed=0,
    reservoir_kPa=121.0,
    seconds=97.0,
)
def test_discharges_are_read_unchanged(rig: Worn, seed: int, reservoir_kPa: float, seconds: float) -> None:
    rig = replace(rig, cv_L=None)
    run = record(rig, "discharge", seed, reservoir_kPa, seconds)
    run = {
        name: values[:: max(1, round(seconds))] for name, values in run.items() if name in (TIME, RESERVOIR)
    }
    case = case_of(rig, [run])
    (read,) = case.runs
    assert np.array_equal(read.reservoir_kPa, run[RESERVOIR])
    assert (read.evp_opening == 1.0).all() and (read.dvp_opening == 0.0).all()
    assert np.isnan(read.cv_kPa).all()
    assert read.to_atmosphere
    assert case.remarks == ()


def scaled(run: Columns, by: float, *names: str) -> Columns:
    return run | {name: run[name] * by for name in names}


@pytest.mark.parametrize(("by", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds")])
@settings(max_examples=2)
@given(rig=plain_rigs, seed=seeds)
def test_time_in_another_unit(by: float, unit: str, rig: Worn, seed: int) -> None:
    run = record(rig, "steps", seed)
    assert unit in refused(rig, scaled(run, by, TIME))
    discharge = replace(rig, cv_L=None)
    gone = record(discharge, "discharge", seed, seconds=40.0)
    assert unit in refused(discharge, scaled(gone, by, TIME))


UNITS = {"Pa": 1000.0, "hPa": 10.0, "psi": 0.145038, "bar": 0.01, "MPa": 0.001}


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("columns", [PRESSURES, (RESERVOIR,), (CV,)], ids=["both", "reservoir", "cv"])
@settings(max_examples=2)
@given(rig=plain_rigs, seed=seeds, reservoir_kPa=st.floats(250.0, 900.0))
def test_pressures_in_another_unit(
    unit: str, columns: tuple[str, ...], rig: Worn, seed: int, reservoir_kPa: float
) -> None:
    runs = [scaled(record(rig, kind, seed, reservoir_kPa), UNITS[unit], *columns) for kind in KINDS]
    line = refused(rig, *runs)
    assert f"looks like {unit}" in line
    assert any(f"{name}: " in line for name in columns)


def test_a_weak_reservoir_read_with_little_noise_is_no_psi_where_a_strong_one_is_beside_it() -> None:
    rig = Worn(noise_stated=6.9)
    assert "looks like psi" in refused(rig, record(rig, "bends", 1, reservoir_kPa=120.0))
    runs = [record(rig, kind, 1, level) for kind, level in (("bends", 120.0), ("steps", 700.0))]
    assert case_of(rig, runs).remarks == ()


@settings(max_examples=5)
@given(rig=plain_rigs, seed=seeds, ambient_kPa=st.floats(60.0, 104.0))
def test_absolute_pressure_of_the_control_volume(rig: Worn, seed: int, ambient_kPa: float) -> None:
    run = record(rig, "bends", seed)
    run[CV] = run[CV] + ambient_kPa
    # A passive vent that is long enough to settle.
    rest = {name: np.full(200, values[-1]) for name, values in run.items()}
    rest[TIME] = run[TIME][-1] + 0.02 * np.arange(1, 201)
    rest |= {EVP: np.zeros(200), SOLENOID: np.ones(200), CV: np.full(200, ambient_kPa)}
    run = {name: np.concatenate((values, rest[name])) for name, values in run.items()}
    assert "cv_pressure_kPa: rests at" in refused(rig, run)


def test_absolute_pressure_of_a_control_volume_that_is_never_vented() -> None:
    run = record(Worn(), "hold", 1)
    run[CV] = run[CV] + 101.3
    assert "looks like absolute pressure" in refused(Worn(), run)
    mountain = run | {CV: run[CV] - 25.0, AMBIENT: np.full(len(run[CV]), 76.3)}
    assert "looks like absolute pressure" in refused(Worn(), mountain)


@settings(max_examples=5)
@given(seed=seeds, offset_kPa=st.floats(-20.0, 20.0))
def test_absolute_pressure_of_a_reservoir_that_empties(seed: int, offset_kPa: float) -> None:
    rig = Worn(cv_L=None, reservoir_L=0.5, offset_kPa=(0.0, offset_kPa))
    run = record(rig, "discharge", seed, seconds=60.0)
    assert case_of(rig, [run]).remarks == ()
    assert "reservoir_pressure_kPa: comes to rest" in refused(rig, run | {RESERVOIR: run[RESERVOIR] + 101.3})


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=3)
@given(rig=plain_rigs, seed=seeds, reservoir_kPa=st.floats(400.0, 800.0))
def test_swapped_pressures(kind: str, rig: Worn, seed: int, reservoir_kPa: float) -> None:
    """The reservoir must keep the higher pressure. Below 250 kPa some runs do not show a swap."""
    run = record(rig, kind, seed, reservoir_kPa)
    assert "look swapped" in refused(rig, run | {CV: run[RESERVOIR], RESERVOIR: run[CV]})


def test_a_slip_of_the_recorder() -> None:
    run = record(Worn(), "bends", 1)
    run[RESERVOIR][40] = 65535.0
    assert "reservoir_pressure_kPa: reads 65535 at 0.8 s" in refused(Worn(), run)


def test_pressures_in_no_unit() -> None:
    run = record(Worn(), "bends", 1)
    assert "gauge pressures of such a rig are" in refused(Worn(), scaled(run, 1e9, RESERVOIR))
    assert "gauge pressures of such a rig are" in refused(Worn(), scaled(run, -1.0, RESERVOIR))


@pytest.mark.parametrize(
    ("name", "level"), [(AMBIENT, 101325.0), (AMBIENT, 1013.0), (AMBIENT, 0.0), (TEMPERATURE, 293.0)]
)
def test_the_air_around_in_another_unit(name: str, level: float) -> None:
    run = record(Worn(), "bends", 1)
    assert f"{name}: is about {level:.4g}" in refused(Worn(), run | {name: np.full(len(run[TIME]), level)})


def test_stuck_sensors() -> None:
    run = record(Worn(), "bends", 1)
    stuck = np.full(len(run[TIME]), 3.0)
    assert "cv_pressure_kPa: is stuck at 3" in refused(Worn(), run | {CV: stuck, RESERVOIR: stuck + 600.0})
    shaken = record(Worn(), "shaken", 1)
    assert "cv_pressure_kPa: is stuck at 3" in refused(Worn(), shaken | {CV: stuck})
    wide = record(Worn(), "discharge", 1)
    assert "reservoir_pressure_kPa: is stuck" in refused(Worn(), wide | {RESERVOIR: stuck + 600.0})


def still(seconds: float = 4.0, falls_kPa: float = 0.0) -> Columns:
    run = record(Worn(), "hold", 1, seconds=2.0 + seconds)
    run = {name: values[round(2.0 / 0.02) :] for name, values in run.items()}
    return run | {RESERVOIR: run[RESERVOIR] - np.linspace(0.0, falls_kPa, len(run[TIME]))}


def test_where_nothing_moves() -> None:
    assert "no valve ever opens" in refused(Worn(), still(), still())
    case = case_of(Worn(), [still(), record(Worn(), "bends", 1)])
    assert case.remarks == ("run_1.csv: no valve ever opens",)
    # A leak is visible while all valves are shut.
    assert case_of(Worn(), [still(falls_kPa=30.0)]).remarks == ("run_1.csv: no valve ever opens",)


def test_a_valve_that_was_not_recorded_cannot_have_moved() -> None:
    shaken = record(Worn(), "shaken", 2)
    for name in INPUTS:
        line = refused(Worn(), {column: values for column, values in shaken.items() if column != name})
        assert f"but {name} was not recorded; add the column" in line


def test_without_openings_a_reservoir_has_to_empty() -> None:
    run = record(Worn(), "discharge", 1)
    bare = {name: run[name] for name in (TIME, RESERVOIR)}
    (read,) = case_of(Worn(), [bare]).runs
    assert read.to_atmosphere
    flat = bare | {RESERVOIR: np.full(len(run[TIME]), 600.0) + 0.5 * np.sin(run[TIME])}
    assert "hardly falls; add evp_opening" in refused(Worn(), flat)
    assert "the valve commands were not recorded" in refused(Worn(), bare | {CV: run[CV]})
