"""Messages about the vehicle's state, with the content that each autopilot gives them."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.simulation.autopilot import sensors
from flying_vines.simulation.autopilot.modes import ARMED_FLAG
from flying_vines.simulation.autopilot.runner import MissionStatus
from flying_vines.simulation.autopilot.snapshot import AutopilotSnapshot
from flying_vines.vehicle.mission.storage import AutopilotKind
from missions.home import CRUISE_M_S

HEARTBEAT, SYS_STATUS, SYSTEM_TIME, ATTITUDE, GLOBAL_POSITION_INT = 0, 1, 2, 30, 33
MISSION_CURRENT, RC_CHANNELS, VFR_HUD, TIMESYNC, AUTOPILOT_VERSION = 42, 65, 74, 111, 148
HOME_POSITION, EXTENDED_SYS_STATE = 242, 245

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


class Px4MissionCurrent(mavlink.MAVLink_mission_current_message):  # type: ignore[misc]
    """MISSION_CURRENT with the plan ids that PX4 appends. pymavlink's ardupilotmega dialect lacks them."""

    def __init__(self, status: MissionStatus, mission_id: int) -> None:
        super().__init__(status.seq, status.total, status.state, status.mode)
        self._ids = mission_id.to_bytes(4, "little") + bytes(8)

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        head = self.unpacker.pack(self.seq, self.total, self.mission_state, self.mission_mode)
        return bytes(self._pack(mav, self.crc_extra, head + self._ids, force_mavlink1=force_mavlink1))


def telemetry(message_id: int, now: AutopilotSnapshot) -> Any | None:
    """The message of this id at `now`; None if it has no content now."""
    make = _MAKERS.get(message_id)
    return make(now) if make is not None else None


def streamable(message_id: int) -> bool:
    """True if SET_MESSAGE_INTERVAL and REQUEST_MESSAGE accept the message."""
    return message_id in _MAKERS


def _heartbeat(now: AutopilotSnapshot) -> Any:
    if now.kind == "ardupilot":
        autopilot = 3
        status = _ACTIVE if now.calibrating or now.flight.airborne else _STANDBY
    else:
        autopilot = 12
        status = _ACTIVE if now.armed else _STANDBY
    status = _CRITICAL if now.rc_failsafe else status
    base = now.mode.base | (ARMED_FLAG if now.armed else 0)
    return mavlink.MAVLink_heartbeat_message(2, autopilot, base, now.mode.custom, status, 3)


def _sys_status(now: AutopilotSnapshot) -> Any:
    if now.kind == "px4":
        present, enabled, health = _PX4_PRESENT, _PX4_ENABLED, _PX4_HEALTH
        if now.rc_reported:
            present, health = present | RC_RECEIVER, health | RC_RECEIVER
    else:
        present, enabled, health = _ARDUPILOT_PRESENT, _ARDUPILOT_ENABLED, _ARDUPILOT_HEALTH
        if not now.armed:
            enabled &= ~_ARDUPILOT_DISARMED
        if now.rc_failsafe or not now.receiver.values_us:
            health &= ~RC_RECEIVER
    current_ca = 3000 if now.flight.airborne else 0
    return mavlink.MAVLink_sys_status_message(
        present, enabled, health, 0, 12600, current_ca, 100, 0, 0, 0, 0, 0, 0
    )


def _system_time(now: AutopilotSnapshot) -> Any:
    return mavlink.MAVLink_system_time_message(int(now.unix_s * 1e6), now.boot_ms)


def _attitude(now: AutopilotSnapshot) -> Any:
    flight = now.flight
    speed = math.hypot(flight.north_m_s, flight.east_m_s)
    pitch_rad = -0.15 * speed / CRUISE_M_S
    return mavlink.MAVLink_attitude_message(now.boot_ms, 0.0, pitch_rad, flight.yaw_rad, 0.0, 0.0, 0.0)


def _global_position(now: AutopilotSnapshot) -> Any:
    flight = now.flight
    latitude_deg, longitude_deg = flight.home.global_deg(flight.north_m, flight.east_m)
    height_mm = round(flight.height_m * 1000)
    return mavlink.MAVLink_global_position_int_message(
        now.boot_ms,
        round(latitude_deg * 1e7),
        round(longitude_deg * 1e7),
        round(flight.home.altitude_amsl_m * 1000) + height_mm,
        height_mm,
        round(flight.north_m_s * 100),
        round(flight.east_m_s * 100),
        round(-flight.climb_m_s * 100),
        round(flight.heading_deg * 100) % 36000,
    )


def _vfr_hud(now: AutopilotSnapshot) -> Any:
    flight = now.flight
    speed = math.hypot(flight.north_m_s, flight.east_m_s)
    return mavlink.MAVLink_vfr_hud_message(
        speed,
        speed,
        round(flight.heading_deg) % 360,
        37 if flight.airborne else 0,
        flight.home.altitude_amsl_m + flight.height_m,
        flight.climb_m_s,
    )


def _mission_current(now: AutopilotSnapshot) -> Any:
    status = now.mission
    if now.kind == "px4":
        return Px4MissionCurrent(status, now.mission_id)
    return mavlink.MAVLink_mission_current_message(status.seq, status.total, status.state, status.mode)


def _rc_channels(now: AutopilotSnapshot) -> Any | None:
    receiver = now.receiver
    values = receiver.values_us
    count, rssi, unused = len(values), _NO_RSSI, 0
    if now.kind == "px4":
        if not values:
            return None
        count, rssi, unused = _PX4_RC["overrides" if receiver.overridden else receiver.source]
        rssi = rssi if receiver.has_rssi else _NO_RSSI
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
    home = now.flight.home
    return mavlink.MAVLink_home_position_message(
        round(home.latitude_deg * 1e7),
        round(home.longitude_deg * 1e7),
        round(home.altitude_amsl_m * 1000),
        0.0,
        0.0,
        0.0,
        [math.nan] * 4,
        0.0,
        0.0,
        0.0,
        int(now.boot_s * 1e6),
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
    sensors.PING: sensors.ping,
    sensors.GPS_RAW_INT: sensors.gps_raw_int,
    sensors.SCALED_PRESSURE: sensors.scaled_pressure,
    sensors.LOCAL_POSITION_NED: sensors.local_position_ned,
    sensors.SERVO_OUTPUT_RAW: sensors.servo_output_raw,
    sensors.GPS_GLOBAL_ORIGIN: sensors.gps_global_origin,
    sensors.POSITION_TARGET_GLOBAL_INT: sensors.position_target,
    sensors.BATTERY_STATUS: sensors.battery_status,
}
