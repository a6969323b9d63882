"""The kernel agrees with scipy's integrators and closed forms, and each effect with its definition."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hidden_truth.effects import CAUSES, EFFECTS, OUTSIDE, Hidden, with_effects
from hidden_truth.kernel import STATES, Array, Control, Physics, flows, fly, rates
from hidden_truth.plans import prbs, steady_time
from hidden_truth.recording import replay
from hidden_truth.rig import Noise, Rig, physics

pytestmark = pytest.mark.long

ALPHA, AMBIENT, GAMMA = 101.325, 101.325, 1.4
RIG = Rig(reservoir_L=1.0, cv_L=0.25)
TIME = steady_time(6.0)
NOISE = Noise()
START = (660.0, 3.0)
"""Reservoir and CV. Not 0, where a compliant CV has a kink at which implicit integrators do not converge."""

STRENGTHS = {
    "reservoir_leak": 4000.0,
    "cv_leak": 300.0,
    "compressible_flow": 0.35,
    "reservoir_cooling": 6.0,
    "cv_heating": 1.5,
    "cv_compliance": 0.01,
    "dead_volume": 0.06,
    "reservoir_volume": 0.9,
    "evp_restriction": 1.3,
    "evp_dead_zone": 0.3,
    "evp_hysteresis": 0.2,
    "evp_lag": 0.012,
    "line_delay": 0.033,
    "solenoid_slow_close": 0.047,
    "venturi_stall": 600.0,
    "cv_sensor_lag": 0.025,
    "cv_sensor_offset": 1.5,
    "cv_sensor_gain": 1.04,
    "reservoir_sensor_offset": -12.0,
    "reservoir_sensor_gain": 0.96,
    "ambient_drop": 0.15,
    "viscous_leak": 70_000.0,
    "reservoir_viscous_leak": 3e6,
    "x_valve_heating": 0.04,
    "x_evp_power": 1.7,
    "x_evp_lifting_force": 3e-4,
    "x_outlet_check_valve": 5.0,
    "x_solenoid_choked": 0.3,
    "x_solenoid_slow_open": 0.033,
    "x_venturi_power": 2.2,
    "x_seam": 200.0,
    "x_second_chamber": 0.08,
    "x_tube_drop": 8.0,
    "x_supply_line_drop": 40.0,
    "x_sensor_drift": 2.0,
    "x_vibration": 0.8,
    "x_ceiling": 30.0,
    "x_repeats": 0.1,
}
TOGETHER = [
    ("line_delay", "evp_hysteresis", "evp_dead_zone", "evp_lag"),
    ("cv_heating", "cv_compliance", "ambient_drop", "cv_leak"),
    ("compressible_flow", "reservoir_cooling", "ambient_drop", "reservoir_leak"),
    ("viscous_leak", "reservoir_viscous_leak", "ambient_drop", "cv_heating"),
    ("venturi_stall", "solenoid_slow_close", "cv_sensor_lag", "cv_sensor_offset", "cv_sensor_gain"),
]


def hiding(*names: str, rig: Rig = RIG) -> Physics:
    return with_effects(rig, [Hidden(name, STRENGTHS[name]) for name in names])


def random_inputs(seed: int = 3) -> Array:
    inputs = prbs(np.random.default_rng(seed), TIME).rows[:, 1:]
    inputs[inputs[:, 0] > 0.0, 1:] = 0.0
    return inputs


def schedule(p: Physics, inputs: Array) -> list[tuple[float, float, float, bool]]:
    """The inputs with their start times: opening after delay, play and dead zone; supply; solenoid open."""
    commands = [(float(t), *map(float, row)) for t, row in zip(TIME, inputs, strict=True)]
    edges = {t for t, *_ in commands} | {t + p.evp_delay_s for t, *_ in commands}
    closes = [b[0] for a, b in pairwise(commands) if a[3] > b[3]]
    opens = [b[0] for a, b in pairwise([(0.0, 0.0, 0.0, 0.0), *commands]) if a[3] < b[3]]
    edges |= {t + p.closing_s for t in closes} | {t + p.opening_s for t in opens}
    held, arrived, found = 0.0, 0, []
    for t in sorted(edges):
        while arrived < len(commands) and commands[arrived][0] + p.evp_delay_s <= t + 1e-12:
            u = commands[arrived][1]
            held = 0.0 if u == 0.0 else min(max(held, u - p.play / 2.0), u + p.play / 2.0)
            arrived += 1
        opening = max(0.0, (held - p.dead_zone) / (1.0 - p.dead_zone))
        now = next(row for row in reversed(commands) if row[0] <= t + 1e-12)
        late = any(c <= t + 1e-12 and t < c + p.closing_s - 1e-12 for c in closes)
        waits = any(o <= t + 1e-12 and t < o + p.opening_s - 1e-12 for o in opens)
        found.append((t, opening, now[2], (now[3] > 0.5 and not waits) or late))
    return found


def by_scipy(p: Physics, inputs: Array, start: tuple[float, float], method: str) -> Array:
    """Readings without noise at every sample, by another integrator and with another list of events."""

    def rate(t: float, y: Any, *held: Any) -> Array:
        out = np.zeros(STATES)
        rates(p, t, np.ascontiguousarray(y), *held, out)
        return out

    y = np.array([*start, 0.0, start[1], 1.0, 1.0, 0.0, start[1]])
    found = np.zeros((TIME.size, 2))
    rows = schedule(p, inputs)
    before: tuple[float, float, bool] = (0.0, 0.0, False)
    for (t, *held), end in zip(rows, [row[0] for row in rows[1:]] + [math.inf], strict=True):
        for i in np.flatnonzero(np.abs(TIME - t) < 1e-9):
            q_e, q_m, q_o = flows(p, t, y, *before)
            cv = (y[3] if p.cv_sensor_lag_s > 0.0 else y[1]) + p.tube_kPa_s_per_SL * (q_e - q_o)
            drift = p.drift_kPa * (1.0 - math.exp(-t / p.drift_s))
            cv = p.cv_gain * (cv + p.cv_offset_kPa + drift)
            cv += p.hum_kPa * math.sin(2.0 * math.pi * p.hum_Hz * t)
            line = y[0] - p.supply_line_kPa_s_per_SL * (q_e + q_m)
            found[i] = min(cv, p.cv_ceiling_kPa), p.reservoir_gain * (line + p.reservoir_offset_kPa)
        before = (held[0], held[1], bool(held[2]))
        if t >= TIME[-1]:
            break
        end = min(end, TIME[-1])
        if end > t:
            solved = solve_ivp(rate, (t, end), y, method, args=before, rtol=1e-9, atol=1e-9)
            assert solved.success, solved.message
            y = solved.y[:, -1]
    return found


@pytest.mark.parametrize(
    "names", [(), *((name,) for name in STRENGTHS if name != "x_repeats"), *TOGETHER], ids="+".join
)
def test_the_kernel_agrees_with_scipy(names: tuple[str, ...]) -> None:
    p, inputs = hiding(*names), random_inputs()
    if "venturi_stall" in names:
        supplied = replay(p, inputs, TIME, START)[inputs[:, 1] > 0.0, 1]
        assert supplied.min() < p.stall_kPa < supplied.max()
    off = np.abs(replay(p, inputs, TIME, START) - by_scipy(p, inputs, START, "LSODA"))
    print(f"{'+'.join(names)}: {off.max(axis=0)} kPa")
    assert off[:, 0].max() < 0.01 * NOISE.cv_kPa
    assert off[:, 1].max() < 0.01 * NOISE.reservoir_kPa


@pytest.mark.parametrize("names", TOGETHER, ids="+".join)
def test_the_kernel_agrees_with_an_implicit_integrator(names: tuple[str, ...]) -> None:
    p, inputs = hiding(*names), random_inputs()
    inputs[TIME >= 3.0] = 0.0
    off = np.abs(replay(p, inputs, TIME, START) - by_scipy(p, inputs, START, "Radau"))
    assert off.max() < 0.01 * NOISE.cv_kPa


def test_every_effect_has_a_strength_here() -> None:
    assert set(STRENGTHS) == set(EFFECTS)
    assert len(CAUSES) == 23
    assert len(OUTSIDE) >= 10


def held_inputs(evp: float = 0.0, dvp: float = 0.0, solenoid: float = 0.0) -> Array:
    return np.tile([evp, dvp, solenoid], (TIME.size, 1))


def test_a_leak_decays() -> None:
    p = physics(RIG)._replace(reservoir_leak_SL_per_s_kPa=1 / 900.0, cv_leak_SL_per_s_kPa=1 / 300.0)
    read = replay(p, held_inputs(), TIME, (600.0, 40.0))
    assert read[:, 1] == pytest.approx(600.0 * np.exp(-ALPHA * TIME / (1.0 * 900.0)), abs=1e-5)
    assert read[:, 0] == pytest.approx(40.0 * np.exp(-ALPHA * TIME / (0.25 * 300.0)), abs=1e-5)


def test_a_viscous_leak_follows_the_difference_of_squares() -> None:
    p = hiding("viscous_leak", "reservoir_viscous_leak")
    read = replay(p, held_inputs(), TIME, (600.0, 40.0))
    for column, start, volume_L, name in (
        (1, 600.0, 1.0, "reservoir_viscous_leak"),
        (0, 40.0, 0.25, "viscous_leak"),
    ):
        # dP/dt = -k P (P + 2 ambient), separated and integrated.
        k = ALPHA / (volume_L * STRENGTHS[name])
        closed_form = 2.0 * AMBIENT / ((1.0 + 2.0 * AMBIENT / start) * np.exp(2.0 * AMBIENT * k * TIME) - 1.0)
        assert read[:, column] == pytest.approx(closed_form, abs=1e-5)


def test_a_baseline_discharge_is_exponential() -> None:
    p = physics(Rig(reservoir_L=2.0, cv_L=None))
    read = replay(p, held_inputs(evp=1.0), TIME, (600.0, 0.0))
    assert read[:, 1] == pytest.approx(600.0 * np.exp(-ALPHA * TIME / (2.0 * 2042.0)), abs=1e-5)
    assert np.all(read[:, 0] == 0.0)


def test_a_choked_discharge_is_exponential_in_absolute_pressure_and_matched_at_690_kPa() -> None:
    p = physics(Rig(reservoir_L=2.0, cv_L=None))._replace(critical_pressure_ratio=0.4)
    read = replay(p, held_inputs(evp=1.0), TIME, (690.0, 0.0))
    first = ALPHA * 690.0 / 2042.0 / 2.0
    absolute = (690.0 + AMBIENT) * np.exp(-first / (690.0 + AMBIENT) * TIME)
    assert AMBIENT / absolute[-1] < 0.4
    assert read[:, 1] == pytest.approx(absolute - AMBIENT, abs=1e-5)


def test_the_matched_flow_is_the_same_for_every_critical_ratio() -> None:
    for b in (0.05, 0.3):
        p = physics(RIG)._replace(critical_pressure_ratio=b)
        q_e, q_m, _ = flows(p, 0.0, np.array([690.0, 0.0, 0, 0, 1, 1, 0, 0.0]), 1.0, 1.0, False)
        assert (q_e, q_m) == pytest.approx((690.0 / 2042.0, 690.0 / 618.0))


def test_gas_without_heat_exchange_is_adiabatic() -> None:
    p = physics(RIG)._replace(reservoir_wall_s=1e9)
    states = fly_states(p, held_inputs(evp=1.0), (600.0, 0.0))
    assert states["reservoir_T"] == pytest.approx(
        ((states["reservoir"] + AMBIENT) / (600.0 + AMBIENT)) ** ((GAMMA - 1.0) / GAMMA), rel=1e-7
    )
    p = physics(RIG)._replace(cv_wall_s=1e9)
    states = fly_states(p, held_inputs(evp=0.3), (600.0, 0.0))
    gained = states["cv"] * 0.25
    assert gained == pytest.approx(GAMMA * (600.0 - states["reservoir"]) * RIG.reservoir_L, rel=1e-7)


def fly_states(p: Physics, inputs: Array, start: tuple[float, float]) -> dict[str, float]:
    """The end of a run with constant inputs, computed from the rates only."""
    y = np.array([*start, 0.0, start[1], 1.0, 1.0, 0.0, start[1]])

    def rate(t: float, y: Any) -> Array:
        out = np.zeros(STATES)
        rates(p, t, np.ascontiguousarray(y), *inputs[0, :2], bool(inputs[0, 2]), out)
        return out

    solved = solve_ivp(rate, (0.0, TIME[-1]), y, "LSODA", rtol=1e-10, atol=1e-10)
    end = solved.y[:, -1]
    read = replay(p, inputs, TIME, start)[-1]
    assert read == pytest.approx([end[1], end[0]], abs=1e-4)
    return {"reservoir": end[0], "cv": end[1], "reservoir_T": end[4], "cv_T": end[5]}


def test_gas_with_fast_heat_exchange_is_isothermal() -> None:
    inputs = random_inputs()
    for quick, none in (
        (physics(RIG)._replace(reservoir_wall_s=1e-4), physics(RIG)),
        (
            hiding("cv_compliance")._replace(cv_wall_s=1e-4),
            hiding("cv_compliance"),
        ),
    ):
        off = replay(quick, inputs, TIME, (500.0, 0.0)) - replay(none, inputs, TIME, (500.0, 0.0))
        assert np.abs(off).max() < 0.05


def test_a_compliant_vessel_keeps_its_air() -> None:
    k = STRENGTHS["cv_compliance"]
    read = replay(hiding("cv_compliance"), held_inputs(evp=0.5), TIME, (600.0, 0.0))
    volume = 0.25 * (1.0 + k * read[:, 0])
    air = (read[:, 0] + AMBIENT) * volume - AMBIENT * 0.25
    assert air == pytest.approx((600.0 - read[:, 1]) * 1.0, abs=1e-4)


def test_falling_ambient_pressure_raises_both_gauge_pressures_without_flow() -> None:
    read = replay(hiding("ambient_drop"), held_inputs(), TIME, (600.0, 20.0))
    assert read == pytest.approx(np.array([20.0, 600.0]) + 0.15 * TIME[:, None], abs=1e-6)


def test_a_falling_ambient_pressure_lets_a_compliant_vessel_grow() -> None:
    p = hiding("ambient_drop", "cv_compliance")
    read = replay(p, held_inputs(), TIME, (600.0, 20.0))
    k = STRENGTHS["cv_compliance"]
    absolute = read[:, 0] + AMBIENT - 0.15 * TIME
    assert absolute * (1.0 + k * read[:, 0]) == pytest.approx((20.0 + AMBIENT) * (1.0 + 20.0 * k), rel=1e-7)
    assert absolute[-1] < 20.0 + AMBIENT - 0.1


def shifted(column: Array, samples: int) -> Array:
    return np.concatenate([np.zeros(samples), column[:-samples]])


def test_a_delay_of_whole_samples_shifts_the_inputs() -> None:
    inputs = random_inputs()
    inputs[0, 0] = 1.0
    late = inputs.copy()
    late[:, 0] = shifted(inputs[:, 0], 2)
    delayed = replay(physics(RIG)._replace(evp_delay_s=0.04), inputs, TIME, (600.0, 0.0))
    assert delayed == pytest.approx(replay(physics(RIG), late, TIME, (600.0, 0.0)), abs=1e-4)
    assert delayed[2, 0] == 0.0


def test_a_solenoid_that_closes_late_opens_on_time() -> None:
    inputs = random_inputs()
    late = inputs.copy()
    late[:, 2] = np.maximum(inputs[:, 2], np.maximum(shifted(inputs[:, 2], 1), shifted(inputs[:, 2], 2)))
    slow = replay(physics(RIG)._replace(closing_s=0.04), inputs, TIME, (600.0, 0.0))
    assert slow == pytest.approx(replay(physics(RIG), late, TIME, (600.0, 0.0)), abs=1e-4)


def test_dead_zone_and_play_change_the_opening() -> None:
    inputs = random_inputs()
    dead = inputs.copy()
    dead[:, 0] = np.maximum(0.0, (inputs[:, 0] - 0.3) / 0.7)
    got = replay(hiding("evp_dead_zone"), inputs, TIME, (600.0, 0.0))
    assert got == pytest.approx(replay(physics(RIG), dead, TIME, (600.0, 0.0)), abs=1e-4)

    commands = [0.5, 0.45, 0.35, 0.3, 0.5, 1.0, 0.0, 0.05, 0.15]
    outputs = [0.4, 0.4, 0.4, 0.4, 0.4, 0.9, 0.0, 0.0, 0.05]
    inputs, play = held_inputs(), held_inputs()
    inputs[:9, 0], play[:9, 0] = commands, outputs
    inputs[9:, 0] = play[9:, 0] = 0.0
    got = replay(hiding("evp_hysteresis"), inputs, TIME, (600.0, 0.0))
    assert got == pytest.approx(replay(physics(RIG), play, TIME, (600.0, 0.0)), abs=1e-5)


def test_an_opening_with_lag_and_a_reading_with_lag() -> None:
    tau = 0.2
    endless = Rig(reservoir_L=1e9, cv_L=0.25)
    read = replay(physics(endless)._replace(evp_lag_s=tau), held_inputs(evp=0.1), TIME, (600.0, 0.0))
    opened_s = TIME - tau * (1.0 - np.exp(-TIME / tau))
    expected = 600.0 * (1.0 - np.exp(-0.1 * ALPHA / (2042.0 * 0.25) * opened_s))
    assert read[:, 0] == pytest.approx(expected, abs=1e-3)

    p = physics(RIG)._replace(cv_sensor_lag_s=tau, ambient_drop_kPa_per_s=0.5, cv_offset_kPa=2.0, cv_gain=1.1)
    read = replay(p, held_inputs(), TIME, (600.0, 5.0))
    lagged = 5.0 + 0.5 * (TIME - tau * (1.0 - np.exp(-TIME / tau)))
    assert read[:, 0] == pytest.approx(1.1 * (lagged + 2.0), abs=1e-5)


def test_a_stalled_venturi_makes_no_vacuum_but_uses_air_and_lets_none_flow_back() -> None:
    inputs = held_inputs(dvp=1.0, solenoid=1.0)
    stalled = replay(physics(RIG)._replace(stall_kPa=1e4), inputs, TIME, (600.0, 30.0))
    without = replay(physics(RIG)._replace(full_vacuum_kPa=0.0), inputs, TIME, (600.0, 30.0))
    assert stalled == pytest.approx(without)
    evacuated = replay(physics(RIG)._replace(stall_kPa=500.0), inputs, TIME, (600.0, 30.0))
    lowest = evacuated[:, 0].min()
    assert lowest < -20.0
    assert evacuated[-1, 0] == pytest.approx(lowest, abs=1e-6)


def test_a_solenoid_at_rest_lets_air_back_in() -> None:
    read = replay(physics(RIG), held_inputs(solenoid=1.0), TIME, (600.0, -30.0))
    assert read[:, 0] == pytest.approx(-30.0 * np.exp(-ALPHA * TIME / (70.0 * 0.25)), abs=1e-5)


def test_the_loop_follows_and_its_inputs_replay_to_the_same_readings() -> None:
    n = TIME.size
    rng = np.random.default_rng(1)
    rows = np.zeros((n, 4))
    rows[:, 0] = np.where(TIME < 3.0, 21.0, 7.0)
    noise = rng.standard_normal((n, 2)) * (0.15, 1.2)
    p = hiding("line_delay", "evp_dead_zone", "cv_sensor_lag")
    flown = fly(p, Control(True), (600.0, 0.0), TIME, rows, noise, rng.random(n), 1e-6)
    for until, level in ((3.0, 21.0), (6.0, 7.0)):
        settled = (until - 0.5 < TIME) & (until > TIME)
        assert flown[settled, 3].mean() == pytest.approx(level, abs=1.0)
    assert np.all((flown[:, 0] == 0.0) | (flown[:, 2] == 0.0))
    assert flown[:, 5:7] - flown[:, 3:5] == pytest.approx(noise)
    again = replay(p, flown[:, :3].copy(), TIME, (600.0, 0.0))
    assert np.array_equal(again, flown[:, 3:5])


def test_above_the_guard_random_openings_inflate_no_more_and_vent_at_the_next_move() -> None:
    rows = np.zeros((TIME.size, 4))
    rows[:, 1] = np.where(TIME < 2.0, 1.0, 0.5)
    rows[:, 1] = np.where(TIME < 4.0, rows[:, 1], 0.1)
    rows[:, 2:] = 0.5, 1.0
    n = TIME.size
    flown = fly(
        physics(RIG),
        Control(False, guard_kPa=60.0),
        (600.0, 0.0),
        TIME,
        rows,
        np.zeros((n, 2)),
        np.ones(n),
        1e-6,
    )
    over = int(np.argmax(flown[:, 5] > 60.0))
    assert np.all(flown[:over, :3] == [1.0, 0.0, 0.0])
    assert np.all(flown[over:100, :3] == 0.0)
    assert np.all(flown[100:200, :3] == [0.0, 0.5, 1.0])
    assert np.all(flown[200:, :3] == [0.1, 0.0, 0.0])


def test_a_hanging_host_keeps_its_inputs_and_hangs_only_while_nothing_inflates() -> None:
    rows = np.column_stack([np.full(TIME.size, np.nan), random_inputs()])
    n = TIME.size
    control = Control(False, stall_from=100, stall_samples=50)
    flown = fly(physics(RIG), control, (600.0, 0.0), TIME, rows, np.zeros((n, 2)), np.ones(n), 1e-6)
    hung = np.flatnonzero(flown[:, 7])
    assert hung[0] > 100
    assert list(hung) == list(range(hung[0], hung[0] + 50))
    assert np.all(flown[hung, :3] == flown[hung[0] - 1, :3])
    assert np.all(flown[hung, 0] == 0.0)


def test_both_readings_repeat_in_the_given_share_of_samples() -> None:
    n = TIME.size
    rng = np.random.default_rng(5)
    rows = np.column_stack([np.full(n, np.nan), random_inputs()])
    chance = rng.random(n)
    noise = rng.standard_normal((n, 2))
    flown = fly(hiding("x_repeats"), Control(False), (600.0, 0.0), TIME, rows, noise, chance, 1e-6)
    same = np.all(flown[1:, 5:7] == flown[:-1, 5:7], axis=1)
    assert np.array_equal(same, chance[1:] < 0.1)
    assert same.any()


def test_a_clipped_reading_is_clipped_with_its_noise() -> None:
    n = TIME.size
    rows = np.column_stack([np.full(n, np.nan), held_inputs(evp=0.3)])
    noise = np.random.default_rng(2).standard_normal((n, 2))
    flown = fly(hiding("x_ceiling"), Control(False), (600.0, 0.0), TIME, rows, noise, np.ones(n), 1e-6)
    assert flown[:, 5].max() == 30.0
    assert np.count_nonzero(flown[:, 5] == 30.0) > 10
