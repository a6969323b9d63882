"""The design guide agrees with the paper's demonstration, and its numbers change in the right direction."""

from __future__ import annotations

import dataclasses
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flying_vines.physics import paper
from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.studies.design import Evaluation, PartsChoice, Robot, catalogue, demonstration, evaluate
from flying_vines.studies.design.parts import PositiveNumber
from flying_vines.studies.design.show import notes

PROTOTYPE = catalogue().choose()
ROBOT = demonstration()
FACTOR = st.floats(1.01, 20.0)


def robot(**changes: object) -> Robot:
    return msgspec.convert({**msgspec.to_builtins(ROBOT), **changes}, Robot)


def number(value: float) -> PositiveNumber:
    return PositiveNumber(value=value, source="the test")


def with_bottle(volume_L: float) -> PartsChoice:
    bottle = msgspec.structs.replace(PROTOTYPE.reservoir, volume_L=number(volume_L))
    return replaced(reservoir=bottle)


def with_resistance(factor: float) -> PartsChoice:
    resistance = number(factor * PROTOTYPE.evp.resistance_kPa_s_per_SL)
    return replaced(evp=msgspec.structs.replace(PROTOTYPE.evp, flow_resistance_kPa_s_per_SL=resistance))


def replaced(**changes: Any) -> PartsChoice:
    return dataclasses.replace(PROTOTYPE, **changes)


@pytest.fixture(scope="module")
def demo() -> Evaluation:
    return evaluate(ROBOT, PROTOTYPE)


def test_the_demonstration_has_the_papers_cycles(demo: Evaluation) -> None:
    assert demo.cycles == demo.cycles_rigid == pytest.approx(311, abs=0.5)
    assert demo.operating_s == pytest.approx(311 / 0.55, abs=1.0)
    assert demo.shortfalls == ()


def test_a_sine_is_steeper_than_a_triangle() -> None:
    assert evaluate(robot(wave="sine"), PROTOTYPE).cycles == pytest.approx(298.5, abs=0.05)


def test_a_pouch_takes_more_air(demo: Evaluation) -> None:
    assert demo.cycles_pouch_air == pytest.approx(53, abs=0.5)
    pouch = evaluate(robot(cv_kind="pouch", least_cycles=0.0), PROTOTYPE)
    assert pouch.cycles == pouch.cycles_pouch == demo.cycles_pouch < demo.cycles_pouch_air
    assert pouch.inflation_kPa_per_s < demo.inflation_kPa_per_s
    spare_SL = PROTOTYPE.reservoir_volume_L * (pouch.fill_kPa - pouch.least_kPa) / ALPHA_KPA
    assert pouch.cycles == pytest.approx(spare_SL / (2.0 * pouch.robot.pouch_fill_SL))


def test_passive_venting_doubles_the_cycles(demo: Evaluation) -> None:
    assert demo.cycles_passive == pytest.approx(2.0 * demo.cycles)
    passive = evaluate(ROBOT, replaced(venturi=None, dvp=None))
    assert passive.cycles == demo.cycles_passive
    assert passive.deflation_kPa_per_s == passive.passive_kPa_per_s < demo.deflation_kPa_per_s
    assert passive.mass_kg < demo.mass_kg


def test_the_mass_is_the_papers_and_its_printed_part_is_known(demo: Evaluation) -> None:
    assert demo.mass_kg == pytest.approx(0.84)
    assert demo.total_kg == pytest.approx(1.4)
    # The paper prints only the masses of EVP, DVP and reservoir.
    assert demo.mass_by_origin_kg["printed"] == pytest.approx(0.077 + 0.139 + 0.070)
    assert sum(demo.mass_by_origin_kg.values()) == pytest.approx(demo.mass_kg)


def test_the_power_is_near_the_papers(demo: Evaluation) -> None:
    assert demo.power_W == pytest.approx(3.0, rel=0.2)


def test_bandwidth_takes_its_swing_peak_to_peak() -> None:
    tc4 = evaluate(robot(cv_volume_L=0.5, pressure_kPa=20.7, fill_kPa=689.0), PROTOTYPE)
    speed = paper.inflation_rate_kPa_per_s(689.0, 2042.05, 0.5)
    assert tc4.inflation_kPa_per_s == pytest.approx(speed)
    assert tc4.bandwidth_Hz == pytest.approx(speed / (np.pi * 20.7))


