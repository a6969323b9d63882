"""The simulation with each cause agrees with an independent simulator."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hidden_truth.effects import EFFECTS, Hidden, with_effects
from hidden_truth.recording import replay
from hidden_truth.rig import Rig as TrueRig

from flying_vines.identification.case import Case, RecordedRun
from flying_vines.identification.simulate import Simulation
from flying_vines.physics.baseline import BaselineState, Inputs, step
from flying_vines.physics.cause import Cause
from flying_vines.physics.effects import catalogue, cause_named
from flying_vines.physics.gas import Gas
from flying_vines.physics.plant.compiled import replay as plant_replay
from flying_vines.physics.plant.plant import at_rest, perfect
from flying_vines.physics.plant.sensors import Sensor
from flying_vines.physics.rig import ControlVolume, Reservoir, Rig

RIG = Rig(cv=ControlVolume(0.25))
START_KPA = (640.0, 0.0)
STARTS = np.array([START_KPA])
LENGTH_S = 12.0
KNOWN_TO_BOTH = [cause for cause in catalogue() if cause.name in EFFECTS]
"""Causes that the independent simulator also has."""


def random_run(seed: int) -> RecordedRun:
    """Random openings, with the Venturi, down to a reservoir pressure at which it stalls."""
    random = np.random.default_rng(seed)
    time_s = np.arange(0.0, LENGTH_S, 0.02)
    evp, dvp, solenoid = np.zeros((3, len(time_s)))
    at = 0
    while at < len(time_s):
        length = int(random.integers(3, 60))
        what = random.choice(("in", "hold", "out", "suck"))
        evp[at : at + length] = random.uniform(0.1, 1.0) if what == "in" else 0.0
        solenoid[at : at + length] = what in ("out", "suck")
        dvp[at : at + length] = random.uniform(0.5, 1.0) if what == "suck" else 0.0
        at += length
    nothing = np.full(len(time_s), np.nan)
    return RecordedRun("random", time_s, None, evp, dvp, solenoid, nothing, nothing, None, None, False)


def case_of(run: RecordedRun, rig: Rig = RIG) -> Case:
    return Case(Path("memory"), rig, (run,), ())


def strength(name: str) -> float:
    """A strength between the weakest and the strongest clear one."""
    effect = EFFECTS[name]
    if name == "venturi_stall":
        # These runs are short, so their reservoirs stay full.
        return 610.0
    return effect.value(math.sqrt(effect.low * effect.high), TrueRig(cv_L=0.25))


@pytest.mark.parametrize("cause", KNOWN_TO_BOTH, ids=lambda cause: cause.name)
@pytest.mark.parametrize("seed", (1, 2))
def test_a_cause_agrees_with_the_independent_model(cause: Cause, seed: int) -> None:
    run = random_run(seed)
    value = strength(cause.name)
    physics = with_effects(TrueRig(cv_L=0.25), [Hidden(cause.name, value)])
    truth = replay(
        physics, np.column_stack((run.evp_opening, run.dvp_opening, run.solenoid)), run.time_s, START_KPA
    )
    ours = Simulation(case_of(run)).readings(0, {}, [(cause, (value,))], STARTS)
    plain = Simulation(case_of(run)).readings(0, {}, [], STARTS)
    # At most 2 % of the sensor noise.
    assert ours.cv_kPa == pytest.approx(truth[:, 0], abs=0.003)
    assert ours.reservoir_kPa == pytest.approx(truth[:, 1], abs=0.003)
    moved = max(
        float(np.abs(ours.cv_kPa - plain.cv_kPa).max()) / 0.15,
        float(np.abs(ours.reservoir_kPa - plain.reservoir_kPa).max()) / 1.2,
    )
    assert moved > 1.0, "the cause does nothing in this run"


@pytest.mark.parametrize("lag_s", [0.0005, 0.0023, 0.008])
def test_a_valve_much_quicker_than_the_samples_is_simulated_as_well(lag_s: float) -> None:
    """Otherwise it would look like a delay, which is nearly the same at this sampling."""
    (cause,) = (cause for cause in catalogue() if cause.name == "evp_lag")
    run = random_run(6)
    # Solenoid and valve alternate at each sample, so early air has more time to leave.
    run.evp_opening[::2], run.solenoid[::2] = 1.0, 0.0
    run.evp_opening[1::2], run.solenoid[1::2] = 0.0, 1.0
    inputs = np.column_stack((run.evp_opening, run.dvp_opening, run.solenoid))
    truth = replay(
        with_effects(TrueRig(cv_L=0.25), [Hidden("evp_lag", lag_s)]), inputs, run.time_s, START_KPA
    )
    ours = Simulation(case_of(run)).readings(0, {}, [(cause, (lag_s,))], STARTS)
    assert ours.cv_kPa == pytest.approx(truth[:, 0], abs=0.003)


def without(run: RecordedRun, rows: list[int]) -> RecordedRun:
    """The run without these rows."""
    left = replace(run)
    for name, values in vars(run).items():
        if isinstance(values, np.ndarray):
            object.__setattr__(left, name, np.delete(values, rows))
    return left


def test_after_a_row_that_was_lost_while_the_valves_were_busy_a_run_begins_again() -> None:
    run = random_run(7)
    moved = np.flatnonzero((np.diff(run.evp_opening) != 0.0) | (np.diff(run.solenoid) != 0.0)) + 1
    assert len(moved) >= 5
    away = np.abs(np.arange(len(run.time_s))[:, None] - moved).min(axis=1)
    at, beside = int(moved[1]), int(moved[4]) + 2
    still = int(np.argmax(away[20:-20])) + 20
    assert away[still] > 5
    lost = without(run, [at, beside, still])
    (prepared,) = Simulation(case_of(lost)).runs
    begins = [0, *(int(np.searchsorted(lost.time_s, run.time_s[row])) for row in sorted((at, beside)))]
    assert prepared.start.tolist() == begins
    # A regulator may have opened a valve only in that row.
    regulated = replace(lost, command_kPa=np.full(len(lost.time_s), 20.0))
    (prepared,) = Simulation(case_of(regulated)).runs
    assert len(prepared.start) == 4


def test_where_samples_never_come_on_time_no_row_is_missing() -> None:
    run = random_run(8)
    random = np.random.default_rng(0)
    uneven = without(run, sorted(random.choice(np.arange(1, len(run.time_s)), 150, replace=False).tolist()))
    (prepared,) = Simulation(case_of(uneven)).runs
    assert prepared.start.tolist() == [0]


def test_a_sensor_that_lags_goes_on_lagging_where_a_run_begins_again() -> None:
    (cause,) = (cause for cause in catalogue() if cause.name == "cv_sensor_lag")
    run = random_run(7)
    whole = Simulation(case_of(run)).readings(0, {}, [(cause, (0.2,))], STARTS)
    pressures = Simulation(case_of(run)).readings(0, {}, [], STARTS)
    moving = int(np.argmax(np.abs(whole.cv_kPa - pressures.cv_kPa)))
    simulation = Simulation(case_of(run))
    simulation.runs = (simulation.runs[0]._replace(start=np.array([0, moving])),)
    # Restarted at the same pressures.
    starts = np.array([START_KPA, (pressures.reservoir_kPa[moving], pressures.cv_kPa[moving])])
    again = simulation.readings(0, {}, [(cause, (0.2,))], starts)
    # Steps are shorter if a sensor lags.
    assert again.cv_kPa == pytest.approx(whole.cv_kPa, abs=1e-3)


@pytest.mark.parametrize("cause", catalogue(), ids=lambda cause: cause.name)
def test_a_neutral_cause_does_nothing(cause: Cause) -> None:
    neutral = cause.parameters[0].neutral
    if neutral is None:
        assert cause.is_flow_law or cause.name == "hose"
        return
    simulation = Simulation(case_of(random_run(1)))
    plain = simulation.readings(0, {}, [], STARTS)
    ours = simulation.readings(0, {}, [(cause, (neutral, *cause.seeds()[0][1:]))], STARTS)
    assert ours.cv_kPa == pytest.approx(plain.cv_kPa, abs=1e-9)
    assert ours.reservoir_kPa == pytest.approx(plain.reservoir_kPa, abs=1e-9)


Own = dict[str, dict[str, float]]


def against_plant(own: Own) -> tuple[float, float]:
    """Maximum difference of both readings from the plant in ticks of 1 ms, kPa: control volume, reservoir."""
    run, made = random_run(5), perfect(RIG)
    for name, parameters in own.items():
        made = cause_named(name).put_into(made, parameters)
    openings = np.repeat(np.column_stack((run.evp_opening, run.dvp_opening, run.solenoid)), 20, axis=0)
    table = plant_replay(
        made.plant,
        openings,
        at_rest(made.plant, *START_KPA),
        cv_sensor=made.cv_sensor,
        reservoir_sensor=made.reservoir_sensor,
        record_every=20,
    ).table
    causes = [(cause_named(name), tuple(parameters.values())) for name, parameters in own.items()]
    ours = Simulation(case_of(run)).readings(0, {}, causes, STARTS)
    return (
        float(np.abs(ours.cv_kPa - table["cv_reading_kPa"]).max()),
        float(np.abs(ours.reservoir_kPa - table["reservoir_reading_kPa"]).max()),
    )


def test_a_saturated_sensor_reads_its_limit_while_it_drifts() -> None:
    limited = Sensor(100.0, lowest_share=0.0, highest_share=0.1, drift_kPa_per_min=60.0)
    own = Cause("limited", "", (), "", apply=lambda setup: replace(setup, cv_sensor=limited))
    cv_kPa = Simulation(case_of(random_run(5))).readings(0, {}, [(own, ())], STARTS).cv_kPa
    assert cv_kPa.min() == 0.0
    assert cv_kPa.max() == 10.0


def hose(flow_resistance_kPa_s_per_SL: float, volume_L: float, **more: dict[str, float]) -> Own:
    return {
        "hose": {"flow_resistance_kPa_s_per_SL": flow_resistance_kPa_s_per_SL, "volume_L": volume_L},
        **more,
    }


def lagging(time_constant_s: float, **more: dict[str, float]) -> Own:
    return {**more, "cv_sensor_lag": {"time_constant_s": time_constant_s}}


WARMING_AND_DRIFTING: Own = {
    "evp_heating": {"share": 0.3, "time_constant_s": 3.0},
    "evp_dead_zone": {"opening": 0.1},
    "line_delay": {"delay_s": 0.05},
    "cv_sensor_drift": {"rate_kPa_per_min": 4.0},
    "reservoir_sensor_drift": {"rate_kPa_per_min": -20.0},
}
STALLING, STRETCHING = {"supply_pressure_kPa": 610.0}, {"per_kPa": 0.01}
LAGS_S = (0.001, 0.02, 1.0)
AGAINST_PLANT: list[tuple[Own, float, float]] = [
    (WARMING_AND_DRIFTING, 0.005, 0.02),
    # Long steps with a hose.
    (hose(3.0, 0.003), 0.02, 0.002),
    (hose(30.0, 0.02), 0.02, 0.002),
    (hose(3000.0, 0.02), 0.02, 0.002),
    (hose(30.0, 0.02, cv_heating={"time_constant_s": 0.5}), 0.02, 0.002),
    (hose(30.0, 0.02, cv_compliance=STRETCHING), 0.02, 0.002),
    (hose(30.0, 0.02, cv_sensor_lag={"time_constant_s": 0.02}), 0.02, 0.002),
    # A lagging sensor in long steps.
    *((lagging(lag_s), 0.01, 0.05) for lag_s in LAGS_S),
    *((lagging(lag_s, venturi_stall=STALLING), 0.01, 0.05) for lag_s in LAGS_S),
    *((lagging(lag_s, cv_compliance=STRETCHING), 0.01, 0.05) for lag_s in LAGS_S),
]
"""Causes, and the maximum difference of both readings, kPa: control volume, reservoir."""


@pytest.mark.parametrize(
    ("own", "cv_kPa", "reservoir_kPa"), AGAINST_PLANT, ids=[str(row[0]) for row in AGAINST_PLANT]
)
def test_readings_are_the_plants(own: Own, cv_kPa: float, reservoir_kPa: float) -> None:
    found_cv_kPa, found_reservoir_kPa = against_plant(own)
    assert found_cv_kPa < cv_kPa and found_reservoir_kPa < reservoir_kPa


def test_without_causes_it_is_the_baseline() -> None:
    run = random_run(3)
    readings = Simulation(case_of(run)).readings(0, {}, [], STARTS)
    state = BaselineState(*START_KPA)
    for i, inputs in enumerate(zip(run.evp_opening, run.dvp_opening, run.solenoid, strict=True)):
        assert readings.cv_kPa[i] == pytest.approx(state.cv_kPa, abs=1e-4)
        assert readings.reservoir_kPa[i] == pytest.approx(state.reservoir_kPa, abs=1e-4)
        for _ in range(20):
            state = step(RIG, state, Inputs(inputs[0], inputs[1], bool(inputs[2])), 0.001)


def test_all_causes_together_agree_with_the_independent_model() -> None:
    """In the order of the effects of each part."""
    names = [
        cause.name for cause in KNOWN_TO_BOTH if cause.name not in ("compressible_flow", "venturi_stall")
    ]
    run = random_run(4)
    hidden = [Hidden(name, strength(name)) for name in names]
    physics = with_effects(TrueRig(cv_L=0.25), hidden)
    truth = replay(
        physics, np.column_stack((run.evp_opening, run.dvp_opening, run.solenoid)), run.time_s, START_KPA
    )
    by_name = {cause.name: cause for cause in catalogue()}
    causes = [(by_name[one.name], (one.value,)) for one in hidden]
    ours = Simulation(case_of(run)).readings(0, {}, causes, STARTS)
    assert ours.cv_kPa == pytest.approx(truth[:, 0], abs=0.003)
    assert ours.reservoir_kPa == pytest.approx(truth[:, 1], abs=0.003)


def test_a_discharge_to_atmosphere_is_an_exponential() -> None:
    rig = Rig(cv=None)
    time_s = np.arange(0.0, 30.0, 0.5)
    shut = np.zeros(len(time_s))
    run = RecordedRun("discharge", time_s, None, shut + 1.0, shut, shut, shut, shut, None, None, True)
    readings = Simulation(case_of(run, rig)).readings(0, {}, [], np.array([[690.0, 0.0]]))
    tau_s = rig.evp.flow_resistance_kPa_s_per_SL * rig.reservoir.volume_L / 101.325
    assert readings.reservoir_kPa == pytest.approx(690.0 * np.exp(-time_s / tau_s), rel=1e-6)
    # The valve discharges to ambient pressure, whatever value a fit gives to the missing pressure.
    other = Simulation(case_of(run, rig)).readings(0, {}, [], np.array([[690.0, -30.0]]))
    assert other.reservoir_kPa == pytest.approx(readings.reservoir_kPa)


def test_the_pressures_are_free_after_a_valve_moved_at_an_unknown_time() -> None:
    time_s = np.arange(0.0, 3.0, 0.1)
    shut, after_gap = np.zeros(len(time_s)), (np.arange(len(time_s)) == 6).astype(float)
    evp = (np.arange(len(time_s)) >= 5).astype(float)
    run = RecordedRun("fired", time_s, None, evp, shut, shut, shut, shut, None, None, True, after_gap)
    simulation = Simulation(case_of(run, Rig(cv=None)))
    assert simulation.runs[0].start.tolist() == [0, 6]
    readings = simulation.readings(0, {}, [], np.array([[690.0, 0.0], [600.0, 0.0]]))
    assert readings.reservoir_kPa[[0, 6]].tolist() == [690.0, 600.0]


def test_an_emptying_vessel_has_smooth_derivatives() -> None:
    """By a flow that ends like a square root they would be noisy, and a fit would stop too early."""
    time_s = np.arange(0.0, 6.0, 0.09)
    shut = np.zeros(len(time_s))
    run = RecordedRun("fired", time_s, None, shut + 1.0, shut, shut, shut, shut, None, None, True)
    rig = Rig(reservoir=Reservoir(0.03), cv=None, gas=Gas("CO2"))
    simulation, start = Simulation(case_of(run, rig)), np.array([[640.0, 0.0]])
    ratio, cooling = cause_named("compressible_flow"), cause_named("reservoir_cooling")
    readings = [
        simulation.readings(0, {}, [(ratio, (0.35,)), (cooling, (0.42 * (1.0 + k * 1e-4),))], start)[1]
        for k in range(8)
    ]
    slopes = np.diff(readings, axis=0)
    assert np.abs(slopes - slopes[0]).max() < 0.01 * np.abs(slopes).max()
