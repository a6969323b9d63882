"""A second sender with the autopilot's ids: it claims that the vehicle is armed, and high."""

from __future__ import annotations

from random import Random

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from examples import examples
from flying_vines.core.events import Action, VehicleMessage
from flying_vines.core.safety import ARMED_CONFIRMED_S
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage
from flying_vines.vehicle.state import CONFLICT_S

from .flights import (
    HIGH,
    LOW,
    airborne,
    assert_vented,
    bent,
    decisions,
    ground_command,
    notices,
    on_the_ground,
    run_for,
)

TRY_S = 8.0
STEP_S = 0.02
BEND = mavlink.MAV_CMD_USER_2
QUADROTOR, ARDUPILOT = 2, 3
CONFLICT = "armed again within 3 s of a disarm, or a second sender claims to be the autopilot"


class Spoofer:
    """Sends frames as 1/1 at its own rates, beside the real autopilot, and asks for bends."""

    def __init__(
        self,
        flight: SimulatedFlight,
        heartbeats_Hz: float,
        armed: bool = True,
        height_m: float | None = 30.0,
        altitude_Hz: float = 20.0,
        bends_Hz: float = 10.0,
        clock_s: float = 0.0,
    ) -> None:
        """`clock_s`: the forged clock against the autopilot's; back in time is a forged reboot."""
        self.flight = flight
        self._codec = MavlinkCodec(1, 1)
        self._armed, self._height_m, self._clock_s = armed, height_m, clock_s
        self._period_s = {"heartbeat": 1 / heartbeats_Hz if heartbeats_Hz else 1e9}
        self._period_s |= {"altitude": 1 / altitude_Hz, "bend": 1 / bends_Hz if bends_Hz else 1e9}
        self._next = dict.fromkeys(self._period_s, flight.world.now)
        self.actions: list[Action] = []

    def run(self, for_s: float) -> None:
        until = self.flight.world.now + for_s
        while self.flight.world.now < until:
            for what, period_s in self._period_s.items():
                if self.flight.world.now >= self._next[what]:
                    self._next[what] += period_s
                    self._act(what)
            self.actions += run_for(self.flight, STEP_S)

    @property
    def bends(self) -> int:
        done = [decision for decision in decisions(self.actions) if decision.safety != "refused"]
        return sum(decision.setpoint_kPa > 0.0 for decision in done)

    def _act(self, what: str) -> None:
        now_ms = round(self.flight.world.now * 1000)
        if what == "bend":
            self.actions += ground_command(self.flight, BEND, 20.0 + now_ms % 1000 / 100)
        elif what == "heartbeat":
            mode = 0x80 if self._armed else 0
            self._forge(mavlink.MAVLink_heartbeat_message(QUADROTOR, ARDUPILOT, mode, 3, 4, 3))
        elif self._height_m is not None:
            now = self.flight.world.now + self._clock_s
            now_ms = self.flight.core._vehicle.state.time_boot_ms(now)
            height_mm = round(self._height_m * 1000)
            self._forge(mavlink.MAVLink_global_position_int_message(now_ms, 0, 0, 0, height_mm, 0, 0, 0, 0))

    def _forge(self, message: MavlinkMessage) -> None:
        (received,) = MavlinkCodec(1, 191).decode(self._codec.encode(message, 1))
        self.actions += self.flight.feed(VehicleMessage(self.flight.world.now, received))


@pytest.mark.parametrize("height_m", [30.0, 2_147_483.0, None])
@pytest.mark.parametrize("heartbeats_Hz", [1.0, 4.0, 50.0])
def test_a_forged_arm_state_bends_no_disarmed_vehicle(heartbeats_Hz: float, height_m: float | None) -> None:
    """At any phase against the real heartbeats."""
    random = Random(f"{heartbeats_Hz} {height_m}")
    for _ in range(examples(3)):
        flight = on_the_ground()
        if height_m is None:  # on a roof above home
            flight.autopilot.flight.height_m = 30.0
        run_for(flight, random.uniform(0.0, 1.0))
        spoofer = Spoofer(flight, heartbeats_Hz, height_m=height_m)
        spoofer.run(TRY_S)
        assert spoofer.bends == 0
        assert any(CONFLICT in text for text in notices(spoofer.actions))
        assert_vented(flight)


