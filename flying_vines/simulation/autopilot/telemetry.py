"""What the autopilot sends periodically: messages about the vehicle's state, and the streams of each link."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.simulation.autopilot.flight import CopterMotion, FlightMode
from flying_vines.simulation.autopilot.links import COMPANION, Port, PortStream
from flying_vines.simulation.autopilot.mission_runners import MissionStatus
from flying_vines.simulation.autopilot.rc_input import RcInput
from flying_vines.simulation.autopilot.scheduler import Scheduler
from flying_vines.vehicle.mission.item import AutopilotKind
from missions.home import CRUISE_M_S, Home

HEARTBEAT, SYS_STATUS, SYSTEM_TIME, GPS_RAW_INT, ATTITUDE, GLOBAL_POSITION_INT = 0, 1, 2, 24, 30, 33
MISSION_CURRENT, GPS_GLOBAL_ORIGIN, RC_CHANNELS, VFR_HUD, TIMESYNC = 42, 49, 65, 74, 111
BATTERY_STATUS, AUTOPILOT_VERSION, HOME_POSITION, EXTENDED_SYS_STATE = 147, 148, 242, 245
_NAMED_VALUE_FLOAT = 251

ARMED_FLAG = 128
RC_RECEIVER = 0x10000

# As recorded from a quadcopter with usual sensors. PX4 reports an RC receiver only while it is good.
_ARDUPILOT_PRESENT, _ARDUPILOT_ENABLED, _ARDUPILOT_HEALTH = 0x5371FC2F, 0x5361FC2F, 0x5771FC2F
_ARDUPILOT_DISARMED = 0x01000000
_PX4_PRESENT, _PX4_ENABLED, _PX4_HEALTH = 0x0300402F, 0x0301402F, 0x1320C83F

_STANDBY, _ACTIVE, _CRITICAL = 3, 4, 5
_ON_GROUND, _IN_AIR, _TAKING_OFF, _LANDING = 1, 2, 3, 4
_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
_PARAM_ENCODING: dict[AutopilotKind, int] = {
    "ardupilot": mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST,
    "px4": mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE,
}
_UID = 0x5F1E5
# For each RC input of PX4: channel count, rssi, and the value of channels 17 and 18.
_PX4_RC = {"overrides": (18, 100, 1500), "sbus": (18, 255, 998), "crsf": (16, 61, 65535)}
_NO_RSSI = 255
_SEA_LEVEL_HPA, _SCALE_HEIGHT_M = 1013.25, 8_434.0
_FIX_3D, _SATELLITES = 3, 10
_MOTORS, _SERVOS, _FLYING_US, _STOPPED_US = 4, 16, 1500, 900
_CELLS, _NO_CELL, _VOLTAGE_MV = 10, 65535, 16200
_NO_TEMPERATURE = 32767
_RELATIVE_ALTITUDE_INT = 6
_NAME_BYTES = 9
_TIMESYNC_S = 10.0

# Default rates of PX4: on the companion's link as recorded, on other links those of PX4's "normal" mode.
_ONBOARD_HZ = {ATTITUDE: 98.0, MISSION_CURRENT: 1.0, _NAMED_VALUE_FLOAT: 10.0}
_NORMAL_HZ = {
    ATTITUDE: 15.0,
    GLOBAL_POSITION_INT: 5.0,
    RC_CHANNELS: 5.0,
    VFR_HUD: 4.0,
    SYS_STATUS: 1.0,
    EXTENDED_SYS_STATE: 1.0,
    MISSION_CURRENT: 1.0,
    HOME_POSITION: 0.5,
    GPS_RAW_INT: 1.0,
    BATTERY_STATUS: 0.5,
    _NAMED_VALUE_FLOAT: 1.0,
}


# Groups of REQUEST_DATA_STREAM; 0 means all.
_GROUPS: dict[int, tuple[int, ...]] = {
    2: (SYS_STATUS, MISSION_CURRENT),
    3: (RC_CHANNELS,),
    6: (GLOBAL_POSITION_INT,),
    10: (ATTITUDE,),
    11: (VFR_HUD,),
    12: (SYSTEM_TIME,),
}


@dataclass(frozen=True, slots=True)
class AutopilotSnapshot:
    """The autopilot's state at one instant."""

    kind: AutopilotKind
    mode: FlightMode
    armed: bool
    calibrating: bool
    boot_s: float
    unix_s: float
    flight: CopterMotion
    rc: RcInput
    mission: MissionStatus
    mission_id: int

    @property
    def boot_ms(self) -> int:
        return int(self.boot_s * 1000) & 0xFFFFFFFF

    @property
    def boot_us(self) -> int:
        return int(self.boot_s * 1e6)


