"""Hysteresis in flight: each angle has one pressure per direction, and displays show the bend."""

from __future__ import annotations

import msgspec
import pytest

from firmware_link.protocol import Setpoint
from flying_vines.config import config
from flying_vines.core.events import ToFirmware
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.simulated_world import SimulatedFlight

LOW, MIDDLE, HIGH = 1000, 1500, 2000
WIDTH_KPA = 3.0


@pytest.fixture
def flight() -> SimulatedFlight:
    """A flying drone with a straight vine that has a hysteresis."""
    vine = config.VineConfig(curve=((0.0, 0.0), (4.0, 0.0), (20.0, 60.0)), hysteresis_kPa=WIDTH_KPA)
    conf = msgspec.structs.replace(config.default(), vine=vine)
    flight = SimulatedFlight(conf, FakeAutopilot("ardupilot", rc_failsafe_mode=None))
    flight.autopilot.set_rc(9, LOW)
    flight.run(2.0)
    flight.autopilot.takeoff(10.0)
    flight.run(8.0)
    return flight


def moved(flight: SimulatedFlight, pulse_us: int) -> float:
    """The setpoint for a position of the switch."""
    flight.autopilot.set_rc(9, pulse_us)
    actions = flight.run(flight.world.now + 3.0)
    sent = [a.message for a in actions if isinstance(a, ToFirmware) and isinstance(a.message, Setpoint)]
    assert all(0.0 <= setpoint.target_kPa <= 20.7 for setpoint in sent)
    return sent[-1].target_kPa


def test_an_angle_has_a_pressure_for_each_way(flight: SimulatedFlight) -> None:
    assert moved(flight, MIDDLE) == pytest.approx(12.0, abs=0.01)
    assert moved(flight, HIGH) == pytest.approx(20.0, abs=0.01)
    assert moved(flight, MIDDLE) == pytest.approx(12.0 - WIDTH_KPA, abs=0.01)
    assert moved(flight, HIGH) == pytest.approx(20.0, abs=0.01)


def test_the_bend_that_is_shown_is_that_of_the_pressures_on_the_way(flight: SimulatedFlight) -> None:
    curve = flight.core.config.vine.bend_curve()
    bent_kPa = 0.0
    for pulse_us in (HIGH, MIDDLE, HIGH, MIDDLE):
        flight.autopilot.set_rc(9, pulse_us)
        for _ in range(150):
            flight.run(flight.world.now + 0.02)
            bent_kPa = curve.bent_kPa(flight.phlosar.cv_kPa, bent_kPa)
        shown_deg = flight.core.snapshot(flight.world.now).bend_deg
        # The sensor's noise is a few tenths of a kPa; the hysteresis 11°.
        assert shown_deg == pytest.approx(curve.angle_deg(bent_kPa), abs=3.0)


def test_no_bend_stays_where_the_dead_zone_is_wider(flight: SimulatedFlight) -> None:
    moved(flight, HIGH)
    flight.autopilot.set_rc(9, LOW)
    flight.run(flight.world.now + 4.0)
    assert flight.phlosar.cv_kPa < 0.5
    assert flight.core.snapshot(flight.world.now).bend_deg == 0.0
