"""The core, whose every unexpected error is a commanded shutdown and not the end of the process.

After one the vine is vented, bends are refused, and heartbeat and values go on as far as they can, until a
person restarts the service. Pure, as the core is: what is done here needs nothing that the core must still
be able to do.
"""

from __future__ import annotations

import math
import traceback
from collections.abc import Callable, Iterator, Sequence
from typing import Literal

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from firmware_link.protocol import Setpoint, Vent
from flying_vines.config.config import Config
from flying_vines.core.core import Core
from flying_vines.core.events import (
    Action,
    Asked,
    Decision,
    Event,
    Failed,
    InternalError,
    LinkChanged,
    Snapshot,
    Tick,
    ToFirmware,
    ToVehicle,
)
from flying_vines.core.safety import INTERNAL_ERROR
from flying_vines.vehicle.mavlink.codec import Message
from flying_vines.vehicle.notice import Notice, Severity
from flying_vines.vine.intent import Vent as VentIntent

TOLD = f"Vine: {INTERNAL_ERROR}, vented"
"""What the pilot reads of it, once."""
TOLD_WITHIN_S = 0.5
"""What the core has not told by then is told past it."""
HEARTBEAT_WITHIN_S = 1.2
MOST_LOGGED = 20
"""Errors, each from another place."""


class Contained:
    """A core whose `handle` and `snapshot` never raise.

    `display_failed` is called with the error of a snapshot, which is no reason to vent.
    """

    def __init__(self, core: Core, display_failed: Callable[[Exception], None] = lambda error: None) -> None:
        self._core = core
        self._display_failed = display_failed
        self._down_at: float | None = None
        """When the shutdown began."""
        self._noticed = self._told = False
        """On the screen here, and by a text to the pilot."""
        self._tell_at = math.inf
        self._heartbeat_at = -math.inf
        self._number = 0
        """Of the latest command to the firmware."""
        self._system_id = core.config.vehicle.system_id or 1
        self._seen: set[str] = set()

    @property
    def config(self) -> Config:
        """The profile with the parameters that are in force."""
        return self._core.config

    def handle(self, event: Event) -> list[Action]:
        """What is to be done about `event`."""
        actions = self._attempt(event)
        for action in actions:
            self._note(event.t, action)
        if self._core.internal_error and self._down_at is None:
            self._down_at, self._tell_at = event.t, event.t + TOLD_WITHIN_S
            # Where the core said it itself, one of the two is dropped.
            actions.append(Notice(event.t, Severity.WARNING, TOLD))
            return self._while_down(event, actions, at_once=True)
        return actions if self._down_at is None else self._while_down(event, actions)

    def snapshot(self, t: float) -> Snapshot:
        """What a display shows; next to nothing where the core cannot say."""
        try:
            return self._core.snapshot(t)
        except Exception as error:
            self._display_failed(error)
            return _blank(t, self._down_at is not None)

    def _attempt(self, event: Event) -> list[Action]:
        try:
            return self._core.handle(event)
        except Exception as error:
            # What was decided before the error holds, but for what moves the vine.
            actions = self._decided()
            actions.extend(self._shut_down(event.t, error))
            if isinstance(event, Tick):
                actions.extend(self._reported(event.t))
            return actions

    def _shut_down(self, t: float, error: Exception) -> list[Action]:
        if not self._is_new(error) and self._core.internal_error:
            return []
        failed = Failed.by(t, "core", error, needed=True)
        try:
            return self._core.handle(failed)
        except Exception:
            self._core.internal_error = True
            rest, logged = self._decided(), InternalError(t, failed.part, failed.trace)
            return rest if logged in rest else [*rest, logged]

    def _decided(self) -> list[Action]:
        return [action for action in self._core.decided if not isinstance(action, ToFirmware)]

    def _reported(self, t: float) -> list[Action]:
        try:
            return self._core.report(t)
        except Exception:
            return []

    def _is_new(self, error: Exception) -> bool:
        """Whether an error comes from a place that none came from before: each is logged once."""
        place = repr((type(error), traceback.extract_tb(error.__traceback__)[-1]))
        if place in self._seen or len(self._seen) >= MOST_LOGGED:
            return False
        self._seen.add(place)
        return True

    def _note(self, t: float, action: Action) -> None:
        match action:
            case ToVehicle(message, system_id):
                self._system_id = system_id
                if message.get_msgId() == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                    self._heartbeat_at = t
            case ToFirmware(Vent(number)) | ToFirmware(Setpoint(number=number)):
                self._number = number

    def _while_down(self, event: Event, actions: list[Action], at_once: bool = False) -> list[Action]:
        """The actions without any that bends the vine or tells again, and with those that are missing."""
        t = event.t
        if isinstance(event, LinkChanged) and event.link == "vehicle" and event.up:
            # What was told while it was down nobody has read.
            self._told, self._tell_at = False, t + TOLD_WITHIN_S
        kept = [action for action in actions if not self._must_not(action)]
        if at_once or isinstance(event, Tick):
            if self._number and not any(_vents(action) for action in kept):
                kept.insert(0, ToFirmware(Vent(self._number % 0xFFFF + 1)))
            kept.extend(ToVehicle(message, self._system_id) for message in self._missing(t))
        if isinstance(event, Asked):
            kept.extend(_answer(event, kept))
        return kept

    def _must_not(self, action: Action) -> bool:
        match action:
            case ToFirmware(Setpoint()):
                return True
            case Notice(text=text) if text == TOLD:
                before, self._noticed = self._noticed, True
                return before
            case ToVehicle(message) if _tells(message):
                before, self._told = self._told, True
                return before
        return False

    def _missing(self, t: float) -> Iterator[Message]:
        """Text and heartbeat, where the core has not sent them."""
        if t - self._heartbeat_at > HEARTBEAT_WITHIN_S:
            self._heartbeat_at = t
            yield mavlink.MAVLink_heartbeat_message(
                *(mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID),
                *(0, 0, mavlink.MAV_STATE_CRITICAL, 3),
            )
        if not self._told and t >= self._tell_at:
            self._told = True
            yield mavlink.MAVLink_statustext_message(Severity.WARNING, TOLD.encode("ascii"), 0, 0)


