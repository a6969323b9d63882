"""A profile segment: a swing that becomes faster, one cycle at a time."""

from collections.abc import Iterator

from flying_vines.vine.profile import Sine


def chirp(from_kPa: float, to_kPa: float, from_Hz: float, to_Hz: float, cycles: float) -> Iterator[Sine]:
    for cycle in range(int(cycles)):
        share = cycle / max(1, int(cycles) - 1)
        yield Sine(frequency_Hz=from_Hz * (to_Hz / from_Hz) ** share, from_kPa=from_kPa, to_kPa=to_kPa)
