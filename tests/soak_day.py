"""A script of endless flights for any world, and a comparison of triggers with motions."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import takewhile
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config.config import ITEM_COMMANDS
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.mission.item import LAND, TAKEOFF, WAYPOINT, AutopilotKind, MissionItem

LOOK_S = 0.1
SETTLED_AFTER_S = 2.5
"""Maximum time from a trigger to the end of a bend: debounce, ramp, and ArduPilot's texts about an item."""

SWITCH = 9
_PULSES_US = (1000, 1500, 2000)
_CRUISE_M = 10.0
_FULL_KPA = 690.0
_NEAR_KPA = 1.5
_LANDED_WITHIN_S = 300.0


class Motion(NamedTuple):
    """The required effect of a trigger: `peak_kPa` on the way, and `end_kPa` after `lasts_s`."""

    name: str
    peak_kPa: float
    end_kPa: float
    lasts_s: float = SETTLED_AFTER_S


def pressure_kPa(angle_deg: float) -> float:
    """The pressure for an angle, by the default configuration's curve."""
    return 0.0 if angle_deg == 0.0 else 2.0 + angle_deg * 18.7 / 60.0


def bend(angle_deg: float) -> Motion:
    kPa = pressure_kPa(angle_deg)
    return Motion(f"bend {angle_deg:g}°", kPa, kPa)


STRAIGHT = bend(0.0)
_START = Motion("the start", 0.0, 0.0, lasts_s=0.0)
SWITCHED = (STRAIGHT, bend(30.0), bend(60.0))
BUTTONS = {
    0: STRAIGHT,
    2: Motion("reach", pressure_kPa(45.0), 0.0, 5.0 + SETTLED_AFTER_S),
    3: Motion("wave", pressure_kPa(40.0), 0.0, 6.0 + SETTLED_AFTER_S),
    4: bend(30.0),
    5: bend(60.0),
}


@dataclass
class Tally:
    """Compares triggers with motions of the plant's pressure."""

    triggers: Counter[str] = field(default_factory=Counter)
    motions: int = 0
    flights: int = 0
    violations: list[str] = field(default_factory=list)
    _motion: Motion = _START
    _began_s: float = 0.0
    _peaked: bool = True
    _judged: bool = True

    def trigger(self, t: float, kind: str, motion: Motion) -> None:
        self.triggers[kind] += 1
        if not self._judged:
            self._violation(t, f"{motion.name} began before {self._motion.name} was judged")
        self._motion, self._began_s, self._peaked, self._judged = motion, t, False, False

    def look(self, t: float, cv_kPa: float) -> None:
        motion = self._motion
        self._peaked |= abs(cv_kPa - motion.peak_kPa) < _NEAR_KPA
        if t - self._began_s < motion.lasts_s:
            return
        there = self._peaked and abs(cv_kPa - motion.end_kPa) < _NEAR_KPA
        if not self._judged:
            self._judged = True
            self.motions += there
        if not there:
            self._violation(t, f"{cv_kPa:.1f} kPa since {motion.name} at {self._began_s:.1f} s")
            # Report it once. The next trigger is compared with the new pressure.
            self._motion = Motion("an unexpected pressure", cv_kPa, cv_kPa)
            self._peaked = True

    def _violation(self, t: float, what: str) -> None:
        self.violations.append(f"at {t:.1f} s: {what}")


@dataclass
class World:
    """The objects on which the script acts."""

    autopilot: FakeAutopilot
    phlosar: SimulatedPhlosar
    press: Callable[[MavlinkMessage], None]
    """Presses a button of the ground station."""
    now: Callable[[], float]
    tally: Tally = field(default_factory=Tally)
    _items_until_s: float = 0.0

    def look(self) -> None:
        """Called ten times a second: count the mission's triggers, and look at the vine."""
        news = takewhile(lambda ran: ran[0] > self._items_until_s, reversed(self.autopilot.payload_log))
        for t, item in reversed(list(news)):
            self._items_until_s = t
            self.tally.trigger(t, "mission item", bend(item.params[1]))
        # The log would keep thousands of items, which would look like growing memory.
        del self.autopilot.payload_log[:-1]
        self.tally.look(self.now(), self.phlosar.cv_kPa)


