"""Pressure profiles are continuous, within the rate limit, and have the specified duration and end."""

from __future__ import annotations

import math
from itertools import pairwise

import msgspec
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from examples import examples
from flying_vines.vine.curve import BendCurve
from flying_vines.vine.motion import Motion, plan
from flying_vines.vine.profile import (
    MAX_NESTING,
    MAX_PIECES,
    MAX_VALUE,
    HoldFor,
    PressureProfile,
    Ramp,
    Segment,
    Sine,
    Step,
    Sub,
    flatten,
)

CURVE = BendCurve([(0, 0), (2, 0), (20.7, 60)])
MAX_KPA = 20.7

pressures = st.floats(0, 25)
angles = st.floats(-10, 70)
durations = st.floats(0.01, 5)
steps = st.one_of(st.builds(Step, to_kPa=pressures), st.builds(Step, to_deg=angles))
ramps = st.one_of(
    st.builds(Ramp, over_s=durations, to_kPa=pressures), st.builds(Ramp, over_s=durations, to_deg=angles)
)
sines = st.one_of(
    st.builds(
        Sine,
        frequency_Hz=st.floats(0.05, 20),
        cycles=st.one_of(st.floats(0.1, 4), st.integers(1, 8).map(lambda halves: halves / 2)),
        from_kPa=pressures,
        to_kPa=pressures,
    ),
    st.builds(Sine, frequency_Hz=st.floats(0.05, 20), from_deg=angles, to_deg=angles),
)
segments = st.lists(st.one_of(steps, ramps, st.builds(HoldFor, for_s=durations), sines), max_size=6)
rates = st.floats(1, 200)


def sampled(motion: Motion, count: int = 4000) -> list[tuple[float, float]]:
    span_s = motion.duration_s + 0.2
    times_s = {-0.1 + span_s * i / count for i in range(count + 1)}
    for begin_s, end_s, _ in motion.pieces:
        for edge_s in (begin_s, end_s):
            times_s |= {edge_s - 1e-6, edge_s, edge_s + 1e-6}
    return [(t, motion.setpoint_kPa(t)) for t in sorted(times_s)]


@given(segments, st.floats(0, 20), rates)
@settings(max_examples=examples(120), deadline=None)
def test_continuous_and_never_steeper_than_the_limit(
    parts: list[Segment], start_kPa: float, rate_kPa_per_s: float
) -> None:
    motion = plan(parts, CURVE, start_kPa, rate_kPa_per_s, MAX_KPA)
    points = sampled(motion)
    for (t0, a), (t1, b) in pairwise(points):
        assert abs(b - a) <= rate_kPa_per_s * (t1 - t0) * (1 + 1e-6) + 1e-9
    assert points[0][1] == start_kPa
    assert points[-1][1] == motion.final_kPa
    assert motion.setpoint_kPa(motion.duration_s) == pytest.approx(motion.final_kPa)


@given(segments, st.floats(0, 20), rates)
@settings(max_examples=examples(120), deadline=None)
def test_peak_and_rise_are_those_of_the_pressure(
    parts: list[Segment], start_kPa: float, rate_kPa_per_s: float
) -> None:
    motion = plan(parts, CURVE, start_kPa, rate_kPa_per_s, MAX_KPA)
    values = [value for _, value in sampled(motion, 6000)]
    risen = sum(max(0.0, b - a) for a, b in pairwise(values))
    # The samples may slightly miss a turning point.
    assert motion.rise_kPa == pytest.approx(risen, abs=0.02 * (1 + motion.rise_kPa))
    assert motion.peak_kPa >= max(values) - 1e-9
    assert max(motion.peak_kPa, *values) <= MAX_KPA + 1e-9
    assert min(values) >= 0.0
    if all(not isinstance(part, Sine) or part.cycles >= 0.5 for part in parts):
        assert motion.peak_kPa == pytest.approx(max(values), abs=0.02)


