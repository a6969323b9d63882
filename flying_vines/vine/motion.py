"""A motion of the vine: planned from segments, judged by safety, followed until the next one."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from flying_vines.vine.curve import BendCurve
from flying_vines.vine.profile import HoldFor, Ramp, Segment, Sine, Step, ends_kPa, top_kPa

AT_REST_KPA = 0.5
"""Gauge; below it a vine is straight."""


@dataclass(frozen=True, slots=True)
class Motion:
    """A pressure over time, continuous and never steeper than its rate limit. Gauge kPa.

    The core follows it from `started_at`. Mission planning leaves `started_at` at 0.
    """

    name: str
    started_at: float
    pieces: tuple[tuple[float, float, Callable[[float], float]], ...]
    """(begin_s, end_s, pressure as a function of the seconds since begin_s)."""
    start_kPa: float
    aim_kPa: float
    """Target of the first segment that is not a hold; for a sine, its second value."""
    final_kPa: float
    """Held after `duration_s`."""
    peak_kPa: float
    """The highest pressure of the motion, including its start."""
    top_kPa: float
    """The highest target of the segments, clipped to the pressure limit."""
    wanted_kPa: float
    """`top_kPa` before clipping."""
    rise_kPa: float
    """The sum of all rises. They cost air."""
    duration_s: float
    rate_kPa_per_s: float
    bent_kPa: float
    """The bend at the end, as the pressure that makes it during inflation (`BendCurve.bent_kPa`)."""

    def setpoint_kPa(self, t: float) -> float:
        since_s = t - self.started_at
        if since_s <= 0.0:
            return self.start_kPa
        for begin, end, value in self.pieces:
            if since_s < end:
                return value(since_s - begin)
        return self.final_kPa

    def is_over(self, t: float) -> bool:
        return t - self.started_at >= self.duration_s

    @property
    def only_deflates(self) -> bool:
        return self.rise_kPa <= 0.0 and self.final_kPa <= 0.0

    @property
    def stays_bent(self) -> bool:
        return self.final_kPa > AT_REST_KPA


def plan(
    segments: Sequence[Segment],
    curve: BendCurve,
    start_kPa: float,
    rate_kPa_per_s: float,
    max_kPa: float,
    bent_kPa: float | None = None,
    *,
    name: str = "",
    started_at: float = 0.0,
) -> Motion:
    """The motion through `segments` from `start_kPa` (gauge), within the rate and pressure limits.

    A sine that is too fast for the rate limit is slowed down. A value above `max_kPa` is clipped to it.
    With hysteresis an angle has one pressure for inflation and one for deflation. The present bend `bent_kPa`
    selects one of them (see `BendCurve.bent_kPa`). Its default is the bend of `start_kPa` during inflation.
    """
    bent = start_kPa if bent_kPa is None else bent_kPa

    def wanted(deg: float | None, kPa: float | None) -> float:
        nonlocal bent
        pressure = kPa or 0.0
        if deg is not None:
            pressure = curve.toward_kPa(curve.pressure_kPa(deg), bent)
        pressure = min(max(pressure, 0.0), max_kPa)
        bent = curve.bent_kPa(pressure, bent)
        return pressure

    pieces: list[tuple[float, float, Callable[[float], float]]] = []
    t, at, peak, rise = 0.0, start_kPa, start_kPa, 0.0
    aims: list[float] = []

    def move(to: float, min_s: float) -> None:
        nonlocal t, at, peak, rise
        takes = max(abs(to - at) / rate_kPa_per_s, min_s)
        if takes > 0.0:
            pieces.append((t, t + takes, _line(at, to, takes)))
            t += takes
        rise += max(0.0, to - at)
        at, peak = to, max(peak, to)

    for segment in segments:
        if isinstance(segment, Step):
            aims.append(wanted(segment.to_deg, segment.to_kPa))
            move(aims[-1], 0.0)
        elif isinstance(segment, Ramp):
            aims.append(wanted(segment.to_deg, segment.to_kPa))
            move(aims[-1], segment.over_s)
        elif isinstance(segment, HoldFor):
            move(at, segment.for_s)
        elif isinstance(segment, Sine):
            low, high = (min(max(end, 0.0), max_kPa) for end in ends_kPa(segment, curve))
            aims.append(high)
            move(low, 0.0)
            fastest_Hz = rate_kPa_per_s / (math.pi * abs(high - low)) if high != low else math.inf
            frequency_Hz = min(segment.frequency_Hz, fastest_Hz)
            takes = segment.cycles / frequency_Hz
            swing = _swing(low, high, frequency_Hz)
            pieces.append((t, t + takes, swing))
            t += takes
            rise += _sine_rise(low, high, segment.cycles)
            at, peak = swing(takes), max(peak, low, high)
            halves = math.floor(2.0 * segment.cycles)
            for turn in range(max(0, halves - 1), halves + 1):
                bent = curve.bent_kPa(high if turn % 2 else low, bent)
            bent = curve.bent_kPa(at, bent)
    furthest_kPa = curve.bent_kPa(peak, start_kPa if bent_kPa is None else bent_kPa)
    return Motion(
        name=name,
        started_at=started_at,
        pieces=tuple(pieces),
        start_kPa=start_kPa,
        aim_kPa=aims[0] if aims else at,
        final_kPa=at,
        peak_kPa=peak,
        top_kPa=top_kPa(segments, curve, max_kPa),
        wanted_kPa=top_kPa(segments, curve, math.inf),
        rise_kPa=rise,
        duration_s=t,
        rate_kPa_per_s=rate_kPa_per_s,
        bent_kPa=curve.bent_kPa(at, furthest_kPa),
    )


def _line(start: float, end: float, takes: float) -> Callable[[float], float]:
    return lambda t: start + (end - start) * t / takes


def _swing(low: float, high: float, frequency_Hz: float) -> Callable[[float], float]:
    return lambda t: low + (high - low) * 0.5 * (1.0 - math.cos(2.0 * math.pi * frequency_Hz * t))


def _sine_rise(low: float, high: float, cycles: float) -> float:
    """The sum of all rises of a sine. A sine that starts high falls first."""
    whole, part = divmod(cycles, 1.0)
    moved = 0.5 * (1.0 - math.cos(2.0 * math.pi * part))
    up_first = moved if part <= 0.5 else 1.0
    down_first = 0.0 if part <= 0.5 else 1.0 - moved
    return abs(high - low) * (whole + (up_first if high > low else down_first))
