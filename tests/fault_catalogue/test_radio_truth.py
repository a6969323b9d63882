"""The monitor finds no violation in flights with misleading data from the radio or the mission.

Each flight exposes one wrong assumption: a service with this assumption has a violation.
`tests/data/recordings/README.md` says what RC does on PX4, and what ArduPilot hides.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import partial
from typing import Literal

import pytest
from faults_flight import ACTUATOR, SCRIPT_MESSAGE, MonitoredFlight, Setup
from required_programs import needs_compiler

from flying_vines.config.config import Config
from flying_vines.core.core import Core
from flying_vines.core.safety import SafetyInputs
from flying_vines.simulation.autopilot import AutopilotKind, RcSource
from flying_vines.vehicle.autopilots import OTHER
from flying_vines.vehicle.autopilots.autopilot import Autopilot
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.mission.mission_cache import MissionCache
from flying_vines.vehicle.radio.pilot import PilotOutput
from flying_vines.vehicle.triggers import Trigger
from flying_vines.vine.intent import Intent

from .catalogue import ROWS

pytestmark = [needs_compiler, pytest.mark.long]

RECEIVERS: list[RcSource] = ["sbus", "crsf"]
BENT_KPA = 5.0
SWITCH = 9
LOOK_S = 0.01


FLOWN: dict[str, Callable[[Config], Core]] = {"core": Core}
"""The core to fly. A test below replaces it by cores that lack a rule."""


def airborne(setup: Setup) -> MonitoredFlight:
    """A flight in which RC has been good for long enough to be accepted."""
    flight = MonitoredFlight(setup, FLOWN["core"])
    flight.run(1.5)
    flight.take_off()
    flight.run(5.5)
    return flight


def px4(receiver: RcSource, seed: int = 1) -> MonitoredFlight:
    return airborne(Setup("px4", receiver=receiver, seed=seed))


def ardupilot(parameters: Mapping[str, float] | None = None) -> MonitoredFlight:
    return airborne(Setup("ardupilot", parameters=parameters or {}))


def bent(flight: MonitoredFlight) -> MonitoredFlight:
    """The flight after the pilot has bent the vine."""
    flight.move_switch(2)
    flight.run(3.0)
    if flight.phlosar.cv_kPa <= BENT_KPA:
        raise RuntimeError("the pilot's own move did not bend the vine")
    return flight


def assert_clean(flight: MonitoredFlight) -> None:
    assert flight.violations == [], "\n".join(f"{t:7.3f} {text}" for t, text in flight.timeline)


# Moves of the pilot, which no rule may prevent.


@pytest.mark.parametrize("receiver", [*RECEIVERS, "overrides"])
def test_a_switch_on_px4_bends_and_straightens(receiver: RcSource) -> None:
    flight = bent(px4(receiver))
    flight.move_switch(0)
    flight.run(0.7)
    assert flight.phlosar.drive.evp == 0.0, "a release is never delayed"
    flight.run(4.0)
    assert flight.phlosar.cv_kPa < 1.0
    flight.move_switch(1)
    flight.run(4.0)
    assert flight.phlosar.cv_kPa > BENT_KPA
    assert_clean(flight)


def test_a_switch_on_ardupilot_bends_within_half_a_second() -> None:
    flight = ardupilot()
    flight.move_switch(1)
    flight.run(0.5)
    assert flight.phlosar.cv_kPa > BENT_KPA
    flight.run(3.0)
    assert_clean(flight)


# PX4 reports the loss of its own receiver late, and repeats the old values.


@pytest.mark.parametrize("receiver", RECEIVERS)
def test_px4_frozen_values_hold_no_bend(receiver: RcSource) -> None:
    row = ROWS["px4_receiver_lost"]
    assert row.allowed_ms is not None
    flight = bent(px4(receiver))
    flight.lose_rc("frozen")
    began_s = unsafe_s = flight.now_s
    while flight.now_s < began_s + 6.0:
        flight.run(LOOK_S)
        if flight.phlosar.drive.evp > 0.0 or not flight.phlosar.drive.solenoid:
            unsafe_s = flight.now_s
    to_safe_ms = round(1000 * (unsafe_s - began_s))
    assert to_safe_ms <= row.allowed_ms
    assert receiver != "sbus" or to_safe_ms == pytest.approx(row.measured_ms, abs=20)
    assert flight.phlosar.cv_kPa < 1.0
    flight.return_rc()
    flight.run(3.0)
    assert_clean(flight)


@pytest.mark.parametrize("receiver", RECEIVERS)
def test_px4_switch_moved_while_rc_was_lost_bends_nothing(receiver: RcSource) -> None:
    flight = px4(receiver)
    flight.lose_rc("frozen")
    flight.run(2.5)
    flight.move_switch(2)
    flight.run(1.5)
    flight.return_rc()
    flight.run(4.0)
    assert_clean(flight)


@pytest.mark.parametrize("also", [{}, {5: 2000, 6: 1500}])
def test_px4_preset_of_the_receiver_is_no_move(also: dict[int, int]) -> None:
    flight = px4("sbus")
    flight.lose_rc("jump", {SWITCH: 2000, **also})
    flight.run(6.0)
    flight.return_rc()
    flight.run(3.0)
    assert_clean(flight)


@pytest.mark.parametrize("seconds", [0.2, 0.4, 0.9, 1.3])
def test_px4_preset_in_a_blip_is_no_move(seconds: float) -> None:
    flight = px4("sbus")
    for _ in range(3):
        flight.lose_rc("jump", {SWITCH: 2000})
        flight.run(seconds)
        flight.return_rc()
        flight.run(3.5)
    assert_clean(flight)


# A parameter of ArduPilot hides a loss, or an override ends.


@pytest.mark.parametrize("parameters", [{"FS_THR_ENABLE": 0}, {"RC_FS_TIMEOUT": 8}, {"RC_OPTIONS": 36}])
def test_ardupilot_switch_moved_in_a_hidden_loss_bends_nothing(parameters: dict[str, float]) -> None:
    flight = ardupilot(parameters)
    flight.lose_rc("frozen")
    flight.run(2.0)
    flight.move_switch(2)
    flight.run(2.0)
    flight.return_rc()
    flight.run(3.0)
    assert_clean(flight)


def test_ardupilot_loss_hidden_in_flight_by_a_parameter() -> None:
    flight = ardupilot()
    flight.hide_rc_losses("FS_THR_ENABLE", 0.0)
    flight.run(1.0)
    flight.lose_rc("frozen")
    flight.run(2.0)
    flight.move_switch(2)
    flight.run(2.0)
    flight.return_rc()
    flight.run(3.0)
    assert_clean(flight)


@pytest.mark.parametrize("vented", ["before", "during"])
def test_an_override_that_ends_is_no_move(vented: Literal["before", "during"]) -> None:
    flight = bent(ardupilot())
    if vented == "before":
        flight.vent()
        flight.run(1.0)
    flight.override(0)
    flight.run(4.0)
    if vented == "during":
        flight.vent()
        flight.run(1.0)
    flight.stop_override()
    flight.run(6.0)
    assert_clean(flight)


# Missions that change, and items that arrive late.


def vine_item(kind: AutopilotKind, seq: int, code: float, angle_deg: float) -> MissionItem:
    command, last = (ACTUATOR, 1.0) if kind == "px4" else (SCRIPT_MESSAGE, 0.0)
    return MissionItem(seq, command, (code, angle_deg, 0.0, 0.0, 0.0, 0.0, last), 2)


def mission(
    kind: AutopilotKind, *wanted: tuple[float, float], delay_s: float = 2.0
) -> tuple[MissionItem, ...]:
    """Take off; then for each entry a delay and a vine item with code and angle."""
    items = [] if kind == "px4" else [MissionItem(0, 16, (0.0,) * 7, 3)]
    items.append(MissionItem(len(items), 22, (0.0,) * 6 + (8.0,), 3))
    for code, angle_deg in wanted:
        items.append(MissionItem(len(items), 93, (delay_s,) + (0.0,) * 6, 2 if kind == "px4" else 3))
        items.append(vine_item(kind, len(items), code, angle_deg))
    items.append(MissionItem(len(items), 93, (20.0,) + (0.0,) * 6, 2 if kind == "px4" else 3))
    return tuple(items)


def other_numbers(stored: tuple[MissionItem, ...], code: float, angle_deg: float) -> tuple[MissionItem, ...]:
    own = (ACTUATOR, SCRIPT_MESSAGE)
    return tuple(
        dataclasses.replace(item, params=(code, angle_deg, *item.params[2:])) if item.command in own else item
        for item in stored
    )


KINDS: list[AutopilotKind] = ["ardupilot", "px4"]
OTHERS = [((1.0, 11.0), (1.0, 44.0)), ((1.0, 44.0), (1.0, 11.0)), ((5.0, 0.0), (0.0, 0.0))]
"""Code and angle of the vine items, before and after the mission is replaced."""


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("waits_s", [0.2, 3.0, 10.0])
@pytest.mark.parametrize(("before", "after"), OTHERS)
def test_a_mission_is_executed_as_stored_at_its_start(
    kind: AutopilotKind, waits_s: float, before: tuple[float, float], after: tuple[float, float]
) -> None:
    stored = mission(kind, before, before, delay_s=0.0)
    flight = airborne(Setup(kind, mission=stored))
    flight.replace_mission(other_numbers(stored, *after))
    flight.run(waits_s)
    flight.start_mission()
    flight.run(6.0)
    assert_clean(flight)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sooner_s", [0.15, 0.5, 1.5])
def test_a_mission_that_was_replaced_in_flight_is_executed_as_stored(
    kind: AutopilotKind, sooner_s: float
) -> None:
    stored = mission(kind, (1.0, 11.0), (1.0, 11.0), delay_s=4.0)
    flight = airborne(Setup(kind, mission=stored))
    flight.start_mission()
    while not flight.autopilot.payload_log:
        flight.run(0.1)
    flight.run(4.0 - sooner_s)
    flight.replace_mission(other_numbers(stored, 1.0, 44.0))
    flight.run(8.0)
    assert_clean(flight)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("stall_s", [2.0, 5.0])
@pytest.mark.parametrize("process", [False, True])
def test_an_item_that_arrives_late_is_not_executed(
    kind: AutopilotKind, stall_s: float, process: bool
) -> None:
    flight = airborne(Setup(kind, mission=mission(kind, (1.0, 40.0)), has_rc=False))
    flight.start_mission()
    flight.run(1.5)
    if process:
        flight.stall_companion(stall_s)
    else:
        flight.stall_vehicle_link(stall_s)
        flight.run(stall_s)
    assert flight.autopilot.payload_log
    flight.run(4.0)
    assert_clean(flight)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("process", [False, True])
def test_a_button_that_arrives_late_bends_nothing(kind: AutopilotKind, process: bool) -> None:
    flight = airborne(Setup(kind, has_rc=False))
    if process:
        flight.stall_companion(4.0, meanwhile=lambda: flight.press(5))
    else:
        flight.stall_vehicle_link(4.0)
        flight.run(1.0)
        flight.press(5)
        flight.run(3.0)
    flight.run(4.0)
    assert_clean(flight)


def test_a_vent_from_before_a_fault_does_not_clear_it() -> None:
    """A link delays the vent until a new companion runs, which has received nothing before."""
    flight = airborne(Setup("px4", has_rc=False))
    flight.arm_pneumatics()
    flight.bend_to(20.0)
    flight.run(1.0)
    flight.stall_vehicle_link(2.0)
    flight.run(1.4)
    flight.kill_companion()
    flight.vent()
    flight.run(0.4)
    flight.start_companion()
    flight.run(2.0)
    flight.bend_to(30.0)
    flight.run(2.0)
    assert_clean(flight)


def test_a_lost_straightening_on_px4_is_executed_later() -> None:
    flight = airborne(Setup("px4", mission=mission("px4", (5.0, 0.0), (0.0, 0.0), delay_s=4.0), has_rc=False))
    flight.start_mission()
    while not flight.autopilot.payload_log:
        flight.run(0.1)
    flight.run(3.5)
    assert flight.phlosar.cv_kPa > BENT_KPA
    flight.lose_commands()
    flight.run(1.0)
    assert len(flight.autopilot.payload_log) == 2
    flight.run(8.0)
    assert flight.phlosar.cv_kPa < 1.0
    assert_clean(flight)


# Limits.


def test_losses_do_not_restart_the_longest_time_bent() -> None:
    flight = bent(airborne(Setup("ardupilot", holds=True, max_bent_s=8.0)))
    for _ in range(5):
        flight.lose_rc("frozen")
        flight.run(2.0)
        flight.return_rc()
        flight.run(1.0)
    assert flight.phlosar.cv_kPa < 1.0
    assert_clean(flight)


def test_losses_do_not_restart_the_longest_hold() -> None:
    flight = bent(airborne(Setup("ardupilot", holds=True)))
    for _ in range(4):
        flight.lose_rc("frozen")
        flight.run(3.0)
        flight.return_rc()
        flight.run(0.3)
    assert flight.phlosar.cv_kPa < 1.0, "held for 4 s at most"
    assert_clean(flight)


# Cores that lack one rule each, and a flight that fails without it.


class AcceptsAnyRc(Core):
    """Accepts every RC_CHANNELS as the pilot's."""

    def __init__(self, conf: Config) -> None:
        super().__init__(conf)
        handle = self._vehicle.pilot.handle

        def accept(
            t: float, message: MavlinkMessage, autopilot: Autopilot, vented: bool = False
        ) -> list[PilotOutput]:
            return [] if message.get_type() == "SYS_STATUS" else handle(t, message, OTHER, vented)

        self._vehicle.pilot.handle = accept  # type: ignore[method-assign]