class Px4MissionCurrent(mavlink.MAVLink_mission_current_message):  # type: ignore[misc]
    """MISSION_CURRENT with the plan ids that PX4 appends. pymavlink's ardupilotmega dialect lacks them."""

    def __init__(self, status: MissionStatus, mission_id: int) -> None:
        super().__init__(*status)
        self._ids = mission_id.to_bytes(4, "little") + bytes(8)

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        head = self.unpacker.pack(self.seq, self.total, self.mission_state, self.mission_mode)
        return bytes(self._pack(mav, self.crc_extra, head + self._ids, force_mavlink1=force_mavlink1))


def streamable(message_id: int) -> bool:
    """True if SET_MESSAGE_INTERVAL and REQUEST_MESSAGE accept the message."""
    return message_id in _MAKERS


def stream_group(group: int) -> tuple[int, ...]:
    """The messages of one group of REQUEST_DATA_STREAM."""
    if group == 0:
        return tuple(message_id for ids in _GROUPS.values() for message_id in ids)
    return _GROUPS.get(group, ())


def _degrees_e7(home: Home, north_m: float, east_m: float) -> tuple[int, int]:
    """Latitude and longitude in units of 1e-7°."""
    latitude_deg, longitude_deg = home.global_deg(north_m, east_m)
    return round(latitude_deg * 1e7), round(longitude_deg * 1e7)


def _home(flight: CopterMotion) -> tuple[int, int, int]:
    """Latitude and longitude (1e-7°) and altitude (mm)."""
    return *_degrees_e7(flight.home, 0.0, 0.0), round(flight.home.altitude_amsl_m * 1000)


def _heartbeat(now: AutopilotSnapshot) -> Any:
    if now.kind == "ardupilot":
        autopilot = 3
        status = _ACTIVE if now.calibrating or now.flight.airborne else _STANDBY
    else:
        autopilot = 12
        status = _ACTIVE if now.armed else _STANDBY
    status = _CRITICAL if now.rc.failsafe else status
    base = now.mode.base | (ARMED_FLAG if now.armed else 0)
    return mavlink.MAVLink_heartbeat_message(2, autopilot, base, now.mode.custom, status, 3)


def _sys_status(now: AutopilotSnapshot) -> Any:
    if now.kind == "px4":
        present, enabled, health = _PX4_PRESENT, _PX4_ENABLED, _PX4_HEALTH
        if now.rc.reported_good:
            present, health = present | RC_RECEIVER, health | RC_RECEIVER
    else:
        present, enabled, health = _ARDUPILOT_PRESENT, _ARDUPILOT_ENABLED, _ARDUPILOT_HEALTH
        if not now.armed:
            enabled &= ~_ARDUPILOT_DISARMED
        if now.rc.failsafe or not now.rc.values_us:
            health &= ~RC_RECEIVER
    current_ca = 3000 if now.flight.airborne else 0
    return mavlink.MAVLink_sys_status_message(
        present, enabled, health, 0, 12600, current_ca, 100, 0, 0, 0, 0, 0, 0
    )


def _system_time(now: AutopilotSnapshot) -> Any:
    return mavlink.MAVLink_system_time_message(int(now.unix_s * 1e6), now.boot_ms)


def _attitude(now: AutopilotSnapshot) -> Any:
    pitch_rad = -0.15 * now.flight.speed_m_s / CRUISE_M_S
    return mavlink.MAVLink_attitude_message(now.boot_ms, 0.0, pitch_rad, now.flight.yaw_rad, 0.0, 0.0, 0.0)


