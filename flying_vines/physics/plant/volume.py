"""Shape of the control volume: rigid, compliant, or a bending pouch that first fills at ambient pressure.

The state of the gas is E = p V + g W. W = ∫ p dV is the work on wall and ambient, from the smallest volume
on. g is γ − 1 for gas with its own temperature, and 0 for isothermal gas. E is the state, and not p V,
because the rate of E is continuous. The rate of p V jumps when a pouch becomes full.

`numbers(volume_L, g)` converts each shape to the numbers of a pouch, for `pressure_and_volume`. A compliant
or rigid shape is a pouch whose flat volume equals its full volume.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

_NO_EDGE_L = -1.0


class Chamber(NamedTuple):
    """The numbers of a shape."""

    flat_L: float
    """The smallest volume, also under vacuum. W is 0 at this volume."""
    full_L: float
    per_kPa: float
    g: float
    flat_edge_L: float
    """E / p_a at which the pouch becomes flat; below 0 without this kink."""
    full_edge_L: float
    """E / p_a at which the pouch becomes full; below 0 without this kink."""


def pressure_and_volume(chamber: Chamber, energy: float, ambient_kPa: float) -> tuple[float, float]:
    """Absolute pressure in kPa and volume in L, from E in kPa·L."""
    g, flat, full = chamber.g, chamber.flat_L, chamber.full_L
    beyond = energy - g * (full - flat) * ambient_kPa
    rigid_kPa = beyond / full
    if rigid_kPa >= ambient_kPa:
        k = chamber.per_kPa
        if k == 0.0:
            return rigid_kPa, full
        rigid_kPa -= ambient_kPa
        # The positive root of k (1 + g/2) P² + (1 + (1 + g) k p_a) P = rigid, in a form valid for k → 0.
        linear = 1.0 + (1.0 + g) * k * ambient_kPa
        gauge = 2.0 * rigid_kPa / (linear + sqrt(linear * linear + 4.0 * k * (1.0 + 0.5 * g) * rigid_kPa))
        return ambient_kPa + gauge, full * (1.0 + k * gauge)
    if energy >= ambient_kPa * flat:
        return ambient_kPa, (energy / ambient_kPa + g * flat) / (1.0 + g)
    return energy / flat, flat


def volume_and_work(
    chamber: Chamber, gauge_kPa: float, ambient_kPa: float, fill_L: float
) -> tuple[float, float]:
    """Volume in L and work W in J at a gauge pressure; at 0 kPa a pouch has the volume `fill_L`."""
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
            raise ValueError("a compliance must not be negative")

    def numbers(self, volume_L: float, g: float) -> Chamber:
        edge_L = volume_L if self.per_kPa > 0.0 else _NO_EDGE_L
        return Chamber(volume_L, volume_L, self.per_kPa, g, _NO_EDGE_L, edge_L)


@dataclass(frozen=True)
class Pouch:
    """Fills from its flat to its full volume at ambient pressure; above ambient it is compliant or rigid."""

    flat_volume_L: float = 0.01
    per_kPa: float = 0.0

    def __post_init__(self) -> None:
        if not (self.flat_volume_L > 0.0 and self.per_kPa >= 0.0):
            raise ValueError("a pouch needs a positive flat volume, and a compliance that is not negative")

    def numbers(self, volume_L: float, g: float) -> Chamber:
        flat_L = self.flat_volume_L
        if not flat_L < volume_L:
            raise ValueError("a pouch's flat volume must be smaller than its full volume")
        return Chamber(flat_L, volume_L, self.per_kPa, g, flat_L, volume_L + g * (volume_L - flat_L))


Shape = Compliant | Pouch
