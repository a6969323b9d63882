"""ArduPilot, and the mission items that it runs: seen by its texts, or by progress if a text was lost."""

from __future__ import annotations

import math
import re
import struct
from collections import deque
from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import ClassVar, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config.config import ITEM_COMMANDS
from flying_vines.vehicle.autopilots.autopilot import LOSS_SHOWN_WITHIN_S, Autopilot, MissionWatch
from flying_vines.vehicle.clock import AutopilotClock, Mark
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.mission.item import (
    INVALID_PARAM1,
    JUMP,
    NAV_SCRIPT_TIME,
    UNSUPPORTED,
    UNSUPPORTED_FRAME,
    Execution,
    MissionItem,
    MissionRefused,
    Params,
    f32,
    is_nav,
    same_numbers,
)
from flying_vines.vehicle.mission.mission_cache import MAX_ITEMS, MissionCache, item_of
from flying_vines.vehicle.repeats import COPIES_WITHIN_S, MAX_DELAY_DIFFERENCE_S

ITEM_TEXT = re.compile(r"Mission: (\d{1,5}) (\S+)")
REACHED_TEXT = re.compile(r"Reached command #(\d{1,5})")
COMMAND_OF_NAME = {
    "Scripting": 217,
    "Gripper": 211,
    "Winch": 42600,
    "NavScriptTime": 42702,
    "AuxFunction": 218,
    "SetRelay": 181,
    "SetServo": 183,
    "DigiCamCfg": 202,
    "DigiCamCtrl": 203,
    "WP": 16,
    "Takeoff": 22,
    "Land": 21,
    "Delay": 93,
}
"""The command for each name in ArduPilot's status text (AP_Mission, Mission_Command::type())."""

NAMED_COMMANDS = set(COMMAND_OF_NAME.values())

ASK_AGAIN_S = 0.2
GIVE_UP_S = 0.8
"""Maximum wait for the params of an item. ArduPilot answers within 6 ms."""
SAME_SCRIPT_ITEM_S = 3.0
"""A text and a script's params are of one item only if they come within this time. Measured: a script on the
autopilot sends the params 5 to 17 ms after the text. Our script repeats unacknowledged params for 2 s."""
SCRIPT_MESSAGE = ITEM_COMMANDS["script_message"]
WAIT_FOR_TEXT_S = 0.5
"""If the text of an item does not arrive within this time, the execution of the item is inferred. If the text
then arrives within `TEXT_LATE_S`, it is ignored. So this time may be shorter than `MAX_DELAY_DIFFERENCE_S`,
and the vine moves earlier."""
TEXT_LATE_S = 1.0
"""A text that arrives within this time after its item was inferred belongs to that item."""
REACHED_AGAIN_S = 3.0
PROGRESS_AFTER_REACHED_S = 3.0
"""MISSION_CURRENT arrives at 1 Hz or faster. If it changes later than this after the waypoint was reached,
the change is a commanded jump, not the end of the waypoint."""
CONDITIONAL = {112, 113, 114, 115, 177, 601}
"""CONDITION_* and jumps. The mission may move on without the items after them."""
FLYING = {0, 3}
"""MISSION_CURRENT.mission_state of a running mission; older releases leave it at 0."""
MAX_WAITING = 64
MAX_REQUESTED = 8


@dataclass(slots=True)
class _Waiting:
    """An item that ran, whose params are not confirmed yet."""

    seq: int
    name: str | None
    """Its name in the text; None if the text was lost."""
    command: int | None
    before: MissionItem | None
    """The item in the cache, if it was known."""
    mark: Mark
    late_s: float = 0.0
    """The item ran this long before the mark."""
    item: MissionItem | None = None
    """The autopilot's answer."""
    asked_at: float = -math.inf


class _Suspect(NamedTuple):
    """An item that should have run at `since`. We noticed this at `t`, and wait for the item's text."""

    t: float
    since: float
    item: MissionItem
    before: int
    certain_while_at: int | None
    """The item ran only if the mission is still at this waypoint after the wait; None: no such condition."""