def _global_position(now: AutopilotSnapshot) -> Any:
    flight = now.flight
    height_mm = round(flight.height_m * 1000)
    return mavlink.MAVLink_global_position_int_message(
        now.boot_ms,
        *_degrees_e7(flight.home, flight.north_m, flight.east_m),
        round(flight.home.altitude_amsl_m * 1000) + height_mm,
        height_mm,
        *(round(speed_m_s * 100) for speed_m_s in flight.velocity_ned_m_s),
        round(flight.heading_deg * 100) % 36000,
    )


def _vfr_hud(now: AutopilotSnapshot) -> Any:
    flight = now.flight
    return mavlink.MAVLink_vfr_hud_message(
        flight.speed_m_s,
        flight.speed_m_s,
        round(flight.heading_deg) % 360,
        37 if flight.airborne else 0,
        flight.home.altitude_amsl_m + flight.height_m,
        flight.climb_m_s,
    )


def _mission_current(now: AutopilotSnapshot) -> Any:
    if now.kind == "px4":
        return Px4MissionCurrent(now.mission, now.mission_id)
    return mavlink.MAVLink_mission_current_message(*now.mission)


def _rc_channels(now: AutopilotSnapshot) -> Any | None:
    rc = now.rc
    values = rc.values_us
    count, rssi, unused = len(values), _NO_RSSI, 0
    if now.kind == "px4":
        if not values:
            return None
        count, rssi, unused = _PX4_RC["overrides" if rc.overridden else rc.source]
        rssi = rssi if rc.has_rssi else _NO_RSSI
    channels = (*values, *(unused,) * (18 - len(values)))
    return mavlink.MAVLink_rc_channels_message(now.boot_ms, count, *channels, rssi)


def _autopilot_version(now: AutopilotSnapshot) -> Any:
    version = (4 << 24 | 6 << 16) if now.kind == "ardupilot" else (1 << 24 | 17 << 16)
    capabilities = _CAPABILITIES | _PARAM_ENCODING[now.kind]
    nothing = [0] * 8
    return mavlink.MAVLink_autopilot_version_message(
        capabilities, version, 0, 0, 0, nothing, nothing, nothing, 0, 0, _UID
    )


def _home_position(now: AutopilotSnapshot) -> Any:
    nowhere = (0.0, 0.0, 0.0)
    return mavlink.MAVLink_home_position_message(
        *_home(now.flight), *nowhere, [math.nan] * 4, *nowhere, now.boot_us
    )


def _extended_sys_state(now: AutopilotSnapshot) -> Any:
    flight = now.flight
    if not flight.airborne:
        landed = _ON_GROUND
    elif flight.landing:
        landed = _LANDING
    elif flight.taking_off:
        landed = _TAKING_OFF
    else:
        landed = _IN_AIR
    return mavlink.MAVLink_extended_sys_state_message(0, landed)


def _timesync(now: AutopilotSnapshot) -> Any:
    return mavlink.MAVLink_timesync_message(0, int(now.boot_s * 1e9) + 1)


def _gps_raw_int(now: AutopilotSnapshot) -> Any:
    flight = now.flight
    altitude_mm = round((flight.home.altitude_amsl_m + flight.height_m) * 1000)
    return mavlink.MAVLink_gps_raw_int_message(
        *(now.boot_us, _FIX_3D, *_degrees_e7(flight.home, flight.north_m, flight.east_m)),
        *(altitude_mm, 70, 110),
        round(flight.speed_m_s * 100),
        round(flight.heading_deg * 100) % 36000,
        _SATELLITES,
    )


def _scaled_pressure(now: AutopilotSnapshot) -> Any:
    altitude_m = now.flight.home.altitude_amsl_m + now.flight.height_m
    ambient_hPa = _SEA_LEVEL_HPA * math.exp(-altitude_m / _SCALE_HEIGHT_M)
    return mavlink.MAVLink_scaled_pressure_message(now.boot_ms, ambient_hPa, 0.0, 1500)


def _local_position_ned(now: AutopilotSnapshot) -> Any:
    flight = now.flight
    return mavlink.MAVLink_local_position_ned_message(
        now.boot_ms, flight.north_m, flight.east_m, -flight.height_m, *flight.velocity_ned_m_s
    )


