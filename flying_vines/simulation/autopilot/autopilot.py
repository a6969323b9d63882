"""The simulated autopilot: bytes in, frames out, stimuli by methods."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.simulation.autopilot import telemetry
from flying_vines.simulation.autopilot.copter import MAX_LOGGED, Copter
from flying_vines.simulation.autopilot.flight import FlightMode, mode_named, mode_numbered
from flying_vines.simulation.autopilot.links import Port
from flying_vines.simulation.autopilot.parameters import answer_file_request
from flying_vines.vehicle.mission import item as mission_item
from flying_vines.vehicle.mission.item import AutopilotKind

_NO_SPACE_S = 0.5
_FASTEST_STREAM_S = 0.0025
_FASTEST_GROUP_HZ = 50
_ACCEPTED, _DENIED, _UNSUPPORTED, _FAILED = 0, 2, 3, 4
"""MAV_RESULT."""
_CUSTOM_MODE_FLAG = 1
_PAYLOAD: dict[AutopilotKind, frozenset[int]] = {
    "ardupilot": frozenset({178, 181, 182, 183, 184, 203, 206, 211, 218, 42600}),
    "px4": frozenset({178, 187, 203, 206, 211, 2000, 2001, 2003}),
}
"""Payload commands that the autopilot carries out itself: servos, relays, grippers, cameras."""


class FakeAutopilot(Copter):
    """A simulated ArduCopter or PX4 copter, seen from a companion computer and a ground station.

    Sans-IO: pass received bytes to `receive`, call `advance`, and send the frames that it returns. Times are
    seconds of any monotonic clock; the first time is the start. Stimuli (`arm`, `set_rc`, …) act at the
    latest time so far, or at the start.

    At the start the vehicle has been up for 30 s, so its boot is visible only after `reboot`.
    """

    def receive(self, t: float, link: str, data: bytes) -> None:
        """Bytes that arrived on `link` at `t`. Never raises, for any bytes."""
        self._run_to(t)
        if not self._links.delays(link, data):
            self._receive(link, data)

    def _receive(self, link: str, data: bytes) -> None:
        if not self._links.hears:
            return
        port = self.add_link(link)
        for message in self._links.decode(port, data):
            self._streams.activate(port)
            if self._links.route(port, message):
                self._handle(port, message)
            self.flush()
            if not self._links.up:
                return

    def advance(self, t: float) -> list[tuple[str, bytes]]:
        """Advance to `t`. Returns the frames sent since the last call as (link, frame), in order."""
        self._run_to(t)
        for link, data in self._links.end_stalls():
            self._receive(link, data)
        return self._links.take()

    def _run_to(self, t: float) -> None:
        if self._epoch_s is None:
            self._epoch_s = t
        self.scheduler.run_until(t - self._epoch_s)

    # Receiving

    def _handle(self, port: Port, message: Any) -> None:
        kind = message.get_type()
        if kind in ("COMMAND_LONG", "COMMAND_INT"):
            self._command(port, message)
        elif kind == "COMMAND_ACK":
            self._sender.acknowledged(message.command)
        elif kind == "MISSION_SET_CURRENT":
            if message.seq < len(self.items):
                self._runner.set_current(message.seq)
                self._streams.once(port, telemetry.MISSION_CURRENT)
        elif kind.startswith("MISSION_"):
            has_space = self.scheduler.now_s - self._ready_s >= _NO_SPACE_S
            self._storage.handle(port.name, message, has_space)
        elif kind.startswith("PARAM_"):
            self.parameters.handle(port.name, message)
        elif kind == "RC_CHANNELS_OVERRIDE":
            if self.kind == "px4" or message.get_srcSystem() == self.parameters["SYSID_MYGCS"]:
                self.rc.override([getattr(message, f"chan{channel}_raw") for channel in range(1, 19)])
        elif kind == "NAMED_VALUE_FLOAT" and self.kind == "px4":
            self._streams.take_value(message)
        elif kind == "FILE_TRANSFER_PROTOCOL":
            reply = answer_file_request(message)
            if reply is not None:
                self._links.send(port, reply)
        elif kind == "PING" and self.kind == "px4" and not message.target_system:
            to = message.get_srcSystem(), message.get_srcComponent()
            self._links.send(port, mavlink.MAVLink_ping_message(message.time_usec, message.seq, *to))
        elif kind == "SET_MODE":
            mode = mode_numbered(self.kind, message.custom_mode)
            if mode is not None:
                self._select(mode)
        elif kind == "REQUEST_DATA_STREAM" and self.kind == "ardupilot":
            rate_hz = min(message.req_message_rate, _FASTEST_GROUP_HZ)
            on = bool(message.start_stop and rate_hz)
            for message_id in telemetry.stream_group(message.req_stream_id):
                self._streams.every(port, message_id, 1.0 / rate_hz if on else 0.0)
        elif kind == "TIMESYNC" and message.tc1 == 0:
            own_ns = int((self.scheduler.now_s - self._boot_s) * 1e9)
            self._links.send(port, mavlink.MAVLink_timesync_message(own_ns, message.ts1))

    def _command(self, port: Port, message: Any) -> None:
        params = _params_of(message)
        result = self._carry_out(port, message.command, params)
        target = message.get_srcSystem(), message.get_srcComponent()
        self._links.send(port, mavlink.MAVLink_command_ack_message(message.command, result, 0, 0, *target))
        if result == _ACCEPTED:
            self._answer(port, message.command, params)
        if message.command == mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN and result == _ACCEPTED:
            self.reboot()

    def _answer(self, port: Port, command: int, params: tuple[float, ...]) -> None:
        """Send the requested message after the acknowledgement."""
        match command:
            case mavlink.MAV_CMD_REQUEST_MESSAGE:
                self._streams.once(port, _whole(params[0]))
            case mavlink.MAV_CMD_GET_HOME_POSITION:
                self._streams.once(port, telemetry.HOME_POSITION)
            case mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
                self._streams.once(port, telemetry.AUTOPILOT_VERSION)
            case mavlink.MAV_CMD_GET_MESSAGE_INTERVAL:
                message_id = _whole(params[0])
                stream = port.streams.get(message_id)
                interval_us = round(stream.interval_s * 1e6) if stream else -1
                self._links.send(port, mavlink.MAVLink_message_interval_message(message_id, interval_us))

    def _carry_out(self, port: Port, command: int, params: tuple[float, ...]) -> int:
        match command:
            case mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                return self._set_interval(port, _whole(params[0]), params[1])
            case mavlink.MAV_CMD_GET_HOME_POSITION | mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
                return _ACCEPTED
            case mavlink.MAV_CMD_REQUEST_MESSAGE | mavlink.MAV_CMD_GET_MESSAGE_INTERVAL:
                known = telemetry.streamable(_whole(params[0]))
                return _ACCEPTED if known else _FAILED
            case mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
                if params[0] == 1.0:
                    self.arm()
                else:
                    self.disarm()
                return _ACCEPTED
            case mavlink.MAV_CMD_DO_SET_MODE:
                mode = self._requested_mode(params)
                return _result(mode is not None and self._select(mode))
            case mission_item.TAKEOFF:
                return _result(self._guided_take_off(params[6]))
            case mission_item.LAND:
                return _result(self._select(mode_named(self.kind, "LAND")))
            case mission_item.RETURN:
                return _result(self._select(mode_named(self.kind, "RTL")))
            case mavlink.MAV_CMD_MISSION_START:
                return _result(self._select(self._mission_mode))
            case mavlink.MAV_CMD_DO_SET_MISSION_CURRENT:
                seq = _whole(params[0])
                if not 0 <= seq < len(self.items):
                    return _DENIED
                self._runner.set_current(seq)
                return _ACCEPTED
            case mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN:
                return _ACCEPTED if params[0] == 1.0 and not self.armed else _DENIED
            case _ if command in _PAYLOAD[self.kind]:
                self.performed.append((self.now_s, command))
                del self.performed[:-MAX_LOGGED]
                return _ACCEPTED
            case _:
                return _UNSUPPORTED

    def _requested_mode(self, params: tuple[float, ...]) -> FlightMode | None:
        """The mode that DO_SET_MODE requests; None if it does not exist."""
        if not _whole(params[0], 0) & _CUSTOM_MODE_FLAG:
            return None
        if self.kind == "ardupilot":
            return mode_numbered(self.kind, _whole(params[1]))
        return mode_numbered(self.kind, _whole(params[1], 0) << 16 | _whole(params[2], 0) << 24)

    def _guided_take_off(self, height_m: float) -> bool:
        if not self.armed or not 0.0 < height_m < 10_000.0:
            return False
        if self.kind == "px4":
            self._select(mode_named(self.kind, "TAKEOFF"))
        elif self.mode.name != "GUIDED":
            return False
        self._fly_item(mission_item.TAKEOFF, height_m)
        return True

    def _set_interval(self, port: Port, message_id: int, interval_us: float) -> int:
        if not telemetry.streamable(message_id):
            if self.kind == "px4":
                return _FAILED
            self.text(f"No ap_message for mavlink id ({message_id})")
            return _DENIED
        if not -1.0 <= interval_us < 1e12:
            return _DENIED
        default_s = 1.0 if message_id == telemetry.HEARTBEAT else 0.0
        interval_s = max(interval_us / 1e6, _FASTEST_STREAM_S) if interval_us > 0.0 else default_s
        self._streams.every(port, message_id, interval_s if interval_us >= 0.0 else 0.0)
        return _ACCEPTED


def _result(done: bool) -> int:
    return _ACCEPTED if done else _FAILED


def _whole(value: float, default: int = -1) -> int:
    """The whole number in a command's parameter; `default` for NaN and infinities."""
    return int(value) if math.isfinite(value) else default


def _params_of(message: Any) -> tuple[float, ...]:
    """param1…param7 of a COMMAND_LONG or COMMAND_INT."""
    first = message.param1, message.param2, message.param3, message.param4
    if message.get_type() == "COMMAND_INT":
        return (*first, float(message.x), float(message.y), message.z)
    return (*first, message.param5, message.param6, message.param7)
