"""Reading of a true pressure: lag, offset and drift, gain, noise, range, converter (ADC), in this order.

dx/dt = (P − x) / τ     reading = gain · (x + offset + drift · t) + noise, clipped to the range, in ADC steps
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import exp, floor, inf
from typing import NamedTuple


@dataclass(frozen=True)
class Adc:
    """A converter behind a ratiometric sensor, whose output is 10 … 90 % of its supply over the span.

    code = round(V · divider / reference · 2^bits), at most 2^bits − 1. Without a divider the converter of the
    Teensy LC ends at 3.3 V. This is 145 kPa for a sensor with a span of 206.8 kPa, and 1050 kPa for 1500 kPa.
    """

    bits: int = 10
    reference_V: float = 3.3
    divider: float = 1.0
    zero_V: float = 0.5
    span_V: float = 4.0

    def __post_init__(self) -> None:
        if not (1 <= self.bits <= 24 and self.reference_V > 0.0 and self.divider > 0.0 and self.span_V > 0.0):
            raise ValueError("a converter needs 1 to 24 bits, and reference, divider and span above 0")

    def step_kPa(self, span_kPa: float) -> float:
        """Pressure per code."""
        return self.reference_V / self.divider / self.span_V * span_kPa / float(1 << self.bits)

    def code(self, pressure_kPa: float, span_kPa: float) -> int:
        """The code for a pressure."""
        return _code(self, pressure_kPa, span_kPa)

    def pressure_kPa(self, code: int, span_kPa: float) -> float:
        """The pressure that the firmware computes from a code."""
        return _pressure_kPa(self, code, span_kPa)


def _code(adc: Adc, pressure_kPa: float, span_kPa: float) -> int:
    volts = adc.zero_V + adc.span_V * pressure_kPa / span_kPa
    code = floor(volts * adc.divider / adc.reference_V * float(1 << adc.bits) + 0.5)
    return min((1 << adc.bits) - 1, max(0, code))


def _pressure_kPa(adc: Adc, code: int, span_kPa: float) -> float:
    volts = code / float(1 << adc.bits) * adc.reference_V / adc.divider
    return (volts - adc.zero_V) / adc.span_V * span_kPa


class Transfer(NamedTuple):
    """The numbers of a sensor."""

    span_kPa: float
    noise_std_kPa: float
    offset_kPa: float
    drift_kPa_per_s: float
    gain: float
    time_constant_s: float
    lowest_kPa: float
    highest_kPa: float
    has_adc: bool
    adc: Adc


@dataclass(frozen=True)
class Sensor:
    """A gauge pressure sensor. With the defaults it is perfect.

    `span_kPa` is the pressure range of 10 … 90 % output. Readings are limited to `lowest_share` …
    `highest_share` of this range.
    """

    span_kPa: float = 206.84
    noise_std_kPa: float = 0.0
    offset_kPa: float = 0.0
    gain: float = 1.0
    time_constant_s: float = 0.0
    lowest_share: float | None = None
    highest_share: float | None = None
    adc: Adc | None = None
    drift_kPa_per_min: float = 0.0
    """Drift of the offset, from the first reading on."""

    def __post_init__(self) -> None:
        if not (self.span_kPa > 0.0 and self.noise_std_kPa >= 0.0 and self.time_constant_s >= 0.0):
            raise ValueError("a sensor's span must be positive, its noise and lag not negative")

    @cached_property
    def numbers(self) -> Transfer:
        return Transfer(
            self.span_kPa,
            self.noise_std_kPa,
            self.offset_kPa,
            self.drift_kPa_per_min / 60.0,
            self.gain,
            self.time_constant_s,
            -inf if self.lowest_share is None else self.lowest_share * self.span_kPa,
            inf if self.highest_share is None else self.highest_share * self.span_kPa,
            self.adc is not None,
            self.adc or Adc(),
        )


HONEYWELL_30PSI = Sensor(
    206.84, noise_std_kPa=0.15, time_constant_s=0.001, lowest_share=-0.09375, highest_share=1.09375
)
"""ABPDANN030PGAA5. Assumptions: lag = update time; output limits at 2.5 and 97.5 % of the supply."""
HONEYWELL_15BAR = Sensor(
    1500.0, noise_std_kPa=1.2, time_constant_s=0.001, lowest_share=-0.09375, highest_share=1.09375
)
"""ABPDANN015BGAA5, with the same assumptions."""


_SHORT = 0.02
"""Below this ratio of step to time constant, Simpson's rule is more accurate than the closed form."""


