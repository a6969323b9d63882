"""Scenario runs: their commands, the closed loop, and recorded openings that give the pressures again."""

from __future__ import annotations

import csv
import io
import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from flying_vines.physics import baseline
from flying_vines.physics.baseline import BaselineState, Inputs
from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.physics.plant.true_rig import TrueRig
from flying_vines.physics.rig import ControlVolume, Reservoir, Rig, Sensors
from flying_vines.simulation.scenario import (
    Scenario,
    ScenarioError,
    ScenarioRun,
    csv_text,
    parse_scenario,
    simulate,
    simulate_scenario,
)
from flying_vines.simulation.scenario.run import (
    SetpointOverTime,
    ValveCommand,
    chirp_cycles,
    command_of,
    valves_of,
)
from flying_vines.simulation.scenario.scenario import (
    BendsRun,
    ChirpRun,
    DischargeRun,
    OpeningsRun,
    PrbsRun,
    ProfileRun,
    RunKind,
    SineRun,
    StepsRun,
    Valves,
)
from flying_vines.vine.profile import HoldFor, Ramp

VINE = Rig()
HALF_LITRE = Rig(cv=ControlVolume(0.5))
NO_CV = Rig(cv=None)
QUIET = Sensors(0.0, 0.0)
EVERY_KIND: tuple[RunKind, ...] = (
    StepsRun(pressures_kPa=(50.0, 20.0, 35.0, 0.0), hold_s=1.5, reservoir_kPa=450.0),
    SineRun(low_kPa=5.0, high_kPa=20.0, frequency_Hz=1.0, duration_s=3.0),
    ChirpRun(high_kPa=20.0, from_Hz=0.5, to_Hz=5.0, duration_s=4.0),
    PrbsRun(levels_kPa=(0.0, 10.0, 30.0), duration_s=4.0),
    PrbsRun(levels_opening=(0.0, 0.3, 1.0), duration_s=6.0, name="prbs_openings"),
    DischargeRun(duration_s=3.0),
    DischargeRun(duration_s=3.0, valve="dvp", opening=0.4, name="discharge_dvp"),
    BendsRun(cycles=3),
    OpeningsRun(valves=(Valves(for_s=2.0, evp=0.5, until_kPa=30.0), Valves(for_s=2.0))),
    ProfileRun(segments=(Ramp(over_s=1.0, to_kPa=15.0), HoldFor(for_s=1.0)), settle_s=0.5),
)


def columns(text: str) -> dict[str, NDArray[np.float64]]:
    rows = list(csv.DictReader(io.StringIO(text)))
    return {name: np.array([float(row[name] or "nan") for row in rows]) for name in rows[0]}


def rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def replay(
    rig: Rig, file: dict[str, NDArray[np.float64]], start: BaselineState, parts: int
) -> NDArray[np.float64]:
    """The baseline with the commands of the file, each sample until the next: reservoir and CV."""
    state = start
    states = []
    time_s = file["time_s"]
    for i, dt_s in enumerate(np.diff(time_s, append=time_s[-1])):
        states.append(state)
        inputs = Inputs(
            float(file["evp_opening"][i]), float(file["dvp_opening"][i]), bool(file["solenoid"][i])
        )
        for _ in range(parts):
            state = baseline.step(rig, state, inputs, float(dt_s) / parts)
    return np.array(states).T


@pytest.mark.parametrize("rig", [VINE, HALF_LITRE], ids=["vine", "half_litre"])
@pytest.mark.parametrize("kind", EVERY_KIND, ids=lambda kind: kind.label)
def test_the_recorded_openings_replayed_give_the_recorded_pressures(rig: Rig, kind: RunKind) -> None:
    run = simulate(rig, kind, seed=5)
    file = columns(csv_text(run))
    reservoir_kPa, cv_kPa = replay(rig, file, BaselineState(kind.reservoir_kPa, 0.0), parts=4)
    assert rms(cv_kPa - run.true_cv_kPa) < 0.01
    assert rms(reservoir_kPa - run.true_reservoir_kPa) < 0.01
    beyond = rms(file["cv_pressure_kPa"] - cv_kPa) ** 2 - rig.sensors.cv_noise_std_kPa**2
    assert abs(beyond) < 0.1**2
    assert rms(file["reservoir_pressure_kPa"] - reservoir_kPa) == pytest.approx(1.2, rel=0.2)


