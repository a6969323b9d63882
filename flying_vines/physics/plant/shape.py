"""What the control volume's volume does: rigid, compliant, or a pouch that first fills at no pressure.

What is known of the gas inside is not its p V alone but E = p V + g W, where W = ∫ p dV is the work it has
done on wall and ambient since the smallest volume, and g = γ − 1 with a temperature of its own, 0 when
isothermal. E has no jump in its rate where a pouch becomes full, as p V has.

A shape is a description; `numbers(volume_L, g)` are what `pressure_and_volume` calculates with. All shapes
are a pouch then: a compliant one has no volume to fill first.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

_NO_EDGE_L = -1.0


class Chamber(NamedTuple):
    """The numbers of a shape."""

    flat_L: float
    """The smallest volume: from where work counts, and what is left in a vacuum."""
    full_L: float
    per_kPa: float
    g: float
    flat_edge_L: float
    """E / p_a where the law has a kink; below 0 where it has none."""
    full_edge_L: float


def pressure_and_volume(chamber: Chamber, energy: float, ambient_kPa: float) -> tuple[float, float]:
    """Absolute pressure in kPa and volume in L, of E in kPa·L."""
    g, flat, full = chamber.g, chamber.flat_L, chamber.full_L
    beyond = energy - g * (full - flat) * ambient_kPa
    rigid_kPa = beyond / full
    if rigid_kPa >= ambient_kPa:
        k = chamber.per_kPa
        if k == 0.0:
            return rigid_kPa, full
        rigid_kPa -= ambient_kPa
        # The positive root of k (1 + g/2) P² + (1 + (1 + g) k p_a) P = rigid, as it survives k → 0.
        linear = 1.0 + (1.0 + g) * k * ambient_kPa
        gauge = 2.0 * rigid_kPa / (linear + sqrt(linear * linear + 4.0 * k * (1.0 + 0.5 * g) * rigid_kPa))
        return ambient_kPa + gauge, full * (1.0 + k * gauge)
    if energy >= ambient_kPa * flat:
        return ambient_kPa, (energy / ambient_kPa + g * flat) / (1.0 + g)
    return energy / flat, flat


def volume_and_work(
    chamber: Chamber, gauge_kPa: float, ambient_kPa: float, fill_L: float
) -> tuple[float, float]:
    """Volume in L and the work W in J at a gauge pressure; at none a pouch holds `fill_L`."""
    flat, full = chamber.flat_L, chamber.full_L
    if gauge_kPa > 0.0:
        stretch = full * chamber.per_kPa
        work = stretch * (ambient_kPa * gauge_kPa + gauge_kPa * gauge_kPa / 2.0)
        return full + stretch * gauge_kPa, work + ambient_kPa * (full - flat)
    volume = flat
    if gauge_kPa == 0.0:
        volume = min(full, max(flat, fill_L))
    return volume, ambient_kPa * (volume - flat)


@dataclass(frozen=True)
class Compliant:
    """V = V₀ (1 + k P) for gauge pressures P > 0, V₀ below; W = V₀ k (p_a P + P²/2). k = 0 is rigid."""

    per_kPa: float = 0.0

    def __post_init__(self) -> None:
        if not self.per_kPa >= 0.0:
            raise ValueError("a compliance is not negative")

    def numbers(self, volume_L: float, g: float) -> Chamber:
        edge_L = volume_L if self.per_kPa > 0.0 else _NO_EDGE_L
        return Chamber(volume_L, volume_L, self.per_kPa, g, _NO_EDGE_L, edge_L)


@dataclass(frozen=True)
class Pouch:
    """Between its flat and its full volume it is at ambient pressure; then it is compliant or rigid."""

    flat_volume_L: float = 0.01
    per_kPa: float = 0.0

    def __post_init__(self) -> None:
        if not (self.flat_volume_L > 0.0 and self.per_kPa >= 0.0):
            raise ValueError("a pouch's flat volume is positive, its compliance not negative")

    def numbers(self, volume_L: float, g: float) -> Chamber:
        flat_L = self.flat_volume_L
        if not flat_L < volume_L:
            raise ValueError("a pouch's flat volume is smaller than the full one")
        return Chamber(flat_L, volume_L, self.per_kPa, g, flat_L, volume_L + g * (volume_L - flat_L))


Shape = Compliant | Pouch
