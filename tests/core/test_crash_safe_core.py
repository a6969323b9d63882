"""An unexpected error anywhere in the core is a commanded shutdown."""

from __future__ import annotations

import math

import pytest
from error_injection import Method, breakable, methods_within
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from firmware_link.host import HostSession
from firmware_link.protocol import Vent
from flying_vines.core.core import Core
from flying_vines.core.crash_safe_core import SHUTDOWN_TEXT, CrashSafeCore
from flying_vines.core.events import (
    Action,
    Asked,
    Decision,
    InternalError,
    LinkChanged,
    ToFirmware,
    ToVehicle,
)
from flying_vines.core.safety import INTERNAL_ERROR, Safety
from flying_vines.supply import ReservoirEstimate
from flying_vines.supply.physics_checks import PhysicsChecks
from flying_vines.vehicle.component import Component
from flying_vines.vehicle.notice import Notice
from flying_vines.vehicle.vehicle import Vehicle
from flying_vines.vine.intent import BendTo

from .flights import HIGH, LOW, MIDDLE, airborne, bent, ground_command, run_for

VENTED_WITHIN_S = 0.4


class Broken:
    """A flight in which one method raises from a given time on."""

    def __init__(self, method: Method, after_s: float, seldom: int = 1) -> None:
        self.flight = airborne()
        self.core = self.flight.core
        self.crash_safe = CrashSafeCore(self.core)
        self.flight.world.core = self.crash_safe  # type: ignore[assignment]
        self.method = method
        self.seldom = seldom
        self.calls = 0
        self.breaks = False
        self.failed_at: float | None = None
        """Time of the first error in a method that the vine needs."""
        self.only_shown = 0
        self.actions: list[Action] = []
        self.breaks_at = self.flight.world.now + after_s

    def raises(self) -> bool:
        self.calls += self.breaks
        return self.breaks and self.calls % self.seldom == 0

    def raised(self, needed: bool) -> None:
        if needed and self.failed_at is None:
            self.failed_at = self.flight.world.now
        self.only_shown += not needed

    def run(self, seconds: float) -> None:
        until = self.flight.world.now + seconds
        while self.flight.world.now < until - 1e-9:
            self.breaks = self.flight.world.now >= self.breaks_at
            self.actions += run_for(self.flight, 0.02)
            self.look()

    def look(self) -> None:
        now, phlosar = self.flight.world.now, self.flight.phlosar
        if self.failed_at is not None and now >= self.failed_at + VENTED_WITHIN_S:
            assert (phlosar.drive.evp, phlosar.drive.solenoid) == (0.0, True), self.method
            assert phlosar.cv_kPa < 1.5, self.method

    def fly(self) -> None:
        """A bend, and then every other request."""
        flight, autopilot = self.flight, self.flight.autopilot
        self.actions += flight.feed(LinkChanged(flight.world.now, "vehicle", True))
        for pulse in (HIGH, LOW, MIDDLE):
            autopilot.set_rc(9, pulse)
            self.run(1.2)
        self.actions += ground_command(flight, mavlink.MAV_CMD_USER_1, 1.0, 30.0)
        self.run(0.6)
        answers = flight.feed(Asked(flight.world.now, "page", BendTo(20.0)))
        assert [a for a in answers if isinstance(a, Decision) and a.trigger == "page"]
        self.actions += answers
        self.crash_safe.snapshot(flight.world.now)
        self.actions += flight.feed(LinkChanged(flight.world.now, "firmware", False))
        self.actions += flight.feed(LinkChanged(flight.world.now, "firmware", True))
        self.run(0.6)
        autopilot.lose_rc("frozen")
        self.run(1.4)
        self.breaks_at = math.inf
        self.run(0.8)

    def texts(self) -> list[str]:
        """The texts that the pilot reads."""
        messages = [a.message for a in self.actions if isinstance(a, ToVehicle)]
        texts = [m.text for m in messages if m.get_type() == "STATUSTEXT"]
        return [text.decode() if isinstance(text, bytes) else text for text in texts]


def fly(method: Method, after_s: float, seldom: int = 1) -> Broken:
    broken = Broken(method, after_s, seldom)
    with breakable(method, broken.raises, broken.raised):
        broken.fly()
    heartbeats = [
        a for a in broken.actions if isinstance(a, ToVehicle) and a.message.get_type() == "HEARTBEAT"
    ]
    assert len(heartbeats) >= 4, method
    if broken.failed_at is None:
        assert not broken.core.internal_error, method
        return broken
    assert broken.core.internal_error, method
    assert broken.texts().count(SHUTDOWN_TEXT) == 1, method
    assert [a.text for a in broken.actions if isinstance(a, Notice)].count(SHUTDOWN_TEXT) == 1, method
    assert [a for a in broken.actions if isinstance(a, InternalError) and "BrokenError" in a.trace], method
    return broken


