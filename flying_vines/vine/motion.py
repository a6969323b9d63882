"""A motion of the vine: planned from segments, judged by safety, followed until the next motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from flying_vines.vine.curve import BendCurve
from flying_vines.vine.profile import HoldFor, Ramp, Segment, Sine, Step, ends_kPa, top_kPa

AT_REST_KPA = 0.5
"""Gauge. At or below this pressure a vine counts as straight."""


@dataclass(frozen=True, slots=True)
class Motion:
    """A pressure over time, continuous and never steeper than its rate limit. Gauge kPa.

    The core follows it from `started_at`. Mission planning leaves `started_at` at 0.
    """

    name: str
    started_at: float
    pieces: tuple[tuple[float, float, Callable[[float], float]], ...]
    """Begin and end in seconds since `started_at`, and the pressure as a function of the time since begin."""
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
    before_kPa = start_kPa if bent_kPa is None else bent_kPa
    path = _Path(curve, rate_kPa_per_s, max_kPa, start_kPa, before_kPa)
    for segment in segments:
        if isinstance(segment, Step):
            path.move_to(segment.to_deg, segment.to_kPa, 0.0)
        elif isinstance(segment, Ramp):
            path.move_to(segment.to_deg, segment.to_kPa, segment.over_s)
        elif isinstance(segment, HoldFor):
            path.hold(segment.for_s)
        elif isinstance(segment, Sine):
            path.swing(segment)
    return Motion(
        name=name,
        started_at=started_at,
        pieces=tuple(path.pieces),
        start_kPa=start_kPa,
        aim_kPa=path.at_kPa if path.aim_kPa is None else path.aim_kPa,
        final_kPa=path.at_kPa,
        peak_kPa=path.peak_kPa,
        top_kPa=top_kPa(segments, curve, max_kPa),
        wanted_kPa=top_kPa(segments, curve, math.inf),
        rise_kPa=path.rise_kPa,
        duration_s=path.t,
        rate_kPa_per_s=rate_kPa_per_s,
        bent_kPa=path.bent_kPa,
    )


class _Path:
    """The pressure over time, extended by one segment after another."""

    def __init__(
        self, curve: BendCurve, rate_kPa_per_s: float, max_kPa: float, start_kPa: float, bent_kPa: float
    ) -> None:
        self._curve = curve
        self._rate_kPa_per_s = rate_kPa_per_s
        self._max_kPa = max_kPa
        self.bent_kPa = bent_kPa
        """The bend after the segments so far, as in `BendCurve.bent_kPa`."""
        self.pieces: list[tuple[float, float, Callable[[float], float]]] = []
        self.t = 0.0
        self.at_kPa = self.peak_kPa = start_kPa
        self.rise_kPa = 0.0
        self.aim_kPa: float | None = None

    def move_to(self, deg: float | None, kPa: float | None, min_s: float) -> None:
        """Go to an angle or a pressure, in `min_s` or longer."""
        pressure = kPa or 0.0
        if deg is not None:
            pressure = self._curve.toward_kPa(self._curve.pressure_kPa(deg), self.bent_kPa)
        pressure = self._clipped(pressure)
        self.bent_kPa = self._curve.bent_kPa(pressure, self.bent_kPa)
        self._aim(pressure)
        self._move(pressure, min_s)

    def hold(self, for_s: float) -> None:
        self._move(self.at_kPa, for_s)

    def swing(self, sine: Sine) -> None:
        """Go to the sine's first end, then follow it, at its frequency or slower."""
        low, high = (self._clipped(end) for end in ends_kPa(sine, self._curve))
        self._aim(high)
        self._move(low, 0.0)
        fastest_Hz = self._rate_kPa_per_s / (math.pi * abs(high - low)) if high != low else math.inf
        frequency_Hz = min(sine.frequency_Hz, fastest_Hz)
        swing = _swing(low, high, frequency_Hz)
        duration_s = sine.cycles / frequency_Hz
        self._append(duration_s, swing)
        self.rise_kPa += _sine_rise(low, high, sine.cycles)
        self.at_kPa, self.peak_kPa = swing(duration_s), max(self.peak_kPa, low, high)
        halves = math.floor(2.0 * sine.cycles)
        for turn in range(max(0, halves - 1), halves + 1):
            self.bent_kPa = self._curve.bent_kPa(high if turn % 2 else low, self.bent_kPa)
        self.bent_kPa = self._curve.bent_kPa(self.at_kPa, self.bent_kPa)

    def _clipped(self, kPa: float) -> float:
        return min(max(kPa, 0.0), self._max_kPa)

    def _aim(self, kPa: float) -> None:
        if self.aim_kPa is None:
            self.aim_kPa = kPa

    def _move(self, to_kPa: float, min_s: float) -> None:
        duration_s = max(abs(to_kPa - self.at_kPa) / self._rate_kPa_per_s, min_s)
        if duration_s > 0.0:
            self._append(duration_s, _line(self.at_kPa, to_kPa, duration_s))
        self.rise_kPa += max(0.0, to_kPa - self.at_kPa)
        self.at_kPa, self.peak_kPa = to_kPa, max(self.peak_kPa, to_kPa)

    def _append(self, duration_s: float, kPa: Callable[[float], float]) -> None:
        self.pieces.append((self.t, self.t + duration_s, kPa))
        self.t += duration_s


def _line(start: float, end: float, duration_s: float) -> Callable[[float], float]:
    return lambda t: start + (end - start) * t / duration_s


def _swing(low: float, high: float, frequency_Hz: float) -> Callable[[float], float]:
    return lambda t: low + (high - low) * 0.5 * (1.0 - math.cos(2.0 * math.pi * frequency_Hz * t))


def _sine_rise(low: float, high: float, cycles: float) -> float:
    """The sum of all rises of a sine. A sine that starts high falls first."""
    whole, part = divmod(cycles, 1.0)
    moved = 0.5 * (1.0 - math.cos(2.0 * math.pi * part))
    up_first = moved if part <= 0.5 else 1.0
    down_first = 0.0 if part <= 0.5 else 1.0 - moved
    return abs(high - low) * (whole + (up_first if high > low else down_first))