def _vents(action: Action) -> bool:
    return isinstance(action, ToFirmware) and isinstance(action.message, Vent)


def _tells(message: Message) -> bool:
    if message.get_msgId() != mavlink.MAVLINK_MSG_ID_STATUSTEXT:
        return False
    text = message.text if isinstance(message.text, bytes) else message.text.encode("ascii", "replace")
    return text.rstrip(b"\0") == TOLD.encode("ascii")


def _answer(asked: Asked, actions: Sequence[Action]) -> Iterator[Decision]:
    """Whoever asks is answered, whatever has failed."""
    if any(isinstance(action, Decision) and action.trigger == asked.by for action in actions):
        return
    vents = isinstance(asked.intent, VentIntent)
    verdict: Literal["accepted", "refused"] = "accepted" if vents else "refused"
    yield Decision(asked.t, asked.by, {}, str(asked.intent), verdict, INTERNAL_ERROR, 0.0)


def _blank(t: float, down: bool) -> Snapshot:
    unknown = math.nan
    return Snapshot(
        t=t,
        vehicle="unknown",
        mode="",
        armed=False,
        altitude_m=unknown,
        rc="unknown",
        switch_position=None,
        firmware="unknown",
        round_trip_s=None,
        telemetry_gaps=0,
        reservoir_kPa=unknown,
        cv_kPa=unknown,
        command_kPa=unknown,
        bend_deg=unknown,
        evp_opening=unknown,
        dvp_opening=unknown,
        solenoid=None,
        cycles=None,
        doing="display failed",
        safe_state={"internal_error": INTERNAL_ERROR} if down else {},
    )