def test_curves_run_from_empty_to_full(demo: Evaluation) -> None:
    assert demo.reservoir_kPa[0] == 0.0
    assert demo.reservoir_kPa[-1] == demo.fill_kPa == 690.0
    assert np.all(np.diff(demo.inflation_curve_kPa_per_s) > 0.0)
    assert np.all(np.diff(demo.deflation_curve_kPa_per_s) >= -1e-9)
    assert np.all(demo.deflation_curve_kPa_per_s >= demo.passive_kPa_per_s)
    at_least = np.interp(demo.least_kPa, demo.reservoir_kPa, demo.inflation_curve_kPa_per_s)
    assert at_least == pytest.approx(ROBOT.wanted_inflation_kPa_per_s)


def test_where_the_venturi_is_needed_it_needs_pressure(demo: Evaluation) -> None:
    assert demo.least_for_deflation_kPa == 0.0
    hurried = evaluate(robot(deflation_rate_kPa_per_s=100.0), PROTOTYPE)
    assert not hurried.passive_is_enough
    least = hurried.least_for_deflation_kPa
    assert least is not None
    assert hurried.least_kPa < least < hurried.fill_kPa
    assert any("deflation is slower than wanted" in note for note in notes(hurried))
    assert evaluate(robot(deflation_rate_kPa_per_s=1e5), PROTOTYPE).least_for_deflation_kPa is None


def test_parts_limit_the_fill() -> None:
    assert evaluate(robot(fill_kPa=2000.0), PROTOTYPE).fill_kPa == 690.0


def test_requirements_that_are_not_met_are_listed() -> None:
    wishes = robot(inflation_rate_kPa_per_s=5000.0, frequency_Hz=None, least_cycles=1e5, payload_kg=1.0)
    found = " ".join(evaluate(wishes, PROTOTYPE).shortfalls)
    for word in ("inflation", "deflation", "cycles", "payload"):
        assert word in found
    assert evaluate(wishes, PROTOTYPE).cycles == 0.0


@given(FACTOR)
def test_more_volume_more_cycles(factor: float) -> None:
    small, large = evaluate(ROBOT, with_bottle(0.2)), evaluate(ROBOT, with_bottle(0.2 * factor))
    assert large.cycles > small.cycles
    assert large.cycles_pouch > small.cycles_pouch
    assert large.full_open_s > small.full_open_s


@given(FACTOR)
def test_more_resistance_is_slower_and_lasts_for_fewer_cycles(factor: float) -> None:
    low, high = evaluate(ROBOT, with_resistance(1.0)), evaluate(ROBOT, with_resistance(factor))
    assert high.inflation_kPa_per_s < low.inflation_kPa_per_s
    assert high.bandwidth_Hz < low.bandwidth_Hz
    assert high.least_kPa > low.least_kPa
    assert high.cycles < low.cycles


@given(FACTOR)
def test_a_larger_robot_is_slower_and_has_fewer_cycles(factor: float) -> None:
    large = evaluate(robot(cv_volume_L=0.1 * factor), PROTOTYPE)
    small = evaluate(ROBOT, PROTOTYPE)
    assert large.inflation_kPa_per_s < small.inflation_kPa_per_s
    assert large.deflation_kPa_per_s < small.deflation_kPa_per_s
    assert large.cycles < small.cycles


@given(
    volume_L=st.floats(1e-6, 1e6),
    pressure_kPa=st.floats(1e-6, 1e6),
    frequency_Hz=st.floats(1e-6, 1e6),
    kind=st.sampled_from(["rigid", "pouch"]),
)
def test_the_results_are_finite_for_any_robot(
    volume_L: float, pressure_kPa: float, frequency_Hz: float, kind: str
) -> None:
    wild = robot(cv_volume_L=volume_L, pressure_kPa=pressure_kPa, frequency_Hz=frequency_Hz, cv_kind=kind)
    e = evaluate(wild, PROTOTYPE)
    results = [e.cycles, e.cycles_passive, e.inflation_kPa_per_s, e.deflation_kPa_per_s, e.operating_s]
    assert np.all(np.isfinite([*results, e.bandwidth_Hz, e.least_kPa, e.full_open_s]))
    assert min(results) >= 0.0
