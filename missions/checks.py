"""Finds problems of a mission with the autopilot, its storage, safety, or the air.

Error: an item would not be executed as written. Warning: an item may be a mistake. A check is one function.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from flying_vines.config.config import Config
from flying_vines.vehicle.autopilots import AUTOPILOTS
from flying_vines.vehicle.mission.item import (
    ABOVE_HOME_FRAME,
    CAPACITY,
    CONDITION_DELAY,
    CONDITION_DISTANCE,
    CONDITION_YAW,
    DELAY,
    FOR_EVER,
    INVALID_PARAM1,
    JUMP,
    LAND,
    LOITER_UNLIMITED,
    MISSION_FRAME,
    RETURN,
    SPEED,
    TAKEOFF,
    UNSUPPORTED_FRAME,
    VTOL_LAND,
    VTOL_TAKEOFF,
    WAYPOINT,
    AutopilotKind,
    MissionItem,
    MissionRefused,
    has_place,
    same_numbers,
)
from flying_vines.vehicle.triggers import Rules
from flying_vines.vine.intent import BendTo
from missions.budget import AirBudget, PlannedBend
from missions.build import BEND_LESS
from missions.home import home_fits, on_earth
from missions.item_for_intent import described, item_for_intent, over_the_wire, suggestion
from missions.timeline import MAX_LENGTH_S, MAX_STEPS, Timeline

BURST = 8
"""PX4 executes at most this many non-navigation items in a row. Of a longer row it loses the first ones."""
TOGETHER_S = 0.5
"""If the next item comes within this time, the vine has hardly moved."""
FAR_M = 2000.0
CENTIMETRE_M = 0.011
ROUNDING_S = 1e-6
_CONDITIONS = {
    CONDITION_DELAY: "CONDITION_DELAY",
    CONDITION_DISTANCE: "CONDITION_DISTANCE",
    CONDITION_YAW: "CONDITION_YAW",
}
_NAMES = {
    WAYPOINT: "waypoint",
    RETURN: "return",
    LAND: "land",
    LOITER_UNLIMITED: "endless loiter",
    TAKEOFF: "take-off",
    DELAY: "wait",
    SPEED: "change speed",
    JUMP: "jump",
    **_CONDITIONS,
}
_YAW_MAY_BE_NAN = {WAYPOINT, LAND, TAKEOFF, VTOL_TAKEOFF, VTOL_LAND}


@dataclass(frozen=True, slots=True)
class MissionFinding:
    """One problem of the item `seq`."""

    severity: Literal["error", "warning"]
    seq: int
    text: str


@dataclass(frozen=True)
class CheckedMission:
    """The input of a check."""

    items: Sequence[MissionItem]
    kind: AutopilotKind
    config: Config
    timeline: Timeline
    budget: AirBudget

    @cached_property
    def rules(self) -> Rules:
        return Rules(self.config)

    @property
    def name(self) -> str:
        """The autopilot's name."""
        return AUTOPILOTS[self.kind].title

    def is_vine(self, item: MissionItem) -> bool:
        return item.command in self.rules.commands

    def error(self, item: MissionItem, text: str) -> MissionFinding:
        return MissionFinding("error", item.seq, f"{self._where(item)}: {text}")

    def warning(self, item: MissionItem, text: str) -> MissionFinding:
        return MissionFinding("warning", item.seq, f"{self._where(item)}: {text}")

    def _where(self, item: MissionItem) -> str:
        """An item as text: its number, its name, and the number of the last waypoint begun."""
        waypoint = next((step.waypoint for step in self.timeline.steps if step.item.seq == item.seq), None)
        place = f", waypoint {waypoint}" if waypoint else ""
        return f"item {item.seq} ({name_of(item)}{place})"


def check(case: CheckedMission) -> list[MissionFinding]:
    """All problems, errors first, each in the mission's order."""
    found = [finding for look in CHECKS for finding in look(case)]
    return sorted(found, key=lambda finding: (finding.severity, finding.seq))


def name_of(item: MissionItem) -> str:
    """What an item does, as a short text."""
    return _NAMES.get(item.command) or described(item)


# Checks of the items alone.


def _refused(case: CheckedMission) -> Iterator[MissionFinding]:
    for item in case.items:
        try:
            stored = AUTOPILOTS[case.kind].store(over_the_wire(item))
        except MissionRefused as refused:
            yield case.error(item, _why_refused(case, item, refused.result))
        else:
            yield from _altered(case, item, stored)