@pytest.mark.long
@settings(max_examples=25, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    method=st.deferred(lambda: st.sampled_from(methods_within(bent().core))),
    after_s=st.floats(0.0, 4.0),
    seldom=st.sampled_from([1, 1, 3]),
)
def test_after_any_error_in_the_core_the_vine_is_vented_and_the_pilot_reads_it_once(
    method: Method, after_s: float, seldom: int
) -> None:
    fly(method, after_s, seldom)


@pytest.mark.parametrize(
    ("method", "after_s"),
    [
        # Methods that make the vent, the text, the heartbeat and the checks.
        ((HostSession, "command"), 0.5),
        ((HostSession, "tick"), 0.5),
        ((Core, "_publish"), 0.5),
        ((Core, "_check_safety"), 0.5),
        ((Core, "handle"), 0.5),
        ((Component, "due"), 0.5),
        ((Safety, "watch"), 0.5),
        ((ReservoirEstimate, "update"), 0.5),
        ((PhysicsChecks, "take"), 0.5),
        ((Vehicle, "rc"), 0.5),
    ],
)
def test_the_vent_does_not_need_the_part_that_failed(method: Method, after_s: float) -> None:
    assert fly(method, after_s).failed_at is not None


@pytest.mark.parametrize(
    ("method", "part"),
    [((ReservoirEstimate, "cycles_left"), "cycles left"), ((Core, "_named_values"), "named values")],
)
def test_a_failing_display_is_switched_off_and_the_flight_continues(method: Method, part: str) -> None:
    broken = Broken(method, 0.0)
    with breakable(method, broken.raises, broken.raised):
        broken.flight.autopilot.set_rc(9, HIGH)
        broken.run(2.0)
    assert (broken.only_shown, broken.core.internal_error) == (1, False)
    assert broken.texts() == [f"Vine: {part} failed, flight goes on"]
    assert broken.flight.phlosar.cv_kPa == pytest.approx(20.7, abs=1.0)


def test_a_display_that_fails_is_blank_and_reported() -> None:
    errors: list[Exception] = []
    flight = bent()
    crash_safe = CrashSafeCore(flight.core, errors.append)
    with breakable((Core, "snapshot"), lambda: True):
        snapshot = crash_safe.snapshot(flight.world.now)
    assert snapshot.doing == "display failed" and math.isnan(snapshot.cv_kPa)
    assert [str(error) for error in errors] == ["Core.snapshot"]
    assert crash_safe.snapshot(flight.world.now).doing != "display failed"


def test_only_a_restart_ends_a_shutdown() -> None:
    broken = Broken((ReservoirEstimate, "update"), 0.5)
    with breakable((ReservoirEstimate, "update"), broken.raises, broken.raised):
        broken.flight.autopilot.set_rc(9, HIGH)
        broken.run(2.0)
    assert broken.core.internal_error
    for move in (LOW, HIGH, LOW, HIGH):
        broken.flight.autopilot.set_rc(9, move)
        broken.run(1.0)
    assert [
        m for m in run_for(broken.flight, 0.1) if isinstance(m, ToFirmware) and isinstance(m.message, Vent)
    ]
    clear = ground_command(broken.flight, mavlink.MAV_CMD_USER_5, 1.0)
    assert not any(isinstance(a, Notice) and "cleared" in a.text for a in clear)
    refused = [a for a in broken.actions if isinstance(a, Decision) and a.safety == "refused"]
    assert {d.reason for d in refused} == {INTERNAL_ERROR} and len(refused) >= 2
    statuses = [
        a.message.system_status
        for a in broken.actions
        if isinstance(a, ToVehicle) and a.message.get_type() == "HEARTBEAT"
    ]
    assert statuses[-1] == mavlink.MAV_STATE_CRITICAL
    values = {
        a.message.name
        for a in broken.actions[-400:]
        if isinstance(a, ToVehicle) and a.message.get_type() == "NAMED_VALUE_FLOAT"
    }
    assert "CV_KPA" in {name if isinstance(name, str) else name.decode() for name in values}
