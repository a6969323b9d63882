"""Injects every fault of the catalogue into a flight in simulated time; the valves are recorded."""

from __future__ import annotations

import pytest

from flying_vines.simulation.phlosar.firmware import setting_rows

from .black_box import STEP_S, BlackBox
from .catalogue import ROWS, UNPOWERED, Cleared, Row
from .injections import INJECTIONS, Injection
from .watched import HALF_BENT_KPA, Watched

pytestmark = pytest.mark.long

MID_INFLATION_KPA, BENT_AT_LEAST_KPA = 8.0, 15.0

DEAD_MAN_S = 0.3
FIRMWARE_LIMIT_KPA = setting_rows()["cv_limit_kPa"].standard
LONGEST_OVER_MS = 20
SAME_MS, SAME_SHARE, SAME_KPA = 10, 0.05, 1.0
"""Maximum differences between a measurement and the table."""


@pytest.mark.parametrize("name", INJECTIONS)
def test_a_fault_in_flight(name: str) -> None:
    row, injection = ROWS[name], INJECTIONS[name]
    flight = in_the_air(injection)
    box = flight.box
    box.watch(FIRMWARE_LIMIT_KPA)
    began_s = flight.phlosar.now_s
    injection.begin(flight)
    injection.during(flight, injection.lasts_s)
    left_kPa = flight.phlosar.cv_kPa
    injection.end(flight)
    # The switch does not move, and there is no request.
    flight.run(5.0)

    if row.pilot_text:
        assert flight.has_text(row.pilot_text), flight.describe()
    assert {d.intent for d in flight.decisions if d.trigger != "switch"} <= {"vent"}, flight.describe()
    if row.highest_kPa is None:
        assert box.longest_over_ms <= LONGEST_OVER_MS
    else:
        assert box.highest_kPa == pytest.approx(row.highest_kPa, abs=SAME_KPA)
    if row.cleared is Cleared.AT_ONCE:
        assert bool(flight.texts.read) == bool(row.pilot_text), flight.describe()
        assert flight.phlosar.cv_kPa > BENT_AT_LEAST_KPA, "the vine stays bent"
        return
    assert left_kPa == pytest.approx(row.left_kPa, abs=SAME_KPA)
    assert flight.phlosar.cv_kPa == pytest.approx(0.0, abs=SAME_KPA)
    if injection.phase == "vented":
        assert box.unsafe_s is None
    else:
        assert_safe_in_time(row, box, began_s)
    if row.cleared is Cleared.PERSON:
        assert_latched_until_a_person_clears_it(flight)
    else:
        flight.straighten()
        flight.run(1.0)
    flight.forget()
    flight.bend_half()
    flight.run(1.0)
    assert [decision.safety for decision in flight.decisions] == ["accepted"], flight.describe()
    assert flight.phlosar.cv_kPa == pytest.approx(HALF_BENT_KPA, abs=SAME_KPA)


def in_the_air(injection: Injection) -> Watched:
    """A flight that has reached the phase in which the fault begins."""
    flight = Watched(
        injection.kind, injection.tables, injection.rc, injection.reservoir_kPa, injection.rested_s
    )
    assert flight.box.unsafe_s is None, "nothing moves before the first trigger"
    if injection.phase != "vented":
        flight.bend_full()
        while flight.phlosar.cv_kPa < MID_INFLATION_KPA:
            flight.run(STEP_S)
            assert flight.now_s < 30.0, f"the vine did not bend: {flight.describe()}"
    if injection.phase == "held":
        flight.run(1.5)
    flight.forget()
    return flight


def assert_safe_in_time(row: Row, box: BlackBox, began_s: float) -> None:
    """The vine is safe in time, and remains safe."""
    assert box.unsafe_s is not None
    assert box.setpoint_s is not None
    assert row.allowed_ms is not None
    to_safe_ms = round(1000 * (box.unsafe_s + STEP_S - began_s))
    assert to_safe_ms <= row.allowed_ms
    assert row.measured_ms == pytest.approx(to_safe_ms, abs=SAME_MS, rel=SAME_SHARE), (
        "correct measured_ms in the catalogue"
    )
    if row.safe_state != UNPOWERED:
        assert box.unsafe_s + STEP_S - box.setpoint_s <= DEAD_MAN_S


def assert_latched_until_a_person_clears_it(flight: Watched) -> None:
    unsafe_s = flight.box.unsafe_s
    flight.forget()
    flight.ask_by_command(4)
    flight.run(0.5)
    assert [decision.safety for decision in flight.decisions] == ["refused"], flight.describe()
    flight.bend_half()
    flight.run(0.5)
    flight.straighten()
    flight.run(0.5)
    assert flight.box.unsafe_s == unsafe_s
