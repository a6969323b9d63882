"""FUEL_STATUS: the reservoir's level in MAVLink's message for fuel tanks.

pymavlink's dialects lack this message, so its class is here. We only send it.
"""

from __future__ import annotations

import math
import struct
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.payloads import MavlinkMessage

_GAS = 2
"""MAV_FUEL_TYPE_GAS: levels are in kPa, the flow in ml/s."""

_PERCENT_NOT_KNOWN = 255


class FuelStatus(mavlink.MAVLink_message):  # type: ignore[misc]
    """FUEL_STATUS as common.xml defines it; on the wire the large fields come first."""

    id = 371
    msgname = "FUEL_STATUS"
    fieldnames = (
        "id", "maximum_fuel", "consumed_fuel", "remaining_fuel",
        "percent_remaining", "flow_rate", "temperature", "fuel_type",
    )  # fmt: skip
    crc_extra = 10
    unpacker = struct.Struct("<fffffIBB")

    def __init__(
        self, maximum_fuel: float, remaining_fuel: float, percent: int, flow_rate: float, temperature: float
    ) -> None:
        super().__init__(self.id, self.msgname)
        self._fieldnames = self.fieldnames
        self.id = 0  # the tank's; it hides the message's number, as in pymavlink's own classes
        self.maximum_fuel = maximum_fuel
        self.consumed_fuel = math.nan  # the field is for measured values only; we could only infer it
        self.remaining_fuel = remaining_fuel
        self.flow_rate = flow_rate
        self.temperature = temperature
        self.fuel_type = _GAS
        self.percent_remaining = percent

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        payload = self.unpacker.pack(
            self.maximum_fuel, self.consumed_fuel, self.remaining_fuel, self.flow_rate, self.temperature,
            self.fuel_type, self.id, self.percent_remaining,
        )  # fmt: skip
        raw: bytes = self._pack(mav, self.crc_extra, payload, force_mavlink1)
        return raw


def fuel_status(
    reservoir_kPa: float, full_kPa: float, flow_ml_per_s: float = math.nan, temperature_K: float = math.nan
) -> MavlinkMessage:
    """The reservoir as a tank of gas. Pressures are gauge, as in our named values. NaN: unknown.

    The flow is positive while air leaves the reservoir.
    """
    percent = _PERCENT_NOT_KNOWN
    if math.isfinite(reservoir_kPa) and full_kPa > 0.0:
        percent = round(100.0 * min(max(reservoir_kPa / full_kPa, 0.0), 1.0))
    return FuelStatus(full_kPa, reservoir_kPa, percent, flow_ml_per_s, temperature_K)