@pytest.mark.parametrize("clock_s", [0.0, -3.0, 3.0])
@pytest.mark.parametrize("altitude_Hz", [1.0, 5.0, 50.0])
def test_a_forged_altitude_bends_nothing_on_the_ground(altitude_Hz: float, clock_s: float) -> None:
    """The vehicle is really armed, and stands."""
    random = Random(f"{altitude_Hz} {clock_s}")
    for _ in range(examples(3)):
        flight = on_the_ground()
        flight.autopilot.arm()
        run_for(flight, 4.0 + random.uniform(0.0, 1.0))
        spoofer = Spoofer(flight, 0.0, altitude_Hz=altitude_Hz, clock_s=clock_s)
        spoofer.run(TRY_S)
        assert spoofer.bends == 0
        assert_vented(flight)


def test_the_spoofer_would_bend_if_nobody_contradicted_it() -> None:
    flight = on_the_ground()
    flight.autopilot.arm()
    flight.autopilot.flight.height_m = 30.0
    spoofer = Spoofer(flight, 4.0)
    spoofer.run(TRY_S)
    assert spoofer.bends > 0


def test_a_forged_disarm_in_flight_vents_and_refuses_until_it_ends() -> None:
    flight = bent()
    spoofer = Spoofer(flight, 4.0, armed=False, height_m=None, bends_Hz=0.0)
    spoofer.run(4.0)
    assert f"Vine: {CONFLICT}, vented" in notices(spoofer.actions)
    assert_vented(flight)
    (refused,) = decisions(ground_command(flight, BEND, 30.0))
    assert (refused.safety, refused.reason) == ("refused", CONFLICT)
    told = notices(run_for(flight, CONFLICT_S + 1.1))
    assert "Vine: only one autopilot again" in told
    (accepted,) = decisions(ground_command(flight, BEND, 30.0))
    assert accepted.safety == "accepted"


@pytest.mark.parametrize("apart_s", [-300.0, 40.0])
def test_two_autopilots_of_one_id_are_told_once_and_bend_nothing(apart_s: float) -> None:
    flight = bent()
    second, actions = MavlinkCodec(1, 1), []
    for _ in range(60):
        boot_ms = 1_000_000 + round((flight.world.now + apart_s) * 1000)
        position = mavlink.MAVLink_global_position_int_message(boot_ms, 0, 0, 0, 30_000, 0, 0, 0, 0)
        (received,) = MavlinkCodec(1, 191).decode(second.encode(position, 1))
        actions += flight.feed(VehicleMessage(flight.world.now, received))
        actions += run_for(flight, 0.2)
    told = notices(actions)
    assert [text for text in told if "two autopilots" in text] == ["Vine: two autopilots with id 1, vented"]
    assert sum("rebooted" in text for text in told) <= 1
    assert_vented(flight)
    (refused,) = decisions([*ground_command(flight, BEND, 30.0), *run_for(flight, 0.5)])
    assert (refused.safety, refused.reason) == ("refused", "two autopilots with id 1")
    (vent,) = decisions([*ground_command(flight, mavlink.MAV_CMD_USER_4, 0.0), *run_for(flight, 0.5)])
    assert vent.safety == "accepted"
    assert "Vine: only one autopilot again" in notices(run_for(flight, CONFLICT_S + 1.0))


def test_arming_and_disarming_once_are_no_conflict() -> None:
    flight = airborne()
    flight.autopilot.set_rc(9, HIGH)
    run_for(flight, 2.0)
    flight.autopilot.disarm()
    told = notices(run_for(flight, 6.0))
    flight.autopilot.set_rc(9, LOW)
    flight.autopilot.arm()
    told += notices(run_for(flight, 6.0))
    assert not [text for text in told if "second sender" in text]


def test_a_bend_is_refused_for_a_moment_after_arming() -> None:
    flight = on_the_ground()
    flight.autopilot.flight.height_m = 30.0
    run_for(flight, 3.0)
    flight.autopilot.arm()
    while not flight.core.snapshot(flight.world.now).armed:
        run_for(flight, STEP_S)
    (early,) = decisions(ground_command(flight, BEND, 30.0))
    assert (early.safety, early.reason) == ("refused", "armed less than 1.5 s ago")
    run_for(flight, ARMED_CONFIRMED_S + 0.1)
    (later,) = decisions(ground_command(flight, BEND, 31.0))
    assert later.safety == "accepted"
