"""Runs missions like ArduCopter and PX4, including their quirks.

The autopilot calls a runner when: its mission mode was selected (`enter`) or left (`leave`); once per loop in
the mission mode (`update`); the vehicle was disarmed in the mission mode (`disarmed`); another mission was
loaded (`replaced`). Each may be called at any time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, Protocol

from flying_vines.simulation.autopilot.flight import CopterMotion, Leg
from flying_vines.simulation.autopilot.scheduler import ScheduledCallback, Scheduler
from flying_vines.vehicle.autopilots import AUTOPILOTS
from flying_vines.vehicle.mission.item import (
    CONDITION_DELAY,
    CONDITION_DISTANCE,
    CONDITION_YAW,
    DELAY,
    JUMP,
    LAND,
    RETURN,
    Jumps,
    MissionItem,
    Params,
    is_nav,
)

_NO_MISSION, _NOT_STARTED, _ACTIVE, _PAUSED, _COMPLETE = 1, 2, 3, 4, 5

# ArduPilot.
_DO_SPACING_S = 0.006
_YAW_S = 2.0
_GRIPPER, _WINCH, _TAG = 211, 42600, 600
_NAMES = {
    16: "WP", 17: "LoitUnlim", 18: "LoitTurns", 19: "LoitTime", 20: "RTL", 21: "Land", 22: "Takeoff",
    82: "SplineWP", 84: "VTOLTakeoff", 85: "VTOLLand", 92: "NavGuidedEnable", 93: "Delay", 94: "PayloadPlace",
    112: "CondDelay", 114: "CondDist", 115: "CondYaw", 177: "Jump", 178: "ChangeSpeed", 179: "SetHome",
    181: "SetRelay", 182: "RepeatRelay", 183: "SetServo", 184: "RepeatServo", 189: "LandStart",
    193: "PauseContinue", 195: "SetROI", 201: "SetROI", 202: "DigiCamCfg", 203: "DigiCamCtrl",
    205: "MountControl", 206: "SetCamTrigDst", 207: "FenceEnable", 208: "Parachute", 211: "Gripper",
    215: "SetRepeatDist", 216: "Sprayer", 217: "Scripting", 218: "AuxFunction", 222: "GuidedLimits",
    531: "SetCameraZoom", 600: "Tag", 601: "JumpTag", 1000: "GimbalPitchYaw", 2000: "ImageStartCapture",
    2001: "ImageStopCapture", 2500: "VideoStartCapture", 2501: "VideoStopCapture", 42600: "Winch",
    42702: "NavScriptTime",
}  # fmt: skip
_DO_REACHED = {112, 114, 115, 178, 179, 189, 193, 195, 201, 205, 207, 222, 42600}
_REACHED_WITH_TEXT = {16, 17, 18, 19, 82}

# PX4.
_TOTAL_BEFORE_FIRST_UPLOAD = 65535
_RETRIES_S = (1.0, 0.5, 0.5)
_FORGOTTEN_S = 0.5
_QUEUE = 8
_SHORTEST_WAIT_S = 0.02
_TO_PARAM1 = {530, 534, 2000, 2001}
_WAITING = {211, 42600}
_SUBMODE_IN_MISSION, _SUBMODE_SUSPENDED = 1, 2
_GIMBAL, _GIMBAL_CONTROL, _STOP_CAMERA_TRIGGER = 1000, 1001, 2003
_START_PICTURES, _STOP_PICTURES, _CAMERA = 2000, 2001, 100
_NAN = float("nan")


class MissionStatus(NamedTuple):
    """The content of MISSION_CURRENT."""

    seq: int
    total: int
    state: int
    mode: int


class Host(Protocol):
    """The autopilot as its mission runner sees it."""

    scheduler: Scheduler
    flight: CopterMotion

    @property
    def items(self) -> list[MissionItem]: ...
    @property
    def armed(self) -> bool: ...
    def text(self, text: str, severity: int = 6) -> None:
        """Send a status text to all links that get texts."""

    def reached(self, seq: int) -> None:
        """Set MISSION_ITEM_REACHED. Only the last one of a loop is sent, at the end of the loop."""

    def executed(self, item: MissionItem) -> None:
        """A DO item was executed."""

    def flush(self) -> None:
        """End a loop now, outside the autopilot's ticks: send its texts and MISSION_ITEM_REACHED."""


