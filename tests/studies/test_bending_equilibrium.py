"""The body as a beam, and its equilibrium with the actuator."""

from __future__ import annotations

import math
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from flying_vines.physics.arrays import Array
from flying_vines.studies.bending import BendingVine, VineError, bend, examples, load_vine, parse_vine
from flying_vines.studies.bending.actuator import force_N
from flying_vines.studies.bending.body import Body, _wrinkled
from flying_vines.studies.bending.description import example_text
from flying_vines.vine.shape import axis, sides, tip

BODY = Body(diameter_mm=80.0, pressure_kPa=14.0, film_um=75.0, modulus_MPa=300.0)


def changed(name: str = "pouch", **body: float) -> BendingVine:
    vine = load_vine(name)
    return msgspec.structs.replace(vine, body=msgspec.structs.replace(vine.body, **body))


def moment_Nm(body: Body, curvature_per_m: ArrayLike) -> Array:
    """The moment at a curvature, without an actuator's pull."""
    lever, held = _wrinkled()
    curvature = body.axial_N / (body.stiffness_N_per_m * body.radius_m**2 * held)
    moment = body.axial_N * body.radius_m * lever
    bent = np.asarray(curvature_per_m, float)
    return np.asarray(np.interp(bent, np.append(0.0, curvature), np.append(0.0, moment)))


def test_the_load_of_a_body_agrees_with_comer_and_levy() -> None:
    assert BODY.collapse_Nm == pytest.approx(2.8, abs=0.02)
    assert BODY.axial_N == pytest.approx(70.0, abs=0.5)
    assert BODY.wrinkling_Nm == pytest.approx(0.5 * BODY.collapse_Nm)
    assert float(BODY.tip_load_N(2.0)) == pytest.approx(BODY.collapse_Nm / 2.0)


def test_moment_is_a_beams_until_it_wrinkles_and_never_passes_collapse() -> None:
    stiffness_Nm2 = math.pi * 300e6 * 75e-6 * 0.04**3
    wrinkles_per_m = BODY.wrinkling_Nm / stiffness_Nm2
    curvature = np.linspace(0.0, wrinkles_per_m, 20)
    np.testing.assert_allclose(moment_Nm(BODY, curvature), stiffness_Nm2 * curvature, rtol=1e-6)
    beyond = moment_Nm(BODY, np.geomspace(wrinkles_per_m, 1000.0 * wrinkles_per_m, 200))
    assert np.all(np.diff(beyond) > 0.0)
    assert 0.97 * BODY.collapse_Nm < beyond[-1] < BODY.collapse_Nm


def test_half_wrinkled_the_moment_is_eight_tenths_of_collapse() -> None:
    # φ₀ = 90°: M = π/4 N r at the curvature N/(2 E t r²).
    curvature = BODY.axial_N / (2.0 * 300e6 * 75e-6 * 0.04**2)
    assert float(moment_Nm(BODY, curvature)) == pytest.approx(math.pi / 4.0 * BODY.collapse_Nm, rel=1e-4)


def test_the_wall_integrated_numerically_bears_the_actuators_pull() -> None:
    """The closed forms agree with a sum over the wall, which has tension only where it is stretched."""
    found = bend(load_vine("pouch"))
    body, i = found.vine.body, 150
    r, stiffness = body.radius_m, body.stiffness_N_per_m
    around = (np.arange(20_000) + 0.5) * 2.0 * math.pi / 20_000
    before = body.axial_N / (2.0 * math.pi * r * stiffness)
    inward = r * np.cos(around)
    strain = before - found.contraction[i] + found.curvature_per_m[i] * (body.lever_m - inward)
    tension = stiffness * np.maximum(strain, 0.0)
    held_N = float(np.mean(tension)) * 2.0 * math.pi * r
    moment_Nm = -float(np.mean(tension * inward)) * 2.0 * math.pi * r
    assert held_N == pytest.approx(body.axial_N - found.force_N[i], rel=1e-4)
    assert moment_Nm == pytest.approx(found.force_N[i] * body.lever_m, rel=1e-4)


@pytest.mark.parametrize("name", examples())
def test_at_rest_the_actuator_pulls_with_what_the_body_yields_to(name: str) -> None:
    found = bend(load_vine(name))
    pull = force_N(found.vine.actuator, found.pressure_kPa[1:], found.contraction[1:])
    np.testing.assert_allclose(pull, found.force_N[1:], rtol=2e-3)


