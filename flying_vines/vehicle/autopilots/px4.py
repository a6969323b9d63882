"""PX4, and the mission items that it runs: it sends them as COMMAND_LONG and reports them as reached."""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Container, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.autopilots.autopilot import Autopilot, MissionWatch
from flying_vines.vehicle.clock import AutopilotClock, Mark
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.mission.item import (
    CONDITION_DELAY,
    MISSION_FRAME,
    UNSUPPORTED,
    UNSUPPORTED_FRAME,
    Execution,
    MissionItem,
    MissionRefused,
    is_nav,
    same_numbers,
)
from flying_vines.vehicle.mission.mission_cache import MissionCache
from flying_vines.vehicle.repeats import MAX_DELAY_DIFFERENCE_S, PX4_REPEAT_S

MIN_REPEAT_S = 0.5
"""The first repeat comes 0.5 s, sometimes 1 s, after its item, plus the link's delay."""
FIRST_REPEAT_LATER_S = 0.25
"""The first repeat is 0.5 or 1 s old. Its assumed age is the middle: 0.5 s plus this."""
BEFORE_A_REPEAT_S = 0.4
"""A repeat's item ran at least 0.5 s ago, less the link's jitter. If the command of another item arrived
within this time before the repeat, that other item ran later than the repeat's item."""
SAME_BURST_S = 3.0
"""Commands within this time may be of consecutive items: PX4 sends such items within milliseconds, and the
last repeat of an item 2 s after the item."""

WAIT_FOR_COMMAND_S = 0.3
"""If the command of a reached item does not arrive within this time, it was lost. Measured: the report comes
up to 20 ms after the command, and once it came before the command."""
LAST_REPEAT_S = 2.5
"""If the cache may be outdated, wait this long for a repeat of the command, which has the params."""
REACHED_WITHIN_S = 3.0
"""PX4 repeats MISSION_ITEM_REACHED every second. A report counts up to this time after the command."""
GRIPPER, WINCH = 211, 42600
TIMEOUT_S = 60.0
"""`REACHED_WITHIN_S` of a gripper and a winch: PX4 waits for MIS_COMMAND_TOUT before it reports them."""
REPEATED_WITHIN_S = 2.5
"""A second report for an item within this time is a repeat, even after another item's report."""
MAX_PAST = 8
HISTORY_S = 2.0
"""A report within this time after the first message that we received may be a repeat of an older report."""


@dataclass(slots=True)
class _Ran:
    t: float
    execution: Execution
    was_reached: bool


@dataclass(slots=True)
class _Reached:
    """A vine item that was reached, and whose command has not arrived."""

    item: MissionItem
    mark: Mark
    late_s: float
    """The item ran at most this long before the mark."""