class _Runner:
    """The state of both runners."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._state = _NOT_STARTED
        self._jumps = Jumps()
        self._leg: Leg | None = None

    def _begin_leg(self, item: MissionItem) -> None:
        self._leg = Leg(self._host.flight, item, self._host.scheduler.now_s)


class ArduPilotMission(_Runner):
    """Runs one navigation command and, in parallel, a queue of DO commands.

    When a navigation command ends, the next DO item and the next navigation command start in the same loop,
    the DO item first. The other DO items between the two navigation commands follow one by one, after the
    status text of the second navigation command. Item 0 is home and never runs.
    """

    def __init__(self, host: Host) -> None:
        super().__init__(host)
        self._nav_seq = 0
        self._queue: list[int] = []
        self._next_do: ScheduledCallback | None = None
        self._condition: Callable[[], bool] | None = None
        self._condition_seq = 0
        self._from_the_start = False

    def status(self, in_mission_mode: bool) -> MissionStatus:
        total = max(0, len(self._host.items) - 1)
        state = self._state if total else _NO_MISSION
        return MissionStatus(self._nav_seq, total, state, int(in_mission_mode))

    def replaced(self) -> None:
        if self._state == _COMPLETE:
            self._state, self._nav_seq = _NOT_STARTED, 0
        if self._nav_seq >= len(self._host.items):
            self._state, self._nav_seq, self._leg = _NOT_STARTED, 0, None
            self._drop_dos()

    def enter(self) -> None:
        if self._from_the_start and len(self._host.items) > 1:
            # As recorded: after MISSION_SET_CURRENT to the first item, the mission starts twice.
            self._from_the_start = False
            self._start()
            self._start()
        elif self._state == _NOT_STARTED and 0 < self._nav_seq < len(self._host.items):
            self._state = _ACTIVE
            self._start_nav(self._nav_seq)
        elif self._state != _ACTIVE:
            self._start()

    def leave(self) -> None:
        self._drop_dos()
        if self._state == _ACTIVE:
            self._state = _NOT_STARTED
            self._leg = None

    def disarmed(self) -> None:
        # After disarming, ArduPilot resets the mission and starts it again on the ground. A DO item at its
        # beginning then runs twice.
        first = self._host.items[1] if len(self._host.items) > 1 else None
        self._start()
        if first is not None and not is_nav(first.command) and first.command != JUMP:
            self._start()

    def set_current(self, seq: int) -> None:
        if self._state == _ACTIVE:
            self._advance(seq)
            return
        self._from_the_start = seq <= 1
        items = self._host.items
        self._nav_seq = next((item.seq for item in items[seq:] if is_nav(item.command)), seq)
        self._state = _NOT_STARTED

    def update(self) -> None:
        if self._state != _ACTIVE or self._leg is None:
            return
        self._leg.update(self._host.scheduler.now_s, self._host.armed)
        if self._condition is not None and self._condition():
            self._end_condition()
        if self._leg.done:
            self._complete(self._leg.item)

    def _start(self) -> None:
        self._jumps = Jumps()
        self._state = _ACTIVE
        self._advance(1)

    def _complete(self, item: MissionItem) -> None:
        if item.command not in (LAND, RETURN):
            self._host.reached(item.seq)
        if item.command in _REACHED_WITH_TEXT:
            self._host.text(f"Reached command #{item.seq}")
        self._advance(item.seq + 1)

    def _advance(self, seq: int) -> None:
        """Continue at item `seq`: start the first DO and the next navigation command, queue the other DOs."""
        self._drop_dos()
        items = self._host.items
        dos: list[int] = []
        jumps_left = 2 * len(items)
        while 0 < seq < len(items):
            item = items[seq]
            if item.command == JUMP:
                if jumps_left == 0:
                    break
                jumps_left -= 1
                seq = self._jumps.take(item)
                continue
            if is_nav(item.command):
                if dos:
                    self._start_do(dos[0], in_nav_loop=True)
                self._start_nav(seq)
                self._queue = dos[1:]
                if self._condition is None:
                    self._schedule_do()
                return
            dos.append(seq)
            seq += 1
        if dos:
            self._start_do(dos[0], in_nav_loop=True)
        self._state = _COMPLETE
        self._leg = None
        self._host.flight.hold()

    def _start_nav(self, seq: int) -> None:
        item = self._host.items[seq]
        self._nav_seq = seq
        self._announce(item)
        if item.command == DELAY:
            self._host.text(f"Delaying {int(item.params[0])} sec")
        self._begin_leg(item)

    def _announce(self, item: MissionItem) -> None:
        name = _NAMES.get(item.command, "?")
        tag = f" {int(item.params[0])}" if item.command == _TAG else ""
        self._host.text(f"Mission: {item.seq} {name}{tag}")

    def _drop_dos(self) -> None:
        if self._next_do is not None:
            self._next_do.cancel()
            self._next_do = None
        self._queue = []
        self._condition = None

    def _schedule_do(self) -> None:
        if self._queue:
            self._next_do = self._host.scheduler.after(_DO_SPACING_S, self._run_next_do)

    def _run_next_do(self) -> None:
        self._next_do = None
        if not self._queue:
            return
        self._start_do(self._queue.pop(0), in_nav_loop=False)
        self._host.flush()
        if self._condition is None:
            self._schedule_do()

    def _start_do(self, seq: int, in_nav_loop: bool) -> None:
        item = self._host.items[seq]
        self._announce(item)
        if self._start_condition(item):
            return
        self._host.executed(item)
        if item.command == _GRIPPER:
            self._host.text("Gripper Grabbed" if item.params[1] else "Gripper Released")
        elif item.command == _WINCH:
            self._host.text(f"Winch: lowering {item.params[2]:4.1f}m to {item.params[2]:4.1f}m")
        if item.command in _DO_REACHED:
            if not in_nav_loop:
                # ArduPilot verifies the item one loop later, so its text is sent before MISSION_ITEM_REACHED.
                self._host.flush()
            self._host.reached(seq)

    def _start_condition(self, item: MissionItem) -> bool:
        scheduler, flight = self._host.scheduler, self._host.flight
        if item.command == CONDITION_DISTANCE:
            self._condition = lambda: flight.distance_to_target_m() <= item.params[0]
        elif item.command in (CONDITION_DELAY, CONDITION_YAW):
            ends_s = scheduler.now_s + (item.params[0] if item.command == CONDITION_DELAY else _YAW_S)
            self._condition = lambda: scheduler.now_s >= ends_s
        else:
            return False
        self._condition_seq = item.seq
        return True

    def _end_condition(self) -> None:
        self._condition = None
        self._host.reached(self._condition_seq)
        if self._queue:
            self._start_do(self._queue.pop(0), in_nav_loop=True)
            if self._condition is None:
                self._schedule_do()


@dataclass(slots=True)
class SentCommand:
    """A COMMAND_LONG of PX4. Once acknowledged, it leaves the list when its next repeat would be due."""

    command: int
    params: Params
    target_component: int = 0
    acknowledged: bool = False


class CommandSender:
    """Sends commands and repeats them with rising confirmation until they are acknowledged.

    As recorded, the first repeat comes after 1 s and two more after 0.5 s each. An acknowledged command stays
    in the list until its next repeat would be due. An acknowledgement counts for the oldest command of its
    number in the list. So of two equal commands the second is repeated although it was acknowledged, and an
    acknowledgement may end the repeats of a lost command.
    """

    def __init__(self, scheduler: Scheduler, send: Callable[[SentCommand, int], None]) -> None:
        self._scheduler = scheduler
        self._send = send
        self._sent: list[SentCommand] = []

    def send(self, command: int, params: Params, target_component: int = 0, repeat: bool = True) -> None:
        sent = SentCommand(command, params, target_component)
        self._send(sent, 0)
        if repeat:
            self._sent.append(sent)
            self._wait(sent, 1)

    def acknowledged(self, command: int) -> None:
        for sent in self._sent:
            if sent.command == command:
                sent.acknowledged = True
                return

    def _wait(self, sent: SentCommand, confirmation: int) -> None:
        delay_s = (*_RETRIES_S, _FORGOTTEN_S)[confirmation - 1]
        self._scheduler.after(delay_s, partial(self._again, sent, confirmation))

    def _again(self, sent: SentCommand, confirmation: int) -> None:
        if not sent.acknowledged and confirmation <= len(_RETRIES_S):
            self._send(sent, confirmation)
            self._wait(sent, confirmation + 1)
        else:
            self._sent.remove(sent)


class Px4Mission(_Runner):
    """Runs all items, including DO items, one after the other.

    Commands 211 (gripper) and 42600 (winch) stop the mission for `command_timeout_s` (MIS_COMMAND_TOUT), even
    if they are acknowledged. Other DO items end at once, so of several DO items in a row only the last one
    is reported as reached.
    """

    def __init__(self, host: Host, sender: CommandSender, command_timeout_s: Callable[[], float]) -> None:
        super().__init__(host)
        self._sender = sender
        self._timeout_s = command_timeout_s
        self._seq = 0
        self._stale_seq: int | None = None
        self._wait: ScheduledCallback | None = None
        self._uploaded = bool(host.items)
        self._pictures = False

    def status(self, in_mission_mode: bool) -> MissionStatus:
        total = len(self._host.items)
        if not total and not self._uploaded:
            total = _TOTAL_BEFORE_FIRST_UPLOAD
        state = self._state if self._host.items else _NO_MISSION
        mode = _SUBMODE_IN_MISSION if in_mission_mode else _SUBMODE_SUSPENDED
        # After a jump or a change of the current item, PX4 reports the old item until an item is reached.
        seq = self._seq if self._stale_seq is None else self._stale_seq
        return MissionStatus(seq, total, state, mode)

    def replaced(self) -> None:
        self._uploaded = True
        self._stop_waiting()
        self._state, self._seq, self._leg = _NOT_STARTED, 0, None
        self._stale_seq = None
        self._jumps = Jumps()

    def enter(self) -> None:
        if self._state == _COMPLETE:
            self._state, self._seq = _NOT_STARTED, 0
        if self._state == _PAUSED:
            self._state = _NOT_STARTED
        self.update()

    def leave(self) -> None:
        self._stop_waiting()
        self._leg = None
        if self._state == _ACTIVE:
            self._state = _PAUSED
            self._stop_cameras()
            self._release_gimbal()

    def disarmed(self) -> None:
        self._stop_waiting()
        self._leg = None
        if self._state == _ACTIVE:
            self._state = _COMPLETE
            self._stop_cameras()

    def set_current(self, seq: int) -> None:
        self._stop_waiting()
        self._keep_reported_seq()
        self._seq = seq
        if self._state == _ACTIVE:
            self._run()
        else:
            self._state = _NOT_STARTED

    def update(self) -> None:
        if self._state == _NOT_STARTED and self._host.armed and self._host.items:
            self._state = _ACTIVE
            self._run()
        if self._state != _ACTIVE or self._leg is None:
            return
        leg, had_arrived = self._leg, self._leg.arrived
        leg.update(self._host.scheduler.now_s, self._host.armed)
        if leg.item.command in (LAND, RETURN):
            # PX4 reports these items as reached above the landing place, before the descent.
            if leg.arrived and not had_arrived:
                self._host.reached(leg.item.seq)
        elif leg.done:
            self._host.reached(leg.item.seq)
            self._stale_seq = None
            self._seq = leg.item.seq + 1
            self._run()

    def _run(self) -> None:
        """Run DO items from the current item on, up to an item that is flown or that takes time."""
        self._leg = None
        items = self._host.items
        burst: list[MissionItem] = []
        jumps_left = 2 * len(items)
        while self._seq < len(items):
            item = items[self._seq]
            if item.command == JUMP and jumps_left:
                jumps_left -= 1
                self._keep_reported_seq()
                self._seq = self._jumps.take(item)
                continue
            if AUTOPILOTS["px4"].waits_for(item):
                self._issue(burst)
                self._start_leg(item)
                return
            burst.append(item)
            if item.command in _WAITING:
                self._issue(burst[:-1])
                self._issue([item], reached=False)
                self._host.flush()
                self._wait = self._host.scheduler.after(
                    max(_SHORTEST_WAIT_S, self._timeout_s()), self._waited
                )
                return
            self._seq += 1
        self._issue(burst)
        self._seq = max(0, len(items) - 1)
        self._state = _COMPLETE
        self._host.flight.hold()

    def _start_leg(self, item: MissionItem) -> None:
        if item.command == LAND:
            self._release_gimbal()
        self._begin_leg(item)

    def _waited(self) -> None:
        self._wait = None
        self._host.reached(self._seq)
        self._stale_seq = None
        self._seq += 1
        self._run()
        self._host.flush()

    def _issue(self, burst: Sequence[MissionItem], reached: bool = True) -> None:
        for item in burst:
            self._host.executed(item)
            self._pictures |= item.command == _START_PICTURES
            if reached:
                self._host.reached(item.seq)
        # PX4's queue between navigator and MAVLink keeps only the last `_QUEUE` commands.
        for item in burst[-_QUEUE:]:
            first = item.params[0]
            target = int(first) if item.command in _TO_PARAM1 and 0.0 <= first < 256.0 else 0
            self._sender.send(item.command, item.params, target)

    def _keep_reported_seq(self) -> None:
        if self._stale_seq is None and self._state == _ACTIVE:
            self._stale_seq = self._seq

    def _stop_waiting(self) -> None:
        if self._wait is not None:
            self._wait.cancel()
            self._wait = None

    def _release_gimbal(self) -> None:
        self._sender.send(_GIMBAL_CONTROL, (1.0, 1.0, -1.0, -1.0, 0.0, 0.0, 0.0))
        self._sender.send(_GIMBAL, (_NAN, _NAN, _NAN, _NAN, 2.0, 0.0, 0.0), repeat=False)
        self._sender.send(_GIMBAL_CONTROL, (-3.0, -3.0, -1.0, -1.0, 0.0, 0.0, 0.0), repeat=False)

    def _stop_cameras(self) -> None:
        self._sender.send(_STOP_CAMERA_TRIGGER, (-1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0))
        if self._pictures:
            self._pictures = False
            self._sender.send(_STOP_PICTURES, (0.0,) * 7, _CAMERA, repeat=False)


Runner = ArduPilotMission | Px4Mission