class SensorMemory(NamedTuple):
    """State of a sensor at the last reading: true and lagged pressure, kPa, and time since the start."""

    true_kPa: float
    lagged_kPa: float
    elapsed_s: float


def rested(true_kPa: float) -> SensorMemory:
    """A settled sensor at this pressure."""
    return SensorMemory(true_kPa, true_kPa, 0.0)


def read(
    sensor: Sensor, seen: SensorMemory, true_kPa: float, dt_s: float, standard_normal: float = 0.0
) -> tuple[SensorMemory, float]:
    """The new state, and the reading `dt_s` after the last one, with this noise.

    The lag is exact for a pressure that is linear between the two readings.
    """
    return reading(sensor.numbers, seen, true_kPa, dt_s, standard_normal)


def reading(
    sensor: Transfer, seen: SensorMemory, true_kPa: float, dt_s: float, standard_normal: float
) -> tuple[SensorMemory, float]:
    """`read` for the numbers of a sensor."""
    lagged_kPa = true_kPa
    tau_s = sensor.time_constant_s
    if tau_s > 0.0:
        lagged_kPa = seen.lagged_kPa
        if dt_s > 0.0:
            behind_kPa = tau_s * (true_kPa - seen.true_kPa) / dt_s
            left = exp(-dt_s / tau_s)
            lagged_kPa = true_kPa - behind_kPa + (seen.lagged_kPa - seen.true_kPa + behind_kPa) * left
    seen = SensorMemory(true_kPa, lagged_kPa, seen.elapsed_s + dt_s)
    return seen, transferred(sensor, seen, standard_normal)


def transferred(sensor: Transfer, seen: SensorMemory, standard_normal: float) -> float:
    """The reading of a sensor in this state."""
    offset_kPa = sensor.offset_kPa + sensor.drift_kPa_per_s * seen.elapsed_s
    kPa = sensor.gain * (seen.lagged_kPa + offset_kPa) + sensor.noise_std_kPa * standard_normal
    kPa = min(sensor.highest_kPa, max(sensor.lowest_kPa, kPa))
    if sensor.has_adc:
        kPa = _pressure_kPa(sensor.adc, _code(sensor.adc, kPa, sensor.span_kPa), sensor.span_kPa)
    return kPa


def lagged_kPa(
    time_constant_s: float,
    before_kPa: float,
    from_kPa: float,
    from_kPa_per_s: float,
    to_kPa: float,
    to_kPa_per_s: float,
    dt_s: float,
) -> float:
    """The lagged pressure `dt_s` after it was `before_kPa`.

    It is exact for a true pressure that is cubic in time, with these values and rates at both ends.
    """
    if time_constant_s == 0.0:
        return to_kPa
    first, last, change = from_kPa_per_s * dt_s, to_kPa_per_s * dt_s, to_kPa - from_kPa
    x = dt_s / time_constant_s
    left = exp(-x)
    if x < _SHORT:
        # For such a short step the recursion below would lose digits.
        middle_kPa = 0.5 * (from_kPa + to_kPa) + (first - last) / 8.0
        return before_kPa * left + x / 6.0 * (from_kPa * left + 4.0 * middle_kPa * exp(-0.5 * x) + to_kPa)
    one = 1.0 + (left - 1.0) / x
    two = 1.0 - 2.0 * one / x
    three = 1.0 - 3.0 * two / x
    square, cube = 3.0 * change - 2.0 * first - last, first + last - 2.0 * change
    return from_kPa + (before_kPa - from_kPa) * left + first * one + square * two + cube * three