class Px4Watch(MissionWatch):
    """Detects the executions of mission items, which PX4 sends as COMMAND_LONG with their params.

    If the command was lost, MISSION_ITEM_REACHED shows the execution. The params then come from the cache, if
    the cache certainly holds the running mission. PX4 reports only the last of several items at one waypoint.
    """

    def __init__(
        self, cache: MissionCache, commands: Container[int] = (), clock: AutopilotClock | None = None
    ) -> None:
        super().__init__(cache, commands, clock)
        self._current = 0
        self._past: deque[_Ran] = deque(maxlen=MAX_PAST)
        self._forgotten_at = -math.inf
        self._begun_at: float | None = None
        self._reached: int | None = None
        self._reached_at: dict[int, float] = {}
        self._waiting: _Reached | None = None
        self._inferred: Execution | None = None
        self._inferred_at = -math.inf
        self._complete_until = 0.0
        """No item that ran before this time was missed."""
        self._current_changed = False

    def forget(self, t: float) -> None:
        """From now on ignore repeats of items that ran before now."""
        self._forgotten_at = t
        self._waiting = None

    def handle(self, t: float, message: MavlinkMessage) -> None:
        kind = message.get_type()
        if self._begun_at is None:
            self._begun_at = self._complete_until = t
        if kind == "MISSION_CURRENT":
            self._current_changed = self._current_changed or message.seq != self._current
            if not self._current_changed:
                self._complete_until = t
            self._current = message.seq
        elif kind == "MISSION_ITEM_REACHED":
            self._reach(t, message.seq)

    def _reach(self, t: float, seq: int) -> None:
        known, self._reached = self._reached, seq
        lost = self._clock.lost_at > self._complete_until
        late_s = t - self._complete_until if lost else 0.0
        self._complete_until, self._current_changed = t, False
        repeated = seq == known or t - self._reached_at.pop(seq, -math.inf) < REPEATED_WITHIN_S
        self._reached_at[seq] = t
        if len(self._reached_at) > MAX_PAST:
            del self._reached_at[next(iter(self._reached_at))]
        item = self._cache.items.get(seq) if self._cache.fresh else None
        if item is None or item.command not in self._commands:
            return
        if repeated or (known is None and t - (self._begun_at or 0.0) < HISTORY_S):
            return
        if not self._has_run(t, item) and not self._later_item_ran(t, item):
            self._waiting = _Reached(item, self._clock.mark(t), late_s)

    def _has_run(self, t: float, item: MissionItem) -> bool:
        """True if the item's command has arrived. Each command belongs to one item."""
        within_s = TIMEOUT_S if item.command in (GRIPPER, WINCH) else REACHED_WITHIN_S
        for ran in reversed(self._past):
            fits = ran.execution.seq in (None, item.seq) and _same(ran.execution, _of(item))
            if fits and not ran.was_reached and t - ran.t < within_s:
                ran.was_reached = True
                return True
        return False

    def _later_item_ran(self, t: float, item: MissionItem) -> bool:
        """True if a later item at the same waypoint has run already."""
        return any(
            other.seq > item.seq and not self._flies_between(item.seq, other.seq)
            for ran in self._past
            if t - ran.t < REACHED_WITHIN_S
            for other in self._cache.alike(ran.execution.command, ran.execution.params or ())
        )

    def command(
        self, t: float, command: int, params: tuple[float, ...], confirmation: int
    ) -> Execution | None:
        """The execution behind a command of the autopilot, with its mission item if that is known.

        None if the execution was inferred already. Also None for a repeat whose earlier copies were lost, if
        a later item already ran or `forget` was called.
        """
        item = self._cache.only(command, params) if self._cache.is_certain else None
        age_s = confirmation * MIN_REPEAT_S + (FIRST_REPEAT_LATER_S if confirmation else 0.0)
        execution = Execution(command, item.seq if item else None, item, params, age_s)
        max_age_s = (confirmation + 1) * PX4_REPEAT_S + MAX_DELAY_DIFFERENCE_S
        if self._inferred and t - self._inferred_at < max_age_s and _same(self._inferred, execution):
            return None
        ran_at = t - (confirmation + 1) * MIN_REPEAT_S - MAX_DELAY_DIFFERENCE_S
        if confirmation and (ran_at < self._forgotten_at or self._overtaken(t, execution)):
            return None
        was_reached = False
        if self._waiting and _same(_of(self._waiting.item), execution):
            execution = replace(execution, seq=self._waiting.item.seq, item=self._waiting.item)
            was_reached = True
        if was_reached or confirmation == 0:
            self._waiting = None
        self._past.append(_Ran(t, execution, was_reached))
        return execution

    @property
    def idle(self) -> bool:
        return self._waiting is None

    def due(self, t: float) -> list[Execution]:
        """The item whose command was certainly lost, if there is one."""
        waiting = self._waiting
        wait_s = WAIT_FOR_COMMAND_S if self._cache.is_certain else LAST_REPEAT_S
        if waiting is None or t - waiting.mark.t < wait_s:
            return []
        age_s = self._clock.age_s(waiting.mark, t)
        if age_s is None:
            return []
        self._waiting = None
        item = waiting.item
        if self._cache.items.get(item.seq) != item:
            return []
        execution = replace(_of(item), age_s=age_s + waiting.late_s)
        if not self._cache.is_certain:
            return [replace(execution, item=None, params=None)]
        self._inferred, self._inferred_at = execution, t
        self._past.append(_Ran(t, execution, True))
        return [execution]

    def _overtaken(self, t: float, execution: Execution) -> bool:
        if not self._past or _same(self._past[-1].execution, execution):
            return False
        ran = self._past[-1]
        if t - ran.t < BEFORE_A_REPEAT_S:
            return True
        seq, ran_seq = (self._nearest(one) for one in (execution, ran.execution))
        if seq is None or ran_seq is None or t - ran.t > SAME_BURST_S:
            return False
        return ran_seq > seq and not self._flies_between(seq, ran_seq)

    def _nearest(self, execution: Execution) -> int | None:
        """The seq of the matching item nearest to the current one; of two equally near items, the later."""
        if execution.seq is not None:
            return execution.seq
        seqs = [item.seq for item in self._cache.alike(execution.command, execution.params or ())]
        return min(seqs, key=lambda seq: (abs(seq - self._current), -seq), default=None)

    def _flies_between(self, first: int, last: int) -> bool:
        items = self._cache.items
        return any(is_nav(items[seq].command) for seq in range(first, last) if seq in items)


def _of(item: MissionItem) -> Execution:
    return Execution(item.command, item.seq, item, item.params)