@given(segments, st.floats(0, 20), rates)
@settings(max_examples=examples(60), deadline=None)
def test_pieces_follow_each_other_without_gaps(
    parts: list[Segment], start_kPa: float, rate_kPa_per_s: float
) -> None:
    motion = plan(parts, CURVE, start_kPa, rate_kPa_per_s, MAX_KPA)
    edges_s = [0.0, *(end_s for _, end_s, _ in motion.pieces)]
    assert [begin_s for begin_s, _, _ in motion.pieces] == edges_s[:-1]
    assert motion.duration_s == edges_s[-1]


def test_a_step_takes_the_time_of_the_rate_limit() -> None:
    motion = plan([Step(to_deg=60)], CURVE, 0.0, 10.0, MAX_KPA)
    assert motion.duration_s == pytest.approx(2.07)
    assert motion.final_kPa == motion.aim_kPa == motion.peak_kPa == 20.7
    assert motion.setpoint_kPa(1.0) == pytest.approx(10.0)


def test_a_ramp_takes_its_time_or_longer() -> None:
    assert plan([Ramp(over_s=5, to_kPa=10)], CURVE, 0.0, 10.0, MAX_KPA).duration_s == 5.0
    assert plan([Ramp(over_s=0.5, to_kPa=10)], CURVE, 0.0, 10.0, MAX_KPA).duration_s == 1.0


def test_a_hold_stays_where_it_is() -> None:
    motion = plan([Step(to_kPa=6), HoldFor(for_s=3)], CURVE, 0.0, 6.0, MAX_KPA)
    assert motion.duration_s == 4.0
    assert {motion.setpoint_kPa(t) for t in (1.0, 2.0, 3.9, 4.0, 99.0)} == {6.0}
    assert plan([HoldFor(for_s=3)], CURVE, 4.0, 6.0, MAX_KPA).final_kPa == 4.0


def test_a_sine_swings_as_commanded_while_the_rate_allows() -> None:
    sine = Sine(frequency_Hz=0.5, cycles=3, from_kPa=2, to_kPa=12)
    motion = plan([sine], CURVE, 2.0, 60.0, MAX_KPA)
    assert motion.duration_s == pytest.approx(6.0)
    for cycle in range(3):
        assert motion.setpoint_kPa(2 * cycle) == pytest.approx(2.0)
        assert motion.setpoint_kPa(2 * cycle + 0.5) == pytest.approx(7.0)
        assert motion.setpoint_kPa(2 * cycle + 1) == pytest.approx(12.0)
    assert motion.rise_kPa == pytest.approx(30.0)
    assert motion.aim_kPa == 12.0
    assert motion.final_kPa == pytest.approx(2.0)


def test_a_sine_that_is_too_fast_is_slowed_exactly_to_the_limit() -> None:
    sine = Sine(frequency_Hz=5, cycles=2, from_kPa=0, to_kPa=10)
    motion = plan([sine], CURVE, 0.0, 20.0, MAX_KPA)
    assert motion.duration_s == pytest.approx(2 * math.pi * 10 / 20)
    steepest = max(
        (b - a) / (t1 - t0) for (t0, a), (t1, b) in pairwise(sampled(motion, 20_000)) if t1 - t0 > 1e-5
    )
    assert steepest == pytest.approx(20.0, rel=1e-4)


@pytest.mark.parametrize(
    ("start", "end", "cycles", "rise_kPa"),
    [
        (0, 8, 0.5, 8),
        (8, 0, 0.5, 0),
        (0, 8, 1, 8),
        (8, 0, 1, 8),
        (8, 0, 1.5, 8),
        (0, 8, 0.25, 4),
        (5, 5, 3, 0),
    ],
)
def test_a_sine_needs_air_only_while_it_rises(
    start: float, end: float, cycles: float, rise_kPa: float
) -> None:
    sine = Sine(frequency_Hz=0.2, cycles=cycles, from_kPa=start, to_kPa=end)
    assert plan([sine], CURVE, start, 60.0, MAX_KPA).rise_kPa == pytest.approx(rise_kPa, abs=1e-9)


