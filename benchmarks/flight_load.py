"""The load of an autopilot in flight on a companion's link: 500 messages a second, with a schedule."""

from __future__ import annotations

import heapq
import math
import random
from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage

RC_RATE_HZ = 50.0
MESSAGES_PER_S = 500.0
SYSTEM_ID = 1
ALTITUDE_MM = 12_000
_HEALTHY = 0x1FFFFFFF
_JITTER = 0.8
"""Jitter as a share of the period. An autopilot's scheduler is not regular; a regular load would always have
the same phase."""

Build = Callable[[float], MavlinkMessage]


def rc_channels(boot_s: float, switch_us: int) -> MavlinkMessage:
    """16 channels of a healthy receiver, with the vine's switch on channel 9."""
    sticks = (1500, 1500, 1600, 1500, 1100, 1500, 1500, 1900)
    return mavlink.MAVLink_rc_channels_message(_ms(boot_s), 16, *sticks, switch_us, *(1500,) * 7, 0, 0, 254)


def mission_count(to_system: int, to_component: int) -> MavlinkMessage:
    """An empty mission, so that the service does not ask again."""
    return mavlink.MAVLink_mission_count_message(to_system, to_component, 0, 0)


class FlightLoad:
    """All messages except RC_CHANNELS, which the code that flips the switch encodes with the same
    `autopilot`."""

    def __init__(self, began_s: float, seed: int) -> None:
        self.autopilot = MavlinkCodec(SYSTEM_ID, mavlink.MAV_COMP_ID_AUTOPILOT1)
        self._ground_station = MavlinkCodec(255, mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self._began_s = began_s
        self._random = random.Random(seed)
        self._due: list[tuple[float, float, str]] = []
        for name, (rate_Hz, _) in _STREAMS.items():
            nominal_s = began_s + self._random.random() / rate_Hz
            heapq.heappush(self._due, (nominal_s, nominal_s, name))

    @property
    def next_due_s(self) -> float:
        return self._due[0][0]

    def boot_s(self, now_s: float) -> float:
        """The autopilot's own clock, which started earlier."""
        return 100.0 + now_s - self._began_s

    def take(self, now_s: float) -> bytes:
        """The frame that is due."""
        _, nominal_s, name = self._due[0]
        rate_Hz, build = _STREAMS[name]
        nominal_s += 1.0 / rate_Hz
        due_s = nominal_s + _JITTER * self._random.random() / rate_Hz
        heapq.heapreplace(self._due, (due_s, nominal_s, name))
        message = build(self.boot_s(now_s))
        if name == "GCS":
            return self._ground_station.encode(message, 255)
        return self.autopilot.encode(message, SYSTEM_ID)


def _ms(boot_s: float) -> int:
    return int(boot_s * 1e3)


def _us(boot_s: float) -> int:
    return int(boot_s * 1e6)


def _heartbeat(boot_s: float) -> MavlinkMessage:
    mode = mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mode, 5, mavlink.MAV_STATE_ACTIVE, 3
    )


def _ground_station_heartbeat(boot_s: float) -> MavlinkMessage:
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
    )


def _attitude(t: float) -> MavlinkMessage:
    roll, pitch = 0.05 * math.sin(3 * t), 0.05 * math.cos(2 * t)
    return mavlink.MAVLink_attitude_message(_ms(t), roll, pitch, 1.2, 0.01, -0.02, 0.001)


def _global_position(t: float) -> MavlinkMessage:
    lat, lon = 473_977_420 + int(50 * math.sin(t)), 85_455_940
    return mavlink.MAVLink_global_position_int_message(
        _ms(t), lat, lon, 500_000 + ALTITUDE_MM, ALTITUDE_MM, 12, -7, 3, 6900
    )


def _local_position(t: float) -> MavlinkMessage:
    return mavlink.MAVLink_local_position_ned_message(_ms(t), math.sin(t), 2.0, -12.0, 0.1, -0.1, 0.02)


def _raw_imu(t: float) -> MavlinkMessage:
    wave = int(40 * math.sin(40 * t))
    return mavlink.MAVLink_raw_imu_message(_us(t), wave, -wave, -998, 3, -2, 1, 210, 40, 410, 0, 3900)


