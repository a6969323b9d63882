"""Simulated flights for the tests of the core, and functions that read its actions."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from firmware_link.protocol import Setpoint
from flying_vines.config import config
from flying_vines.config.config import Config
from flying_vines.core.events import (
    Action,
    Decision,
    ToFirmware,
    ToVehicle,
    VehicleMessage,
)
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.notice import Notice, Severity

from .prepared import prepared

LOW, MIDDLE, HIGH = 1000, 1500, 2000


def configured(**tables: object) -> Config:
    return msgspec.structs.replace(config.default(), **tables)


def airborne(
    conf: Config | None = None,
    autopilot: FakeAutopilot | None = None,
    phlosar: SimulatedPhlosar | None = None,
) -> SimulatedFlight:
    """A flight at 10 m, RC good, switch low, vine straight, after 4 s."""
    conf = conf or config.default()
    if autopilot or phlosar:
        return _climbed(conf, autopilot, phlosar)
    return prepared(_climbed, conf)


def _climbed(
    conf: Config, autopilot: FakeAutopilot | None = None, phlosar: SimulatedPhlosar | None = None
) -> SimulatedFlight:
    autopilot = autopilot or FakeAutopilot("ardupilot", rc_failsafe_mode=None)
    flight = SimulatedFlight(conf, autopilot, phlosar)
    autopilot.set_rc(9, LOW)
    flight.run(2.0)
    autopilot.takeoff(10.0)
    autopilot.flight.take_off_to(10.0)
    autopilot.flight.height_m = 10.0  # skip the climb
    flight.run(4.0)
    return flight


def on_the_ground(conf: Config | None = None) -> SimulatedFlight:
    """A disarmed vehicle with RC and phloSAR, switch low, after 4 s."""
    return prepared(_on_the_ground, conf or config.default())


def _on_the_ground(conf: Config) -> SimulatedFlight:
    autopilot = FakeAutopilot("ardupilot")
    autopilot.set_rc(9, LOW)
    flight = SimulatedFlight(conf, autopilot)
    flight.run(4.0)
    return flight


def run_for(flight: SimulatedFlight, seconds: float) -> list[Action]:
    return flight.run(flight.world.now + seconds)


def decisions(actions: Sequence[Action]) -> list[Decision]:
    return [a for a in actions if isinstance(a, Decision)]


def notices(actions: Sequence[Action]) -> list[str]:
    return [a.text for a in actions if isinstance(a, Notice)]


def shown(actions: Sequence[Action]) -> list[str]:
    """The texts that a pilot sees."""
    return [a.text for a in actions if isinstance(a, Notice) and a.severity is not Severity.DEBUG]


def setpoints(actions: Sequence[Action]) -> list[Setpoint]:
    return [a.message for a in actions if isinstance(a, ToFirmware) and isinstance(a.message, Setpoint)]


def answers(actions: Sequence[Action]) -> list[tuple[int, int]]:
    return [
        (a.message.command, a.message.result)
        for a in actions
        if isinstance(a, ToVehicle) and a.message.get_type() == "COMMAND_ACK"
    ]


def ground_command(
    flight: SimulatedFlight,
    command: int,
    *params: float,
    target: tuple[int, int] = (1, 191),
    confirmation: int = 0,
) -> list[Action]:
    numbers = [*params, *[0.0] * (7 - len(params))]
    message = mavlink.MAVLink_command_long_message(*target, command, confirmation, *numbers)
    ground = MavlinkCodec(255, 190)
    flight_codec = MavlinkCodec(1, 191)
    ground._out.seq = int(flight.world.now * 1000) % 256
    (received,) = flight_codec.decode(ground.encode(message, 255))
    return flight.feed(VehicleMessage(flight.world.now, received))


def bent(phlosar: SimulatedPhlosar | None = None, conf: Config | None = None) -> SimulatedFlight:
    conf = conf or config.default()
    return begin_bent(conf, phlosar) if phlosar else prepared(begin_bent, conf)


def begin_bent(conf: Config, phlosar: SimulatedPhlosar | None = None) -> SimulatedFlight:
    flight = airborne(conf, phlosar=phlosar)
    flight.autopilot.set_rc(9, HIGH)
    (decision,) = decisions(run_for(flight, 2.0))
    assert decision.safety == "accepted"
    assert flight.phlosar.cv_kPa == pytest.approx(20.7, abs=1.0)
    return flight


def assert_vented(flight: SimulatedFlight) -> None:
    assert flight.phlosar.drive.evp == 0.0
    assert flight.phlosar.drive.solenoid
    assert flight.phlosar.cv_kPa < 1.0
