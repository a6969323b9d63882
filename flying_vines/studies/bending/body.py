"""The vine's body: a thin tube under pressure, as a beam that wrinkles before it folds.

The wall only carries tension, in proportion to its strain. A bending moment reduces the tension of the inner
side. Where the tension is zero the wall wrinkles, from the inner side up to an angle φ₀, and the rest of the
wall carries the moment. N is the axial force in the wall, κ the curvature, ν = π − φ₀ (Comer and Levy 1963):

    M = N r (ν − sin ν cos ν) / (2 (sin ν − ν cos ν)),    N = 2 E t r² κ (sin ν − ν cos ν)

Before the wall wrinkles, M = π E t r³ κ. Wrinkling starts at M = N r/2, and the tube folds at M = N r.
Without an actuator N = π r² p, which gives the known moments π p r³/2 and π p r³. An actuator that pulls with
F at a distance d from the axis gives the moment F d and reduces N to π r² p − F. So the tube folds at
F = π p r³/(r + d), well before F = π p r² would crush it. But an actuator's pull falls as it contracts, so
the actuator alone does not fold the tube.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import ArrayLike

from flying_vines.physics.arrays import Array
from flying_vines.studies.bending.actuator import Size

_TAUT = np.geomspace(1.0, 3e-3, 3000) * math.pi
"""ν: half angle of the taut part of the wall, from the start of wrinkling on."""


class Yielding(NamedTuple):
    """The bend of a tube under an actuator's pull, from straight to sharply bent; all arrays rise from 0."""

    contraction: Array
    """Contraction along the actuator, as a share of its length."""
    curvature_per_m: Array
    force_N: Array
    """The pull that is needed."""


class Body(msgspec.Struct, frozen=True, forbid_unknown_fields=True, dict=True):
    """A straight tube, closed at the tip, as long as the actuator on it."""

    diameter_mm: Size
    pressure_kPa: Size
    """Gauge, held by the growth supply."""
    film_um: Size
    modulus_MPa: Size
    offset_mm: Annotated[float, Meta(ge=0, le=1000)] = 0.0
    """Distance of the actuator's pull from the wall, outwards."""

    @property
    def radius_m(self) -> float:
        return self.diameter_mm / 2000.0

    @property
    def lever_m(self) -> float:
        """d, from the axis to the actuator."""
        return self.radius_m + self.offset_mm / 1000.0

    @property
    def stiffness_N_per_m(self) -> float:
        """E t of the wall."""
        return self.modulus_MPa * self.film_um

    @property
    def axial_N(self) -> float:
        """π p r²: the axial pull at which the wall has no tension."""
        return 1000.0 * self.pressure_kPa * math.pi * self.radius_m**2

    @property
    def wrinkling_Nm(self) -> float:
        """π p r³/2: the moment at which the inner side wrinkles, without an actuator's pull."""
        return 0.5 * self.axial_N * self.radius_m

    @property
    def collapse_Nm(self) -> float:
        """π p r³: the moment at which the tube folds, without an actuator's pull."""
        return self.axial_N * self.radius_m

    @property
    def wrinkling_N(self) -> float:
        """The actuator's pull at which the inner side wrinkles."""
        return self.axial_N * self.radius_m / (self.radius_m + 2.0 * self.lever_m)

    @property
    def collapse_N(self) -> float:
        """The actuator's pull at which the tube folds, π p r³/(r + d)."""
        return self.axial_N * self.radius_m / (self.radius_m + self.lever_m)

    def spare_Nm(self, force_N: ArrayLike) -> Array:
        """The additional moment that folds the tube, under an actuator's pull."""
        pull = np.asarray(force_N, float)
        return (self.axial_N - pull) * self.radius_m - pull * self.lever_m

    def tip_load_N(self, length_m: float, force_N: ArrayLike = 0.0) -> Array:
        """The load across the tip that folds the tube at its base; π p r³/L without an actuator's pull."""
        return self.spare_Nm(force_N) / length_m

    @cached_property
    def yielding(self) -> Yielding:
        """The bend under an actuator's pull, computed for all ν at once: each ν has exactly one force."""
        lever, held = _wrinkled()
        r, d, stiffness = self.radius_m, self.lever_m, self.stiffness_N_per_m
        force = self.axial_N * lever * r / (d + lever * r)
        curvature = (self.axial_N - force) / (stiffness * r**2 * held)
        straight = self.axial_N / (2.0 * math.pi * r * stiffness)
        contraction = straight + curvature * (d + r * np.cos(_TAUT))
        return Yielding(*(np.append(0.0, values) for values in (contraction, curvature, force)))


def _wrinkled() -> tuple[Array, Array]:
    """M/(N r) and N/(E t r² κ) for each ν."""
    held = np.sin(_TAUT) - _TAUT * np.cos(_TAUT)
    return (_TAUT - np.sin(_TAUT) * np.cos(_TAUT)) / (2.0 * held), 2.0 * held