def test_values_beyond_the_limits_are_clipped_to_them() -> None:
    motion = plan([Step(to_kPa=99), Step(to_kPa=-5), Step(to_deg=300)], CURVE, 0.0, 60.0, 15.0)
    assert motion.peak_kPa == 15.0
    assert min(value for _, value in sampled(motion)) == 0.0


def test_without_segments_the_pressure_stays() -> None:
    motion = plan([], CURVE, 7.0, 60.0, MAX_KPA)
    assert (motion.duration_s, motion.final_kPa, motion.rise_kPa) == (0.0, 7.0, 0.0)
    assert motion.setpoint_kPa(5.0) == 7.0


def test_a_motion_begins_at_its_start() -> None:
    up = plan([Step(to_kPa=10)], CURVE, 0.0, 10.0, MAX_KPA, started_at=100.0)
    assert [up.setpoint_kPa(t) for t in (99.0, 100.5, 101.0, 500.0)] == pytest.approx([0, 5, 10, 10])
    assert (up.is_over(100.99), up.is_over(101.0)) == (False, True)
    assert (up.only_deflates, up.stays_bent) == (False, True)
    down = plan([Step(to_kPa=0)], CURVE, 10.0, 10.0, MAX_KPA)
    assert (down.only_deflates, down.stays_bent) == (True, False)


@pytest.mark.parametrize("cycles", [1, 3, 7, 100, 1000])
def test_a_sine_that_ends_at_zero_ends_exactly_there(cycles: int) -> None:
    wave = plan([Sine(frequency_Hz=0.55, cycles=cycles, from_kPa=0, to_kPa=13)], CURVE, 0.0, 60.0, MAX_KPA)
    assert wave.final_kPa <= 0.0


# Hysteresis.


def bent_along(curve: BendCurve, motion: Motion, bent_kPa: float) -> tuple[float, list[float]]:
    """The final `bent_kPa` of a vine with hysteresis after a motion, and all its angles."""
    angles_deg = []
    for _, pressure_kPa in sampled(motion):
        bent_kPa = curve.bent_kPa(pressure_kPa, bent_kPa)
        angles_deg.append(curve.angle_deg(bent_kPa))
    return bent_kPa, angles_deg


RUBS = BendCurve([(0, 0), (5, 0), (20.7, 60)], 3.0)


@pytest.mark.parametrize("to_deg", [5.0, 30.0, 60.0])
@pytest.mark.parametrize("before_kPa", [[0.0], [20.7], [20.7, 0.0], [20.7, 10.0], [20.7, 2.0, 14.0]])
def test_an_angle_is_reached_from_any_bend(to_deg: float, before_kPa: list[float]) -> None:
    bent_kPa = 0.0
    for pressure_kPa in before_kPa:
        bent_kPa = RUBS.bent_kPa(pressure_kPa, bent_kPa)
    motion = plan([Step(to_deg=to_deg)], RUBS, before_kPa[-1], 60.0, MAX_KPA, bent_kPa)
    assert bent_along(RUBS, motion, bent_kPa)[1][-1] == pytest.approx(to_deg, abs=1e-6)


def test_an_angle_has_different_pressures_on_the_way_up_and_down() -> None:
    there_and_back: list[Segment] = [Ramp(to_deg=30, over_s=1), Step(to_deg=60), Ramp(to_deg=30, over_s=1)]
    motion = plan(there_and_back, RUBS, 0.0, 60.0, MAX_KPA)
    assert motion.setpoint_kPa(1.0) == pytest.approx(RUBS.pressure_kPa(30))
    assert motion.final_kPa == pytest.approx(RUBS.pressure_kPa(30) - 3.0)


