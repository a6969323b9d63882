"""Pressure profiles of the configuration: segments, repeats, profiles inside profiles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import msgspec

from flying_vines.vine.curve import BendCurve

MAX_NESTING = 8
MAX_PIECES = 10_000
MIN_VALUE, MAX_VALUE = 1e-4, 1e6
"""Limits of durations, cycles, frequencies and rates. Larger numbers make times imprecise, smaller ones
overflow."""


class _Segment(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind"):
    """One part of a profile."""


class Step(_Segment, tag="step", frozen=True):
    """Go to a value as fast as the rate limit allows."""

    to_deg: float | None = None
    to_kPa: float | None = None

    def __post_init__(self) -> None:
        _exactly_one(self.to_deg, self.to_kPa, "to_deg", "to_kPa")


class Ramp(_Segment, tag="ramp", frozen=True):
    """Ramp linearly to a value in `over_s` seconds; longer if the rate limit requires it."""

    over_s: float
    to_deg: float | None = None
    to_kPa: float | None = None

    def __post_init__(self) -> None:
        _exactly_one(self.to_deg, self.to_kPa, "to_deg", "to_kPa")
        _positive(self.over_s, "over_s")


class HoldFor(_Segment, tag="hold", frozen=True):
    """Stay for `for_s` seconds."""

    for_s: float

    def __post_init__(self) -> None:
        _positive(self.for_s, "for_s")


class Sine(_Segment, tag="sine", frozen=True):
    """Swing between two values, starting at the first, for a number of cycles."""

    frequency_Hz: float
    cycles: float = 1.0
    from_deg: float | None = None
    to_deg: float | None = None
    from_kPa: float | None = None
    to_kPa: float | None = None

    def __post_init__(self) -> None:
        in_deg = self.from_deg is not None and self.to_deg is not None
        in_kPa = self.from_kPa is not None and self.to_kPa is not None
        given = sum(x is not None for x in (self.from_deg, self.to_deg, self.from_kPa, self.to_kPa))
        if given != 2 or not (in_deg or in_kPa):
            raise ValueError("a sine needs from_deg and to_deg, or from_kPa and to_kPa")
        _positive(self.frequency_Hz, "frequency_Hz")
        _positive(self.cycles, "cycles")
        _positive(self.cycles / self.frequency_Hz, "cycles / frequency_Hz")


class Sub(_Segment, tag="profile", frozen=True):
    """Run another profile of the configuration, `repeat` times."""

    name: str
    repeat: int = 1

    def __post_init__(self) -> None:
        if not 1 <= self.repeat <= 1000:
            raise ValueError(f"repeat must be 1 to 1000, not {self.repeat}")


Segment = Step | Ramp | HoldFor | Sine | Sub


class PressureProfile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A sequence of segments. After the last segment its value is held."""

    segments: tuple[Segment, ...]
    repeat: int = 1
    rate_kPa_per_s: float | None = None
    """Optional rate limit of this profile. If `limits.max_rate_kPa_per_s` is lower, that limit applies."""

    def __post_init__(self) -> None:
        if not self.segments:
            raise ValueError("a profile needs at least one segment")
        if not 1 <= self.repeat <= 1000:
            raise ValueError(f"repeat must be 1 to 1000, not {self.repeat}")
        if self.rate_kPa_per_s is not None:
            _positive(self.rate_kPa_per_s, "rate_kPa_per_s")


def _exactly_one(a: float | None, b: float | None, name_a: str, name_b: str) -> None:
    if (a is None) == (b is None):
        raise ValueError(f"give either {name_a} or {name_b}")


def _positive(value: float, name: str) -> None:
    if not MIN_VALUE <= value <= MAX_VALUE:
        raise ValueError(f"{name} must be from {MIN_VALUE:g} to {MAX_VALUE:.0f}, not {value:g}")


def flatten(
    profiles: Mapping[str, PressureProfile], name: str, _inside: tuple[str, ...] = ()
) -> Iterator[Segment]:
    """The segments of a profile in order, repeats and sub-profiles unrolled.

    Raises `ValueError` with the profile's name if the profile contains itself, is missing, is nested too
    deeply, or has more than `MAX_PIECES` segments.
    """
    if name not in profiles:
        raise ValueError(f"there is no profile '{name}'")
    if name in _inside:
        raise ValueError(f"profile '{name}' contains itself")
    if len(_inside) >= MAX_NESTING:
        raise ValueError(f"profile '{name}' is nested more than {MAX_NESTING} deep")
    pieces = 0
    for _ in range(profiles[name].repeat):
        for segment in profiles[name].segments:
            inner: Iterator[Segment] = (
                (s for _ in range(segment.repeat) for s in flatten(profiles, segment.name, (*_inside, name)))
                if isinstance(segment, Sub)
                else iter((segment,))
            )
            for piece in inner:
                pieces += 1
                if pieces > MAX_PIECES:
                    raise ValueError(f"profile '{name}' unrolls to more than {MAX_PIECES} segments")
                yield piece


def ends_kPa(sine: Sine, curve: BendCurve) -> tuple[float, float]:
    """The two gauge pressures between which a sine swings, the start first.

    The larger angle uses the inflation curve. The smaller angle uses the deflation curve, whose pressure is
    lower by the hysteresis. So the vine reaches both angles.
    """
    if sine.from_deg is None or sine.to_deg is None:
        return sine.from_kPa or 0.0, sine.to_kPa or 0.0
    start, end = curve.pressure_kPa(sine.from_deg), curve.pressure_kPa(sine.to_deg)
    if start == end:
        return start, end
    if start < end:
        return curve.toward_kPa(start, end), end
    return start, curve.toward_kPa(end, start)


def top_kPa(segments: Sequence[Segment], curve: BendCurve, max_kPa: float) -> float:
    """The highest gauge pressure among the segments' targets, clipped to `max_kPa`."""
    highest = 0.0
    for segment in segments:
        for end in ("to", "from"):
            deg, kPa = getattr(segment, f"{end}_deg", None), getattr(segment, f"{end}_kPa", None)
            if deg is not None or kPa is not None:
                highest = max(highest, curve.pressure_kPa(deg) if deg is not None else kPa or 0.0)
    return min(highest, max_kPa)
