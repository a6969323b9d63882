"""Each cause agrees with its equation, written independently and solved by scipy."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from flying_vines.physics.baseline import Inputs
from flying_vines.physics.effects import catalogue, setup
from flying_vines.physics.plant.plant import Setup, at_rest
from flying_vines.physics.plant.sensors import read, rested
from flying_vines.physics.plant.simulator import Simulator
from flying_vines.physics.rig import ControlVolume, Reservoir, Rig

integrate = pytest.importorskip("scipy.integrate", reason="pip install scipy to check the causes")

A, GAMMA, P0 = 101.325, 1.4, 101.325
VR, VC, RE, RD, RS, FULL, RATED = 1.0, 0.25, 2042.0, 618.0, 70.0, 55.0, 600.0
RIG = Rig(reservoir=Reservoir(VR), cv=ControlVolume(VC))
START = (660.0, 0.0)

Row = tuple[float, float, float, bool]
SCHEDULE: list[Row] = [  # from second, inflation, supply, solenoid
    (0.0, 0.6, 0.0, False),
    (0.5, 1.0, 0.0, False),
    (0.8, 0.35, 0.0, False),
    (1.1, 0.0, 0.0, False),
    (1.4, 0.0, 0.0, True),
    (1.7, 0.0, 1.0, True),
    (2.2, 0.0, 0.5, True),
    (2.6, 0.9, 0.0, False),
    (3.0, 0.5, 0.0, False),
    (3.2, 0.7, 0.0, False),
    (3.6, 0.0, 1.0, True),
    (4.4, 0.0, 0.0, True),
    (4.6, 0.25, 0.0, True),
    (5.0, 0.0, 0.0, False),
]
END_S = 5.4

Ode = Callable[[float, Any, float, float, bool], list[float]]
Pair = tuple[float, float]


def vacuum(u_d: float, p_r: float) -> float:
    return FULL * u_d * min(1.0, p_r / RATED)


def outlet(p_cv: float, p_r: float, u_d: float, s: bool, resistance: float = RS) -> float:
    q = s * (p_cv + vacuum(u_d, p_r)) / resistance
    return max(0.0, q) if u_d > 0.0 else q


def plain(
    *,
    vr: float = VR,
    vc: float = VC,
    re: float = RE,
    leak_r: Callable[[float], float] = lambda p: 0.0,
    leak_c: Callable[[float], float] = lambda p: 0.0,
    rise: float = 0.0,
) -> Ode:
    """The baseline with one changed number or one additional term."""

    def ode(t: float, y: Any, u_e: float, u_d: float, s: bool) -> list[float]:
        p_r, p_c = y
        q_e = u_e * (p_r - p_c) / re
        q_o = outlet(p_c, p_r, u_d, s)
        return [
            -A * (q_e + u_d * p_r / RD + leak_r(p_r)) / vr + rise,
            A * (q_e - q_o - leak_c(p_c)) / vc + rise,
        ]

    return ode


def phi(r: float, b: float) -> float:
    if r <= b:
        return 1.0
    return math.sqrt(max(0.0, 1.0 - ((r - b) / (1.0 - b)) ** 2)) if r < 1.0 else 0.0


def gap(p: float, constant: float) -> float:
    return ((p + P0) ** 2 - P0**2) / constant


def hole(p: float, conductance: float) -> float:
    if p < 0.0:
        return -conductance * P0 * phi((p + P0) / P0, 0.5)
    return conductance * (p + P0) * phi(P0 / (p + P0), 0.5)


def compressible(b: float) -> Ode:
    def ode(t: float, y: Any, u_e: float, u_d: float, s: bool) -> list[float]:
        p_r, p_c = y
        up = p_r + P0
        share = phi(P0 / (690.0 + P0), b) * (690.0 + P0)
        q_e = u_e * 690.0 / RE / share * up * phi((p_c + P0) / up, b)
        q_m = u_d * 690.0 / RD / share * up * phi(P0 / up, b)
        return [-A * (q_e + q_m) / VR, A * (q_e - outlet(p_c, p_r, u_d, s)) / VC]

    return ode


def cooling(tau: float) -> Ode:
    def ode(t: float, y: Any, u_e: float, u_d: float, s: bool) -> list[float]:
        p_r, p_c, warmth = y
        q_e = u_e * (p_r - p_c) / RE
        out = A * (q_e + u_d * p_r / RD)
        p_abs = p_r + P0
        return [
            -GAMMA * warmth * out / VR + p_abs / warmth * (1.0 - warmth) / tau,
            A * (q_e - outlet(p_c, p_r, u_d, s)) / VC,
            -(GAMMA - 1.0) * warmth**2 * out / (VR * p_abs) + (1.0 - warmth) / tau,
        ]

    return ode


def heating(tau: float) -> Ode:
    def ode(t: float, y: Any, u_e: float, u_d: float, s: bool) -> list[float]:
        p_r, p_c, warmth = y
        q_e = u_e * (p_r - p_c) / RE
        q_o = outlet(p_c, p_r, u_d, s)
        p_abs = p_c + P0
        back = min(0.0, q_o)
        q_in, q_out = q_e - back, q_o - back
        p_rate = GAMMA * A * (q_in - warmth * q_out) / VC - p_abs / warmth * (warmth - 1.0) / tau
        # T = p V / (α n): its rate from those of p and n.
        n_rate = A * (q_in - q_out) / VC
        return [
            -A * (q_e + u_d * p_r / RD) / VR,
            p_rate,
            warmth * (p_rate - warmth * n_rate) / p_abs,
        ]

    return ode


def compliant(k: float) -> Ode:
    def ode(t: float, y: Any, u_e: float, u_d: float, s: bool) -> list[float]:
        p_r, p_c = y
        q_e = u_e * (p_r - p_c) / RE
        slope = VC * (1.0 + k * p_c) + (p_c + P0) * VC * k if p_c > 0.0 else VC
        return [-A * (q_e + u_d * p_r / RD) / VR, A * (q_e - outlet(p_c, p_r, u_d, s)) / slope]

    return ode


def warming(share: float, tau: float) -> Ode:
    base = plain()

    def ode(t: float, y: Any, u_e: float, u_d: float, s: bool) -> list[float]:
        return [*base(t, y[:2], u_e * (1.0 - share * y[2]), u_d, s), (u_e - y[2]) / tau]

    return ode


def lagging(tau: float) -> Ode:
    base = plain()

    def ode(t: float, y: Any, u_e: float, u_d: float, s: bool) -> list[float]:
        return [*base(t, y[:2], y[2], u_d, s), (u_e - y[2]) / tau]

    return ode


def stalling(supply: float) -> Ode:
    def ode(t: float, y: Any, u_e: float, u_d: float, s: bool) -> list[float]:
        p_r, p_c = y
        q_e = u_e * (p_r - p_c) / RE
        q_o = outlet(p_c, p_r, u_d, s) if p_r >= supply else s * p_c / RS
        if u_d > 0.0:
            q_o = max(0.0, q_o)
        return [-A * (q_e + u_d * p_r / RD) / VR, A * (q_e - q_o) / VC]

    return ode


def dead(rows: list[Row], u0: float) -> list[Row]:
    return [(t, max(0.0, (u_e - u0) / (1.0 - u0)), u_d, s) for t, u_e, u_d, s in rows]


def play(rows: list[Row], width: float) -> list[Row]:
    held, out = 0.0, []
    for t, u_e, u_d, s in rows:
        if u_e == 0.0:
            held = 0.0
        elif u_e > held + width / 2.0:
            held = u_e - width / 2.0
        elif u_e < held - width / 2.0:
            held = u_e + width / 2.0
        out.append((t, held, u_d, s))
    return out


def merged(times: set[float], at: Callable[[float], tuple[float, float, bool]]) -> list[Row]:
    return [(t, *at(t)) for t in sorted(times)]


def value(rows: list[Row], t: float) -> tuple[float, float, bool]:
    found = (0.0, 0.0, False)
    for start, *rest in rows:
        if start <= t + 1e-9:
            found = (rest[0], rest[1], bool(rest[2]))
    return found


def late(rows: list[Row], delay: float) -> list[Row]:
    times = {t for t, *_ in rows} | {t + delay for t, *_ in rows}
    return merged(times, lambda t: (value(rows, t - delay)[0], *value(rows, t)[1:]))


def slow_close(rows: list[Row], delay: float) -> list[Row]:
    times = {t for t, *_ in rows} | {t + delay for t, *_ in rows}

    def at(t: float) -> tuple[float, float, bool]:
        u_e, u_d, s = value(rows, t)
        recently = any(value(rows, start)[2] and start <= t for start, *_ in rows) and any(
            value(rows, t - back * delay / 50.0)[2] for back in range(50)
        )
        return u_e, u_d, s or recently

    return merged(times, at)


def solve(ode: Ode, rows: list[Row], start: list[float]) -> dict[int, list[float]]:
    """States every 20 ms, solved piecewise by scipy."""
    found: dict[int, list[float]] = {}
    y = start
    for (t, u_e, u_d, s), end in zip(rows, [row[0] for row in rows[1:]] + [END_S], strict=True):
        if t >= END_S:
            break
        grid = [
            ms for ms in range(0, round(END_S * 1000) + 1, 20) if t * 1000 - 1e-6 <= ms <= end * 1000 + 1e-6
        ]
        solution = integrate.solve_ivp(
            ode, (t, end), y, "LSODA", args=(u_e, u_d, s), rtol=1e-9, atol=1e-9, dense_output=bool(grid)
        )
        assert solution.success, solution.message
        for ms in grid:
            found[ms] = list(solution.sol(min(end, max(t, ms / 1000.0))))
        y = list(solution.y[:, -1])
    return found


def simulate(made: Setup) -> Iterator[tuple[int, Pair, Pair]]:
    """(ms, true pressures, noiseless readings) at every 20 ms."""
    simulator = Simulator(made.plant, at_rest(made.plant, *START))
    quiet = [dataclasses.replace(s, noise_std_kPa=0.0) for s in (made.reservoir_sensor, made.cv_sensor)]
    seen = [rested(p) for p in START]
    readings = [read(sensor, one, p, 0.0)[1] for sensor, one, p in zip(quiet, seen, START, strict=True)]
    for ms in range(round(END_S * 1000) + 1):
        true = simulator.conditions[:2]
        if ms > 0:
            for i in range(2):
                seen[i], readings[i] = read(quiet[i], seen[i], true[i], 0.001)
        if ms % 20 == 0:
            yield ms, true, (readings[0], readings[1])
        simulator.advance(Inputs(*value(SCHEDULE, ms / 1000.0)))


STANDING: dict[str, tuple[dict[str, float], Ode, list[Row], list[float]]] = {
    "none": ({}, plain(), SCHEDULE, []),
    "reservoir_leak": (
        {"flow_resistance_kPa_s_per_SL": 900.0},
        plain(leak_r=lambda p: p / 900.0),
        SCHEDULE,
        [],
    ),
    "cv_leak": ({"flow_resistance_kPa_s_per_SL": 300.0}, plain(leak_c=lambda p: p / 300.0), SCHEDULE, []),
    "viscous_leak": (
        {"conductance_constant_kPa2_s_per_SL": 7e4},
        plain(leak_c=lambda p: gap(p, 7e4)),
        SCHEDULE,
        [],
    ),
    "reservoir_viscous_leak": (
        {"conductance_constant_kPa2_s_per_SL": 8e5},
        plain(leak_r=lambda p: gap(p, 8e5)),
        SCHEDULE,
        [],
    ),
    "orifice_leak": (
        {"sonic_conductance_SL_per_s_kPa": 3e-4},
        plain(leak_c=lambda p: hole(p, 3e-4)),
        SCHEDULE,
        [],
    ),
    "reservoir_orifice_leak": (
        {"sonic_conductance_SL_per_s_kPa": 1e-3},
        plain(leak_r=lambda p: hole(p, 1e-3)),
        SCHEDULE,
        [],
    ),
    "compressible_flow": ({"critical_pressure_ratio": 0.4}, compressible(0.4), SCHEDULE, []),
    "reservoir_cooling": ({"time_constant_s": 6.0}, cooling(6.0), SCHEDULE, [1.0]),
    "cv_heating": ({"time_constant_s": 1.5}, heating(1.5), SCHEDULE, [1.0]),
    "cv_compliance": ({"per_kPa": 0.01}, compliant(0.01), SCHEDULE, []),
    "dead_volume": ({"volume_L": 0.05}, plain(vc=VC + 0.05), SCHEDULE, []),
    "reservoir_volume": ({"scale": 0.9}, plain(vr=VR * 0.9), SCHEDULE, []),
    "evp_restriction": ({"scale": 1.3}, plain(re=RE * 1.3), SCHEDULE, []),
    "evp_dead_zone": ({"opening": 0.3}, plain(), dead(SCHEDULE, 0.3), []),
    "evp_hysteresis": ({"width": 0.2}, plain(), play(SCHEDULE, 0.2), []),
    "evp_lag": ({"time_constant_s": 0.03}, lagging(0.03), SCHEDULE, [0.0]),
    "evp_heating": ({"share": 0.3, "time_constant_s": 2.0}, warming(0.3, 2.0), SCHEDULE, [0.0]),
    "line_delay": ({"delay_s": 0.044}, plain(), late(SCHEDULE, 0.044), []),
    "solenoid_slow_close": ({"delay_s": 0.06}, plain(), slow_close(SCHEDULE, 0.06), []),
    "venturi_stall": ({"supply_pressure_kPa": 540.0}, stalling(540.0), SCHEDULE, []),
    "ambient_drop": ({"rate_kPa_per_s": 0.3}, plain(rise=0.3), SCHEDULE, []),
}


@pytest.mark.parametrize("cause", STANDING)
def test_a_cause_is_its_equation(cause: str) -> None:
    parameters, ode, rows, more = STANDING[cause]
    expected = solve(ode, rows, [*START, *more])
    worst = 0.0
    for ms, true, readings in simulate(setup(RIG, cause, **parameters)):
        worst = max(worst, abs(true[0] - expected[ms][0]), abs(true[1] - expected[ms][1]))
        assert readings == pytest.approx(true, abs=1e-12)
    print(f"{cause}: {worst:.1e} kPa")
    assert worst < 0.005


@pytest.mark.parametrize(
    ("cause", "parameters", "which", "gain", "offset"),
    [
        ("cv_sensor_offset", {"offset_kPa": 1.5}, 1, 1.0, 1.5),
        ("cv_sensor_gain", {"gain": 1.03}, 1, 1.03, 0.0),
        ("reservoir_sensor_offset", {"offset_kPa": -12.0}, 0, 1.0, -12.0),
        ("reservoir_sensor_gain", {"gain": 0.97}, 0, 0.97, 0.0),
    ],
)
def test_a_sensors_error_is_in_the_reading_only(
    cause: str, parameters: dict[str, float], which: int, gain: float, offset: float
) -> None:
    for _, true, readings in simulate(setup(RIG, cause, **parameters)):
        expected = list(true)
        expected[which] = gain * (true[which] + offset)
        assert readings == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(("cause", "which"), [("reservoir_sensor_drift", 0), ("cv_sensor_drift", 1)])
def test_a_sensors_drift_is_a_straight_line(cause: str, which: int) -> None:
    for ms, true, readings in simulate(setup(RIG, cause, rate_kPa_per_min=6.0)):
        expected = list(true)
        expected[which] += ms / 1000.0 * 0.1
        assert readings == pytest.approx(expected, abs=1e-9)


def test_a_sensors_lag_is_its_equation() -> None:
    tau = 0.02
    base = plain()

    def ode(t: float, y: Any, u_e: float, u_d: float, s: bool) -> list[float]:
        return [*base(t, y[:2], u_e, u_d, s), (y[1] - y[2]) / tau]

    expected = solve(ode, SCHEDULE, [*START, START[1]])
    worst = max(
        abs(readings[1] - expected[ms][2])
        for ms, _, readings in simulate(setup(RIG, "cv_sensor_lag", time_constant_s=tau))
    )
    print(f"cv_sensor_lag: {worst:.1e} kPa")
    assert worst < 0.005


def test_every_cause_of_the_table_is_a_setting() -> None:
    causes = {cause.name for cause in catalogue()}
    sensors = {name for name in causes if "sensor" in name}
    # tests/physics/test_pump_and_hose.py has the equations of these.
    elsewhere = {"pump_flow", "pump_stall", "pump_curve", "choked_outlet", "hose"}
    assert set(STANDING) | sensors | elsewhere == causes | {"none"}
    assert len(sensors) == 7


def test_what_cannot_be_set_up() -> None:
    with pytest.raises(KeyError):
        setup(RIG, "gremlins")
    with pytest.raises(ValueError, match="control volume"):
        setup(Rig(cv=None), "dead_volume", volume_L=0.1)
