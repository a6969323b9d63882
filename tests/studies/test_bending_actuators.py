"""The actuators without body: closed forms, virtual work, and more force at more pressure."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ellipe, ellipk

from flying_vines.studies.bending.actuator import BendingActuator, burst_kPa, force_N, free, held_at, volume_L
from flying_vines.studies.bending.cpam import Cpam, complete_elliptic
from flying_vines.studies.bending.fpam import Fpam
from flying_vines.studies.bending.pouch_motor import PouchMotor

STIFF_MPa = 10_000.0
"""A film of 10 mm, which does not stretch."""


def pouch(modulus_MPa: float = STIFF_MPa, film_um: float = 10_000.0, **keys: float) -> PouchMotor:
    sizes = {"pouch_length_mm": 40.0, "width_mm": 30.0, "strength_N_per_mm": 0.75} | keys
    return PouchMotor(**sizes, count=8, film_um=film_um, modulus_MPa=modulus_MPa)


def cpam(modulus_MPa: float = STIFF_MPa, film_um: float = 10_000.0, width_mm: float = 40.0) -> Cpam:
    return Cpam(45.0, width_mm, count=7, film_um=film_um, modulus_MPa=modulus_MPa, strength_N_per_mm=3.0)


def fpam(angle_deg: float = 32.0, stiffness_N: float = 0.0) -> Fpam:
    return Fpam(300.0, 12.0, angle_deg, strength_N_per_mm=3.0, stiffness_N=stiffness_N)


KINDS: list[BendingActuator] = [
    pouch(),
    pouch(200.0, 75.0),
    cpam(),
    cpam(300.0, 80.0),
    cpam(width_mm=100.0),
    fpam(),
    fpam(30.0, 40.0),
]


def test_a_pouch_motor_shortens_by_a_third_and_pulls_no_more() -> None:
    state = free(pouch(), 20.7)
    assert float(state.contraction) == pytest.approx(1.0 - 2.0 / math.pi, abs=1e-5)
    assert float(state.contraction) == pytest.approx(0.363, abs=5e-4)
    assert float(state.force_N) == pytest.approx(0.0, abs=1e-9)


def test_a_pouch_motors_force_is_niiyamas() -> None:
    theta = math.radians(50.0)
    at = 1.0 - math.sin(theta) / theta
    assert float(force_N(pouch(), 20.7, at)) == pytest.approx(
        20_700.0 * 0.030 * 0.040 * math.cos(theta) / theta, rel=1e-4
    )


def test_a_free_pouch_is_a_round_tube() -> None:
    # Two arcs of 40 mm are a circle with a circumference of 80 mm.
    radius_m = 0.080 / (2.0 * math.pi)
    assert float(free(pouch(), 5.0).volume_L) == pytest.approx(
        8 * 0.030 * math.pi * radius_m**2 * 1000.0, rel=1e-4
    )


def test_a_film_that_stretches_shortens_less_and_pulls_with_a_finite_force() -> None:
    soft = pouch(200.0, 75.0)
    assert float(free(soft, 20.7).contraction) < 0.36
    # th³ = 3 P L/(E t), from sin θ/θ ≈ 1 − θ²/6 where the ends are held.
    theta = (3.0 * 1000.0 * 0.040 / 15_000.0) ** (1 / 3)
    held = float(force_N(soft, 1.0, 0.0))
    assert held == pytest.approx(1000.0 * 0.030 * 0.040 * math.cos(theta) / math.sin(theta), rel=0.01)


@pytest.mark.parametrize(
    ("angle_deg", "contraction"), [(45.0, 1.0 - math.sqrt(2.0 / 3.0)), (30.0, 1.0 / 3.0), (20.0, 0.3856)]
)
def test_a_mckibben_shortens_until_its_threads_cross_at_54_7_degrees(
    angle_deg: float, contraction: float
) -> None:
    state = free(fpam(angle_deg), 50.0)
    assert float(state.contraction) == pytest.approx(contraction, abs=1e-4)
    left = 1.0 - float(state.contraction)
    assert math.degrees(math.acos(left * math.cos(math.radians(angle_deg)))) == pytest.approx(
        54.7356, abs=1e-3
    )


def test_a_mckibben_at_rest_pulls_like_chou_and_hannafords() -> None:
    # F = π r² P (3 cos² α − 1)/sin² α; the tube is a cylinder of its radius.
    angle = math.radians(32.0)
    force = math.pi * 0.012**2 * 20_000.0 * (3.0 * math.cos(angle) ** 2 - 1.0) / math.sin(angle) ** 2
    assert float(force_N(fpam(), 20.0, 0.0)) == pytest.approx(force, rel=1e-6)
    assert float(volume_L(fpam(), 20.0, 0.0)) == pytest.approx(math.pi * 0.12**2 * 3.0, rel=1e-6)


def test_elastic_fabric_shortens_less_the_lower_the_pressure() -> None:
    shortened = free(fpam(stiffness_N=40.0), np.array([5.0, 20.0, 80.0])).contraction
    assert np.all(np.diff(shortened) > 0.02)
    assert shortened[-1] < fpam().ideal_contraction


def test_elliptic_integrals_are_scipys() -> None:
    m = np.linspace(1e-6, 0.5, 200)
    first, second = complete_elliptic(m)
    np.testing.assert_allclose(first, ellipk(m), rtol=1e-14)
    np.testing.assert_allclose(second, ellipe(m), rtol=1e-14)


def test_a_wide_chamber_becomes_a_mylar_balloon() -> None:
    # Its meridian a from pole to equator inflates to 0.7627 a, 0.4570 a half as thick; volume 1.2185 a³.
    wide = Cpam(100.0, 1000.0, 1, film_um=10_000.0, modulus_MPa=STIFF_MPa, strength_N_per_mm=3.0)
    state = free(wide, 10.0)
    assert 1.0 - float(state.contraction) == pytest.approx(2.0 * 0.4570 / 2.0, abs=2e-4)
    assert float(state.volume_L) == pytest.approx(1.2185 * 0.5**3, rel=1e-3)


@pytest.mark.parametrize(("width_mm", "contraction"), [(29.7, 0.30), (39.6, 0.40)])
def test_a_cpams_force_vanishes_at_30_to_40_percent(width_mm: float, contraction: float) -> None:
    # 1.424 r₀ per chamber's length, r₀ the radius of the tube laid flat.
    state = free(cpam(width_mm=width_mm), 20.0)
    assert float(state.contraction) == pytest.approx(contraction, abs=2e-3)
    assert float(state.force_N) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("actuator", KINDS)
@pytest.mark.parametrize("pressure_kPa", [2.0, 20.7, 60.0])
def test_virtual_work(actuator: BendingActuator, pressure_kPa: float) -> None:
    """F dL = dU − p dV along the whole stroke."""
    most = float(free(actuator, pressure_kPa).contraction)
    contraction = np.linspace(0.01, 0.99, 2001) * most
    state = held_at(actuator, pressure_kPa, contraction)
    length_m = actuator.length_m * (1.0 - contraction)
    given_J = np.diff(state.elastic_J) - pressure_kPa * np.diff(state.volume_L)
    pulled_J = 0.5 * (state.force_N[1:] + state.force_N[:-1]) * np.diff(length_m)
    scale_J = float(np.sum(np.abs(pulled_J)))
    np.testing.assert_allclose(np.cumsum(given_J), np.cumsum(pulled_J), atol=2e-5 * scale_J)


@pytest.mark.parametrize("actuator", KINDS)
@given(st.floats(0.5, 40.0), st.floats(1.0, 1.5), st.floats(0.0, 0.3), st.floats(0.0, 0.1))
@settings(max_examples=8, deadline=None)
def test_pull_rises_with_pressure_and_falls_with_contraction(
    actuator: BendingActuator, pressure_kPa: float, times: float, contraction: float, further: float
) -> None:
    most = float(free(actuator, pressure_kPa).contraction)
    less, more = min(contraction, most), min(contraction + further, most)
    pull = float(force_N(actuator, pressure_kPa, less))
    assert float(force_N(actuator, times * pressure_kPa, less)) >= pull - 1e-6 * abs(pull) - 1e-9
    assert float(force_N(actuator, pressure_kPa, more)) <= pull + 1e-6 * abs(pull) + 1e-9
    # A film that stretches may lose volume as it relaxes, but never more than its energy allows.
    before, after = (held_at(actuator, pressure_kPa, at) for at in (less, more))
    spent_J = pressure_kPa * (after.volume_L - before.volume_L) - (after.elastic_J - before.elastic_J)
    assert float(spent_J) >= -1e-9


def test_thin_film_bursts_where_a_thin_wall_does() -> None:
    # p = σ t/r: 50 µm at 10 MPa are 0.5 N/mm; arcs of 20 mm radius bear 25 kPa.
    wide = pouch(pouch_length_mm=20.0 * math.pi, strength_N_per_mm=0.5)
    assert burst_kPa(wide) == pytest.approx(25.0, rel=1e-3)
    assert burst_kPa(pouch(pouch_length_mm=20.0 * math.pi, strength_N_per_mm=3.0)) == pytest.approx(
        150.0, rel=1e-3
    )