def _servo_output_raw(now: AutopilotSnapshot) -> Any:
    motors_us = _FLYING_US if now.flight.airborne else _STOPPED_US
    outputs_us = [motors_us] * _MOTORS + [_STOPPED_US] * (_SERVOS - _MOTORS)
    return mavlink.MAVLink_servo_output_raw_message(now.boot_us & 0xFFFFFFFF, 0, *outputs_us)


def _battery_status(now: AutopilotSnapshot) -> Any:
    cells = [_VOLTAGE_MV] + [_NO_CELL] * (_CELLS - 1)
    return mavlink.MAVLink_battery_status_message(0, 1, 1, _NO_TEMPERATURE, cells, -1, -1, -1, 100)


def _gps_global_origin(now: AutopilotSnapshot) -> Any:
    return mavlink.MAVLink_gps_global_origin_message(*_home(now.flight), now.boot_us)


def _position_target(now: AutopilotSnapshot) -> Any | None:
    """The position controller's target; None while disarmed."""
    if not now.armed:
        return None
    flight = now.flight
    north_m, east_m, height_m = flight.target
    place = (*_degrees_e7(flight.home, north_m, east_m), height_m)
    acceleration = (0.0, 0.0, 0.0)
    return mavlink.MAVLink_position_target_global_int_message(
        *(now.boot_ms, _RELATIVE_ALTITUDE_INT, 0, *place, *flight.velocity_ned_m_s, *acceleration),
        flight.yaw_rad,
        0.0,
    )


def _ping(now: AutopilotSnapshot) -> Any:
    """A PING request of the autopilot; its sequence number is the time since boot in s."""
    return mavlink.MAVLink_ping_message(now.boot_us, int(now.boot_s) & 0xFFFFFFFF, 0, 0)


_MAKERS = {
    HEARTBEAT: _heartbeat,
    SYS_STATUS: _sys_status,
    SYSTEM_TIME: _system_time,
    ATTITUDE: _attitude,
    GLOBAL_POSITION_INT: _global_position,
    MISSION_CURRENT: _mission_current,
    RC_CHANNELS: _rc_channels,
    VFR_HUD: _vfr_hud,
    TIMESYNC: _timesync,
    AUTOPILOT_VERSION: _autopilot_version,
    HOME_POSITION: _home_position,
    EXTENDED_SYS_STATE: _extended_sys_state,
    GPS_RAW_INT: _gps_raw_int,
    GPS_GLOBAL_ORIGIN: _gps_global_origin,
    BATTERY_STATUS: _battery_status,
    mavlink.MAVLINK_MSG_ID_PING: _ping,
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: _scaled_pressure,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position_ned,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: _servo_output_raw,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: _position_target,
}


class StreamSender:
    """Sends  A port that has received nothing yet gets only heartbeats and TIMESYNC."""

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
        self.every(port, HEARTBEAT, 1.0, first_s=0.0)
        if self._kind == "ardupilot":
            first_s = max(0.0, _TIMESYNC_S - self._snapshot().boot_s)
            self.every(port, TIMESYNC, _TIMESYNC_S, first_s)

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
            stream.next.cancel()
        if interval_s <= 0.0:
            return
        begin_s = self._scheduler.now_s + (interval_s if first_s is None else first_s)
        entry = self._scheduler.every(interval_s, partial(self.once, port, message_id), begin_s)
        port.streams[message_id] = PortStream(interval_s, entry)

    def once(self, port: Port, message_id: int) -> None:
        """Send a message now, if it has content."""
        if not port.active and message_id not in (HEARTBEAT, TIMESYNC):
            return
        if message_id == _NAMED_VALUE_FLOAT:
            self._echo(port)
            return
        now = self._snapshot()
        if message_id == RC_CHANNELS and self._kind == "px4" and now.rc.overridden:
            if port.rc_updates == now.rc.updates:
                return
            port.rc_updates = now.rc.updates
        make = _MAKERS.get(message_id)
        if make is not None and (message := make(now)) is not None:
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
