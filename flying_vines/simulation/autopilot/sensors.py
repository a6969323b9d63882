"""Sensor messages: GPS, barometer, battery, motors, and the position target."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.simulation.autopilot.snapshot import AutopilotSnapshot

PING, GPS_RAW_INT, SCALED_PRESSURE, LOCAL_POSITION_NED, SERVO_OUTPUT_RAW = 4, 24, 29, 32, 36
GPS_GLOBAL_ORIGIN, POSITION_TARGET_GLOBAL_INT, BATTERY_STATUS = 49, 87, 147

_SEA_LEVEL_HPA, _SCALE_HEIGHT_M = 1013.25, 8_434.0
_FIX_3D, _SATELLITES = 3, 10
_MOTORS, _SERVOS, _FLYING_US, _STOPPED_US = 4, 16, 1500, 900
_CELLS, _NO_CELL, _VOLTAGE_MV = 10, 65535, 16200
_NO_TEMPERATURE = 32767
_RELATIVE_ALTITUDE_INT = 6


def gps_raw_int(now: AutopilotSnapshot) -> Any:
    flight = now.flight
    latitude_deg, longitude_deg = flight.home.global_deg(flight.north_m, flight.east_m)
    altitude_mm = round((flight.home.altitude_amsl_m + flight.height_m) * 1000)
    return mavlink.MAVLink_gps_raw_int_message(
        int(now.boot_s * 1e6),
        _FIX_3D,
        round(latitude_deg * 1e7),
        round(longitude_deg * 1e7),
        altitude_mm,
        70,
        110,
        round(math.hypot(flight.north_m_s, flight.east_m_s) * 100),
        round(flight.heading_deg * 100) % 36000,
        _SATELLITES,
    )


def scaled_pressure(now: AutopilotSnapshot) -> Any:
    altitude_m = now.flight.home.altitude_amsl_m + now.flight.height_m
    ambient_hPa = _SEA_LEVEL_HPA * math.exp(-altitude_m / _SCALE_HEIGHT_M)
    return mavlink.MAVLink_scaled_pressure_message(now.boot_ms, ambient_hPa, 0.0, 1500)


def local_position_ned(now: AutopilotSnapshot) -> Any:
    flight = now.flight
    velocity = flight.north_m_s, flight.east_m_s, -flight.climb_m_s
    return mavlink.MAVLink_local_position_ned_message(
        now.boot_ms, flight.north_m, flight.east_m, -flight.height_m, *velocity
    )


def servo_output_raw(now: AutopilotSnapshot) -> Any:
    motors_us = _FLYING_US if now.flight.airborne else _STOPPED_US
    outputs = [motors_us] * _MOTORS + [_STOPPED_US] * (_SERVOS - _MOTORS)
    first, rest = outputs[:8], outputs[8:]
    return mavlink.MAVLink_servo_output_raw_message(int(now.boot_s * 1e6) & 0xFFFFFFFF, 0, *first, *rest)


def battery_status(now: AutopilotSnapshot) -> Any:
    cells = [_VOLTAGE_MV] + [_NO_CELL] * (_CELLS - 1)
    return mavlink.MAVLink_battery_status_message(0, 1, 1, _NO_TEMPERATURE, cells, -1, -1, -1, 100)


def gps_global_origin(now: AutopilotSnapshot) -> Any:
    home = now.flight.home
    return mavlink.MAVLink_gps_global_origin_message(
        round(home.latitude_deg * 1e7),
        round(home.longitude_deg * 1e7),
        round(home.altitude_amsl_m * 1000),
        int(now.boot_s * 1e6),
    )


def position_target(now: AutopilotSnapshot) -> Any | None:
    """The position controller's target; None while disarmed."""
    if not now.armed:
        return None
    flight = now.flight
    north_m, east_m, height_m = flight.target
    latitude_deg, longitude_deg = flight.home.global_deg(north_m, east_m)
    return mavlink.MAVLink_position_target_global_int_message(
        now.boot_ms,
        _RELATIVE_ALTITUDE_INT,
        0,
        round(latitude_deg * 1e7),
        round(longitude_deg * 1e7),
        height_m,
        flight.north_m_s,
        flight.east_m_s,
        -flight.climb_m_s,
        0.0,
        0.0,
        0.0,
        flight.yaw_rad,
        0.0,
    )


def ping(now: AutopilotSnapshot) -> Any:
    """A PING request of the autopilot; its sequence number is the time since boot in s."""
    return mavlink.MAVLink_ping_message(int(now.boot_s * 1e6), int(now.boot_s) & 0xFFFFFFFF, 0, 0)
