"""A monitor finds no violation in random flights, and finds each violation of a mutant.

A mutant is a service or a firmware that breaks one rule.

In each flight of a mutant, the real service and firmware have no violation.
"""

from __future__ import annotations

import dataclasses
import random
from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec
import pytest
from faults_flight import PULSES_US, SWITCH, MonitoredFlight, Setup
from faults_script import draw, fly
from hypothesis import note, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from random_mishaps import DRAWN
from required_programs import needs_compiler

from examples import examples
from firmware_link import host, protocol
from firmware_link.protocol import Setpoint, Vent
from flying_vines.config.config import Config
from flying_vines.core.core import Core
from flying_vines.core.events import Action, Decision, Event, Tick
from flying_vines.core.safety import LossEnded, ResponseNeeded, Ruling
from flying_vines.physics.baseline import Inputs
from flying_vines.simulation.autopilot import AutopilotKind, RcSource
from flying_vines.simulation.autopilot.rc_input import LOSSES
from flying_vines.simulation.phlosar.firmware import Firmware
from flying_vines.simulation.phlosar.mishaps import PLACES, Filled, StuckAt
from flying_vines.vehicle.triggers import Trigger
from flying_vines.vine.intent import BendTo, StartProfile
from flying_vines.vine.motion import Motion

# Mutants, and the flights that expose them.


class ResumesAfterRcLoss(Core):
    """Resumes its motion after an RC loss."""

    _before: Motion | None = None

    def _enter(self, t: float, change: ResponseNeeded) -> None:
        if self._vine.motion is not None:
            self._before = self._vine.motion
        super()._enter(t, change)

    def _leave(self, t: float, change: LossEnded) -> None:
        super()._leave(t, change)
        self._vine.motion = self._before


class MovesWithoutRequest(Core):
    """Moves without a request."""

    def handle(self, event: Event) -> list[Action]:
        actions = super().handle(event)
        if isinstance(event, Tick) and event.t == pytest.approx(9.0):
            self._decide(event.t, Trigger(event.t, "none", {}, StartProfile("bend-full")))
        return actions


class IgnoresSafety(Core):
    """Continues although safety vents."""

    def _enter(self, t: float, change: ResponseNeeded) -> None:
        pass


class AcceptsUnseenMoves(Core):
    """Accepts a move of the switch that nobody saw."""

    def __init__(self, conf: Config) -> None:
        super().__init__(conf)
        self._vehicle.switch.lose = lambda: None  # type: ignore[method-assign]


class ResumesAfterReset(Core):
    """Gives a restarted board its former command."""

    def _on_firmware(self, t: float, message: protocol.Message) -> None:
        before = self._vine.motion
        super()._on_firmware(t, message)
        if before is not None and "firmware_reset" in self._safety.reasons:
            self._again = before
        if self._firmware.state is host.SessionState.READY and hasattr(self, "_again"):
            self._safety._latched.clear()
            self._vine.motion = self._again


class FinishesItsMotion(Core):
    """On RC loss it does not hold the vine, but finishes its motion."""

    def _freeze(self, t: float) -> None:
        pass


class HasNoLimits(Core):
    """Has no limits."""

    def __init__(self, conf: Config) -> None:
        limits = msgspec.structs.replace(conf.limits, max_kPa=24.0)
        vine = msgspec.structs.replace(conf.vine, curve=((0.0, 0.0), (24.0, 60.0)))
        super().__init__(msgspec.structs.replace(conf, limits=limits, vine=vine))


class ClearsFaultsItself(Core):
    """Clears latched faults as soon as possible."""

    def _on_tick(self, t: float) -> None:
        self._clear_faults(t)
        super()._on_tick(t)


class NeverStraightens(Core):
    """Ignores requests to straighten."""

    def _decide(self, t: float, trigger: Trigger) -> Decision:
        if trigger.intent == StartProfile("straight"):
            return self._record(t, trigger, Ruling("accepted"))
        return super()._decide(t, trigger)


class ReportsButDoesNotBend(Core):
    """Reports a bend, but does not bend the vine."""

    def _decide(self, t: float, trigger: Trigger) -> Decision:
        if trigger.what.get("position"):
            return self._record(t, trigger, Ruling("accepted"))
        return super()._decide(t, trigger)


class BendsByHalf(Core):
    """Bends the vine by half of the requested angle."""

    def _decide(self, t: float, trigger: Trigger) -> Decision:
        if isinstance(trigger.intent, BendTo):
            trigger = dataclasses.replace(trigger, intent=BendTo(trigger.intent.angle_deg / 2))
        return super()._decide(t, trigger)


