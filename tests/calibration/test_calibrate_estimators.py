"""The estimators on readings with known truth, without a simulated rig."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_link.protocol import Fault, Mode, Telemetry
from flying_vines.calibration import valve, vine_air
from flying_vines.calibration.evaluation import StageRecording, bend_curve, cv_zero, reservoir_zero
from flying_vines.calibration.findings import (
    Estimate,
    Findings,
    MeasuredQuantity,
    SettingProposal,
)
from flying_vines.calibration.plan import CalibrationRequest, plan
from flying_vines.calibration.readings import Readings, ReadingsBuffer
from flying_vines.calibration.reservoir_balance import Bins, fit_balance
from flying_vines.calibration.rig import CURVE, HYSTERESIS_KPA, SimulatedAngleReader
from flying_vines.calibration.vine_air import AirInputs, VineAir, fit_vine_air, volumes
from flying_vines.config import config
from flying_vines.config.config import PneumaticsConfig
from flying_vines.physics.arrays import Array, BoolArray
from flying_vines.supply.rig_prior import Prior
from flying_vines.vine.curve import BendCurve

TOP_KPA = 20.0
RESERVOIR_L = 2.0
KNOWN = AirInputs(PneumaticsConfig(), Estimate(RESERVOIR_L, 0.0), TOP_KPA, 0.5, 101.325)


def times(n: int, step_s: float) -> Array:
    return np.linspace(0.0, (n - 1) * step_s, n)


def resting(
    seconds: float, cv_kPa: float, seed: int, step_s: float = 0.001, noise_kPa: float = 0.15
) -> Readings:
    """Readings of a vented vine."""
    rng = np.random.default_rng(seed)
    n = round(seconds / step_s)
    none = np.zeros(n)
    return Readings(
        times(n, step_s),
        np.zeros(n, bool),
        none,
        cv_kPa + noise_kPa * rng.standard_normal(n),
        600.0 + 1.2 * rng.standard_normal(n),
        none,
        none,
        np.ones(n, bool),
    )


# Zero.


@given(offset=st.floats(-4.0, 4.0), seed=st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_zero_is_found_and_taken_out(offset: float, seed: int) -> None:
    result = cv_zero(resting(5.0, offset, seed))
    found = result.findings[0]
    assert found.value == pytest.approx(offset, abs=0.02)
    noise = next(finding for finding in result.findings if finding.name == "cv_noise_kPa")
    assert noise.value == pytest.approx(0.15, rel=0.1)
    if abs(offset) > 0.1:
        (proposal,) = result.proposals
        assert proposal.relative and proposal.value == pytest.approx(-offset, abs=0.02)


def test_a_zero_that_wanders_is_not_proposed() -> None:
    still = resting(5.0, 1.0, 1)
    result = cv_zero(replace(still, cv_kPa=still.cv_kPa + still.t_s))
    assert result.proposals == () and result.remarks


def test_a_good_zero_is_left_alone() -> None:
    assert cv_zero(resting(5.0, 0.01, 3)).proposals == ()


# The reservoir's balance.


def reservoir_kPa(taken_kPa: Array, dt_s: float, heat_W_per_K: float) -> Array:
    """The pressure of a reservoir of 2 L at 600 kPa that loses this air; its wall is at ambient temperature.

    By the first law, in SI and with small steps: m c_v dT = h (T_a − T) dt + R T dm.
    """
    ambient_K, gas, heat_J_per_kgK, volume_m3 = 293.15, 287.05, 717.6, 2e-3
    mass = 701_325.0 * volume_m3 / (gas * ambient_K)
    kelvin, read = ambient_K, []
    for lost_kPa in np.diff(taken_kPa, prepend=0.0):
        lost = lost_kPa * 1000.0 * volume_m3 / (gas * ambient_K) / 50.0
        for _ in range(50):
            warmed = heat_W_per_K * (ambient_K - kelvin) * dt_s / 50.0 - gas * kelvin * lost
            kelvin += warmed / (mass * heat_J_per_kgK)
            mass -= lost
        read.append(mass * gas * kelvin / volume_m3 / 1000.0 - 101.325)
    return np.array(read)


@pytest.mark.parametrize("heat_W_per_K", [0.7, 1.0, 1.5, 1000.0])
@pytest.mark.parametrize(("volume", "leak"), [(0.05, 0.0), (0.05, 1e-3), (0.3, 3e-4)])
def test_the_balance_separates_volume_leak_and_cold(volume: float, leak: float, heat_W_per_K: float) -> None:
    rng = np.random.default_rng(7)
    dt_s, n, noise_kPa = 0.2, 600, 0.03
    # A rest, then inflations with unequal pauses.
    begins = np.cumsum([200, 45, 35, 60, 50, 40, 70])
    rises = 20.0 * np.searchsorted(begins, np.arange(n), "right").astype(np.float64)
    held = np.cumsum(np.full(n, dt_s)) * 600.0
    kPa = reservoir_kPa(volume * rises + leak * held, dt_s, heat_W_per_K)
    read = kPa + noise_kPa * rng.standard_normal(n)
    columns = {"volume": rises, "leak": held}
    bins = Bins(times(n, dt_s), np.zeros(n), read, columns, np.ones(n, bool), noise_kPa)
    found = fit_balance(bins, {}, RESERVOIR_L)
    assert found.values["volume"].value == pytest.approx(volume, rel=0.05)
    assert found.values["leak"].value == pytest.approx(leak, abs=5e-5 + 0.05 * leak)
    # Without volume and leak the pressure is constant.
    assert np.std(found.without("volume", "leak")) < 0.1 + 0.01 * np.ptp(kPa)


def test_a_parameter_without_data_keeps_its_prior() -> None:
    t = times(200, 0.2)
    flat = {"never": np.zeros(200)}
    found = fit_balance(
        Bins(t, t, np.full(200, 500.0), flat, np.ones(200, bool), 0.1), {"never": Prior(3.0, 2.0)}, 2.0
    )
    assert found.values["never"].value == pytest.approx(3.0) and found.values["never"].sd >= 2.0


# Inflations through a valve with a start, a gain and a play.


def filled(litres: float, start: float, gain: float, play: float, seed: int = 1) -> Readings:
    """Inflations at several openings from 5 to 20 kPa, without heat or leak.

    The valve passes `gain` SL/s per opening at any supply pressure.
    """
    rng = np.random.default_rng(seed)
    step_s = 0.001
    command: list[Array] = []
    setpoint: list[Array] = []
    regulating: list[BoolArray] = []
    solenoid: list[BoolArray] = []

    def add(seconds: float, u: float, kPa: float, held: bool) -> None:
        n = round(seconds / step_s)
        command.append(np.full(n, u))
        setpoint.append(np.full(n, kPa))
        regulating.append(np.full(n, held))
        solenoid.append(np.full(n, not held))

    add(6.0, 0.0, 0.0, False)
    for over in (0.01, 0.02, 0.05, 0.1, 0.2, 0.05, 0.02):
        for low, high in ((0.0, 5.0), (5.0, 20.0)):
            seconds = (high - low) * litres / 101.325 / (gain * over)
            add(seconds, start + over, high, True)
            add(1.5, 0.0, high, True)
        add(1.5, 0.0, 0.0, False)
    u, held, is_open = np.concatenate(command), np.concatenate(regulating), np.concatenate(solenoid)
    n = len(u)
    passed = np.zeros(n)
    on = np.flatnonzero(u > 0.0)
    passed[on] = gain * np.maximum(0.0, valve.after_play(u, np.array([play]))[:, 0] - start)
    cv = np.zeros(n)
    for k in range(1, n):
        cv[k] = 0.0 if is_open[k] else cv[k - 1] + passed[k - 1] * step_s * 101.325 / litres
    taken = np.cumsum(passed) * step_s * 101.325 / RESERVOIR_L
    return Readings(
        times(n, step_s),
        held,
        np.concatenate(setpoint),
        cv + 0.02 * rng.standard_normal(n),
        650.0 - taken + 0.2 * rng.standard_normal(n),
        u,
        np.zeros(n),
        is_open,
    )


@pytest.fixture(scope="module")
def seen() -> tuple[Readings, VineAir]:
    readings = filled(0.15, 0.35, 0.5, 0.06)
    return readings, fit_vine_air(readings, KNOWN)


def test_the_volume_is_found(seen: tuple[Readings, VineAir]) -> None:
    _, vine = seen
    found = vine.volume()
    assert found.value == pytest.approx(0.15, rel=0.04)
    assert found.low <= 0.15 <= found.high
    assert vine.air_SL(0.0, TOP_KPA) == pytest.approx(0.15 * TOP_KPA / 101.325, rel=0.04)
    by_name = {finding.name: finding for finding in volumes(vine).findings}
    assert by_name["refill_air_SL"].value is None and "none seen" in by_name["refill_air_SL"].note


def test_start_and_gain_of_the_valve(seen: tuple[Readings, VineAir]) -> None:
    readings, vine = seen
    opened = valve.fit_valve(readings, vine)
    assert not isinstance(opened, str)
    assert opened.start.value == pytest.approx(0.35, abs=0.003)
    supply_kPa = float(np.mean(readings.reservoir_kPa)) + 101.325
    assert opened.gain.value * supply_kPa == pytest.approx(0.5, rel=0.06)


def every_tenth(readings: Readings) -> Readings:
    return Readings(*(getattr(readings, name)[::10] for name in Readings.__dataclass_fields__))


def test_slow_telemetry_does_not_measure_the_valve(seen: tuple[Readings, VineAir]) -> None:
    readings, vine = seen
    reason = valve.fit_valve(every_tenth(readings), vine)
    assert isinstance(reason, str) and "100 Hz" in reason
    result = valve.inflation_valve(every_tenth(readings), vine)
    assert all(finding.value is None and finding.note == reason for finding in result.findings)
    assert result.proposals == ()


def test_a_vessel_of_known_volume_measures_the_reservoir(seen: tuple[Readings, VineAir]) -> None:
    _, vine = seen
    (found,) = vine_air.vessel_volume(vine, 0.15).findings
    assert found.value == pytest.approx(RESERVOIR_L, rel=0.04)
    assert found.assumed == PneumaticsConfig().reservoir_volume_L


@given(width=st.floats(0.0, 0.2), commands=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=30))
def test_a_play_stays_within_its_width(width: float, commands: list[float]) -> None:
    u = np.array(commands)
    passed = valve.after_play(u, np.array([width]))[:, 0]
    open_ = u[u > 0.0]
    assert np.all(passed >= open_ - 1e-12) and np.all(passed <= open_ + width + 1e-12)


def test_the_outlets_resistance_is_found_from_the_decay(seen: tuple[Readings, VineAir]) -> None:
    _, vine = seen
    resistance, litres, delay_s = 60.0, vine.volume().value, 0.015
    n, held = 4000, 1000
    t = times(n, 0.001)
    after = np.maximum(0.0, t - t[held] - delay_s)
    kPa = 20.0 * np.exp(-after * 101.325 / (resistance * litres))
    none = np.zeros(n)
    vented = np.arange(n) >= held
    readings = Readings(t, ~vented, np.where(vented, 0.0, 20.0), kPa, none + 600.0, none, none, vented)
    (found,) = valve.outlet(readings, vine).findings
    assert found.low is not None and found.high is not None
    assert found.low <= resistance <= found.high
    assert found.value == pytest.approx(resistance * (1.0 + valve.COLD), rel=0.05)


def test_without_a_vent_the_outlet_is_unknown(seen: tuple[Readings, VineAir]) -> None:
    (found,) = valve.outlet(resting(2.0, 0.0, 1), seen[1]).findings
    assert found.value is None and found.note


def test_without_a_volume_what_depends_on_it_is_unknown(seen: tuple[Readings, VineAir]) -> None:
    readings, vine = seen
    vague = replace(vine.balance, values={**vine.balance.values, "volume": Estimate(-0.03, 0.05)})
    unsure = replace(vine, balance=vague)
    for result in (
        volumes(unsure),
        valve.inflation_valve(readings, unsure),
        valve.outlet(readings, unsure),
    ):
        for finding in result.findings:
            if finding.name.startswith(("cv_volume", "evp", "outlet")):
                assert finding.value is None and finding.note
        assert result.proposals == ()


# Stages.


def recorded(stage: str, readings: Readings, findings: Findings, **request: float) -> Findings:
    calibration = plan(config.default(), CalibrationRequest(asks_angles=False, **request))  # type: ignore[arg-type]
    return StageRecording(calibration, stage, readings, findings, 101.325).result()


def test_a_large_vessel_counts_only_after_its_gas_has_cooled() -> None:
    """Warm gas of a rise fills a part of the vessel, and the regulator replaces it as it cools."""
    step_s, tau_s = 0.01, 2.0
    points = [(0.0, 0.0)]

    def move(seconds: float, kPa: float) -> None:
        points.append((points[-1][0] + seconds, kPa))

    for _ in range(3):
        move(6.0, 0.0)
        for level in (1, 2, 3):
            move(0.5, TOP_KPA * level / 3.0)
            move(7.5, TOP_KPA * level / 3.0)
        move(step_s, 0.0)
    move(6.0, 0.0)
    t_s = np.arange(0.0, points[-1][0], step_s)
    setpoint = np.interp(t_s, *np.transpose(points))
    setpoint[np.diff(setpoint, prepend=0.0) < -1e-9] = 0.0
    held = setpoint > 0.0
    rises = np.clip(np.diff(setpoint, prepend=0.0), 0.0, None)
    warm_kPa = np.zeros(len(t_s))
    for k in np.flatnonzero(held):
        warm_kPa[k] = warm_kPa[k - 1] * np.exp(-step_s / tau_s) + 0.2 * rises[k]
    flowed_kPa = np.cumsum(np.clip(np.diff(setpoint - warm_kPa, prepend=0.0), 0.0, None))
    readings = Readings(
        t_s,
        held,
        setpoint,
        setpoint,
        650.0 - flowed_kPa / RESERVOIR_L + 0.2 * np.random.default_rng(2).standard_normal(len(t_s)),
        np.where(np.diff(flowed_kPa, prepend=0.0) > 0.0, 0.1, 0.0),
        np.zeros(len(t_s)),
        ~held,
    )
    (found,) = recorded("vessel", readings, Findings(), vessel_L=1.0).findings
    assert found.low is not None and found.high is not None
    assert found.low <= RESERVOIR_L <= found.high


def test_the_measured_zero_of_the_reservoirs_sensor_is_used() -> None:
    resistance, zero_kPa = 20_000.0, 30.0
    still = resting(30.0, 0.0, 4, step_s=0.01)
    leaking = 600.0 * np.exp(-still.t_s * 101.325 / (resistance * RESERVOIR_L))
    readings = replace(still, reservoir_kPa=still.reservoir_kPa - 600.0 + leaking + zero_kPa)
    zero_found = reservoir_zero(replace(still, reservoir_kPa=still.reservoir_kPa - 600.0 + zero_kPa))

    def leak(findings: Findings) -> MeasuredQuantity:
        result = recorded("reservoir_leak", readings, findings, reservoir_volume_L=RESERVOIR_L)
        return next(found for found in result.findings if found.name == "reservoir_leak_kPa_s_per_SL")

    known, unknown = leak(Findings().renewed_by(zero_found)), leak(Findings())
    assert known.value is not None and known.low is not None and known.high is not None
    assert known.value == pytest.approx(resistance, rel=0.01)
    assert unknown.low is not None and unknown.high is not None
    assert known.high - known.low < 0.8 * (unknown.high - unknown.low)


# Angles.


def test_a_curve_is_found_from_read_angles() -> None:
    reader = SimulatedAngleReader(seed=3)
    levels = [*np.linspace(0.0, 20.0, 13), *np.linspace(20.0, 0.0, 13)[1:]]
    pairs = tuple((float(kPa), reader.read(float(kPa))) for kPa in levels)
    result = bend_curve(pairs)
    truth = BendCurve(CURVE, HYSTERESIS_KPA)
    found = BendCurve(result.curve)
    for kPa in (5.0, 10.0, 15.0, 19.0):
        assert found.angle_deg(kPa) == pytest.approx(truth.angle_deg(kPa), abs=3.0)
    assert result.hysteresis_kPa == pytest.approx(HYSTERESIS_KPA, abs=0.5)


def test_too_few_angles_give_no_curve() -> None:
    result = bend_curve(((0.0, 0.0), (10.0, 30.0)))
    assert result.curve == () and "2 angles" in result.findings[0].note


# Records.


def test_a_clock_that_wraps_goes_on() -> None:
    buffer = ReadingsBuffer()
    for ms in (2**32 - 2, 2**32 - 1, 0, 1):
        buffer.append(Telemetry(ms, Mode.VENT, Fault.NONE, 0, 0.0, 0.1, 600.0, 0.0, 0.0, True))
    readings = buffer.readings()
    assert readings.t_s.tolist() == [0.0, 0.001, 0.002, 0.003]
    assert readings.solenoid.all() and not readings.regulating.any()
    assert len(buffer.readings(2)) == 2


def test_the_newest_finding_counts_and_is_plain_json() -> None:
    first = Findings((MeasuredQuantity("a", "what", "kPa", 1.0, 0.5, 1.5), MeasuredQuantity("b", "b", "")))
    second = Findings(
        (MeasuredQuantity("a", "what", "kPa").unknown("gone"),),
        (SettingProposal("s", 1.0, True, "why"),),
        ("said",),
    )
    findings = Findings(pairs=((1.0, 2.0),)).renewed_by(first).renewed_by(second).renewed_by(second)
    assert [finding.name for finding in findings.findings] == ["a", "b"]
    assert findings.estimate("a") is None and findings.remarks == ("said",)
    assert json.loads(json.dumps(findings.as_json()))["pairs"] == [[1.0, 2.0]]