def test_at_the_firmware_s_rate_too() -> None:
    kind = StepsRun(pressures_kPa=(20.0, 10.0), hold_s=1.0, sample_rate_Hz=1000)
    run = simulate(VINE, kind)
    assert len(run.time_s) == 2000
    _, cv_kPa = replay(VINE, columns(csv_text(run)), BaselineState(690.0, 0.0), parts=1)
    assert rms(cv_kPa - run.true_cv_kPa) < 0.01


@pytest.mark.parametrize(
    "rate_Hz", [40, *(pytest.param(rate_Hz, marks=pytest.mark.long) for rate_Hz in (50, 100)), 1000]
)
@pytest.mark.parametrize("volume_L", [0.1, 0.5, 2.0])
def test_the_regulator_settles_at_every_sample_rate(rate_Hz: int, volume_L: float) -> None:
    rig = Rig(reservoir=Reservoir(4.0), cv=ControlVolume(volume_L))
    kind = StepsRun(pressures_kPa=(20.0, 10.0, 35.0), hold_s=4.0, sample_rate_Hz=rate_Hz)
    run = simulate(rig, kind)
    assert run.faults == ""
    for end_s, wanted_kPa in ((4.0, 20.0), (8.0, 10.0), (12.0, 35.0)):
        settled = run.true_cv_kPa[(run.time_s >= end_s - 1.0) & (run.time_s < end_s)]
        assert settled == pytest.approx(wanted_kPa, abs=0.8)


def test_the_noise_is_the_rig_s() -> None:
    run = simulate(HALF_LITRE, OpeningsRun(valves=(Valves(for_s=60.0),)))
    assert np.std(run.cv_pressure_kPa - run.true_cv_kPa) == pytest.approx(0.15, rel=0.05)
    assert np.std(run.reservoir_pressure_kPa - run.true_reservoir_kPa) == pytest.approx(1.2, rel=0.05)
    quiet = simulate(replace(VINE, sensors=QUIET), BendsRun(cycles=1))
    assert np.array_equal(quiet.cv_pressure_kPa, quiet.true_cv_kPa)


def test_the_same_seed_is_the_same_run_and_another_is_not() -> None:
    scenario = Scenario(
        runs=(BendsRun(cycles=1), BendsRun(cycles=1), PrbsRun(levels_opening=(0, 1), duration_s=2.0))
    )

    def texts(seed: int) -> list[str]:
        return [csv_text(run) for run in simulate_scenario(HALF_LITRE, scenario, seed)]

    first = texts(1)
    assert first == texts(1)
    assert all(a != b for a, b in zip(first, texts(2), strict=True))
    assert first[0] != first[1]


def test_without_a_control_volume_the_reservoir_falls_exponentially() -> None:
    rig = replace(NO_CV, sensors=QUIET)
    run = simulate(rig, DischargeRun(duration_s=20.0, reservoir_kPa=600.0))
    tau_s = 2042.0 * 2.0 / ALPHA_KPA
    assert run.reservoir_pressure_kPa == pytest.approx(600.0 * np.exp(-run.time_s / tau_s), rel=1e-9)
    assert np.isnan(run.cv_pressure_kPa).all()


@pytest.mark.parametrize(
    "kind", [BendsRun(cycles=1), OpeningsRun(valves=(Valves(for_s=1.0, evp=1.0, until_kPa=3.0),))]
)
def test_runs_that_need_a_control_volume_are_refused_without_one(kind: RunKind) -> None:
    with pytest.raises(ScenarioError, match=rf"runs\[0\]: {kind.label} needs a control volume"):
        simulate(NO_CV, kind)


