"""Runs a mission like PX4: DO items are sent as commands, most of them to all components."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from flying_vines.simulation.autopilot.legs import Leg
from flying_vines.simulation.autopilot.runner import (
    ACTIVE,
    COMPLETE,
    NO_MISSION,
    NOT_STARTED,
    PAUSED,
    Host,
    MissionStatus,
)
from flying_vines.simulation.autopilot.scheduler import ScheduledCallback, Scheduler
from flying_vines.vehicle.autopilots import AUTOPILOTS
from flying_vines.vehicle.mission.item import LAND, RETURN, MissionItem
from flying_vines.vehicle.mission.jumps import JUMP, Jumps

TOTAL_BEFORE_FIRST_UPLOAD = 65535

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


@dataclass(frozen=True, slots=True)
class CommandLong:
    """A COMMAND_LONG that PX4 itself sends."""

    command: int
    params: tuple[float, float, float, float, float, float, float]
    target_component: int = 0


@dataclass(slots=True)
class _Sent:
    """A sent command. Once acknowledged, it leaves the list when its next repeat would be due."""

    command: CommandLong
    acknowledged: bool = False


class CommandSender:
    """Sends commands and repeats them with rising confirmation until they are acknowledged.

    As recorded, the first repeat comes after 1 s and two more after 0.5 s each. An acknowledged command stays
    in the list until its next repeat would be due. An acknowledgement counts for the oldest command of its
    number in the list. So of two equal commands the second is repeated although it was acknowledged, and an
    acknowledgement may end the repeats of a lost command.
    """

    def __init__(self, scheduler: Scheduler, send: Callable[[CommandLong, int], None]) -> None:
        self._scheduler = scheduler
        self._send = send
        self._sent: list[_Sent] = []

    def send(self, command: CommandLong, repeat: bool = True) -> None:
        self._send(command, 0)
        if repeat:
            sent = _Sent(command)
            self._sent.append(sent)
            self._wait(sent, 1)

    def acknowledged(self, command: int) -> None:
        for sent in self._sent:
            if sent.command.command == command:
                sent.acknowledged = True
                return

    def _wait(self, sent: _Sent, confirmation: int) -> None:
        def again() -> None:
            if not sent.acknowledged and confirmation <= len(_RETRIES_S):
                self._send(sent.command, confirmation)
                self._wait(sent, confirmation + 1)
            else:
                self._sent.remove(sent)

        self._scheduler.after((*_RETRIES_S, _FORGOTTEN_S)[confirmation - 1], again)


class Px4Mission:
    """Runs all items, including DO items, one after the other.

    Commands 211 (gripper) and 42600 (winch) stop the mission for `command_timeout_s` (MIS_COMMAND_TOUT), even
    if they are acknowledged. Other DO items end at once, so of several DO items in a row only the last one
    is reported as reached.
    """

    def __init__(self, host: Host, sender: CommandSender, command_timeout_s: Callable[[], float]) -> None:
        self._host = host
        self._sender = sender
        self._timeout_s = command_timeout_s
        self._state = NOT_STARTED
        self._seq = 0
        self._stale_seq: int | None = None
        self._jumps = Jumps()
        self._leg: Leg | None = None
        self._wait: ScheduledCallback | None = None
        self._uploaded = bool(host.items)
        self._pictures = False

    def status(self, in_mission_mode: bool) -> MissionStatus:
        total = len(self._host.items)
        if not total and not self._uploaded:
            total = TOTAL_BEFORE_FIRST_UPLOAD
        state = self._state if self._host.items else NO_MISSION
        mode = _SUBMODE_IN_MISSION if in_mission_mode else _SUBMODE_SUSPENDED
        # After a jump or a change of the current item, PX4 reports the old item until an item is reached.
        seq = self._seq if self._stale_seq is None else self._stale_seq
        return MissionStatus(seq, total, state, mode)

    def replaced(self) -> None:
        self._uploaded = True
        self._stop_waiting()
        self._state, self._seq, self._leg = NOT_STARTED, 0, None
        self._stale_seq = None
        self._jumps = Jumps()

    def enter(self) -> None:
        if self._state == COMPLETE:
            self._state, self._seq = NOT_STARTED, 0
        if self._state == PAUSED:
            self._state = NOT_STARTED
        self.update()

    def leave(self) -> None:
        self._stop_waiting()
        self._leg = None
        if self._state == ACTIVE:
            self._state = PAUSED
            self._stop_cameras()
            self._release_gimbal()

    def disarmed(self) -> None:
        self._stop_waiting()
        self._leg = None
        if self._state == ACTIVE:
            self._state = COMPLETE
            self._stop_cameras()

    def set_current(self, seq: int) -> None:
        self._stop_waiting()
        self._keep_reported_seq()
        self._seq = seq
        if self._state == ACTIVE:
            self._run()
        else:
            self._state = NOT_STARTED

    def update(self) -> None:
        if self._state == NOT_STARTED and self._host.armed and self._host.items:
            self._state = ACTIVE
            self._run()
        if self._state != ACTIVE or self._leg is None:
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
        self._state = COMPLETE
        self._host.flight.hold()

    def _start_leg(self, item: MissionItem) -> None:
        if item.command == LAND:
            self._release_gimbal()
        self._leg = Leg(self._host.flight, item, self._host.scheduler.now_s)

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
            self._sender.send(CommandLong(item.command, item.params, target))

    def _keep_reported_seq(self) -> None:
        if self._stale_seq is None and self._state == ACTIVE:
            self._stale_seq = self._seq

    def _stop_waiting(self) -> None:
        if self._wait is not None:
            self._wait.cancel()
            self._wait = None

    def _release_gimbal(self) -> None:
        self._sender.send(CommandLong(_GIMBAL_CONTROL, (1.0, 1.0, -1.0, -1.0, 0.0, 0.0, 0.0)))
        self._sender.send(CommandLong(_GIMBAL, (_NAN, _NAN, _NAN, _NAN, 2.0, 0.0, 0.0)), repeat=False)
        self._sender.send(CommandLong(_GIMBAL_CONTROL, (-3.0, -3.0, -1.0, -1.0, 0.0, 0.0, 0.0)), repeat=False)

    def _stop_cameras(self) -> None:
        self._sender.send(CommandLong(_STOP_CAMERA_TRIGGER, (-1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0)))
        if self._pictures:
            self._pictures = False
            self._sender.send(CommandLong(_STOP_PICTURES, (0.0,) * 7, _CAMERA), repeat=False)
