"""Periodic messages on a link: requested ones, and those that an autopilot sends by default."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.simulation.autopilot import sensors, telemetry
from flying_vines.simulation.autopilot.port import COMPANION, Port, PortStream
from flying_vines.simulation.autopilot.scheduler import Scheduler
from flying_vines.simulation.autopilot.snapshot import AutopilotSnapshot
from flying_vines.vehicle.mission.storage import AutopilotKind

_NAMED_VALUE_FLOAT = 251
_NAME_BYTES = 9
_TIMESYNC_S = 10.0

# Default rates of PX4: on the companion's link as recorded, on other links those of PX4's "normal" mode.
_ONBOARD_HZ = {telemetry.ATTITUDE: 98.0, telemetry.MISSION_CURRENT: 1.0, _NAMED_VALUE_FLOAT: 10.0}
_NORMAL_HZ = {
    telemetry.ATTITUDE: 15.0,
    telemetry.GLOBAL_POSITION_INT: 5.0,
    telemetry.RC_CHANNELS: 5.0,
    telemetry.VFR_HUD: 4.0,
    telemetry.SYS_STATUS: 1.0,
    telemetry.EXTENDED_SYS_STATE: 1.0,
    telemetry.MISSION_CURRENT: 1.0,
    telemetry.HOME_POSITION: 0.5,
    sensors.GPS_RAW_INT: 1.0,
    sensors.BATTERY_STATUS: 0.5,
    _NAMED_VALUE_FLOAT: 1.0,
}


class StreamSender:
    """Sends telemetry. A port that has received nothing yet gets only heartbeats and TIMESYNC."""

    def __init__(
        self,
        kind: AutopilotKind,
        scheduler: Scheduler,
        snapshot: Callable[[], AutopilotSnapshot],
        send: Callable[[Port, Any], None],
    ) -> None:
        self._kind = kind
        self._scheduler = scheduler
        self._snapshot = snapshot
        self._send = send
        self._named_value: Any = None
        self._named_values = 0

    def reboot(self) -> None:
        self._named_value = None

    def begin(self, port: Port) -> None:
        """Start the messages that a port sends from boot on."""
        self.every(port, telemetry.HEARTBEAT, 1.0, first_s=0.0)
        if self._kind == "ardupilot":
            first_s = max(0.0, _TIMESYNC_S - self._snapshot().boot_s)
            self.every(port, telemetry.TIMESYNC, _TIMESYNC_S, first_s)

    def activate(self, port: Port) -> None:
        """The port has received a message. On PX4 the first message starts the port's default streams."""
        if port.active:
            return
        port.active = True
        if self._kind == "px4":
            for message_id, rate_hz in (_ONBOARD_HZ if port.name == COMPANION else _NORMAL_HZ).items():
                self.every(port, message_id, 1 / rate_hz)

    def every(self, port: Port, message_id: int, interval_s: float, first_s: float | None = None) -> None:
        """Send a message every `interval_s` from now on; 0 stops it."""
        stream = port.streams.pop(message_id, None)
        if stream is not None:
            stream.entry.cancel()
        if interval_s <= 0.0:
            return

        begin_s = self._scheduler.now_s + (interval_s if first_s is None else first_s)
        self._schedule(port, message_id, interval_s, begin_s, 0)

    def _schedule(self, port: Port, message_id: int, interval_s: float, begin_s: float, count: int) -> None:
        # Computed from a count, so that rounding errors do not add up.
        t_s = begin_s + count * interval_s
        entry = self._scheduler.at(t_s, partial(self._repeat, port, message_id, interval_s, begin_s, count))
        port.streams[message_id] = PortStream(interval_s, entry)

    def _repeat(self, port: Port, message_id: int, interval_s: float, begin_s: float, count: int) -> None:
        self._schedule(port, message_id, interval_s, begin_s, count + 1)
        self.once(port, message_id)

    def once(self, port: Port, message_id: int) -> None:
        """Send a message now, if it has content."""
        if not port.active and message_id not in (telemetry.HEARTBEAT, telemetry.TIMESYNC):
            return
        if message_id == _NAMED_VALUE_FLOAT:
            self._echo(port)
            return
        now = self._snapshot()
        if message_id == telemetry.RC_CHANNELS and self._kind == "px4" and now.receiver.overridden:
            if port.rc_updates == now.receiver.updates:
                return
            port.rc_updates = now.receiver.updates
        message = telemetry.telemetry(message_id, now)
        if message is not None:
            self._send(port, message)

    def take_value(self, message: Any) -> None:
        """Take a received NAMED_VALUE_FLOAT. PX4 streams the latest one as its own, with a shorter name."""
        self._named_value = message
        self._named_values += 1

    def _echo(self, port: Port) -> None:
        value = self._named_value
        if value is not None and port.echoed != self._named_values:
            port.echoed = self._named_values
            name = value.name.encode()[:_NAME_BYTES]
            boot_ms = self._snapshot().boot_ms
            self._send(port, mavlink.MAVLink_named_value_float_message(boot_ms, name, value.value))