class RemembersTheSetpoint(Firmware):
    """Stores the last setpoint without a later vent, and its time."""

    def __init__(self) -> None:
        super().__init__()
        self._decoder = protocol.Codec()
        self._now_us = self._since_us = 0
        self._last: Setpoint | None = None

    def receive(self, data: bytes) -> None:
        for message in self._decoder.decode(data):
            if isinstance(message, Setpoint):
                # Leave room for more setpoints in between.
                message = dataclasses.replace(message, count=1000 * message.count)
            if isinstance(message, Setpoint | Vent):
                self._last = message if isinstance(message, Setpoint) else None
                self._since_us = self._now_us
            super().receive(protocol.encode(message, 0))

    def step(self, now_us: int, cv_kPa: float, reservoir_kPa: float) -> Inputs:
        self._now_us = now_us
        if self._last is not None:
            self._remember(self._last, (now_us - self._since_us) // 1000)
        return super().step(now_us, cv_kPa, reservoir_kPa)

    def _remember(self, last: Setpoint, for_ms: int) -> None: ...


class LateDeadMan(RemembersTheSetpoint):
    """Its dead-man waits 150 ms longer than the time-to-live."""

    def _remember(self, last: Setpoint, for_ms: int) -> None:
        if for_ms < 150:
            repeated = dataclasses.replace(last, count=last.count + 1 + for_ms)
            Firmware.receive(self, protocol.encode(repeated, 0))


class DoesNotLatchItsDeadMan(RemembersTheSetpoint):
    """Vents when its dead-man runs out, but does not latch this, so the next setpoint continues."""

    def _remember(self, last: Setpoint, for_ms: int) -> None:
        if for_ms >= last.ttl_ms - 1:
            Firmware.receive(self, protocol.encode(Vent(last.number), 0))


class IgnoresOverPressure(Firmware):
    """Ignores over-pressure of vine and reservoir."""

    def step(self, now_us: int, cv_kPa: float, reservoir_kPa: float) -> Inputs:
        return super().step(now_us, min(cv_kPa, 25.0), min(reservoir_kPa, 700.0))


class IgnoresVents(Firmware):
    """Ignores vents."""

    def __init__(self) -> None:
        super().__init__()
        self._decoder = protocol.Codec()

    def receive(self, data: bytes) -> None:
        for message in self._decoder.decode(data):
            if not isinstance(message, Vent):
                super().receive(protocol.encode(message, 0))


class OpensAtPowerUp(Firmware):
    """Inflates for one step after each Hello."""

    def __init__(self) -> None:
        super().__init__()
        self._decoder = protocol.Codec()
        self._greeted = False

    def receive(self, data: bytes) -> None:
        self._greeted = any(isinstance(message, protocol.Hello) for message in self._decoder.decode(data))
        super().receive(data)

    def step(self, now_us: int, cv_kPa: float, reservoir_kPa: float) -> Inputs:
        drive = super().step(now_us, cv_kPa, reservoir_kPa)
        if self._greeted:
            self._greeted = False
            return Inputs(1.0, 0.0, False)
        return drive


def airborne(flight: MonitoredFlight) -> None:
    flight.run(1.5)
    flight.take_off()
    flight.run(5.2)


def bent(flight: MonitoredFlight) -> None:
    airborne(flight)
    flight.move_switch(2)
    flight.run(1.0)


def lose_rc_for_a_while(flight: MonitoredFlight) -> None:
    bent(flight)
    flight.lose_rc("jump")
    flight.run(1.5)
    flight.return_rc()
    flight.run(1.5)


def lose_rc_while_bending(flight: MonitoredFlight) -> None:
    airborne(flight)
    flight.press(3)
    flight.run(0.2)
    flight.lose_rc("jump")
    flight.run(3.0)
    flight.return_rc()
    flight.run(1.0)


def do_nothing(flight: MonitoredFlight) -> None:
    airborne(flight)
    flight.run(4.5)


def bend_by_a_number(flight: MonitoredFlight) -> None:
    airborne(flight)
    flight.bend_to(40.0)
    flight.run(2.0)


def disarm(flight: MonitoredFlight) -> None:
    bent(flight)
    flight.disarm()
    flight.run(2.0)


def move_unseen(flight: MonitoredFlight) -> None:
    airborne(flight)
    flight.lose_rc("jump")
    flight.run(1.5)
    flight.move_switch(2)
    flight.run(0.5)
    flight.return_rc()
    flight.run(2.0)


def reset_board(flight: MonitoredFlight) -> None:
    bent(flight)
    flight.phlosar.reset_firmware()
    flight.run(1.5)


def cut(flight: MonitoredFlight) -> None:
    bent(flight)
    flight.cut_commands()
    flight.run(1.0)
    flight.mend_line()
    flight.run(1.0)


def cut_and_ask_again(flight: MonitoredFlight) -> None:
    cut(flight)
    flight.press(4)
    flight.run(0.5)


def stay_bent(flight: MonitoredFlight) -> None:
    bent(flight)
    flight.run(3.0)


def cut_while_bending(flight: MonitoredFlight) -> None:
    """The switch requests more while the board receives nothing."""
    airborne(flight)
    flight.move_switch(1)
    flight.run(1.0)
    flight.cut_commands()
    flight.run(0.27)
    flight.mend_line()
    flight.run(1.0)


def overfill(flight: MonitoredFlight) -> None:
    bent(flight)
    flight.inject("reservoir", Filled(800.0))
    flight.run(0.5)


def straighten(flight: MonitoredFlight) -> None:
    """Straighten in the middle of a wave, which continues to bend the vine."""
    airborne(flight)
    flight.press(3)
    flight.run(0.5)
    flight.press(0)
    flight.run(3.0)


@dataclass(frozen=True)
class Mutant:
    flown: Callable[[MonitoredFlight], None]
    rules: set[str]
    """The monitor must report a violation of at least one of these rules."""
    core: Callable[[Config], Core] = Core
    board: type[Firmware] = Firmware
    setup: Setup = field(default_factory=Setup)


MUTANTS = [
    Mutant(lose_rc_for_a_while, {"trigger"}, core=ResumesAfterRcLoss),
    Mutant(do_nothing, {"trigger"}, core=MovesWithoutRequest),
    Mutant(disarm, {"safe state"}, core=IgnoresSafety),
    Mutant(lose_rc_for_a_while, {"safe state"}, core=IgnoresSafety),
    Mutant(move_unseen, {"trigger"}, core=AcceptsUnseenMoves),
    Mutant(reset_board, {"resumed"}, core=ResumesAfterReset),
    Mutant(cut_and_ask_again, {"resumed"}, core=ClearsFaultsItself),
    Mutant(straighten, {"safe state"}, core=NeverStraightens),
    Mutant(stay_bent, {"missed"}, core=ReportsButDoesNotBend),
    Mutant(bend_by_a_number, {"numbers"}, core=BendsByHalf),
    Mutant(stay_bent, {"trigger"}, core=IgnoresSafety, setup=Setup(max_bent_s=2.0)),
    Mutant(lose_rc_while_bending, {"resumed"}, FinishesItsMotion, setup=Setup(holds=True)),
    Mutant(bent, {"limits"}, core=HasNoLimits),
    Mutant(cut, {"dead-man"}, board=LateDeadMan),
    Mutant(overfill, {"firmware's limits"}, board=IgnoresOverPressure),
    Mutant(lose_rc_for_a_while, {"trigger"}, board=IgnoresVents),
    Mutant(cut_while_bending, {"resumed"}, board=DoesNotLatchItsDeadMan),
    Mutant(do_nothing, {"trigger"}, board=OpensAtPowerUp),
]


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda c: f"{c.core.__name__}-{c.board.__name__}")
def test_the_monitor_finds_each_violation(mutant: Mutant) -> None:
    flight = MonitoredFlight(mutant.setup, mutant.core, mutant.board())
    mutant.flown(flight)
    assert mutant.rules & {violation.rule for violation in flight.violations}, flight.timeline