def test_openings_do_without_one() -> None:
    run = simulate(NO_CV, OpeningsRun(valves=(Valves(for_s=1.0, evp=1.0), Valves(for_s=1.0))))
    assert run.true_reservoir_kPa[-1] == run.true_reservoir_kPa[50] < 690.0


def test_the_true_rig_is_simulated_and_the_nominal_one_decides() -> None:
    rig = replace(HALF_LITRE, sensors=QUIET)
    true = TrueRig(rig, causes={"reservoir_leak": {"flow_resistance_kPa_s_per_SL": 20_000.0}})
    shut = OpeningsRun(valves=(Valves(for_s=5.0),))
    run = simulate(true, shut)
    tau_s = 20_000.0 * 2.0 / ALPHA_KPA
    assert run.reservoir_pressure_kPa == pytest.approx(690.0 * np.exp(-run.time_s / tau_s), rel=1e-9)
    assert np.array_equal(run.reservoir_pressure_kPa, run.true_reservoir_kPa)
    doubled = TrueRig(rig, causes={"dead_volume": {"volume_L": 0.5}})
    fill = OpeningsRun(valves=(Valves(for_s=0.5, evp=1.0), Valves(for_s=0.5)))
    ratio = simulate(doubled, fill).true_cv_kPa[-1] / simulate(rig, fill).true_cv_kPa[-1]
    assert ratio == pytest.approx(0.5, rel=0.02)
    # The regulator's gains are those of the nominal rig, so its first command is the same.
    up = StepsRun(pressures_kPa=(20.0,), hold_s=0.1)
    assert simulate(doubled, up).evp_opening[0] == simulate(rig, up).evp_opening[0]


def test_readings_have_the_errors_of_their_sensors() -> None:
    rig = replace(HALF_LITRE, sensors=QUIET)
    causes = {
        "cv_sensor_lag": {"time_constant_s": 0.05},
        "cv_sensor_offset": {"offset_kPa": 0.4},
        "reservoir_sensor_gain": {"gain": 1.02},
    }
    run = simulate(TrueRig(rig, causes=causes), OpeningsRun(valves=(Valves(for_s=0.5, evp=1.0),)))
    assert run.reservoir_pressure_kPa == pytest.approx(1.02 * run.true_reservoir_kPa)
    # Behind a ramp, a lag is a delay of its time constant.
    slope_kPa_per_s = (run.true_cv_kPa[-1] - run.true_cv_kPa[-6]) / 0.1
    behind_kPa = run.true_cv_kPa[-1] + 0.4 - run.cv_pressure_kPa[-1]
    assert behind_kPa == pytest.approx(0.05 * slope_kPa_per_s, rel=0.02)


def test_a_likely_rig_regulates_all_the_same() -> None:
    true = TrueRig(HALF_LITRE, likely=True, without=("cv_shape",))
    kind = StepsRun(pressures_kPa=(20.0, 10.0, 35.0), hold_s=4.0)
    run = simulate(true, kind)
    assert run.faults == ""
    for end_s, wanted_kPa in ((4.0, 20.0), (8.0, 10.0), (12.0, 35.0)):
        settled = run.true_cv_kPa[(run.time_s >= end_s - 1.0) & (run.time_s < end_s)]
        assert settled == pytest.approx(wanted_kPa, abs=1.0)
    # A converter has a limited number of readings.
    lsb_kPa = 206.84 / 4.0 * 3.3 / 4096
    steps = run.cv_pressure_kPa / lsb_kPa
    assert np.ptp(steps - np.round(steps)) < 1e-6