@pytest.mark.parametrize("name", examples())
def test_the_bend_rises_from_0_and_levels_off(name: str) -> None:
    found = bend(load_vine(name))
    assert (found.angle_deg[0], found.air_SL[0], found.force_N[0]) == (0.0, 0.0, 0.0)
    assert np.all(np.diff(found.angle_deg) > 0.0)
    assert np.all(np.diff(found.air_SL) > 0.0)
    assert np.all(found.contraction <= found.free_contraction + 1e-9)
    slope = np.diff(found.angle_deg) / np.diff(found.pressure_kPa)
    assert slope[-1] < 0.2 * slope.max()
    assert 0.0 < found.dead_zone_kPa < found.usable_kPa


def test_the_example_bends_like_the_papers_vine() -> None:
    found = bend(load_vine("pouch"))
    assert found.at(found.angle_deg, 20.7) == pytest.approx(60.0, abs=1.0)
    assert found.at(found.volume_L, 20.7) == pytest.approx(0.1, abs=0.002)
    # Flat at first: the air is six times that of a rigid volume, whose 0.1 L take 0.0204 SL.
    assert found.at(found.air_SL, 20.7) == pytest.approx(0.12, abs=0.003)


bodies = st.builds(
    Body,
    diameter_mm=st.floats(30.0, 120.0),
    pressure_kPa=st.floats(3.0, 40.0),
    film_um=st.floats(30.0, 200.0),
    modulus_MPa=st.floats(50.0, 2000.0),
    offset_mm=st.floats(0.0, 20.0),
)


@given(bodies, st.sampled_from(examples()), st.floats(0.0, 1.0))
@settings(max_examples=25, deadline=None)
def test_for_any_body_the_limits_keep_their_order(body: Body, name: str, load_N: float) -> None:
    vine = msgspec.structs.replace(load_vine(name), body=body, tip_load_N=load_N)
    found = bend(vine, np.linspace(0.0, vine.max_kPa, 40))
    # Beyond the usable range a film may stretch faster than it shortens.
    used = found.angle_deg[found.pressure_kPa <= found.usable_kPa]
    assert np.all(np.diff(used) >= 0.0)
    assert 0.0 < body.wrinkling_N < body.collapse_N < body.axial_N
    assert np.all(found.force_N < body.collapse_N)
    assert np.all(found.tip_load_N > 0.0)
    # The outer side never becomes shorter.
    assert np.all(
        np.radians(found.angle_deg) * (body.lever_m + body.radius_m)
        >= vine.actuator.length_m * found.contraction * (1.0 - 1e-5) - 1e-12
    )
    met = [limit.pressure_kPa for limit in found.limits if limit.pressure_kPa is not None]
    assert met == sorted(met)
    ends = {limit.name: limit.pressure_kPa for limit in found.limits if limit.ends}
    if found.end:
        assert ends[found.end.name] == found.usable_kPa == min(p for p in ends.values() if p is not None)


def test_a_body_under_more_pressure_bends_less_and_bears_more() -> None:
    soft, hard = (bend(changed(pressure_kPa=kPa)) for kPa in (8.0, 16.0))
    wrinkled = soft.force_N > soft.vine.body.wrinkling_N
    assert np.all(hard.angle_deg[wrinkled] < soft.angle_deg[wrinkled])
    np.testing.assert_allclose(hard.angle_deg[~wrinkled], soft.angle_deg[~wrinkled], rtol=1e-3)
    assert np.all(hard.tip_load_N > soft.tip_load_N)


def ending(vine: BendingVine) -> str:
    end = bend(vine).end
    assert end is not None and end.pressure_kPa is not None
    return end.name


def test_each_limit_can_end_it() -> None:
    vine = load_vine("pouch")
    weak = msgspec.structs.replace(vine.actuator, strength_N_per_mm=0.2)
    assert ending(msgspec.structs.replace(vine, actuator=weak)) == "burst"
    assert ending(msgspec.structs.replace(vine, tip_load_N=0.2)) == "collapse"
    limp = msgspec.structs.replace(changed(pressure_kPa=1.0), tip_load_N=0.0)
    assert ending(limp) == "contraction"
    assert bend(msgspec.structs.replace(vine, tip_load_N=0.0)).end is None