def _same(a: Execution, b: Execution) -> bool:
    # x and y are not compared: an item may have scaled coordinates there, and a command any numbers.
    one, other = ((*params[:4], *params[6:]) for params in (a.params or (), b.params or ()))
    return a.command == b.command and len(one) == len(other) and same_numbers(one, other)


MAIN_MODES = {1: "MANUAL", 2: "ALTCTL", 3: "POSCTL", 4: "AUTO", 5: "ACRO", 6: "OFFBOARD", 7: "STABILIZED"}
AUTO, AUTO_MODES = 4, {1: "READY", 2: "TAKEOFF", 3: "LOITER", 4: "MISSION", 5: "RTL", 6: "LAND"}

RECEIVER_NOT_USED = {1: "joystick only", 4: "stick input disabled"}
"""Values of COM_RC_IN_MODE with which the RC status does not cover the receiver."""
DEFAULT_LOSS_S = 0.5
STATUS_AFTER_S = 1.1
"""Maximum time from the end of COM_RC_LOSS_T to the status in SYS_STATUS. Measured: the status changes 0.8 to
1.4 s after a loss with COM_RC_LOSS_T = 0.5 s."""

_NAV = {16, 17, 19, 20, 21, 22, 84, 85}
_MISSION_FRAME = {
    *(20, 93, 112, 114, 177, 178, 179, 187, 189, 195, 197, 200, 201, 203, 204, 205, 206, 211),
    *(530, 531, 532, 534, 1000, 1001, 2000, 2001, 2003, 2500, 2501, 3000, 42600),
}
_GLOBAL_FRAMES = {0: 5, 5: 5, 3: 6, 6: 6}
"""The frames in which PX4 returns items: those with integer coordinates."""


class Px4(Autopilot):
    kind = "px4"
    title = "PX4"
    mav_autopilot = mavlink.MAV_AUTOPILOT_PX4
    rc_parameters = ("COM_RC_LOSS_T", "COM_RC_IN_MODE")
    mode_channel_parameter = "RC_MAP_FLTMODE"
    other_uses = tuple(
        f"RC_MAP_{use}_SW" for use in ("KILL", "ARM", "RETURN", "LOITER", "OFFB", "GEAR", "TRANS")
    )
    needs_rc_status = True
    mission_watch = Px4Watch
    item_commands = ("actuator", "winch", "gripper")
    item_match = ", param7 = 1"
    own_rates_Hz: ClassVar = {"MISSION_CURRENT": 1.0}
    rc_remedies: ClassVar = {"COM_RC_IN_MODE": "set COM_RC_IN_MODE = 0, so that the receiver is used"}

    def mode_name(self, custom_mode: int) -> str:
        main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
        name = MAIN_MODES.get(main, f"MODE {main}")
        return f"{name}.{AUTO_MODES.get(sub, sub)}" if main == AUTO else name

    def parameter_value(self, message: MavlinkMessage) -> float:
        """PX4 puts the bytes of an integer into the float field."""
        if message.param_type == mavlink.MAV_PARAM_TYPE_INT32:
            return float(struct.unpack("<i", struct.pack("<f", message.param_value))[0])
        return float(message.param_value)

    def hides_rc_loss(self, values: Mapping[str, float]) -> str:
        mode = int(values.get("COM_RC_IN_MODE", 0))
        return f"COM_RC_IN_MODE {mode}" if mode in RECEIVER_NOT_USED else ""

    def rc_loss_shows_within_s(self, values: Mapping[str, float]) -> float:
        return STATUS_AFTER_S + max(DEFAULT_LOSS_S, values.get("COM_RC_LOSS_T", 0.0))

    def how_to_set_stream(self, message: str, rate_Hz: int) -> str:
        if message in self.own_rates_Hz:
            return "PX4 sends it by itself once it has a mission: set a baud rate that carries all streams"
        return (
            f"put into etc/extras.txt on its card: mavlink stream -d DEVICE -s {message} -r {rate_Hz}; "
            "and set a baud rate that carries all streams"
        )

    def store(self, item: MissionItem) -> MissionItem:
        if item.frame == MISSION_FRAME:
            if item.command not in _MISSION_FRAME:
                raise MissionRefused(item, UNSUPPORTED)
            return replace(item, current=False)
        if item.frame not in _GLOBAL_FRAMES:
            raise MissionRefused(item, UNSUPPORTED_FRAME)
        if item.command not in _NAV:
            takes = item.command in _MISSION_FRAME
            raise MissionRefused(item, UNSUPPORTED_FRAME if takes else UNSUPPORTED)
        return replace(item, frame=_GLOBAL_FRAMES[item.frame], current=False)

    def waits_for(self, item: MissionItem) -> bool:
        """PX4 also waits for CONDITION_DELAY; ArduPilot flies on."""
        return super().waits_for(item) or item.command == CONDITION_DELAY