def _why_refused(case: CheckedMission, item: MissionItem, result: int) -> str:
    if result == UNSUPPORTED_FRAME:
        better = MISSION_FRAME if case.is_vine(item) else ABOVE_HOME_FRAME
        return f"{case.name} refuses it in frame {item.frame}; use frame {better}"
    if INVALID_PARAM1 <= result < INVALID_PARAM1 + len(item.params):
        return f"param{result - INVALID_PARAM1 + 1} is not a number, which {case.name} refuses; write 0"
    refuses = f"{case.name} refuses MAV_CMD {item.command}"
    intent, _ = case.rules.for_command(item.command, item.params)
    if intent is None:
        return f"{refuses}; remove it"
    instead = item_for_intent(intent, case.config, case.kind)
    if instead is None:
        add = suggestion(intent, case.config, case.kind)
        return f"{refuses}; for '{intent}' add to the configuration: {add}"
    return f"{refuses}; for '{intent}' use {described(instead)}"


def _altered(case: CheckedMission, item: MissionItem, stored: MissionItem) -> Iterator[MissionFinding]:
    """Numbers that the autopilot's storage changes."""
    sent = list(item.params)
    if item.command in _YAW_MAY_BE_NAN and math.isnan(sent[3]):
        sent[3] = stored.params[3]
    if abs(sent[6] - stored.params[6]) < CENTIMETRE_M:
        sent[6] = stored.params[6]
    if same_numbers(sent, stored.params):
        return
    changes = ", ".join(
        f"param{number} {a:g} becomes {b:g}"
        for number, (a, b) in enumerate(zip(sent, stored.params, strict=True), start=1)
        if not same_numbers((a,), (b,))
    )
    stores = f"{case.name} stores other numbers: {changes}"
    meant, _ = case.rules.for_command(item.command, item.params)
    means, _ = case.rules.for_command(stored.command, stored.params)
    if meant is None or meant == means:
        yield case.warning(item, stores)
        return
    instead = item_for_intent(meant, case.config, case.kind)
    use = f"; use {described(instead)}" if instead else ""
    yield case.error(item, f"{stores}, so that '{meant}' becomes '{means or 'nothing'}'{use}")


def _home(case: CheckedMission) -> Iterator[MissionFinding]:
    if home_fits(case.items, case.kind):
        return
    if case.kind == "ardupilot":
        why = "ArduPilot uses item 0 as home and skips it; insert home before it"
    else:
        why = "looks like home. PX4 has no home item and would fly there; remove it"
    yield case.error(case.items[0], why)


def _capacity(case: CheckedMission) -> Iterator[MissionFinding]:
    if len(case.items) > CAPACITY:
        last = case.items[-1]
        yield case.error(last, f"there are {len(case.items)} items; {case.name} stores at most {CAPACITY}")


def _burst(case: CheckedMission) -> Iterator[MissionFinding]:
    for flown, group in itertools.groupby(case.items, AUTOPILOTS["px4"].waits_for):
        burst = [] if flown or case.kind != "px4" else list(group)
        for item in filter(case.is_vine, burst[:-BURST]):
            row = f"one of {len(burst)} items in a row without a waypoint"
            yield case.error(item, f"{row}; PX4 executes only the last {BURST}; insert a NAV_DELAY")


def _places(case: CheckedMission) -> Iterator[MissionFinding]:
    for item in case.items:
        latitude, longitude = item.params[4:6]
        if not has_place(item.command, item.frame) or (latitude, longitude) == (0.0, 0.0):
            continue
        distance_m = math.hypot(*case.timeline.home.local_m(latitude, longitude))
        if not on_earth(item):
            yield case.error(item, f"{latitude:g}, {longitude:g} is not a place on earth")
        elif distance_m > FAR_M:
            yield case.warning(item, f"{distance_m / 1000:.1f} km from home: is that intended?")


# Checks of the order and the times of the items.


def _never(case: CheckedMission) -> Iterator[MissionFinding]:
    end, last = case.timeline.end, case.timeline.steps[-1] if case.timeline.steps else None
    for item in filter(case.is_vine, case.timeline.never):
        if end is not None and item.seq > end.seq:
            after = f"item {end.seq} ({name_of(end)})"
            why = f"no item runs after {after}; move it before that item"
        elif case.kind == "ardupilot" and last is not None and not last.flown and item.seq > last.item.seq:
            only = "after the last waypoint ArduPilot runs only one more item"
            why = f"{only}; add a NAV_DELAY or a waypoint after each"
        else:
            why = "a jump skips it; move it, or remove the jump"
        yield case.error(item, f"never runs: {why}")


def _on_the_ground(case: CheckedMission) -> Iterator[MissionFinding]:
    first = case.timeline.steps[0] if case.timeline.steps else None
    if first is not None and not first.flown and case.is_vine(first.item):
        again = ", before arming and again after landing" if case.kind == "ardupilot" else ""
        runs = f"is the first item, so {case.name} runs it on the ground{again}"
        yield case.error(first.item, f"{runs}; move it after the take-off")