def flights(world: World, seed: int) -> Iterator[float]:
    """Endless flights. Yields the time to wait; 0 after a landing."""
    dice = random.Random(seed)
    yield 8.0
    while True:
        fly = dice.choice((_by_switch, _by_buttons, _by_mission))
        yield from fly(world, dice)
        yield from _landed(world)
        world.phlosar.fill(_FULL_KPA)
        world.tally.flights += 1
        yield dice.uniform(1.0, 10.0)
        yield 0.0


def _by_switch(world: World, dice: random.Random) -> Iterator[float]:
    yield from _take_off(world)
    position = 0
    for _ in range(dice.randrange(2, 16)):
        position = dice.choice([other for other in range(3) if other != position])
        yield from _move_switch(world, dice, position)
    if position != 0:
        yield from _move_switch(world, dice, 0)
    world.autopilot.land()


def _move_switch(world: World, dice: random.Random, position: int) -> Iterator[float]:
    world.tally.trigger(world.now(), "switch", SWITCHED[position])
    world.autopilot.set_rc(SWITCH, _PULSES_US[position])
    yield SETTLED_AFTER_S + dice.uniform(0.2, 6.0)


def _by_buttons(world: World, dice: random.Random) -> Iterator[float]:
    yield from _take_off(world)
    pressed = [dice.choice(list(BUTTONS)) for _ in range(dice.randrange(2, 10))]
    for button in (*pressed, 0):
        motion = BUTTONS[button]
        world.tally.trigger(world.now(), "command", motion)
        world.press(
            mavlink.MAVLink_command_long_message(1, 191, mavlink.MAV_CMD_USER_1, 0, button, *[0.0] * 6)
        )
        yield motion.lasts_s + dice.uniform(0.2, 6.0)
    world.autopilot.land()


def _take_off(world: World) -> Iterator[float]:
    world.autopilot.takeoff(_CRUISE_M)
    yield 7.0


def _by_mission(world: World, dice: random.Random) -> Iterator[float]:
    autopilot = world.autopilot
    angles_deg = [float(dice.randrange(5, 61)) for _ in range(dice.randrange(2, 10))]
    autopilot.set_mission(mission(autopilot, [*angles_deg, 0.0], dice))
    yield 6.0
    autopilot.start_mission()
    while not autopilot.flight.airborne:
        yield LOOK_S
    while autopilot.flight.airborne:
        yield LOOK_S


def mission(autopilot: FakeAutopilot, angles_deg: list[float], dice: random.Random) -> list[MissionItem]:
    """Take off, bend to each angle between waypoints, land."""
    here = autopilot.flight.home
    made: list[MissionItem] = []

    def add(command: int, *params: float, place: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        first = [*params, 0.0, 0.0, 0.0, 0.0][:4]
        frame = 3 if command in (WAYPOINT, LAND, TAKEOFF) else 2
        made.append(MissionItem(len(made), command, (*first, *place), frame=frame))  # type: ignore[arg-type]

    if autopilot.kind == "ardupilot":
        add(WAYPOINT, place=(here.latitude_deg, here.longitude_deg, here.altitude_amsl_m))
    add(TAKEOFF, place=(here.latitude_deg, here.longitude_deg, _CRUISE_M))
    north_m = 0.0
    for angle_deg in (None, *angles_deg):
        if angle_deg is not None:
            _add_vine(autopilot.kind, add, angle_deg)
        # Even the nearest waypoint takes the vehicle longer than a motion.
        north_m += dice.choice((-1.0, 1.0)) * dice.uniform(20.0, 40.0)
        latitude_deg, longitude_deg = here.global_deg(north_m, 0.0)
        add(WAYPOINT, place=(latitude_deg, longitude_deg, _CRUISE_M))
    add(LAND)
    return made


def _add_vine(kind: AutopilotKind, add: Callable[..., None], angle_deg: float) -> None:
    if kind == "ardupilot":
        add(ITEM_COMMANDS["script_message"], 1.0, angle_deg)
    else:
        add(ITEM_COMMANDS["actuator"], 1.0, angle_deg, place=(0.0, 0.0, 1.0))


def _landed(world: World) -> Iterator[float]:
    for _ in range(round(_LANDED_WITHIN_S / LOOK_S)):
        if not world.autopilot.armed:
            return
        yield LOOK_S
    raise SystemExit(f"The vehicle did not land within {_LANDED_WITHIN_S:g} s: {world.autopilot.mode.name}")
