"""Arming the pneumatics and calibrating, as a ground station commands them."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config
from flying_vines.config.config import Calibration, Config, Interlocks
from flying_vines.core.events import Action, Calibrated, Decision, KeepDisarmed, ToVehicle, VehicleMessage
from flying_vines.simulation.autopilot import Autopilot
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.mavlink.codec import Codec
from flying_vines.vehicle.notice import Notice

BEND, STOP, MORE = 31011, 31013, 31014
VENT, HOLD, DISARM, ARM = 0, 1, 2, 3
START, END = 2, 3
GROUND, SCRIPT = (255, 190), (1, 1)
SHORT = Calibration(steps=3, hold_s=2.0)


class Bench:
    """A vine on the bench: nothing flies, everything else is there."""

    def __init__(self, *, disarmed: bool = False, **interlocks: object) -> None:
        conf = msgspec.structs.replace(
            config.default(),
            interlocks=msgspec.structs.replace(Interlocks(bench_mode=True), **interlocks),
            calibration=SHORT,
        )
        self.flight = SimulatedFlight(conf, Autopilot("ardupilot"), disarmed=disarmed)
        self.actions: list[Action] = self.flight.run(3.0)
        self._senders: dict[tuple[int, int], Codec] = {}

    def command(self, number: int, param1: float, sender: tuple[int, int] = GROUND) -> Decision:
        """Send it and let a moment pass; what came of it."""
        message = mavlink.MAVLink_command_long_message(1, 191, number, 0, param1, 0, 0, 0, 0, 0, 0)
        codec = self._senders.setdefault(sender, Codec(*sender))
        (received,) = Codec(1, 191).decode(codec.encode(message, sender[0]))
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
    def answers(self) -> list[tuple[int, int]]:
        """Results and percents that were told of the command that calibrates."""
        messages = [action.message for action in self.actions if isinstance(action, ToVehicle)]
        return [
            (message.result, message.progress)
            for message in messages
            if message.get_type() == "COMMAND_ACK" and message.command == MORE
        ]

    @property
    def kept(self) -> list[bool]:
        """Whether disarmed, each time that this was to be kept."""
        return [action.disarmed for action in self.actions if isinstance(action, KeepDisarmed)]

    @property
    def texts(self) -> list[str]:
        return [action.text for action in self.actions if isinstance(action, Notice)]


def test_disarmed_pneumatics_let_air_out_and_bend_for_nobody_until_a_person_arms() -> None:
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


def test_a_profile_may_want_a_person_to_arm_first() -> None:
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
    assert bench.kept == []
    assert bench.command(STOP, ARM).safety == "accepted"
    assert bench.kept == [False]
    assert bench.command(BEND, 30.0).safety == "accepted"
    bench.command(STOP, DISARM)
    assert bench.kept == [False, True]


def test_latched_faults_are_no_companions_to_clear() -> None:
    bench = Bench()
    assert bench.command(MORE, 1, sender=(1, 195)).safety == "refused"
    assert bench.command(MORE, 1, sender=SCRIPT).safety == "refused"
    assert bench.command(MORE, 1).safety == "accepted"


def test_a_calibration_holds_every_level_and_says_what_it_found() -> None:
    bench = Bench()
    bottle_kPa = bench.flight.phlosar.reservoir_kPa
    assert bench.command(MORE, START).safety == "accepted"
    bench.wait(25.0)
    (found,) = (action for action in bench.actions if isinstance(action, Calibrated))
    assert [asked for asked, _ in found.levels_kPa] == pytest.approx(
        [0, 6.9, 13.8, 20.7, 13.8, 6.9, 0], abs=0.01
    )
    assert all(read == pytest.approx(asked, abs=0.6) for asked, read in found.levels_kPa)
    (said,) = (text for text in bench.texts if "calibrated" in text)
    taken_kPa = bottle_kPa - bench.flight.phlosar.reservoir_kPa
    assert f"took {taken_kPa:.0f} kPa of the bottle" in said
    percents = [percent for result, percent in bench.answers if result == mavlink.MAV_RESULT_IN_PROGRESS]
    assert percents[0] == 0 and percents == sorted(percents) and percents[-1] > 85
    assert 12 <= len(percents) <= 17  # one a second
    assert bench.answers[-1] == (mavlink.MAV_RESULT_ACCEPTED, 0)
    assert bench.flight.phlosar.cv_kPa < 1.0


@pytest.mark.parametrize(
    ("number", "param1"), [(MORE, END), (STOP, VENT), (STOP, HOLD), (STOP, DISARM), (BEND, 10.0)]
)
def test_whatever_takes_its_place_ends_a_calibration(number: int, param1: float) -> None:
    bench = Bench()
    bench.command(MORE, START)
    bench.wait(5.0)
    assert bench.command(number, param1).safety == "accepted"
    assert not any(isinstance(action, Calibrated) for action in bench.actions)
    assert bench.texts[-1] == "Vine: calibration ended early"
    assert bench.answers[-1][0] == (mavlink.MAV_RESULT_FAILED) or number == MORE
    results = [result for result, _ in bench.answers]
    assert results.count(mavlink.MAV_RESULT_FAILED) == 1
    assert bench.command(MORE, END).reason == "none is under way"


def test_a_loss_ends_a_calibration() -> None:
    bench = Bench()
    bench.command(MORE, START)
    bench.wait(5.0)
    bench.flight.autopilot.mute(10.0)
    bench.wait(5.0)
    assert "Vine: calibration ended early" in bench.texts
    assert bench.flight.phlosar.cv_kPa < 1.0


def test_a_calibration_starts_from_a_vented_vine_and_only_for_a_person() -> None:
    bench = Bench()
    assert bench.command(MORE, START, sender=SCRIPT).safety == "refused"
    bench.command(BEND, 20.0)
    assert bench.command(MORE, START).reason == "vent the vine first"


def test_a_calibration_needs_what_every_bend_needs() -> None:
    bench = Bench(bench_mode=False)
    assert bench.command(MORE, START).reason == "not armed"


def too_long() -> Config:
    text = config.default_text().replace("hold_s = 3 ", "hold_s = 30 ")
    return config.parse(text, "my.toml")


def test_a_calibration_that_the_limits_would_cut_off_is_no_profile() -> None:
    with pytest.raises(config.ConfigError, match=r"my\.toml:\d+: calibration: takes 391 s, longer than"):
        too_long()