def test_latched_faults_of_the_firmware_are_reported() -> None:
    true = TrueRig(VINE, causes={"cv_sensor_offset": {"offset_kPa": 203.0}})
    run = simulate(true, BendsRun(cycles=1))
    assert run.faults == "cv overpressure"
    assert run.solenoid[1:].all()
    assert not run.evp_opening[1:].any()
    assert simulate(VINE, BendsRun(cycles=1)).faults == ""


def test_a_tiny_control_volume_stays_finite() -> None:
    rig = Rig(cv=ControlVolume(0.002))
    run = simulate(rig, OpeningsRun(valves=(Valves(for_s=0.2, evp=0.02), Valves(for_s=0.2, solenoid=True))))
    assert np.isfinite(run.true_cv_kPa).all()
    assert run.true_cv_kPa[-1] == pytest.approx(0.0, abs=1e-3)


def test_the_samples_are_those_of_the_rate() -> None:
    scenario = parse_scenario(
        '[[runs]]\nkind="bends"\ncycles=1\nhold_s=0.5\nrest_s=0.5\nsample_rate_Hz=125', ""
    )
    (run,) = simulate_scenario(VINE, scenario)
    assert isinstance(run, ScenarioRun)
    assert run.time_s == pytest.approx(np.arange(125) * 0.008)
    assert run.command_kPa[[0, 62, 63, 124]] == pytest.approx([20.7, 20.7, 0.0, 0.0])


# Commands.


FREQUENCIES = st.floats(0.01, 20.0)


def follow(run: RunKind, seed: int = 1) -> SetpointOverTime:
    command = command_of(run, random.Random(seed))
    assert command is not None
    return command


def move(run: RunKind, seed: int = 1) -> ValveCommand:
    valves = valves_of(run, random.Random(seed))
    assert valves is not None
    return valves


def test_steps_change_at_their_time_and_stay() -> None:
    command = follow(StepsRun(pressures_kPa=(10.0, 5.0), hold_s=0.1))
    assert [command(t) for t in (0.0, 0.08, 0.1, 0.18, 5.0)] == [10.0, 10.0, 5.0, 5.0, 5.0]


def test_bends_repeat() -> None:
    command = follow(BendsRun(cycles=3, bend_kPa=20.0, hold_s=1.0, rest_s=0.5))
    assert [command(t) for t in (0.0, 0.98, 1.0, 1.48, 1.5, 3.0, 4.0)] == [20, 20, 0, 0, 20, 20, 0]


def test_a_sine_starts_at_its_low_end() -> None:
    command = follow(SineRun(low_kPa=5.0, high_kPa=15.0, frequency_Hz=2.0, duration_s=1.0))
    assert [command(t) for t in (0.0, 0.125, 0.25, 0.5)] == pytest.approx([5.0, 10.0, 15.0, 5.0])


def test_a_profile_is_followed_as_planned() -> None:
    run = ProfileRun(segments=(Ramp(over_s=2.0, to_kPa=10.0), HoldFor(for_s=1.0)), repeat=2)
    assert [follow(run)(t) for t in (0.0, 1.0, 2.5, 4.0, 9.0)] == pytest.approx([0, 5, 10, 10, 10])


@given(start_Hz=FREQUENCIES, end_Hz=FREQUENCIES, linear=st.booleans(), share=st.floats(0.0, 1.0))
def test_a_chirp_has_the_frequency_that_was_asked_for(
    start_Hz: float, end_Hz: float, linear: bool, share: float
) -> None:
    run = ChirpRun(
        high_kPa=1.0,
        from_Hz=start_Hz,
        to_Hz=end_Hz,
        duration_s=10.0,
        sweep="linear" if linear else "log",
    )
    wanted_Hz = start_Hz + (end_Hz - start_Hz) * share if linear else start_Hz * (end_Hz / start_Hz) ** share
    h_s = 1e-4
    t_s = 10.0 * share
    found_Hz = (chirp_cycles(run, t_s + h_s) - chirp_cycles(run, t_s - h_s)) / (2.0 * h_s)
    assert found_Hz == pytest.approx(wanted_Hz, rel=1e-4)
    assert chirp_cycles(run, 0.0) == 0.0
    assert 0.0 <= follow(run)(t_s) <= 1.0


