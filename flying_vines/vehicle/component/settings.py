"""The settings that a pilot may change in the field: one row each, with the limits of its value.

If a setting keeps people or hardware safe, the profile's value is its maximum or minimum: a pilot may make
the vine weaker or slower, never stronger or faster. A pressure profile that then exceeds the limits is
clipped, which safety reports, or slowed.
"""

from __future__ import annotations

import math
from ctypes import c_float
from dataclasses import dataclass
from functools import cache
from typing import Literal, get_type_hints

import msgspec
from msgspec import inspect

from flying_vines.config.config import Config

Guard = Literal["none", "most", "least"]


@dataclass(frozen=True, slots=True)
class ParameterRow:
    """One parameter: a float over MAVLink, a key of the profile here."""

    name: str
    """At most 16 characters, as MAVLink has it."""
    table: str
    key: str
    doc: str
    guard: Guard = "none"
    """Whether the profile's value is the maximum or the minimum that may be set."""
    least: float = -math.inf
    most: float = math.inf
    """Limits that are narrower than the configuration's."""
    choices: tuple[str | bool, ...] = ()
    """The meaning of the numbers 0, 1 …, if they are not the value itself."""
    in_flight: bool = False
    """It does not affect motion, so it may be changed while the vine is bent."""


VENT_OR_HOLD = ("vent", "hold")
OFF_OR_ON = (False, True)

SETTINGS = (
    ParameterRow("VINE_SW_CHAN", "switch", "channel", "RC channel of the switch"),
    ParameterRow("VINE_SW_DEBOUNCE", "switch", "debounce_s", "s that a new position of the switch must last"),
    ParameterRow(
        "VINE_SW_HYST_US", "switch", "hysteresis_us", "us past the border before the position changes"
    ),
    ParameterRow("VINE_RC_LOSS_S", "losses", "rc_s", "s without RC_CHANNELS until RC is lost", "most"),
    ParameterRow("VINE_RC_ACTION", "losses", "on_rc_loss", "RC lost: 0 vent, 1 hold", choices=VENT_OR_HOLD),
    ParameterRow(
        "VINE_AP_LOSS_S", "losses", "autopilot_s", "s without a message: the autopilot is lost", "most"
    ),
    ParameterRow(
        "VINE_HOLD_MAX_S", "losses", "hold_at_most_s", "s that RC losses are held, then it vents", "most", 0.5
    ),
    ParameterRow("VINE_MAX_KPA", "limits", "max_kPa", "gauge kPa: no setpoint is above it", "most", 0.5),
    ParameterRow("VINE_MAX_RATE", "limits", "max_rate_kPa_per_s", "kPa/s: no motion is faster", "most", 1.0),
    ParameterRow(
        "VINE_MAX_BENT_S", "limits", "max_bent_s", "s since the last trigger, then it vents", "most", 1.0
    ),
    ParameterRow(
        "VINE_MIN_ALT_M", "interlocks", "min_altitude_m", "m above home, to bend", "least", most=1000.0
    ),
    ParameterRow(
        "VINE_RESERVE_KPA", "interlocks", "reserve_kPa", "gauge kPa kept in the bottle", "least", most=2000.0
    ),
    ParameterRow("VINE_RATE_HZ", "telemetry", "rate_Hz", "Hz of each named value", in_flight=True),
    ParameterRow(
        "VINE_FUEL_STATUS",
        "telemetry",
        "fuel_status",
        "1: FUEL_STATUS, too",
        choices=OFF_OR_ON,
        in_flight=True,
    ),
    ParameterRow(
        "VINE_LOW_CYCLES",
        "telemetry",
        "low_reservoir_cycles",
        "cycles left: warn below",
        most=1000.0,
        in_flight=True,
    ),
)
"""In the order of their index, which stays the same as long as the service runs."""

BY_NAME = {setting.name: setting for setting in SETTINGS}


class ParameterRefused(Exception):
    """A value that a parameter may not have; `reason` is a clause for people."""

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(f"{name}: {reason}")
        self.name = name
        self.reason = reason


def value_of(setting: ParameterRow, config: Config) -> float:
    """What a configuration has, as a parameter's number."""
    value = getattr(getattr(config, setting.table), setting.key)
    return float(setting.choices.index(value)) if setting.choices else float(value)


def bounds(setting: ParameterRow, profile: Config) -> tuple[float, float]:
    """The least and the most that may be set: of the configuration, the row and the profile the narrowest."""
    least, most = setting.least, setting.most
    kind = _type(setting)
    if setting.choices:
        least, most = 0.0, len(setting.choices) - 1.0
    elif isinstance(kind, inspect.FloatType | inspect.IntType):
        least = max(least, -math.inf if kind.ge is None else kind.ge)
        most = min(most, math.inf if kind.le is None else kind.le)
    # What the profile has is always allowed.
    ours = value_of(setting, profile)
    least = max(least, ours) if setting.guard == "least" else min(least, ours)
    most = min(most, ours) if setting.guard == "most" else max(most, ours)
    return least, most


def changed(profile: Config, config: Config, name: str, value: float) -> Config:
    """The configuration with another value; raises `ParameterRefused` where the profile does not allow it.

    Args:
        profile: as the engineer wrote it.
        config: the profile with the values in force so far.
        name: of the parameter.
        value: finite or not, as it came.
    """
    setting = BY_NAME[name]
    table = getattr(config, setting.table)
    table = msgspec.structs.replace(table, **{setting.key: _checked(setting, profile, value)})
    return msgspec.structs.replace(config, **{setting.table: table})


def decimal(value: float) -> float:
    """The shortest decimal number that is this 32-bit float: 0.15 and not 0.15000000596."""
    for digits in range(6, 9):
        short = float(f"{value:.{digits}g}")
        if same(short, value):
            return short
    return value


def same(one: float, other: float) -> bool:
    """Whether two numbers are one parameter value, which is a 32-bit float."""
    return c_float(one).value == c_float(other).value


def _checked(setting: ParameterRow, profile: Config, value: float) -> float | str | bool:
    """The value as the configuration has it."""
    if not math.isfinite(value):
        raise ParameterRefused(setting.name, "it must be a number")
    least, most = bounds(setting, profile)
    if not least <= value <= most:
        raise ParameterRefused(setting.name, f"{value:g} is outside {least:g} to {most:g}")
    if not setting.choices and not isinstance(_type(setting), inspect.IntType):
        return value
    if value != int(value):
        raise ParameterRefused(setting.name, f"{value:g} is no whole number")
    return setting.choices[int(value)] if setting.choices else int(value)


@cache
def _type(setting: ParameterRow) -> inspect.Type:
    info = inspect.type_info(get_type_hints(Config)[setting.table])
    assert isinstance(info, inspect.StructType)
    return next(field.type for field in info.fields if field.name == setting.key)