def _too_long(case: CheckedMission) -> Iterator[MissionFinding]:
    if case.timeline.cut:
        last = case.timeline.steps[-1].item if case.timeline.steps else case.items[-1]
        longest = f"more than {MAX_LENGTH_S / 3600:.0f} h or {MAX_STEPS} items"
        yield case.error(last, f"the mission has {longest}; the rest is not checked; shorten it")


def _jumps(case: CheckedMission) -> Iterator[MissionFinding]:
    for item in case.items:
        if item.command == JUMP and item.params[1] == FOR_EVER:
            yield case.warning(item, "endless loop: the budget counts only the first pass")
        if item.command in _CONDITIONS:
            yield case.warning(item, "items after it may run later than shown, or never")


# Checks of the vine's actions.


def _no_vine(case: CheckedMission) -> Iterator[MissionFinding]:
    if not any(map(case.is_vine, case.items)):
        yield case.warning(case.items[0], "no item matches a rule in [[items]]: the vine will not move")


def _disarmed(case: CheckedMission) -> Iterator[MissionFinding]:
    bends = case.budget.bends
    if bends and not case.config.interlocks.armed_at_start:
        first = "the pneumatics start disarmed (interlocks.armed_at_start), and safety then refuses bends"
        yield case.warning(bends[0].step.item, f"{first}; arm them before the flight")


def _ruled(case: CheckedMission) -> Iterator[MissionFinding]:
    for bend in case.budget.bends:
        item, ruling = bend.step.item, bend.ruling
        if ruling.verdict == "refused" and bend.step is not case.timeline.steps[0]:
            # An item without a rule may be for a real gripper or servo: only a warning.
            make = case.warning if bend.intent is None else case.error
            yield make(item, f"refused: {ruling.reason}{_advice(case, bend)}")
        elif ruling.verdict == "limited":
            yield case.warning(item, f"limited {ruling.reason}")
        if bend.doubt:
            yield case.warning(item, f"may be refused, if the reservoir is at its low estimate: {bend.doubt}")


def _advice(case: CheckedMission, bend: PlannedBend) -> str:
    if bend.motion is None:
        return f"; {BEND_LESS}" if isinstance(bend.intent, BendTo) else ""
    if bend.step.height_m < case.config.interlocks.min_altitude_m:
        return "; fly higher there (interlocks.min_altitude_m)"
    return "; fill the reservoir more, or remove earlier bends"


def _overtaken(case: CheckedMission) -> Iterator[MissionFinding]:
    accepted = [bend for bend in case.budget.bends if bend.ruling.verdict != "refused"]
    for bend, after in itertools.pairwise(accepted):
        if bend.motion is None:
            continue
        gap_s = after.step.t_s - bend.step.t_s
        takes_s = bend.motion.duration_s
        item, then = bend.step.item, f"item {after.step.item.seq}"
        if gap_s < TOGETHER_S and gap_s < takes_s:
            yield case.error(item, f"{then} follows at once and replaces it; insert a wait (hold_s)")
        elif gap_s < takes_s - ROUNDING_S:
            cut = f"takes {takes_s:.1f} s, but {then} replaces it after {gap_s:.1f} s"
            yield case.warning(item, f"{cut}; hold longer")


def _bent(case: CheckedMission) -> Iterator[MissionFinding]:
    limit_s = case.config.limits.max_bent_s
    for bend in case.budget.bends:
        if bend.bent_s > limit_s:
            stays = f"stays bent for {bend.bent_s:.0f} s, but safety vents it after {limit_s:g} s"
            yield case.error(bend.step.item, f"{stays} (limits.max_bent_s); straighten it earlier")
    if case.budget.bent_at_end is not None:
        ends = "still bent when the mission ends, and vented by the landing; straighten it before"
        yield case.warning(case.budget.bent_at_end.step.item, ends)


def _reserve(case: CheckedMission) -> Iterator[MissionFinding]:
    for bend in case.budget.bends:
        if bend.low_at_s is not None:
            low = f"the reservoir is below the reserve {bend.low_at_s:.0f} s after take-off, and safety vents"
            yield case.error(bend.step.item, f"{low}; fill it more, or bend less")


CHECKS: tuple[Callable[[CheckedMission], Iterator[MissionFinding]], ...] = (
    _refused,
    _home,
    _capacity,
    _burst,
    _places,
    _never,
    _on_the_ground,
    _too_long,
    _jumps,
    _no_vine,
    _disarmed,
    _ruled,
    _overtaken,
    _bent,
    _reserve,
)