@pytest.mark.parametrize(("from_deg", "to_deg"), [(10.0, 50.0), (50.0, 10.0)])
@pytest.mark.parametrize("before_deg", [0.0, 60.0])
def test_a_sine_reaches_both_of_its_angles(from_deg: float, to_deg: float, before_deg: float) -> None:
    sine = Sine(frequency_Hz=0.5, cycles=2, from_deg=from_deg, to_deg=to_deg)
    start_kPa = RUBS.pressure_kPa(before_deg)
    motion = plan([sine], RUBS, start_kPa, 200.0, MAX_KPA)
    _, angles_deg = bent_along(RUBS, motion, start_kPa)
    swinging = angles_deg[len(angles_deg) // 3 :]
    assert (min(swinging), max(swinging)) == pytest.approx((10.0, 50.0), abs=0.01)


@given(segments, st.floats(0, 20), st.floats(0, 6), rates, st.floats(0, 4))
@settings(max_examples=examples(80), deadline=None)
def test_with_hysteresis_no_limit_is_exceeded_and_the_final_angle_is_right(
    parts: list[Segment], start_kPa: float, further_kPa: float, rate_kPa_per_s: float, width_kPa: float
) -> None:
    curve = BendCurve([(0, 0), (5, 0), (20.7, 60)], width_kPa)
    bent_kPa = start_kPa + min(further_kPa, width_kPa)
    motion = plan(parts, curve, start_kPa, rate_kPa_per_s, MAX_KPA, bent_kPa)
    points = sampled(motion)
    for (t0, a), (t1, b) in pairwise(points):
        assert abs(b - a) <= rate_kPa_per_s * (t1 - t0) * (1 + 1e-6) + 1e-9
    assert min(kPa for _, kPa in points) >= 0.0
    assert max(kPa for _, kPa in points) <= MAX_KPA + 1e-9
    asked = [part.to_deg for part in parts if isinstance(part, Step | Ramp) and part.to_deg is not None]
    last = next((part for part in reversed(parts) if not isinstance(part, HoldFor)), None)
    if isinstance(last, Step | Ramp) and last.to_deg is not None:
        ended_deg = bent_along(curve, motion, bent_kPa)[1][-1]
        assert ended_deg == pytest.approx(min(max(asked[-1], 0.0), 60.0), abs=0.01)


@given(segments, st.floats(0, 20), st.floats(0, 6), rates, st.floats(0, 4))
@example([Step(to_kPa=0.0), Step(to_kPa=3.0)], 10.0, 0.0, 10.0, 2.0)
@settings(max_examples=examples(80), deadline=None)
def test_a_motion_ends_with_the_bend_of_a_vine_that_followed_it(
    parts: list[Segment], start_kPa: float, further_kPa: float, rate_kPa_per_s: float, width_kPa: float
) -> None:
    curve = BendCurve([(0, 0), (5, 0), (20.7, 60)], width_kPa)
    bent_kPa = start_kPa + min(further_kPa, width_kPa)
    motion = plan(parts, curve, start_kPa, rate_kPa_per_s, MAX_KPA, bent_kPa)
    for begin_s, end_s, pressure_kPa in motion.pieces:
        for i in range(1001):
            bent_kPa = curve.bent_kPa(pressure_kPa((end_s - begin_s) * i / 1000), bent_kPa)
    assert motion.bent_kPa == pytest.approx(bent_kPa, abs=0.02)


# Nested profiles.


def profile(*parts: Segment, repeat: int = 1) -> PressureProfile:
    return PressureProfile(segments=parts, repeat=repeat)


def test_profiles_unroll_in_order() -> None:
    one, two = Step(to_kPa=1), Step(to_kPa=2)
    profiles = {
        "inner": profile(one, two, repeat=2),
        "outer": profile(two, Sub(name="inner", repeat=2), one, repeat=2),
    }
    once = [two, *(4 * [one, two]), one]
    assert list(flatten(profiles, "outer")) == once * 2


def chain(length: int) -> dict[str, PressureProfile]:
    profiles = {str(i): profile(Sub(name=str(i + 1))) for i in range(length - 1)}
    return profiles | {str(length - 1): profile(Step(to_kPa=1))}


def test_nesting_is_limited() -> None:
    assert len(list(flatten(chain(MAX_NESTING), "0"))) == 1
    with pytest.raises(ValueError, match=f"nested more than {MAX_NESTING} deep"):
        list(flatten(chain(MAX_NESTING + 1), "0"))


@pytest.mark.parametrize("around", [1, 2, 3])
def test_a_profile_that_contains_itself_is_reported(around: int) -> None:
    profiles = {str(i): profile(Step(to_kPa=1), Sub(name=str((i + 1) % around))) for i in range(around)}
    with pytest.raises(ValueError, match="profile '0' contains itself"):
        list(flatten(profiles, "0"))


def test_the_same_profile_twice_in_a_row_is_not_a_loop() -> None:
    profiles = {"a": profile(Step(to_kPa=1)), "b": profile(Sub(name="a"), Sub(name="a"))}
    assert len(list(flatten(profiles, "b"))) == 2


def test_a_missing_profile_is_reported() -> None:
    with pytest.raises(ValueError, match="there is no profile 'nowhere'"):
        list(flatten({"a": profile(Sub(name="nowhere"))}, "a"))


def test_too_many_pieces_are_refused_before_they_are_made() -> None:
    inner = profile(Step(to_kPa=1), Step(to_kPa=2), repeat=1000)
    assert len(list(flatten({"a": inner, "b": profile(Sub(name="a", repeat=5))}, "b"))) == MAX_PIECES
    with pytest.raises(ValueError, match=f"unrolls to more than {MAX_PIECES} segments"):
        list(flatten({"a": inner, "b": profile(Sub(name="a", repeat=6))}, "b"))
    tower = {str(i): profile(Sub(name=str(i + 1), repeat=1000), repeat=1000) for i in range(6)}
    with pytest.raises(ValueError, match="unrolls to more than"):
        list(flatten(tower | {"6": inner}, "0"))


BAD = [
    {"kind": "step"},
    {"kind": "step", "to_deg": 1, "to_kPa": 1},
    {"kind": "ramp", "to_deg": 1},
    {"kind": "ramp", "to_deg": 1, "over_s": 0},
    {"kind": "ramp", "to_deg": 1, "over_s": math.nan},
    {"kind": "ramp", "over_s": 1},
    {"kind": "hold"},
    {"kind": "hold", "for_s": -1},
    {"kind": "hold", "for_s": math.inf},
    {"kind": "hold", "for_s": 2 * MAX_VALUE},
    {"kind": "sine", "frequency_Hz": 1},
    {"kind": "sine", "frequency_Hz": 1, "from_deg": 1, "to_kPa": 1},
    {"kind": "sine", "frequency_Hz": 1, "from_deg": 1, "to_deg": 1, "to_kPa": 1},
    {"kind": "sine", "frequency_Hz": 0, "from_deg": 1, "to_deg": 1},
    {"kind": "sine", "frequency_Hz": 1, "cycles": 0, "from_deg": 1, "to_deg": 1},
    {"kind": "sine", "frequency_Hz": 1e-300, "cycles": 1e6, "from_deg": 1, "to_deg": 1},
    {"kind": "profile"},
    {"kind": "profile", "name": "x", "repeat": 0},
    {"kind": "profile", "name": "x", "repeat": 1001},
    {"kind": "jump"},
    {"to_deg": 1},
    {"kind": "step", "to_deg": 1, "over_s": 1},
]


@pytest.mark.parametrize("segment", BAD)
def test_invalid_segments_are_refused(segment: dict[str, object]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"segments": [segment]}, PressureProfile)


@pytest.mark.parametrize("keys", [{"repeat": 0}, {"repeat": 1001}, {"rate_kPa_per_s": 0}, {"rate": 1}])
def test_invalid_profiles_are_refused(keys: dict[str, object]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"segments": [{"kind": "step", "to_kPa": 0}], **keys}, PressureProfile)


def test_a_profile_without_segments_is_refused() -> None:
    with pytest.raises(msgspec.ValidationError, match="at least one segment"):
        msgspec.convert({"segments": []}, PressureProfile)
