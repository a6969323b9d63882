"""A mission of the simulated autopilot on a bad link, and the items that the service's `Vehicle` sees."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass, field
from heapq import heappop, heappush

from flying_vines.config import config
from flying_vines.simulation.autopilot import AutopilotKind, FakeAutopilot
from flying_vines.simulation.autopilot.links import COMPANION
from flying_vines.vehicle.clock import LATE_S
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.mission.item import MissionItem, same_numbers
from flying_vines.vehicle.triggers import Rules, Trigger
from flying_vines.vehicle.vehicle import Vehicle

WP, LAND, TAKEOFF, DELAY, CONDITION_DELAY, JUMP, CHANGE_SPEED = 16, 21, 22, 93, 112, 177, 178
SCRIPT, GRIPPER, WINCH, ACTUATOR = 217, 211, 42600, 187
CONFIG = config.default()
VINE_COMMANDS = Rules(CONFIG).commands
TICK_S = 0.02
LONGEST_WAIT_S = 4.0
"""Maximum delay of a trigger after its item: the wait for the mission's numbers, its first download,
delays."""
ORDER_S: dict[AutopilotKind, float] = {"ardupilot": 0.1, "px4": 2.0}
"""Items that run this shortly after one another may arrive in another order. On ArduPilot these are items of
one place, milliseconds apart; on PX4 items of which one arrived only by its last repeat."""
UNNUMBERED_WAIT_S = 7.0
"""PX4 sends a command four times. Only after the last one is an item reported without its numbers."""
LEARNT_S = 0.4
"""A mission that runs sooner than this after its replacement may run with the old numbers."""
RESTART_S = 3.0
"""If a service starts sooner, PX4 repeats commands that the previous service has not acknowledged."""
GLOBAL_ABOVE_HOME, MISSION_FRAME = 3, 2


@dataclass(frozen=True)
class Link:
    """The effect of a link on frames, in each direction. After a loss, no frame is lost for `spare_s`."""

    loss: float = 0.0
    copies: float = 0.0
    late_s: float = 0.0
    spare_s: float = 0.0


@dataclass
class Seen:
    """One trigger: time, item, and numbers (None: not known)."""

    t: float
    seq: int | None
    command: int
    numbers: tuple[float, ...] | None


@dataclass
class MissionOnBadLink:
    """The flight: `ran` has the executed items, `seen` the items that `Vehicle` saw."""

    kind: AutopilotKind
    dice: random.Random
    link: Link
    items: list[MissionItem]
    t: float = 0.0
    seen: list[Seen] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.autopilot = FakeAutopilot(self.kind, mission=self.items)
        self.start_service()
        self.changed_at: list[float] = []
        self._coming: list[tuple[float, int, str, bytes]] = []
        self._sent = 0
        self._spared_until = {"up": 0.0, "down": 0.0}

    @property
    def ran(self) -> list[tuple[float, MissionItem]]:
        return [(t, item) for t, item in self.autopilot.payload_log if item.command in VINE_COMMANDS]

    def start_service(self, down_s: float = 0.0) -> None:
        """Start a service without memory; it receives nothing for `down_s`."""
        self._up_at = self.t + down_s
        self.vehicle = Vehicle(CONFIG)
        self._decoder, self._encoder = MavlinkCodec(1, 191), MavlinkCodec(1, 191)

    def run(self, for_s: float) -> None:
        end = self.t + for_s
        while self.t < end:
            self.t += TICK_S
            for link, frame in self.autopilot.advance(self.t):
                if link == COMPANION:
                    self._send("down", frame)
            while self._coming and self._coming[0][0] <= self.t:
                _, _, way, frame = heappop(self._coming)
                if way == "up":
                    self.autopilot.receive(self.t, COMPANION, frame)
                elif self.t >= self._up_at:
                    for message in self._decoder.decode(frame):
                        self._take(self.vehicle.handle(self.t, message))
            if self.t >= self._up_at:
                self._take(self.vehicle.tick(self.t))

    def _send(self, way: str, frame: bytes) -> None:
        if self.t >= self._spared_until[way] and self.dice.random() < self.link.loss:
            self._spared_until[way] = self.t + self.link.spare_s
            return
        for _ in range(2 if self.dice.random() < self.link.copies else 1):
            self._sent += 1
            late_s = self.dice.uniform(0.0, self.link.late_s)
            heappush(self._coming, (self.t + late_s, self._sent, way, frame))

    def _take(self, outputs: list[object]) -> None:
        for output in outputs:
            if isinstance(output, Trigger):
                if output.kind == "mission_item" and output.age_s <= LATE_S:  # later it is refused
                    self._note(output)
                self._take(list(self.vehicle.acknowledge(output, True)))
            elif hasattr(output, "get_type"):
                self._send("up", self._encoder.encode(output, 1))

    def _note(self, trigger: Trigger) -> None:
        seq, command, numbers = (trigger.what.get(key) for key in ("seq", "command", "params"))
        assert seq is None or isinstance(seq, int)
        assert isinstance(command, int)
        assert numbers is None or isinstance(numbers, list)
        self.seen.append(Seen(self.t, seq, command, None if numbers is None else tuple(numbers)))


@dataclass
class Comparison:
    """`pairs`: (index in `ran`, index in `seen`). An item without partner is missed or extra."""

    pairs: list[tuple[int, int]]
    missed: list[tuple[float, MissionItem]]
    extra: list[Seen]


def compare(flight: MissionOnBadLink, since: float = -math.inf) -> Comparison:
    """Pair each trigger with the earliest execution since `since` that can have caused it."""
    ran, seen = [one for one in flight.ran if one[0] >= since], flight.seen
    pairs: list[tuple[int, int]] = []
    free = set(range(len(ran)))
    extra = []
    for j, one in enumerate(seen):
        fitting = [i for i in sorted(free) if _fits(flight, one, *ran[i])]
        if fitting:
            free.discard(fitting[0])
            pairs.append((fitting[0], j))
        else:
            extra.append(one)
    return Comparison(pairs, [ran[i] for i in sorted(free)], extra)


def in_order(flight: MissionOnBadLink) -> bool:
    """True if triggers have the order of their items, as far as the link kept it."""
    latest = -math.inf
    for one in flight.seen:
        fitting = [ran_at for ran_at, item in flight.ran if _fits(flight, one, ran_at, item)]
        if fitting and max(fitting) < latest - flight.link.late_s - ORDER_S[flight.kind]:
            return False
        latest = max(latest, min(fitting, default=latest))
    return True


def numbers_of_before(flight: MissionOnBadLink) -> list[float]:
    """Times of triggers with numbers of a mission that had been replaced."""
    ran, seen = flight.ran, flight.seen
    return [
        ran[i][0]
        for i, j in compare(flight).pairs
        if (numbers := seen[j].numbers) is not None and not same_numbers(numbers[:4], ran[i][1].params[:4])
    ]


def _fits(flight: MissionOnBadLink, one: Seen, ran_at: float, item: MissionItem) -> bool:
    px4 = flight.kind == "px4"
    longest_wait_s = UNNUMBERED_WAIT_S if px4 and one.numbers is None else LONGEST_WAIT_S
    if item.command != one.command or not -TICK_S <= one.t - ran_at <= longest_wait_s:
        return False
    if not px4 or one.numbers is None:
        return one.seq == item.seq
    renumbered = any(0.0 <= ran_at - changed_at < LEARNT_S for changed_at in flight.changed_at)
    return (renumbered or one.seq in (None, item.seq)) and same_numbers(one.numbers[:4], item.params[:4])


def vine_item(kind: AutopilotKind, dice: random.Random) -> tuple[int, tuple[float, ...]]:
    """A vine item that this autopilot accepts, with numbers that it can store."""
    choices: list[tuple[int, tuple[float, ...]]] = [
        (GRIPPER, (1.0, float(dice.randrange(2)))),
        (WINCH, (1.0, float(dice.randrange(2)), 2.0, 0.5)),
    ]
    if kind == "ardupilot":
        choices += [(SCRIPT, (1.0, float(dice.randrange(-60, 60)), 0.0, 0.0))] * 2
    else:
        choices += [(ACTUATOR, (0.0, float(dice.randrange(-60, 60)), 0.0, 0.0, 0.0, 0.0, 1.0))] * 2
    return dice.choice(choices)


def mission(kind: AutopilotKind, dice: random.Random, *, wild: bool) -> list[MissionItem]:
    """A mission with a few stops. If not `wild`, one vine item follows each stop (a waypoint or a delay)."""
    plan: list[tuple[int, tuple[float, ...], bool]] = []
    if kind == "ardupilot":
        plan.append((WP, (0.0,) * 7, True))  # home
    plan.append((TAKEOFF, (0, 0, 0, 0, 0, 0, 10.0), True))
    waypoints: list[int] = []
    for _ in range(dice.randrange(2, 6)):
        waypoints.append(len(plan))
        plan.append(_stop(kind, dice, wild))
        for _ in range(dice.choice([0, 1, 1, 2, 3]) if wild else 1):
            plan.append((*vine_item(kind, dice), False))
            if wild and dice.random() < 0.2:
                plan.append((CHANGE_SPEED, (1.0, 5.0), False))
            if wild and kind == "ardupilot" and dice.random() < 0.15:
                plan.append((CONDITION_DELAY, (dice.uniform(0.1, 3.0),), False))
        if wild and dice.random() < 0.25:
            plan.append((JUMP, (float(dice.choice(waypoints)), float(dice.randrange(1, 3))), False))
    plan.append((WP, _somewhere(kind, dice), True))
    plan.append((LAND, (0.0,) * 7, True))
    items = []
    for seq, (command, params, placed) in enumerate(plan):
        p = (*params, *(0.0,) * 7)[:7]
        frame = GLOBAL_ABOVE_HOME if placed or kind == "ardupilot" else MISSION_FRAME
        items.append(MissionItem(seq, command, (p[0], p[1], p[2], p[3], p[4], p[5], p[6]), frame))
    return items


def _stop(kind: AutopilotKind, dice: random.Random, wild: bool) -> tuple[int, tuple[float, ...], bool]:
    if dice.random() < 0.3:
        return DELAY, (dice.choice([0.0, 0.5, 2.0]) if wild else dice.uniform(1.5, 3.0),), False
    hold_s = 0.0 if wild else dice.uniform(1.5, 3.0)
    return WP, (hold_s, *_somewhere(kind, dice)[1:]), True


def _somewhere(kind: AutopilotKind, dice: random.Random) -> tuple[float, ...]:
    """A point a few seconds of flight from home."""
    latitude_deg, longitude_deg = (-35.363262, 149.165237) if kind == "ardupilot" else (47.3977431, 8.5455944)
    metre_deg = 1 / 111_318.84
    north_m, east_m = dice.uniform(-12.0, 12.0), dice.uniform(-12.0, 12.0)
    return 0.0, 0.0, 0.0, 0.0, latitude_deg + north_m * metre_deg, longitude_deg + east_m * metre_deg, 10.0


def fly(flight: MissionOnBadLink, for_s: float, happenings: int = 0) -> None:
    """Fly the mission, with this number of disturbances."""
    flight.run(flight.dice.uniform(0.0, 8.0))
    flight.autopilot.start_mission()
    for _ in range(happenings):
        flight.run(flight.dice.uniform(0.0, 12.0))
        flight.dice.choice(stimuli(flight))()
    flight.run(for_s)


def stimuli(flight: MissionOnBadLink) -> list[Callable[[], None]]:
    """Possible actions of a pilot and a ground station, and faults, during a mission."""
    autopilot, dice = flight.autopilot, flight.dice

    def pause() -> None:
        autopilot.set_mode("LOITER")
        flight.run(dice.uniform(0.5, 6.0))
        autopilot.set_mode("AUTO")

    def choose() -> None:
        autopilot.set_current(dice.randrange(1, len(autopilot.items)))

    def replace() -> None:
        flight.changed_at.append(flight.t)
        autopilot.set_mission(mission(flight.kind, dice, wild=True))
        autopilot.set_current(1)  # a former waypoint may be an action now, which is not a target of a jump

    def change_numbers() -> None:
        changed = []
        for item in autopilot.items:
            if item.command in VINE_COMMANDS:
                command, params = vine_item(flight.kind, dice)
                p = (*params, *(0.0,) * 7)[:7]
                p7 = (p[0], p[1], p[2], p[3], p[4], p[5], p[6])
                item = MissionItem(item.seq, command, p7, item.frame)
            changed.append(item)
        flight.changed_at.append(flight.t)
        autopilot.set_mission(changed)

    def restart_service() -> None:
        flight.start_service(down_s=dice.uniform(RESTART_S, 6.0))

    def fly_again() -> None:
        autopilot.disarm()
        flight.run(dice.uniform(0.5, 5.0))
        autopilot.start_mission()

    def reboot() -> None:
        autopilot.disarm()
        autopilot.reboot()
        flight.run(dice.uniform(2.0, 15.0))
        autopilot.start_mission()

    def cut() -> None:
        autopilot.mute(dice.uniform(0.2, 5.0))

    return [pause, choose, replace, change_numbers, restart_service, fly_again, reboot, cut]