class ArduPilotWatch(MissionWatch):
    """Detects the executions of mission items whose command is one of `commands`.

    Each text is one execution. An execution without a text is inferred if the waypoint before the item was
    reached, the mission moved on to the next waypoint, frames were lost in that time, and no conditional item
    is before it. It is also inferred if the item itself was reported as reached and frames were lost. It is
    not inferred if a later item has run since. If a script on the autopilot also sends the item as a command,
    text and command are one execution.

    No message shows that the mission was replaced by another of the same length. So each item that ran is
    requested again (`asks`), and only an answer after the execution counts.
    """

    publishes_items = False

    def __init__(
        self, cache: MissionCache, commands: Container[int] = (), clock: AutopilotClock | None = None
    ) -> None:
        super().__init__(cache, commands, clock)
        self.restarted()

    def restarted(self) -> None:
        self._waiting: deque[_Waiting] = deque(maxlen=MAX_WAITING)
        self._frames: dict[int, tuple[float, int]] = {}
        self._ran_at: dict[int, float] = {}
        self._ran: deque[tuple[float, int | None]] = deque(maxlen=MAX_WAITING)
        self._reached: dict[int, float] = {}
        self._current: int | None = None
        self._flying = False
        self._suspects: deque[_Suspect] = deque(maxlen=MAX_WAITING)
        self._inferred_at: dict[int, float] = {}
        self._params_of_texts = _RecentParams()
        self._params_of_script = _RecentParams()

    def command(
        self, t: float, command: int, params: tuple[float, ...], confirmation: int
    ) -> Execution | None:
        if command != ITEM_COMMANDS["user_1"]:
            return super().command(t, command, params, confirmation)
        return self._handed_over(t, params[:4])

    def _handed_over(self, t: float, params: tuple[float, ...]) -> Execution | None:
        """The execution behind params from a script on the autopilot; None if `due` returned it already."""
        for waiting in self._waiting:
            if waiting.command == SCRIPT_MESSAGE:
                self._waiting.remove(waiting)
                return Execution(SCRIPT_MESSAGE, waiting.seq, None, params)
        if self._params_of_texts.take(t, params):
            return None
        self._params_of_script.put(t, params)
        item = self._cache.only(SCRIPT_MESSAGE, params)
        seq = item.seq if item else None
        self._note(t, seq)
        return Execution(SCRIPT_MESSAGE, seq, item, params)

    def handle(self, t: float, message: MavlinkMessage) -> None:
        kind = message.get_type()
        if kind == "STATUSTEXT":
            if match := ITEM_TEXT.match(message.text):
                self._take_text(t, message.get_seq(), int(match[1]), match[2])
            elif match := REACHED_TEXT.match(message.text):
                self._reach(t, int(match[1]))
        elif kind == "MISSION_ITEM_REACHED":
            self._reach(t, message.seq)
        elif kind == "MISSION_CURRENT":
            self._flying = message.mission_state in FLYING
            if self._current not in (None, message.seq):
                self._suspect_between(t, self._current, message.seq)
            self._current = message.seq
        elif kind in ("MISSION_ITEM_INT", "MISSION_ITEM") and message.mission_type == 0:
            self._answer(item_of(message))

    def asks(self, t: float) -> list[int]:
        asks = []
        for waiting in islice(self._waiting, MAX_REQUESTED):
            if waiting.item is None and not self._cache.is_given and t - waiting.asked_at >= ASK_AGAIN_S:
                waiting.asked_at = t
                asks.append(waiting.seq)
        return asks

    def _answer(self, item: MissionItem) -> None:
        for waiting in self._waiting:
            if waiting.seq != item.seq or waiting.item is not None:
                continue
            # An inferred item ran some time ago. Other params may belong to a newer mission.
            guess = waiting.before if waiting.name is None else None
            if _same(item, guess) if guess else _fits(waiting.name, item.command, confirmed=True):
                waiting.item = item

    def _take_text(self, t: float, sequence: int, seq: int, name: str) -> None:
        copied_at, copied_seq = self._frames.get(sequence, (-math.inf, seq))
        if seq > MAX_ITEMS or (copied_seq == seq and t - copied_at < COPIES_WITHIN_S):
            return
        self._frames[sequence] = (t, seq)
        if t - self._inferred_at.pop(seq, -math.inf) < TEXT_LATE_S:
            return
        self._ran_at[seq] = t
        command = COMMAND_OF_NAME.get(name)
        item = self._cache.items.get(seq) if self._cache.fresh else None
        if self._cache.fresh:
            if item is None or not _fits(name, item.command):
                self._cache.mark_outdated(t)
            elif command is None:
                command = item.command
        if command is None or command in self._commands:
            self._note(t, seq)
            self._waiting.append(_Waiting(seq, name, command, item, self._clock.mark(t)))

    def _note(self, t: float, seq: int | None) -> None:
        if seq is not None:
            self._ran_at[seq] = t
        self._ran.append((t, seq))

    def _reach(self, t: float, seq: int) -> None:
        if seq > MAX_ITEMS or t - self._reached.get(seq, -math.inf) < REACHED_AGAIN_S:
            return
        self._reached[seq] = t
        item = self._cache.items.get(seq)
        if item is not None and not is_nav(item.command) and item.command in self._commands:
            self._suspects.append(_Suspect(t, t, item, seq - 1, None))

    def _suspect_between(self, t: float, before: int | None, now: int) -> None:
        """The mission moved on from waypoint `before` to `now`. Texts of items between them may be lost."""
        reached_at = self._reached.get(before or 0, -math.inf)
        if before is None or not self._cache.fresh or t - reached_at > PROGRESS_AFTER_REACHED_S:
            return
        for item in self._certain(before, now):
            # The first item after a waypoint starts at the waypoint's end, the others milliseconds later.
            first = item.seq == before + 1
            self._suspects.append(_Suspect(t, reached_at, item, before, None if first else now))

    def _certain(self, before: int, now: int) -> list[MissionItem]:
        """The items that certainly run after waypoint `before`; none if `now` cannot be the next waypoint."""
        items = self._cache.items
        certain: list[MissionItem] = []
        conditional = False
        leads_to: set[int | None] = set()
        seq = before + 1
        while (item := items.get(seq)) is not None:
            if is_nav(item.command):
                leads_to.add(seq)
                break
            if item.command == JUMP and math.isfinite(item.params[0]):
                leads_to.add(self._first_nav(int(item.params[0])))
            conditional = conditional or item.command in CONDITIONAL
            if not conditional and item.command in self._commands:
                certain.append(item)
            seq += 1
        return certain if now in leads_to else []

    def _first_nav(self, seq: int) -> int | None:
        while (item := self._cache.items.get(seq)) is not None:
            if is_nav(item.command):
                return seq
            seq += 1
        return None

    @property
    def idle(self) -> bool:
        return not (self._waiting or self._suspects)

    def due(self, t: float) -> list[Execution]:
        self._infer(t)
        executions = []
        while self._waiting:
            waiting = self._waiting[0]
            item = waiting.item
            gave_up = t - waiting.mark.t >= GIVE_UP_S
            if self._cache.is_given or (gave_up and self._cache.is_certain):
                known = self._cache.items.get(waiting.seq)
                item = item or (known if known and _fits(waiting.name, known.command) else None)
            age_s = self._clock.age_s(waiting.mark, t)
            if age_s is None or (item is None and not gave_up and not self._cache.is_given):
                break  # later items wait, to keep the order
            self._waiting.popleft()
            command = item.command if item else waiting.command
            params = item.params if item else None
            if command is None or command not in self._commands:
                continue
            if command == SCRIPT_MESSAGE:
                if self._params_of_script.take(t, params):
                    continue
                if params is not None:
                    self._params_of_texts.put(t, params)
            before = waiting.before
            changed = bool(item and before and not _same(item, before))
            executions.append(Execution(command, waiting.seq, item, params, age_s + waiting.late_s, changed))
        return executions

    def _infer(self, t: float) -> None:
        """Infer executions whose texts were lost. Their params must then be confirmed, as after a text."""
        while self._suspects and t - self._suspects[0].t >= WAIT_FOR_TEXT_S:
            suspect = self._suspects.popleft()
            if self._ran_without_text(t, suspect):
                item = suspect.item
                self._note(t, item.seq)
                self._inferred_at[item.seq] = t
                waiting = _Waiting(item.seq, None, item.command, item, Mark(t), t - suspect.since)
                self._waiting.append(waiting)

    def _ran_without_text(self, t: float, suspect: _Suspect) -> bool:
        since, item = suspect.since - MAX_DELAY_DIFFERENCE_S, suspect.item
        cache = self._cache
        if not cache.fresh or cache.items.get(item.seq) != item or self._clock.lost_at < since:
            return False
        if self._ran_at.get(item.seq, -math.inf) >= since:
            return False
        if any(ran_at >= since and not self._is_before(seq, suspect) for ran_at, seq in self._ran):
            return False
        here = suspect.certain_while_at
        return here is None or (here == self._current and self._flying)

    def _is_before(self, seq: int | None, suspect: _Suspect) -> bool:
        return seq is not None and suspect.before < seq <= suspect.item.seq