class BendsAtOnce(Core):
    """Does not wait for PX4's RC status."""

    def __init__(self, conf: Config) -> None:
        super().__init__(conf)
        self._vehicle.pilot._must_wait = lambda position: False  # type: ignore[method-assign]


class ReadsNoParameters(Core):
    """Ignores the parameters that can hide a loss."""

    def __init__(self, conf: Config) -> None:
        super().__init__(conf)
        self._vehicle.pilot.parameters.handle = lambda autopilot, message: False  # type: ignore[method-assign]


class AcceptsEndsOfOverrides(Core):
    """Accepts the end of an override as a move of the pilot."""

    def __init__(self, conf: Config) -> None:
        super().__init__(conf)
        self._vehicle.pilot._why_not_the_pilots = lambda t, move: ""  # type: ignore[method-assign]


class DoesNotRereadItems(Core):
    """Does not read an item again when it runs."""

    class _Cache(MissionCache):
        @property
        def is_given(self) -> bool:
            return self.fresh

    def __init__(self, conf: Config) -> None:
        super().__init__(conf)
        self._vehicle._mission_cache.__class__ = self._Cache


class ExecutesLateRequests(Core):
    """Executes late requests, also on a late link."""

    def _outdated(self, t: float, trigger: Trigger, intent: Intent) -> str:
        return ""

    def _conditions(self, t: float) -> SafetyInputs:
        return super()._conditions(t)._replace(link_delay_s=0.0)


