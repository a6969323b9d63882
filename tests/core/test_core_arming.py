"""A ground station arms and disarms the pneumatics."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config
from flying_vines.config.config import InterlocksConfig
from flying_vines.core.events import Action, Asked, Decision, KeepDisarmed, StoredState, VehicleMessage
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.notice import Notice
from flying_vines.vine.intent import DisarmPneumatics

BEND, STOP, MORE = 31011, 31013, 31014
VENT, HOLD, DISARM, ARM = 0, 1, 2, 3
GROUND, SCRIPT = (255, 190), (1, 1)


class Bench:
    """A vine on the bench: all links work, and the vehicle is disarmed on the ground."""

    def __init__(self, *, disarmed: bool = False, **interlocks: object) -> None:
        conf = msgspec.structs.replace(
            config.default(),
            interlocks=msgspec.structs.replace(InterlocksConfig(bench_mode=True), **interlocks),
        )
        self.flight = SimulatedFlight(conf, FakeAutopilot("ardupilot"), stored=StoredState(disarmed=disarmed))
        self.actions: list[Action] = self.flight.run(3.0)
        self._senders: dict[tuple[int, int], MavlinkCodec] = {}

    def command(self, number: int, param1: float, sender: tuple[int, int] = GROUND) -> Decision:
        """Send a command, and run for a moment. Returns the decision."""
        message = mavlink.MAVLink_command_long_message(1, 191, number, 0, param1, 0, 0, 0, 0, 0, 0)
        codec = self._senders.setdefault(sender, MavlinkCodec(*sender))
        (received,) = MavlinkCodec(1, 191).decode(codec.encode(message, sender[0]))
        actions = self.flight.feed(VehicleMessage(self.flight.world.now, received))
        self.actions += actions
        (decision,) = (action for action in actions if isinstance(action, Decision))
        self.wait(0.1)
        return decision

    def wait(self, seconds: float) -> Sequence[Action]:
        actions = self.flight.run(self.flight.world.now + seconds)
        self.actions += actions
        return actions

    @property
    def stored(self) -> list[bool]:
        """The states of disarming that the core asked to store, in order."""
        return [action.disarmed for action in self.actions if isinstance(action, KeepDisarmed)]


def test_disarmed_pneumatics_vent_and_do_not_bend_until_a_person_arms_them() -> None:
    bench = Bench()
    bench.command(BEND, 30.0)
    bench.wait(2.0)
    assert bench.flight.phlosar.cv_kPa > 5.0
    assert bench.command(STOP, DISARM).safety == "accepted"
    bench.wait(2.0)
    assert bench.flight.phlosar.cv_kPa < 1.0
    refused = bench.command(BEND, 30.0)
    assert (refused.safety, refused.reason) == ("refused", "the pneumatics are disarmed")
    assert bench.command(STOP, VENT).safety == "accepted"
    assert bench.command(STOP, ARM, sender=SCRIPT).safety == "refused"
    assert bench.command(STOP, ARM, sender=(1, 195)).safety == "refused"
    assert bench.command(BEND, 30.0).safety == "refused"
    assert bench.command(STOP, ARM).safety == "accepted"
    assert bench.command(BEND, 30.0).safety == "accepted"


def test_a_configuration_may_require_that_a_person_arms_first() -> None:
    bench = Bench(armed_at_start=False)
    assert bench.flight.core.snapshot(3.0).doing == "pneumatics disarmed"
    assert bench.command(BEND, 30.0).safety == "refused"
    assert bench.command(STOP, ARM).safety == "accepted"
    assert bench.flight.core.snapshot(3.0).doing == "vented"
    assert bench.command(BEND, 30.0).safety == "accepted"


@pytest.mark.parametrize("armed_at_start", [True, False])
def test_pneumatics_that_were_disarmed_before_a_restart_still_are(armed_at_start: bool) -> None:
    bench = Bench(disarmed=True, armed_at_start=armed_at_start)
    assert bench.flight.core.snapshot(3.0).doing == "pneumatics disarmed"
    assert bench.command(BEND, 30.0).reason == "the pneumatics are disarmed"
    assert bench.command(STOP, ARM, sender=SCRIPT).safety == "refused"
    assert bench.stored == []
    assert bench.command(STOP, ARM).safety == "accepted"
    assert bench.stored == [False]
    assert bench.command(BEND, 30.0).safety == "accepted"
    bench.command(STOP, DISARM)
    assert bench.stored == [False, True]


def test_another_companion_cannot_clear_latched_faults() -> None:
    bench = Bench()
    assert bench.command(MORE, 1, sender=(1, 195)).safety == "refused"
    assert bench.command(MORE, 1, sender=SCRIPT).safety == "refused"
    assert bench.command(MORE, 1).safety == "accepted"


@pytest.mark.parametrize("sender", [GROUND, SCRIPT, (77, 33)])
def test_the_pilot_reads_who_disarmed_the_pneumatics_once(sender: tuple[int, int]) -> None:
    bench = Bench()
    for _ in range(3):
        bench.command(STOP, DISARM, sender)
    told = [a.text for a in bench.actions if isinstance(a, Notice) and "disarmed" in a.text]
    assert told == [f"Vine: pneumatics disarmed by {sender[0]}/{sender[1]}"]
    assert bench.flight.core.snapshot(bench.flight.world.now).waiting is None


def test_the_pilot_reads_that_the_page_disarmed_the_pneumatics() -> None:
    flight = Bench().flight
    actions = flight.feed(Asked(flight.world.now, "page", DisarmPneumatics()))
    assert "Vine: pneumatics disarmed by the page" in [a.text for a in actions if isinstance(a, Notice)]