def _scaled_imu2(t: float) -> MavlinkMessage:
    wave = int(40 * math.sin(41 * t))
    return mavlink.MAVLink_scaled_imu2_message(_ms(t), wave, -wave, -1001, 2, -2, 0, 205, 44, 400, 3900)


def _servos(t: float) -> MavlinkMessage:
    wave = int(20 * math.sin(10 * t))
    motors = (1500 + wave, 1500 - wave, 1490 + wave, 1510 - wave, 0, 0, 0, 0)
    return mavlink.MAVLink_servo_output_raw_message(_us(t) & 0xFFFFFFFF, 0, *motors)


def _vfr_hud(t: float) -> MavlinkMessage:
    return mavlink.MAVLink_vfr_hud_message(0.1, 0.1 + 0.05 * math.sin(t), 69, 38, 512.0, 0.02)


def _navigation(t: float) -> MavlinkMessage:
    return mavlink.MAVLink_nav_controller_output_message(0.3, -0.2, 69, 70, 0, 0.05, 0.0, 0.1)


def _ahrs2(t: float) -> MavlinkMessage:
    return mavlink.MAVLink_ahrs2_message(0.05 * math.sin(3 * t), 0.02, 1.2, 512.0, 473_977_420, 85_455_940)


def _pressure(t: float) -> MavlinkMessage:
    return mavlink.MAVLink_scaled_pressure_message(_ms(t), 953.2 + 0.01 * math.sin(t), 0.0, 3900)


def _gps(t: float) -> MavlinkMessage:
    return mavlink.MAVLink_gps_raw_int_message(
        _us(t), 4, 473_977_420, 85_455_940, 512_000, 70, 110, 12, 6900, 17
    )


def _ekf(t: float) -> MavlinkMessage:
    return mavlink.MAVLink_ekf_status_report_message(831, 0.05, 0.03, 0.04, 0.06, 0.0)


def _vibration(t: float) -> MavlinkMessage:
    return mavlink.MAVLink_vibration_message(_us(t), 4.1, 3.9, 6.2 + math.sin(t), 0, 0, 0)


def _sys_status(t: float) -> MavlinkMessage:
    return mavlink.MAVLink_sys_status_message(
        _HEALTHY, _HEALTHY, _HEALTHY, 310, 15_800, 1840, 71, 0, 0, 0, 0, 0, 0
    )


def _mission_current(t: float) -> MavlinkMessage:
    return mavlink.MAVLink_mission_current_message(0)


def _battery(t: float) -> MavlinkMessage:
    cells_mV = (3950, 3948, 3952, 3950, *(0xFFFF,) * 6)
    return mavlink.MAVLink_battery_status_message(0, 0, 1, 3200, cells_mV, 1840, 900, -1, 71)


def _power(t: float) -> MavlinkMessage:
    return mavlink.MAVLink_power_status_message(5080, 0, 5)


def _system_time(t: float) -> MavlinkMessage:
    return mavlink.MAVLink_system_time_message(1_780_000_000_000_000 + _us(t), _ms(t))


_STREAMS: dict[str, tuple[float, Build]] = {
    "ATTITUDE": (100, _attitude),
    "GLOBAL_POSITION_INT": (50, _global_position),
    "LOCAL_POSITION_NED": (50, _local_position),
    "RAW_IMU": (50, _raw_imu),
    "SERVO_OUTPUT_RAW": (50, _servos),
    "SCALED_IMU2": (25, _scaled_imu2),
    "VFR_HUD": (25, _vfr_hud),
    "NAV_CONTROLLER_OUTPUT": (20, _navigation),
    "AHRS2": (20, _ahrs2),
    "SCALED_PRESSURE": (10, _pressure),
    "GPS_RAW_INT": (10, _gps),
    "EKF_STATUS_REPORT": (10, _ekf),
    "VIBRATION": (10, _vibration),
    "SYS_STATUS": (5, _sys_status),
    "MISSION_CURRENT": (5, _mission_current),
    "BATTERY_STATUS": (4, _battery),
    "POWER_STATUS": (2, _power),
    "SYSTEM_TIME": (2, _system_time),
    "HEARTBEAT": (1, _heartbeat),
    "GCS": (1, _ground_station_heartbeat),
}
assert sum(rate_Hz for rate_Hz, _ in _STREAMS.values()) + RC_RATE_HZ == MESSAGES_PER_S
