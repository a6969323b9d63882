"""A core that turns every unexpected error into a commanded shutdown; the process continues.

After an error the vine is vented and bends are refused, until a person restarts the service. Heartbeat and
named values continue as far as possible. This class does no I/O, and it works with a broken core.
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
    Tick,
    ToFirmware,
    ToVehicle,
)
from flying_vines.core.safety import INTERNAL_ERROR
from flying_vines.core.snapshot import Snapshot
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.notice import Notice, Severity
from flying_vines.vine.intent import VentVine as VentIntent

SHUTDOWN_TEXT = f"Vine: {INTERNAL_ERROR}, vented"
"""The text to the pilot. It is sent once, and again when the vehicle's link comes back."""
SENT_WITHIN_S = 0.5
"""If the core has not sent the text within this time, this class sends it."""
HEARTBEAT_WITHIN_S = 1.2
MAX_LOGGED = 20
"""At most this many errors are logged, one for each place in the code."""


class CrashSafeCore:
    """A core whose `handle` and `snapshot` never raise.

    `display_failed` is called with the error of a snapshot. Such an error does not vent the vine.
    """

    def __init__(self, core: Core, display_failed: Callable[[Exception], None] = lambda error: None) -> None:
        self._core = core
        self._display_failed = display_failed
        self._down = False
        """The shutdown began."""
        self._noticed = False
        """The local screen shows the text."""
        self._sent = False
        """The text went out over MAVLink."""
        self._send_at = math.inf
        self._heartbeat_at = -math.inf
        self._number = 0
        """Sequence number of the latest command to the firmware."""
        self._system_id = core.config.vehicle.system_id or 1
        self._actuator = core.config.firmware.name
        self._seen: set[str] = set()
        """The places in the code that raised an error. Each is logged once."""

    @property
    def config(self) -> Config:
        """The configuration with the parameters that are in force."""
        return self._core.config

    def handle(self, event: Event) -> list[Action]:
        """The actions that follow from `event`."""
        actions = self._attempt(event)
        for action in actions:
            self._note(event.t, action)
        if self._core.internal_error and not self._down:
            self._down, self._send_at = True, event.t + SENT_WITHIN_S
            # The core may have sent the same notice; `_while_down` drops the duplicate.
            actions.append(Notice(event.t, Severity.WARNING, SHUTDOWN_TEXT))
            return self._while_down(event, actions, at_once=True)
        return self._while_down(event, actions) if self._down else actions

    def snapshot(self, t: float) -> Snapshot:
        """The state for displays. If the core fails, almost all fields are unknown."""
        try:
            return self._core.snapshot(t)
        except Exception as error:
            self._display_failed(error)
            return _blank(t, self._actuator, self._down)

    def _attempt(self, event: Event) -> list[Action]:
        try:
            return self._core.handle(event)
        except Exception as error:
            # Keep the actions made before the error, except commands to the firmware.
            actions = self._decided()
            actions.extend(self._shut_down(event.t, error))
            if isinstance(event, Tick):
                actions.extend(self._reported(event.t))
            return actions

    def _shut_down(self, t: float, error: Exception) -> list[Action]:
        place = repr((type(error), traceback.extract_tb(error.__traceback__)[-1]))
        is_new = place not in self._seen and len(self._seen) < MAX_LOGGED
        if is_new:
            self._seen.add(place)
        elif self._core.internal_error:
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

    def _note(self, t: float, action: Action) -> None:
        match action:
            case ToVehicle(message, system_id):
                self._system_id = system_id
                if message.get_msgId() == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                    self._heartbeat_at = t
            case ToFirmware(Vent(number)) | ToFirmware(Setpoint(number=number)):
                self._number = number

    def _while_down(self, event: Event, actions: list[Action], at_once: bool = False) -> list[Action]:
        """Remove setpoints and duplicate texts. Add vent, heartbeat and text if they are missing."""
        t = event.t
        if isinstance(event, LinkChanged) and event.link == "vehicle" and event.up:
            # A text that was sent while the link was down is lost: send it again.
            self._sent, self._send_at = False, t + SENT_WITHIN_S
        allowed: list[Action] = []
        for action in actions:
            match action:
                case ToFirmware(Setpoint()):
                    continue
                case Notice(text=text) if text == SHUTDOWN_TEXT:
                    if self._noticed:
                        continue
                    self._noticed = True
                case ToVehicle(message) if _is_shutdown_text(message):
                    if self._sent:
                        continue
                    self._sent = True
            allowed.append(action)
        if at_once or isinstance(event, Tick):
            if self._number and not any(_vents(action) for action in allowed):
                allowed.insert(0, ToFirmware(Vent(self._number % 0xFFFF + 1)))
            allowed.extend(ToVehicle(message, self._system_id) for message in self._send_missing(t))
        if isinstance(event, Asked):
            allowed.extend(_answer(event, allowed))
        return allowed

    def _send_missing(self, t: float) -> Iterator[MavlinkMessage]:
        """The heartbeat and the text, if the core has not sent them."""
        if t - self._heartbeat_at > HEARTBEAT_WITHIN_S:
            self._heartbeat_at = t
            yield mavlink.MAVLink_heartbeat_message(
                *(mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID),
                *(0, 0, mavlink.MAV_STATE_CRITICAL, 3),
            )
        if not self._sent and t >= self._send_at:
            self._sent = True
            yield mavlink.MAVLink_statustext_message(Severity.WARNING, SHUTDOWN_TEXT.encode("ascii"), 0, 0)


def _vents(action: Action) -> bool:
    return isinstance(action, ToFirmware) and isinstance(action.message, Vent)


def _is_shutdown_text(message: MavlinkMessage) -> bool:
    if message.get_msgId() != mavlink.MAVLINK_MSG_ID_STATUSTEXT:
        return False
    text = message.text if isinstance(message.text, bytes) else message.text.encode("ascii", "replace")
    return text.rstrip(b"\0") == SHUTDOWN_TEXT.encode("ascii")


def _answer(asked: Asked, actions: Sequence[Action]) -> Iterator[Decision]:
    """The decision on a request that the core has not answered."""
    if any(isinstance(action, Decision) and action.trigger == asked.by for action in actions):
        return
    vents = isinstance(asked.intent, VentIntent)
    verdict: Literal["accepted", "refused"] = "accepted" if vents else "refused"
    yield Decision(asked.t, asked.by, {}, str(asked.intent), verdict, INTERNAL_ERROR, 0.0)


def _blank(t: float, actuator: str, down: bool) -> Snapshot:
    unknown = math.nan
    return Snapshot(
        t=t,
        vehicle="unknown",
        mode="",
        armed=False,
        altitude_m=unknown,
        rc="unknown",
        switch_position=None,
        actuator=actuator,
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
