"""Bend angle and pressure: there and back, dead zones, and invalid curves."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flying_vines.vine.curve import BendCurve

steps = st.floats(0.01, 50.0)
rises = st.one_of(st.just(0.0), st.floats(0.01, 50.0))


@st.composite
def pairs(draw: st.DrawFn) -> list[tuple[float, float]]:
    pressure, angle = draw(st.floats(-5, 5)), draw(st.floats(-90, 90))
    made = [(pressure, angle)]
    for step, rise in draw(st.lists(st.tuples(steps, rises), min_size=1, max_size=8)):
        made.append((made[-1][0] + step, made[-1][1] + rise))
    return made


@given(pairs(), st.floats(0, 1))
def test_an_angles_pressure_gives_that_angle(curve_pairs: list[tuple[float, float]], part: float) -> None:
    curve = BendCurve(curve_pairs)
    angle_deg = curve.min_deg + part * (curve.max_deg - curve.min_deg)
    assert curve.angle_deg(curve.pressure_kPa(angle_deg)) == pytest.approx(angle_deg, abs=1e-6)


@given(pairs(), st.floats(-100, 500), st.floats(0, 100))
def test_both_ways_never_fall_and_stay_within(
    curve_pairs: list[tuple[float, float]], at: float, further: float
) -> None:
    curve = BendCurve(curve_pairs)
    lowest_kPa, highest_kPa = curve_pairs[0][0], curve_pairs[-1][0]
    assert (
        curve.min_deg <= curve.angle_deg(at) <= curve.angle_deg(at + further) + 1e-9 <= curve.max_deg + 2e-9
    )
    assert (
        lowest_kPa <= curve.pressure_kPa(at) <= curve.pressure_kPa(at + further) + 1e-9 <= highest_kPa + 2e-9
    )
    assert curve.max_kPa == highest_kPa


@given(pairs())
def test_every_calibrated_pair_is_met(curve_pairs: list[tuple[float, float]]) -> None:
    curve = BendCurve(curve_pairs)
    for pressure_kPa, angle_deg in curve_pairs:
        assert curve.angle_deg(pressure_kPa) == pytest.approx(angle_deg)
        lowest_kPa = min(kPa for kPa, deg in curve_pairs if deg == angle_deg)
        assert curve.pressure_kPa(angle_deg) == pytest.approx(lowest_kPa)


@pytest.mark.parametrize(
    ("curve_pairs", "angle_deg", "pressure_kPa"),
    [
        ([(0, 0), (2, 0), (20, 60)], 0.0, 0.0),
        ([(0, 0), (2, 0), (20, 60)], 1e-9, 2.0),
        ([(0, 0), (2, 0), (20, 60)], 30.0, 11.0),
        ([(0, 0), (5, 30), (8, 30), (20, 60)], 30.0, 5.0),
        ([(0, 0), (5, 30), (8, 30), (20, 60)], 30.0001, 8.0),
        ([(0, 0), (20, 60), (25, 60), (30, 60)], 60.0, 20.0),
        ([(0, 0), (20, 60)], 90.0, 20.0),
        ([(0, 0), (20, 60)], -5.0, 0.0),
    ],
)
def test_in_a_dead_zone_the_lowest_pressure_serves(
    curve_pairs: list[tuple[float, float]], angle_deg: float, pressure_kPa: float
) -> None:
    assert BendCurve(curve_pairs).pressure_kPa(angle_deg) == pytest.approx(pressure_kPa, abs=1e-4)


def test_it_stays_flat_beyond_its_ends() -> None:
    curve = BendCurve([(1, -10), (3, 20)])
    assert (curve.angle_deg(-100), curve.angle_deg(0.9)) == (-10, -10)
    assert (curve.angle_deg(3.1), curve.angle_deg(1e9)) == (20, 20)


@pytest.mark.parametrize(
    ("curve_pairs", "reason"),
    [
        ([], "at least two pairs"),
        ([(0, 0)], "at least two pairs"),
        ([(0, 0), (0, 10)], "pressures .* must rise"),
        ([(0, 0), (5, 10), (4, 20)], "pressures .* must rise"),
        ([(0, 0), (5, 10), (6, 9.9)], "angles .* must not fall"),
        ([(0, 0), (math.nan, 10)], "must be a finite number"),
        ([(0, 0), (5, math.nan)], "must be a finite number"),
        ([(0, 0), (math.inf, 10)], "must be a finite number"),
        ([(0, -math.inf), (5, 10)], "must be a finite number"),
    ],
)
def test_an_invalid_curve_gives_a_sentence(curve_pairs: list[tuple[float, float]], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        BendCurve(curve_pairs)


# Hysteresis: a bend remains when the pressure falls.

widths = st.floats(0.0, 6.0)
RISING = ((0.0, 0.0), (2.0, 0.0), (20.7, 60.0))


def bent_after(curve: BendCurve, pressures_kPa: list[float]) -> float:
    bent_kPa = 0.0
    for pressure_kPa in pressures_kPa:
        bent_kPa = curve.bent_kPa(pressure_kPa, bent_kPa)
    return bent_kPa


@given(widths, st.lists(st.floats(0, 20.7), max_size=8), st.floats(0, 60))
def test_the_pressure_toward_an_angle_brings_the_vine_there(
    width_kPa: float, before_kPa: list[float], angle_deg: float
) -> None:
    curve = BendCurve(RISING, width_kPa)
    bent_kPa = bent_after(curve, before_kPa)
    wanted_kPa = curve.pressure_kPa(angle_deg)
    pressure_kPa = curve.toward_kPa(wanted_kPa, bent_kPa)
    reached_deg = curve.angle_deg(curve.bent_kPa(pressure_kPa, bent_kPa))
    assert 0.0 <= pressure_kPa <= max(wanted_kPa, 0.0)
    if pressure_kPa > 0.0 or wanted_kPa >= width_kPa:
        assert reached_deg == pytest.approx(angle_deg, abs=1e-9)
    else:
        assert angle_deg - 1e-9 <= reached_deg <= max(angle_deg, curve.angle_deg(width_kPa)) + 1e-9


@given(widths, st.lists(st.floats(0, 20.7), min_size=1, max_size=12))
def test_a_bend_lies_within_the_hysteresis_above_its_pressure(
    width_kPa: float, pressures_kPa: list[float]
) -> None:
    bent_kPa = bent_after(BendCurve(RISING, width_kPa), pressures_kPa)
    assert pressures_kPa[-1] <= bent_kPa <= pressures_kPa[-1] + width_kPa
    assert bent_kPa <= max(pressures_kPa)


def test_a_bend_stays_while_the_pressure_falls_by_less_than_the_hysteresis() -> None:
    curve = BendCurve(RISING, 3.0)
    assert [curve.bent_kPa(kPa, 15.0) for kPa in (16.0, 15.0, 12.0, 11.0, 0.0)] == [
        16.0,
        15.0,
        15.0,
        14.0,
        3.0,
    ]


def test_without_hysteresis_a_bend_is_that_of_its_pressure() -> None:
    curve = BendCurve(RISING)
    assert bent_after(curve, [20.7, 3.0, 12.5]) == 12.5
    assert curve.toward_kPa(9.0, 12.5) == 9.0


def test_a_reading_that_is_no_number_changes_no_bend() -> None:
    assert BendCurve(RISING, 3.0).bent_kPa(math.nan, 15.0) == 15.0


@pytest.mark.parametrize("width_kPa", [-0.1, 20.7, math.nan, math.inf])
def test_a_hysteresis_that_leaves_nothing_is_refused(width_kPa: float) -> None:
    with pytest.raises(ValueError, match="hysteresis must be 0 or more, and narrower"):
        BendCurve(RISING, width_kPa)
