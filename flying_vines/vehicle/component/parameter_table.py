"""The settings that a pilot may change in the field: a row for each, with its limits.

For a safety setting, the configuration's value is the maximum or minimum: a parameter can only be stricter,
for example a lower pressure or a higher minimum altitude. A pressure profile that exceeds the new limits is
clipped or slowed; safety reports the clipping.
"""

from __future__ import annotations

import math
from ctypes import c_float
from dataclasses import dataclass
from functools import cache
from typing import Literal, get_type_hints

import msgspec
from msgspec import inspect

from flying_vines.config.config import FIRST_FREE_CHANNEL, Config, SwitchConfig

Guard = Literal["none", "max", "min"]


@dataclass(frozen=True, slots=True)
class ParameterRow:
    """One parameter: a float over MAVLink, and its key in the configuration."""

    name: str
    """At most 16 characters (MAVLink)."""
    table: str
    key: str
    doc: str
    guard: Guard = "none"
    """ "max": the configuration's value is the maximum that may be set; "min": the minimum."""
    min: float = -math.inf
    """Lower limit; used if it is above the lower limit of the key."""
    max: float = math.inf
    """Upper limit; used if it is below the upper limit of the key."""
    choices: tuple[str | bool, ...] = ()
    """The values for the numbers 0, 1 …; empty if the number itself is the value."""
    in_flight: bool = False
    """True: the parameter does not affect motion, so it may change while the vine is bent."""


VENT_OR_HOLD = ("vent", "hold")

SETTINGS = (
    ParameterRow(
        "VINE_SW_CHAN", "switch", "channel", "RC channel of the switch", min=float(FIRST_FREE_CHANNEL)
    ),
    ParameterRow("VINE_SW_DEBOUNCE", "switch", "debounce_s", "time that a new switch position must last, s"),
    ParameterRow(
        "VINE_SW_HYST_US",
        "switch",
        "hysteresis_us",
        "distance past a boundary until the position changes, us",
    ),
    ParameterRow("VINE_RC_LOSS_S", "losses", "rc_s", "time without RC_CHANNELS until RC is lost, s", "max"),
    ParameterRow("VINE_RC_ACTION", "losses", "on_rc_loss", "RC lost: 0 vent, 1 hold", choices=VENT_OR_HOLD),
    ParameterRow(
        "VINE_AP_LOSS_S",
        "losses",
        "autopilot_s",
        "time without a message until the autopilot is lost, s",
        "max",
    ),
    ParameterRow(
        "VINE_HOLD_MAX_S",
        "losses",
        "hold_at_most_s",
        "maximum hold time after RC losses, s; then vent",
        "max",
        0.5,
    ),
    ParameterRow("VINE_MAX_KPA", "limits", "max_kPa", "maximum setpoint, gauge kPa", "max", 0.5),
    ParameterRow("VINE_MAX_RATE", "limits", "max_rate_kPa_per_s", "maximum rate, kPa/s", "max", 1.0),
    ParameterRow(
        "VINE_MAX_BENT_S",
        "limits",
        "max_bent_s",
        "maximum time bent after a trigger, s; then vent",
        "max",
        1.0,
    ),
    ParameterRow(
        "VINE_MIN_ALT_M",
        "interlocks",
        "min_altitude_m",
        "minimum altitude above home to bend, m",
        "min",
    ),
    ParameterRow(
        "VINE_RESERVE_KPA",
        "interlocks",
        "reserve_kPa",
        "minimum pressure in the reservoir, gauge kPa",
        "min",
    ),
    ParameterRow("VINE_RATE_HZ", "telemetry", "rate_Hz", "rate of each named value, Hz", in_flight=True),
    ParameterRow(
        "VINE_LOW_CYCLES",
        "telemetry",
        "low_reservoir_cycles",
        "warn below this number of cycles left",
        in_flight=True,
    ),
)
"""In the order of their MAVLink index, which is constant while the service runs."""

BY_NAME = {setting.name: setting for setting in SETTINGS}


class ParameterRefused(Exception):
    """The value is not allowed; `reason` is a text for people."""

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(f"{name}: {reason}")
        self.name = name
        self.reason = reason


def value_of(setting: ParameterRow, config: Config) -> float:
    """The parameter's number in a configuration."""
    value = getattr(getattr(config, setting.table), setting.key)
    return float(setting.choices.index(value)) if setting.choices else float(value)


def bounds(setting: ParameterRow, base: Config) -> tuple[float, float]:
    """The minimum and maximum that may be set: the strictest limits of the key, the row and the guard."""
    lower, upper = setting.min, setting.max
    kind = _type(setting)
    if setting.choices:
        lower, upper = 0.0, len(setting.choices) - 1.0
    elif isinstance(kind, inspect.FloatType | inspect.IntType):
        lower = max(lower, -math.inf if kind.ge is None else kind.ge)
        upper = min(upper, math.inf if kind.le is None else kind.le)
    # The value of `base` is always allowed.
    own = value_of(setting, base)
    lower = max(lower, own) if setting.guard == "min" else min(lower, own)
    upper = min(upper, own) if setting.guard == "max" else max(upper, own)
    return lower, upper


def changed(base: Config, config: Config, name: str, value: float) -> Config:
    """The configuration with a new value. Raises `ParameterRefused` if `base` does not allow it.

    Args:
        base: the configuration without any parameters.
        config: the configuration with the present values.
        name: the parameter's name.
        value: the received value; it may be NaN or infinite.
    """
    setting = BY_NAME[name]
    table = getattr(config, setting.table)
    table = msgspec.structs.replace(table, **{setting.key: _checked(setting, base, value)})
    if isinstance(table, SwitchConfig) and (problem := table.channel_problem):
        raise ParameterRefused(name, problem)
    return msgspec.structs.replace(config, **{setting.table: table})


def decimal(value: float) -> float:
    """The shortest decimal number for this 32-bit float: 0.15, not 0.15000000596."""
    for digits in range(6, 9):
        short = float(f"{value:.{digits}g}")
        if same(short, value):
            return short
    return value


def same(one: float, other: float) -> bool:
    """True if two numbers are equal as 32-bit floats."""
    return c_float(one).value == c_float(other).value


def _checked(setting: ParameterRow, base: Config, value: float) -> float | str | bool:
    """The value for the configuration, after all checks."""
    if not math.isfinite(value):
        raise ParameterRefused(setting.name, "it must be a number")
    lower, upper = bounds(setting, base)
    if not lower <= value <= upper:
        raise ParameterRefused(setting.name, f"{value:g} is outside {lower:g} to {upper:g}")
    if not setting.choices and not isinstance(_type(setting), inspect.IntType):
        return value
    if value != int(value):
        raise ParameterRefused(setting.name, f"{value:g} is not a whole number")
    return setting.choices[int(value)] if setting.choices else int(value)


@cache
def _type(setting: ParameterRow) -> inspect.Type:
    info = inspect.type_info(get_type_hints(Config)[setting.table])
    assert isinstance(info, inspect.StructType)
    return next(field.type for field in info.fields if field.name == setting.key)
