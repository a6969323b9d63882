"""The commands of the scenario runs over time."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flying_vines.physics.baseline import Inputs
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

frequencies = st.floats(0.01, 20.0)


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


@given(start_Hz=frequencies, end_Hz=frequencies, linear=st.booleans(), share=st.floats(0.0, 1.0))
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
