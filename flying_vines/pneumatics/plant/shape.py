"""What the control volume's volume does: rigid, compliant, or a pouch that first fills at no pressure.

What is known of the gas inside is not its p V alone but E = p V + g W, where W = ∫ p dV is the work it has
done on wall and ambient since the smallest volume, and g = γ − 1 with a temperature of its own, 0 when
isothermal. E has no jump in its rate where a pouch becomes full, as p V has.

A shape is a description; `function(volume_L, g)` makes it into `shape(E, ambient) -> (p, V)`: absolute
pressures in kPa, litres, kPa·L.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

ShapeFunction = Callable[[float, float], tuple[float, float]]


@dataclass(frozen=True)
class Compliant:
    """V = V₀ (1 + k P) for gauge pressures P > 0, V₀ below; W = V₀ k (p_a P + P²/2). k = 0 is rigid."""

    per_kPa: float = 0.0

    def __post_init__(self) -> None:
        if not self.per_kPa >= 0.0:
            raise ValueError("a compliance is not negative")

    def smallest_L(self, volume_L: float) -> float:
        """From where work counts, and what is left of it in a vacuum."""
        return volume_L

    def function(self, volume_L: float, g: float) -> ShapeFunction:
        k = self.per_kPa

        if k == 0.0:
            return lambda energy, ambient_kPa: (energy / volume_L, volume_L)

        def shape(energy: float, ambient_kPa: float) -> tuple[float, float]:
            rigid_kPa = energy / volume_L - ambient_kPa
            if rigid_kPa <= 0.0:
                return energy / volume_L, volume_L
            # The positive root of k (1 + g/2) P² + (1 + (1 + g) k p_a) P = rigid, as it survives k → 0.
            linear = 1.0 + (1.0 + g) * k * ambient_kPa
            root = sqrt(linear * linear + 4.0 * k * (1.0 + 0.5 * g) * rigid_kPa)
            gauge = 2.0 * rigid_kPa / (linear + root)
            return ambient_kPa + gauge, volume_L * (1.0 + k * gauge)

        return shape

    def edges(self, volume_L: float, g: float) -> tuple[float, ...]:
        """E / p_a where the law has a kink."""
        return (volume_L,) if self.per_kPa > 0.0 else ()

    def at(
        self, volume_L: float, kPa: float, ambient_kPa: float, fill_L: float | None
    ) -> tuple[float, float]:
        """Volume and work W at a gauge pressure."""
        above = max(0.0, kPa)
        work = volume_L * self.per_kPa * (ambient_kPa * above + above * above / 2.0)
        return volume_L * (1.0 + self.per_kPa * above), work


@dataclass(frozen=True)
class Pouch:
    """Between its flat and its full volume it is at ambient pressure; then it is compliant or rigid."""

    flat_volume_L: float = 0.01
    per_kPa: float = 0.0

    def __post_init__(self) -> None:
        if not (self.flat_volume_L > 0.0 and self.per_kPa >= 0.0):
            raise ValueError("a pouch's flat volume is positive, its compliance not negative")

    def smallest_L(self, volume_L: float) -> float:
        """From where work counts, and what is left of it in a vacuum."""
        return self.flat_volume_L

    def function(self, volume_L: float, g: float) -> ShapeFunction:
        flat = self.flat_volume_L
        if not flat < volume_L:
            raise ValueError("a pouch's flat volume is smaller than the full one")
        full = Compliant(self.per_kPa).function(volume_L, g)
        filling = g * (volume_L - flat)

        def shape(energy: float, ambient_kPa: float) -> tuple[float, float]:
            beyond = energy - filling * ambient_kPa
            if beyond >= ambient_kPa * volume_L:
                return full(beyond, ambient_kPa)
            if energy >= ambient_kPa * flat:
                return ambient_kPa, (energy / ambient_kPa + g * flat) / (1.0 + g)
            return energy / flat, flat

        return shape

    def edges(self, volume_L: float, g: float) -> tuple[float, ...]:
        """E / p_a where the law has a kink."""
        return self.flat_volume_L, volume_L + g * (volume_L - self.flat_volume_L)

    def at(
        self, volume_L: float, kPa: float, ambient_kPa: float, fill_L: float | None
    ) -> tuple[float, float]:
        """Volume and work W at a gauge pressure; at none it holds `fill_L`, flat if not given."""
        if kPa > 0.0:
            volume, work = Compliant(self.per_kPa).at(volume_L, kPa, ambient_kPa, None)
            return volume, work + ambient_kPa * (volume_L - self.flat_volume_L)
        if kPa < 0.0 or fill_L is None:
            return self.flat_volume_L, 0.0
        fill_L = min(volume_L, max(self.flat_volume_L, fill_L))
        return fill_L, ambient_kPa * (fill_L - self.flat_volume_L)


Shape = Compliant | Pouch