@pytest.mark.long
@pytest.mark.parametrize(
    "mutant", {mutant.flown: mutant for mutant in MUTANTS}.values(), ids=lambda c: c.flown.__name__
)
def test_the_real_core_has_no_violation(mutant: Mutant) -> None:
    flight = MonitoredFlight(mutant.setup, board=Firmware())
    mutant.flown(flight)
    assert flight.violations == []


def test_a_limit_that_is_too_high_is_seen_at_the_vine() -> None:
    """The true pressure is above the firmware's limit. The repair of an intact part does not excuse this."""
    flight = MonitoredFlight(Setup(), board=Firmware({"cv_limit_kPa": 60.0}))
    bent(flight)
    flight.heal("reservoir")
    flight.phlosar.mishaps.evp = StuckAt(1.0)
    flight.phlosar.mishaps.solenoid = StuckAt(0.0)
    flight.run(0.5)
    assert "over the limit" in {violation.rule for violation in flight.violations}


# Flights that hypothesis draws.


class AnyFlight(RuleBasedStateMachine):
    """Any requests and any faults, in any order. The monitor checks after each of them."""

    @initialize(receiver=st.sampled_from(sorted(LOSSES)), holds=st.booleans())
    def take_off(self, receiver: RcSource, holds: bool) -> None:
        autopilot: AutopilotKind = "ardupilot" if receiver == "pulses" else "px4"
        self.flight = MonitoredFlight(Setup(autopilot, receiver=receiver, holds=holds))
        self.rc_lost = self.unplugged = self.link_closed = self.overridden = False
        airborne(self.flight)

    @rule(seconds=st.floats(0.05, 2.0))
    def wait(self, seconds: float) -> None:
        self.flight.run(seconds)

    @rule(position=st.integers(0, 2))
    def move_the_switch(self, position: int) -> None:
        self.flight.move_switch(position)
        self.flight.run(0.3)

    @rule(code=st.integers(0, 5), angle_deg=st.floats(0.0, 60.0))
    def press_a_button(self, code: int, angle_deg: float) -> None:
        self.flight.press(code, angle_deg)
        self.flight.run(0.2)

    @rule(verb=st.sampled_from(["vent", "hold", "clear_faults", "take_off", "land", "disarm"]))
    def ask(self, verb: str) -> None:
        getattr(self.flight, verb)()
        self.flight.run(0.2)

    @precondition(lambda self: self.flight.setup.receiver != "joystick")
    @rule(jumps=st.booleans(), preset_us=st.none() | st.sampled_from(PULSES_US))
    def rc_is_lost_or_returns(self, jumps: bool, preset_us: int | None) -> None:
        if self.rc_lost:
            self.flight.return_rc()
        else:
            how = LOSSES[self.flight.autopilot.rc.source][-1 if jumps else 0]
            # On ArduPilot, nobody sees a preset that does not change the throttle.
            unseen = self.flight.setup.autopilot == "ardupilot" or preset_us is None
            self.flight.lose_rc(how, None if unseen else {SWITCH: preset_us or 0})
        self.rc_lost = not self.rc_lost

    @precondition(lambda self: self.flight.setup.autopilot == "ardupilot")
    @rule(position=st.integers(0, 2))
    def a_ground_station_overrides_rc_or_ceases_to(self, position: int) -> None:
        if self.overridden:
            self.flight.stop_override()
        else:
            self.flight.override(position)
        self.overridden = not self.overridden

    @rule(seconds=st.floats(0.1, 4.0), both_ways=st.booleans())
    def the_vehicle_link_stalls(self, seconds: float, both_ways: bool) -> None:
        self.flight.stall_vehicle_link(seconds, both_ways)

    @rule()
    def the_vehicle_link_closes_or_opens(self) -> None:
        if self.link_closed:
            self.flight.open_vehicle_link()
        else:
            self.flight.close_vehicle_link()
        self.link_closed = not self.link_closed

    @rule(seconds=st.floats(0.1, 4.0))
    def the_autopilot_is_silent(self, seconds: float) -> None:
        self.flight.mute(seconds)

    @rule()
    def the_serial_line_is_unplugged_or_plugged_in(self) -> None:
        if self.unplugged:
            self.flight.plug_in()
        else:
            self.flight.unplug()
        self.unplugged = not self.unplugged

    @rule(share=st.sampled_from([0.0, 0.2, 0.6]))
    def the_serial_line_is_noisy(self, share: float) -> None:
        self.flight.spoil_line(share)

    @rule()
    def the_companion_dies_or_starts(self) -> None:
        if self.flight.companion_lives:
            self.flight.kill_companion()
        else:
            self.flight.start_companion()

    @precondition(lambda self: self.flight.companion_lives)
    @rule(seconds=st.floats(0.1, 2.0))
    def the_companion_stalls(self, seconds: float) -> None:
        self.flight.stall_companion(seconds)

    @rule(which=st.integers(0, len(DRAWN) - 1), seed=st.integers(0, 1000))
    def something_breaks(self, which: int, seed: int) -> None:
        place, make = DRAWN[which]
        self.flight.inject(place, make(random.Random(seed)))
        self.flight.run(0.2)

    @rule(place=st.sampled_from(sorted(PLACES)))
    def it_is_mended(self, place: str) -> None:
        self.flight.heal(place)

    @invariant()
    def no_violation(self) -> None:
        if self.flight.violations:
            for t, text in self.flight.timeline:
                note(f"{t:7.3f} {text}")
        assert self.flight.violations == []


@needs_compiler
class TestAnyFlight(AnyFlight.TestCase):  # type: ignore[misc, valid-type]
    settings = settings(max_examples=examples(15), stateful_step_count=40, derandomize=True)


@needs_compiler
@pytest.mark.parametrize("seed", [1, 2, 3, 5641])
def test_flights_of_the_campaign(seed: int) -> None:
    """Some of the flights of benchmarks/faults.py."""
    outcome = fly(draw(seed))
    assert outcome.violations == (), outcome.timeline


@pytest.mark.long
@needs_compiler
def test_a_flight_is_the_same_each_time() -> None:
    assert draw(11) == draw(11)
    assert draw(11) != draw(12)
    assert fly(draw(11)) == fly(draw(11))