class AcceptsTheFirstTimeStamp(Core):
    """Accepts the first time stamp as the present time."""

    def __init__(self, conf: Config) -> None:
        super().__init__(conf)
        clock = self._vehicle.state.clock
        mark = clock.mark
        clock.mark = lambda t: dataclasses.replace(mark(t), first_stamps=False)  # type: ignore[method-assign]


class IgnoresReachedItems(Core):
    """Ignores MISSION_ITEM_REACHED of PX4."""

    def __init__(self, conf: Config) -> None:
        super().__init__(conf)
        take = self._vehicle._take_autopilot

        def take_and_ignore(t: float) -> None:
            take(t)
            self._vehicle._watch.due = lambda t: []  # type: ignore[method-assign]

        self._vehicle._take_autopilot = take_and_ignore  # type: ignore[method-assign]


class RestartsLimitsAtEachLoss(Core):
    """A loss that holds the vine restarts its limits."""

    def _freeze(self, t: float) -> None:
        self._note_trigger(t)
        self._safety._held_s = 0.0
        super()._freeze(t)


@pytest.mark.parametrize(
    ("mutant", "witness"),
    [
        (AcceptsAnyRc, partial(test_px4_frozen_values_hold_no_bend, "sbus")),
        (AcceptsAnyRc, partial(test_px4_switch_moved_while_rc_was_lost_bends_nothing, "crsf")),
        (BendsAtOnce, partial(test_px4_preset_of_the_receiver_is_no_move, {})),
        (BendsAtOnce, partial(test_px4_preset_in_a_blip_is_no_move, 0.9)),
        (
            ReadsNoParameters,
            partial(test_ardupilot_switch_moved_in_a_hidden_loss_bends_nothing, {"FS_THR_ENABLE": 0}),
        ),
        (AcceptsEndsOfOverrides, partial(test_an_override_that_ends_is_no_move, "before")),
        (
            DoesNotRereadItems,
            partial(test_a_mission_is_executed_as_stored_at_its_start, "ardupilot", 0.2, *OTHERS[0]),
        ),
        (
            ExecutesLateRequests,
            partial(test_an_item_that_arrives_late_is_not_executed, "ardupilot", 5.0, False),
        ),
        (ExecutesLateRequests, partial(test_an_item_that_arrives_late_is_not_executed, "px4", 5.0, True)),
        (ExecutesLateRequests, partial(test_a_button_that_arrives_late_bends_nothing, "ardupilot", False)),
        (AcceptsTheFirstTimeStamp, test_a_vent_from_before_a_fault_does_not_clear_it),
        (IgnoresReachedItems, test_a_lost_straightening_on_px4_is_executed_later),
        (RestartsLimitsAtEachLoss, test_losses_do_not_restart_the_longest_time_bent),
        (RestartsLimitsAtEachLoss, test_losses_do_not_restart_the_longest_hold),
    ],
)
def test_without_the_rule_a_flight_fails(
    mutant: type[Core], witness: Callable[[], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(FLOWN, "core", mutant)
    with pytest.raises(AssertionError):
        witness()