class _RecentParams:
    """The params of recent script messages. Each can be taken once."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, tuple[float, ...]]] = deque(maxlen=MAX_WAITING)

    def put(self, t: float, params: tuple[float, ...]) -> None:
        self._seen.append((t, params[:4]))

    def take(self, t: float, params: tuple[float, ...] | None) -> bool:
        """Remove these params (None: any). Returns True if they came recently."""
        while self._seen and t - self._seen[0][0] > SAME_SCRIPT_ITEM_S:
            self._seen.popleft()
        for entry in self._seen:
            if params is None or same_numbers(entry[1], params[:4]):
                self._seen.remove(entry)
                return True
        return False


def _fits(name: str | None, command: int, confirmed: bool = False) -> bool:
    """True if the name fits the command. `confirmed`: an unknown name, perhaps of another release, fits."""
    expected = COMMAND_OF_NAME.get(name or "")
    if expected is not None:
        return expected == command
    return name is None or confirmed or command not in NAMED_COMMANDS


def _same(a: MissionItem, b: MissionItem) -> bool:
    return a.command == b.command and same_numbers(a.params, b.params)


COPTER_MODES = {
    0: "STABILIZE", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL", 9: "LAND",
    16: "POSHOLD", 17: "BRAKE", 21: "SMART_RTL", 27: "AUTO RTL",
}  # fmt: skip

IGNORE_RECEIVER, IGNORE_OVERRIDES, IGNORE_FAILSAFE_FLAG = 1, 2, 4
"""Bits of RC_OPTIONS."""
DEFAULT_OVERRIDE_S = 3.0

STREAM_GROUPS = {
    "SYS_STATUS": "EXT_STAT",
    "MISSION_CURRENT": "EXT_STAT",
    "GLOBAL_POSITION_INT": "POSITION",
    "RC_CHANNELS": "RC_CHAN",
    "SYSTEM_TIME": "EXTRA3",
    "SCALED_PRESSURE": "RAW_SENS",
}
"""The stream group of each message: a part of the name of the parameter for its rate."""


class ArduPilot(Autopilot):
    kind = "ardupilot"
    title = "ArduPilot"
    mav_autopilot = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    rc_parameters = ("FS_THR_ENABLE", "RC_FS_TIMEOUT", "RC_OPTIONS", "RC_OVERRIDE_TIME")
    mode_channel_parameter = "FLTMODE_CH"
    other_uses = ("RC{}_OPTION",)
    mission_watch = ArduPilotWatch
    begins_with_home = True
    item_commands = ("script_message", "winch", "gripper")
    gives_items_in_any_order = True
    hides_our_parameters = True
    rc_remedies: ClassVar = {
        "FS_THR_ENABLE": "set FS_THR_ENABLE = 1",
        "RC_FS_TIMEOUT": "set RC_FS_TIMEOUT = 1",
        "RC_OPTIONS": "clear bits 0 and 2 of RC_OPTIONS: they ignore the receiver, or its failsafe flag",
    }
    unseen_loss_remedy = (
        "if you switched off this vehicle's transmitter: set FS_THR_ENABLE = 1, and the receiver's failsafe"
        " to no pulses, or to a throttle below FS_THR_VALUE"
    )

    def mode_name(self, custom_mode: int) -> str:
        return COPTER_MODES.get(custom_mode, f"MODE {custom_mode}")

    def hides_rc_loss(self, values: Mapping[str, float]) -> str:
        if values.get("FS_THR_ENABLE") == 0:
            return "FS_THR_ENABLE 0"
        if values.get("RC_FS_TIMEOUT", 0.0) > LOSS_SHOWN_WITHIN_S:
            return f"RC_FS_TIMEOUT {values['RC_FS_TIMEOUT']:g}"
        options = int(values.get("RC_OPTIONS", 0))
        return f"RC_OPTIONS {options}" if options & (IGNORE_RECEIVER | IGNORE_FAILSAFE_FLAG) else ""

    def override_lasts_s(self, values: Mapping[str, float]) -> float:
        if int(values.get("RC_OPTIONS", 0)) & IGNORE_OVERRIDES:
            return 0.0
        lasts_s = values.get("RC_OVERRIDE_TIME", DEFAULT_OVERRIDE_S)
        return math.inf if lasts_s < 0.0 else lasts_s

    def how_to_set_stream(self, message: str, rate_Hz: int) -> str:
        group = STREAM_GROUPS.get(message)
        if group is None:
            return super().how_to_set_stream(message, rate_Hz)
        return (
            f"set SRn_{group} = {rate_Hz} (n is the number of the MAVLink port, USB = 0; from 4.7 on "
            f"MAVn_{group}, USB = 1), and a baud rate that carries all streams"
        )

    def store(self, item: MissionItem) -> MissionItem:
        if item.command not in _DO and item.command not in _NAV:
            raise MissionRefused(item, UNSUPPORTED)
        params = list(item.params)
        if item.command in _YAW_MAY_BE_NAN and math.isnan(params[3]):
            params[3] = 0.0
        for index, value in enumerate(params):
            if not math.isfinite(value):
                raise MissionRefused(item, INVALID_PARAM1 + index)
        if item.command == NAV_SCRIPT_TIME:
            return _stored(item, _cast(params, (_u8, _u8, _f16, _f16, _i16, _i16)), frame=0)
        if item.command in _DO:
            return _stored(item, _cast(params, _DO[item.command]), frame=0)
        p1, p2, p3, p4, latitude, longitude, z = params
        # ArduPilot stores latitude and longitude as integers of 1e-7 degrees; a double is precise enough.
        place = latitude, longitude, whole_centimetres(z)
        return _stored(item, (f32(p1), f32(p2), f32(p3), f32(p4), *place), frame=_frame(item))


# Each function returns a number as ArduPilot stores it.


def _u8(value: float) -> float:
    return float(int(value) & 0xFF)


def _u16(value: float) -> float:
    return float(int(value) & 0xFFFF)


def _i16(value: float) -> float:
    return float((int(value) + 0x8000 & 0xFFFF) - 0x8000)


def _f16(value: float) -> float:
    try:
        return float(struct.unpack("<e", struct.pack("<e", value))[0])
    except OverflowError:
        return math.copysign(math.inf, value)


def whole_centimetres(altitude_m: float) -> float:
    """An altitude as ArduPilot stores it: in centimetres, with 32 bits."""
    max_cm = float((1 << 31) - 1)
    centimetres = int(max(-max_cm, min(max_cm, f32(altitude_m * 100.0))))
    return f32(centimetres * f32(0.01))


def _none(value: float) -> float:
    return 0.0


_Cast = Callable[[float], float]

# Casts of param1..4, x, y, z, by command. Values after the last cast are not stored.
_DO: dict[int, tuple[_Cast, ...]] = {
    112: (f32,),
    114: (f32,),
    115: (f32, _u16, _i16, _u8),
    177: (_u16, _i16),
    178: (_u8, f32, f32),
    179: (_u8,),
    181: (_u8, _u8),
    182: (_u8, _i16, f32),
    183: (_u8, _u16),
    184: (_u8, _u16, _i16, f32),
    189: (),
    193: (_u8,),
    195: (_none, _none, _none, _none, f32, f32, f32),
    201: (_u16, _none, _none, _none, f32, f32, f32),
    202: (_u16, _u16, _u16, _u8, _u8, _u16, _u16),
    203: (_u8, _u8, _i16, _u8, _u8, _u16),
    205: (f32, f32, f32),
    206: (f32, _none, _u8),
    207: (_u8,),
    208: (_u8,),
    211: (_u8, _u8),
    215: (_u16,),
    216: (_u8,),
    217: (_u16, f32, f32, f32),
    218: (_u16, _u8),
    222: (_u16, f32, f32, f32),
    531: (_u8, f32),
    600: (_u16,),
    601: (_u16, _i16),
    1000: (f32, f32, f32, f32, _u8),
    2000: (_u8, f32, _u16, _u16),
    2001: (_u8,),
    2500: (_u8,),
    2501: (_u8,),
    42600: (_u8, _u8, f32, f32),
}
_NAV = {16, 17, 18, 19, 20, 21, 22, 82, 84, 85, 92, 93, 94, NAV_SCRIPT_TIME}
_YAW_MAY_BE_NAN = {16, 21, 22, 84, 85}
_NAV_DELAY = 93


def _frame(item: MissionItem) -> int:
    if item.command == _NAV_DELAY:
        return 0
    frame = {5: 0, 6: 3, 11: 10}.get(item.frame, item.frame)
    if frame not in (0, 2, 3, 10):
        raise MissionRefused(item, UNSUPPORTED_FRAME)
    return frame


def _cast(params: list[float], casts: tuple[_Cast, ...]) -> Params:
    out = [cast(value) for cast, value in zip(casts, params, strict=False)]
    out += [0.0] * (7 - len(out))
    return out[0], out[1], out[2], out[3], out[4], out[5], out[6]


def _stored(item: MissionItem, params: Params, frame: int) -> MissionItem:
    return MissionItem(item.seq, item.command, params, frame, False, item.autocontinue)