def test_the_dead_zone_of_a_soft_film_belongs_to_the_maximum_bend() -> None:
    vine = load_vine("cpam")
    soft = msgspec.structs.replace(vine.actuator, modulus_MPa=30.0)
    found = bend(msgspec.structs.replace(vine, actuator=soft, max_kPa=100.0))
    most = float(np.max(found.angle_deg))
    assert found.angle_deg[-1] < 0.5 * most
    assert found.at(found.angle_deg, found.dead_zone_kPa) == pytest.approx(0.05 * most)


def test_a_load_beyond_what_the_straight_vine_bears_ends_it_at_once() -> None:
    found = bend(msgspec.structs.replace(load_vine("pouch"), tip_load_N=5.0))
    assert found.usable_kPa == 0.0


@pytest.mark.parametrize("pressures", [[0.0], [1.0, 2.0], [0.0, 2.0, 1.0], [[0.0, 1.0]], [0.0, math.nan]])
def test_pressures_must_rise_from_0(pressures: list[float]) -> None:
    with pytest.raises(ValueError, match="must rise from 0"):
        bend(load_vine("pouch"), pressures)


# The shape.


@given(st.floats(-300.0, 300.0), st.floats(0.05, 5.0))
def test_an_arc_is_as_long_as_the_vine_and_turns_by_its_angle(angle_deg: float, length_m: float) -> None:
    points = axis(angle_deg, length_m, pieces=500)
    long_m = sum(math.dist(a[:2], b[:2]) for a, b in pairwise(points))
    assert long_m == pytest.approx(length_m, rel=1e-4)
    assert points[0] == (0.0, 0.0, 0.0)
    assert points[-1] == tip(angle_deg, length_m)
    assert math.degrees(points[-1].heading_rad) == pytest.approx(angle_deg)


def test_tips_that_anyone_can_check() -> None:
    assert tip(0.0, 0.5)[:2] == pytest.approx((0.0, 0.5))
    assert tip(90.0, math.pi / 2.0)[:2] == pytest.approx((1.0, 1.0))
    assert tip(180.0, math.pi)[:2] == pytest.approx((2.0, 0.0), abs=1e-12)


def test_the_inner_side_is_shorter_by_angle_times_diameter() -> None:
    inner, outer = (sum(math.dist(a, b) for a, b in pairwise(side)) for side in sides(60.0, 0.5, 0.05))
    assert outer - inner == pytest.approx(math.radians(60.0) * 0.05, rel=1e-3)


def test_the_drawn_axis_fits_the_sides_that_were_computed() -> None:
    found = bend(load_vine("cpam"))
    inner = found.length_m[-1] - math.radians(found.angle_deg[-1]) * found.vine.body.radius_m
    assert inner == pytest.approx(found.vine.actuator.length_m * (1.0 - found.contraction[-1]), rel=1e-9)


# The description.


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            "diameter_mm = 50",
            "diameter_mm = 0",
            "my.toml:9: body.diameter_mm: must be a number of at least 0.1",
        ),
        ("diameter_mm = 50", "diameter = 50", "body.diameter: unknown key; did you mean 'diameter_mm'?"),
        ("max_kPa = 40 ", "", "'max_kPa' is missing"),
        ('kind = "pouch_motor"', 'kind = "pouch"', "actuator.kind: give one of pouch_motor, fpam, cpam"),
        ("count = 9", "count = 9.5", "actuator.count: must be a whole number, not 9.5"),
        ("width_mm = 31", "width_mm = nan", "actuator.width_mm: is not a finite number"),
        ("[body]", "[body", "my.toml:8: not TOML"),
    ],
)
def test_an_invalid_description_gives_one_line(old: str, new: str, says: str) -> None:
    text = example_text("pouch")
    assert old in text
    with pytest.raises(VineError) as caught:
        parse_vine(text.replace(old, new), "my.toml")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unknown_name_gives_the_names_of_the_examples() -> None:
    with pytest.raises(
        VineError, match="no such file and no such example; the examples are pouch, cpam, fpam"
    ):
        load_vine("octopus")
