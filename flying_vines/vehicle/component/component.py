"""Our MAVLink component on the vehicle: heartbeat, values, texts, parameters and answers."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config.config import Config
from flying_vines.vehicle.component.parameters import ParameterOutput, Parameters
from flying_vines.vehicle.component.requests import Requests
from flying_vines.vehicle.component.senders import Sender, Senders
from flying_vines.vehicle.component.telemetry import Heartbeat, NamedValues
from flying_vines.vehicle.component.texts import Texts
from flying_vines.vehicle.component.transmit_queue import TransmitQueue
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.notice import Notice, Severity
from flying_vines.vehicle.state import VehicleState


class Component:
    """Sans-IO; all times are seconds of one clock.

    `values` are the saved parameters that differ from the configuration. All messages to the vehicle wait in
    one queue: `due` and `leaving` return those that may leave.
    """

    def __init__(self, config: Config, values: Mapping[str, float] | None = None) -> None:
        self.parameters = Parameters(config, values)
        self._component_id = config.vehicle.component_id
        self._heartbeat = Heartbeat()
        self._values = NamedValues(1.0 / self.parameters.config.telemetry.rate_Hz)
        self._texts = Texts()
        self._requests = Requests(self._component_id, self._heartbeat, self._values)
        self._key_reported = bool(config.vehicle.signing_key)
        self._duplicate_id = DuplicateIdDetector(self._component_id)
        self._senders = Senders()
        self._queue = TransmitQueue()

    @property
    def dropped(self) -> int:
        """Messages that were dropped because the queue was full."""
        return self._queue.dropped

    def handle(
        self, t: float, message: MavlinkMessage, vehicle: VehicleState, may_change: bool
    ) -> list[ParameterOutput] | None:
        """Answer a message of any sender. None: the message is not ours to answer.

        Args:
            t: now.
            message: as received.
            vehicle: our vehicle, which has already handled the message.
            may_change: the vine is vented, so parameters that affect the vine's motion may change.
        """
        if not vehicle.found:
            return None
        number = message.get_msgId()
        sender = self.sender(message, vehicle)
        if number == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            if sender.is_autopilot:
                self._heartbeat.autopilot_spoke(t)
            else:
                self._senders.handle(t, message, vehicle.autopilot.hides_our_parameters)
            return None
        if number in Requests.MESSAGES:
            return self._requests.handle(t, message, vehicle.system_id, sender)
        if number == mavlink.MAVLINK_MSG_ID_SETUP_SIGNING:
            return self._report_ignored_key(t, message, vehicle.system_id)
        if number in Parameters.MESSAGES:
            us = (vehicle.system_id, self._component_id)
            return self.parameters.handle(t, message, us, sender, may_change)
        return None

    def is_duplicate(self, message: MavlinkMessage, vehicle: VehicleState) -> bool:
        """True if another program sends with our ids. The codec has dropped the echoes of our messages."""
        us = (vehicle.system_id, self._component_id)
        return vehicle.found and (message.get_srcSystem(), message.get_srcComponent()) == us

    def note_duplicate(self, t: float) -> list[Notice]:
        """Note any message of it: ArduPilot forwards its values and texts to us, but no HEARTBEAT."""
        return self._duplicate_id.received(t)

    def sender(self, message: MavlinkMessage, vehicle: VehicleState) -> Sender:
        """The sender of a message, and what it may do."""
        return self._senders.of(message, vehicle)

    def _report_ignored_key(self, t: float, message: MavlinkMessage, system_id: int) -> list[ParameterOutput]:
        """Report once that we ignore a signing key that is sent to the vehicle."""
        if self._key_reported or message.target_system not in (0, system_id):
            return []
        self._key_reported = True
        return [Notice(t, Severity.NOTICE, "Vine: SETUP_SIGNING ignored: no key configured")]

    def greet(self) -> None:
        """Send a heartbeat at once: the autopilot does not know us yet."""
        self._heartbeat.now()

    def say(self, notice: Notice) -> None:
        self._texts.say(notice)

    def send(self, message: MavlinkMessage) -> None:
        self._queue.put(message)

    def wants_values(self, t: float) -> bool:
        """False if `due` sends no named value at time `t`, whatever the values are."""
        return self._values.may_send(t)

    def due(
        self, t: float, time_boot_ms: int, values: Mapping[str, float], system_status: int
    ) -> list[MavlinkMessage]:
        """The messages that leave at time `t`. `values` are the present named values; NaN is not sent."""
        config = self.parameters.config
        self._values.usual_s = 1.0 / config.telemetry.rate_Hz
        if self._senders.due(t) and not self.parameters.showing:
            self.parameters.show()
        due = [
            *self._heartbeat.due(t, system_status),
            *self._texts.due(t),
            *self.parameters.due(t),
            *self._values.due(t, time_boot_ms, values),
        ]
        for message in due:
            self._queue.put(message)
        return self._queue.due(t)

    def leaving(self, t: float) -> list[MavlinkMessage]:
        """The queued messages that may leave now."""
        return self._queue.due(t)


MIN_MESSAGES = 2
WITHIN_S = 5.0
REPORT_AGAIN_S = 60.0


class DuplicateIdDetector:
    """Detects another program with our system and component id: their messages repeat.

    Ground stations and autopilots cannot distinguish the two programs, and send commands to both. 191 is the
    usual component id of companion computers. (If a router sends our own frames back, the codec drops them.)
    """

    def __init__(self, component_id: int) -> None:
        self._component_id = component_id
        self._received_at: deque[float] = deque(maxlen=MIN_MESSAGES)
        self._reported_at = -math.inf

    def received(self, t: float) -> list[Notice]:
        """A message from our own address that we did not send."""
        self._received_at.append(t)
        if len(self._received_at) < MIN_MESSAGES or t - self._received_at[0] > WITHIN_S:
            return []
        if t - self._reported_at < REPORT_AGAIN_S:
            return []
        self._reported_at = t
        text = f"Vine: another program has component id {self._component_id}: set vehicle.component_id"
        return [Notice(t, Severity.ERROR, text)]
