"""Runs a mission like ArduCopter, including its quirks."""

from __future__ import annotations

from collections.abc import Callable

from flying_vines.simulation.autopilot.legs import Leg
from flying_vines.simulation.autopilot.runner import (
    ACTIVE,
    COMPLETE,
    NO_MISSION,
    NOT_STARTED,
    Host,
    MissionStatus,
)
from flying_vines.simulation.autopilot.scheduler import ScheduledCallback
from flying_vines.vehicle.mission.item import (
    CONDITION_DELAY,
    CONDITION_DISTANCE,
    CONDITION_YAW,
    DELAY,
    LAND,
    RETURN,
    MissionItem,
    is_nav,
)
from flying_vines.vehicle.mission.jumps import JUMP, Jumps

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


class ArduPilotMission:
    """Runs one navigation command and, in parallel, a queue of DO commands.

    When a navigation command ends, the next DO item and the next navigation command start in the same loop,
    the DO item first. The other DO items between the two navigation commands follow one by one, after the
    status text of the second navigation command. Item 0 is home and never runs.
    """

    def __init__(self, host: Host) -> None:
        self._host = host
        self._state = NOT_STARTED
        self._jumps = Jumps()
        self._nav_seq = 0
        self._leg: Leg | None = None
        self._queue: list[int] = []
        self._next_do: ScheduledCallback | None = None
        self._condition: Callable[[], bool] | None = None
        self._condition_seq = 0
        self._from_the_start = False

    def status(self, in_mission_mode: bool) -> MissionStatus:
        total = max(0, len(self._host.items) - 1)
        state = self._state if total else NO_MISSION
        return MissionStatus(self._nav_seq, total, state, int(in_mission_mode))

    def replaced(self) -> None:
        if self._state == COMPLETE:
            self._state = NOT_STARTED
            self._nav_seq = 0
        if self._nav_seq >= len(self._host.items):
            self._state = NOT_STARTED
            self._nav_seq = 0
            self._leg = None
            self._drop_dos()

    def enter(self) -> None:
        if self._from_the_start and len(self._host.items) > 1:
            # As recorded: after MISSION_SET_CURRENT to the first item, the mission starts twice.
            self._from_the_start = False
            self._start()
            self._start()
        elif self._state == NOT_STARTED and 0 < self._nav_seq < len(self._host.items):
            self._state = ACTIVE
            self._start_nav(self._nav_seq)
        elif self._state != ACTIVE:
            self._start()

    def leave(self) -> None:
        self._drop_dos()
        if self._state == ACTIVE:
            self._state = NOT_STARTED
            self._leg = None

    def disarmed(self) -> None:
        # After disarming, ArduPilot resets the mission and starts it again on the ground. A DO item at its
        # beginning then runs twice.
        first = self._host.items[1] if len(self._host.items) > 1 else None
        self._start()
        if first is not None and not is_nav(first.command) and first.command != JUMP:
            self._start()

    def set_current(self, seq: int) -> None:
        if self._state == ACTIVE:
            self._advance(seq)
            return
        self._from_the_start = seq <= 1
        items = self._host.items
        self._nav_seq = next((item.seq for item in items[seq:] if is_nav(item.command)), seq)
        self._state = NOT_STARTED

    def update(self) -> None:
        if self._state != ACTIVE or self._leg is None:
            return
        self._leg.update(self._host.scheduler.now_s, self._host.armed)
        if self._condition is not None and self._condition():
            self._end_condition()
        if self._leg.done:
            self._complete(self._leg.item)

    def _start(self) -> None:
        self._jumps = Jumps()
        self._state = ACTIVE
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
        self._state = COMPLETE
        self._leg = None
        self._host.flight.hold()

    def _start_nav(self, seq: int) -> None:
        item = self._host.items[seq]
        self._nav_seq = seq
        self._announce(item)
        if item.command == DELAY:
            self._host.text(f"Delaying {int(item.params[0])} sec")
        self._leg = Leg(self._host.flight, item, self._host.scheduler.now_s)

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
        ends_s = scheduler.now_s
        if item.command == CONDITION_DELAY:
            ends_s += item.params[0]
        elif item.command == CONDITION_YAW:
            ends_s += _YAW_S
        elif item.command != CONDITION_DISTANCE:
            return False
        within_m = item.params[0]
        self._condition_seq = item.seq
        if item.command == CONDITION_DISTANCE:
            self._condition = lambda: flight.distance_to_target_m() <= within_m
        else:
            self._condition = lambda: scheduler.now_s >= ends_s
        return True

    def _end_condition(self) -> None:
        self._condition = None
        self._host.reached(self._condition_seq)
        if self._queue:
            self._start_do(self._queue.pop(0), in_nav_loop=True)
            if self._condition is None:
                self._schedule_do()