@pytest.mark.long
@settings(max_examples=20)
@given(seed=st.integers(0, 1000), least_s=st.floats(0.1, 0.5), more_s=st.floats(0.0, 1.0))
def test_random_pressures_keep_their_levels_and_times(seed: int, least_s: float, more_s: float) -> None:
    run = PrbsRun(
        duration_s=20.0, levels_kPa=(0.0, 5.0, 20.0), min_hold_s=least_s, max_hold_s=least_s + more_s
    )
    command = follow(run, seed)
    values = [command(i * 0.02) for i in range(1000)]
    changes = [i for i in range(1, 1000) if values[i] != values[i - 1]]
    assert set(values) <= {0.0, 5.0, 20.0}
    held_s = [0.02 * (b - a) for a, b in zip([0, *changes], changes, strict=False)]
    assert min(held_s) > least_s - 0.0201
    assert max(held_s) < least_s + more_s + 0.0201
    assert values != [follow(run, seed + 1)(i * 0.02) for i in range(1000)]


@settings(max_examples=20)
@given(seed=st.integers(0, 1000))
def test_random_openings_let_nothing_more_in_above_the_most(seed: int) -> None:
    run = PrbsRun(duration_s=20.0, levels_opening=(0.0, 0.5, 1.0), most_kPa=60.0)
    valves = move(run, seed)
    drives = [valves(i * 0.02, 70.0 if i % 100 > 50 else 10.0) for i in range(1000)]
    assert all(drive.evp == 0.0 for i, drive in enumerate(drives) if i % 100 > 50)
    assert all(drive.evp in (0.0, 0.5, 1.0) and drive.dvp in (0.0, 0.5, 1.0) for drive in drives)
    assert all(drive.evp == 0.0 if drive.solenoid else drive.dvp == 0.0 for drive in drives)
    assert {drive.solenoid for drive in drives} == {False, True}


@pytest.mark.parametrize("vent_share", [0.0, 1.0])
def test_the_share_that_vents(vent_share: float) -> None:
    run = PrbsRun(duration_s=20.0, levels_opening=(0.0, 1.0), vent_share=vent_share)
    valves = move(run)
    assert {valves(i * 0.02, 0.0).solenoid for i in range(1000)} == {vent_share == 1.0}


def test_a_discharge_passes_the_control_volume_by_the_solenoid() -> None:
    assert move(DischargeRun(duration_s=1.0, opening=0.5))(0.3, 0.0) == Inputs(0.5, 0.0, True)
    assert move(DischargeRun(duration_s=1.0, valve="dvp"))(0.3, 0.0) == Inputs(0.0, 1.0, False)


def test_openings_follow_each_other_and_end_early_at_their_pressure() -> None:
    run = OpeningsRun(
        valves=(
            Valves(for_s=1.0, evp=1.0, until_kPa=30.0),
            Valves(for_s=1.0),
            Valves(for_s=1.0, dvp=1.0, solenoid=True),
        )
    )
    on_time = move(run)
    assert [on_time(t, 0.0).evp for t in (0.0, 0.98, 1.0)] == [1.0, 1.0, 0.0]
    assert on_time(2.0, 0.0) == Inputs(0.0, 1.0, True)
    early = move(run)
    assert [early(t, 31.0 * (t > 0.3)).evp for t in (0.0, 0.3, 0.4)] == [1.0, 1.0, 0.0]
    assert [early(t, 0.0).solenoid for t in (1.38, 1.4, 2.98)] == [False, True, True]


def test_a_run_either_regulates_or_moves_the_valves() -> None:
    assert command_of(DischargeRun(duration_s=1.0), random.Random(1)) is None
    assert valves_of(BendsRun(cycles=1), random.Random(1)) is None
