"""The vine's body: a thin tube under pressure, as a beam that wrinkles before it folds.

The wall bears tension only, in proportion to its strain. Under a bending moment the tension of the inner
side falls; where it is gone the wall wrinkles, from the inner side up to an angle φ₀, and less and less
wall bears the moment. With N the axial force that the wall holds, curvature κ and ν = π − φ₀ (Comer and
Levy 1963):

    M = N r (ν − sin ν cos ν) / (2 (sin ν − ν cos ν)),    N = 2 E t r² κ (sin ν − ν cos ν)

Until it wrinkles M = π E t r³ κ; wrinkling begins at M = N r/2 and the tube folds at M = N r. Alone it
holds N = π r² p, hence the known π p r³/2 and π p r³. An actuator that pulls with F at a distance d from
the axis bends the tube with F d and takes its pull off the wall: N = π r² p − F. So it folds the tube at F
= π p r³/(r + d), well before F = π p r² would crush it; that far the pull never comes by itself, because it
falls with the contraction.
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
"""ν: how far around the wall is still taut, from where wrinkling begins."""


class Yielding(NamedTuple):
    """A tube that yields to an actuator, from straight to sharply bent; all rise from 0."""

    contraction: Array
    """Of the line along which the actuator lies, share of its length."""
    curvature_per_m: Array
    force_N: Array
    """That the actuator must pull with."""


class Body(msgspec.Struct, frozen=True, forbid_unknown_fields=True, dict=True):
    """A straight tube, closed at the tip, as long as the actuator on it."""

    diameter_mm: Size
    pressure_kPa: Size
    """Gauge, held by the growth supply."""
    film_um: Size
    modulus_MPa: Size
    offset_mm: Annotated[float, Meta(ge=0, le=1000)] = 0.0
    """How far outside the wall the actuator pulls."""

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
        """π p r²: the pull along the axis that takes all tension off the wall."""
        return 1000.0 * self.pressure_kPa * math.pi * self.radius_m**2

    @property
    def wrinkling_Nm(self) -> float:
        """π p r³/2: the moment from which the inner side wrinkles, nothing else pulling."""
        return 0.5 * self.axial_N * self.radius_m

    @property
    def collapse_Nm(self) -> float:
        """π p r³: the moment at which the tube folds, nothing else pulling."""
        return self.axial_N * self.radius_m

    @property
    def wrinkling_N(self) -> float:
        """The actuator's pull from which the inner side wrinkles."""
        return self.axial_N * self.radius_m / (self.radius_m + 2.0 * self.lever_m)

    @property
    def collapse_N(self) -> float:
        """The actuator's pull at which the tube folds, π p r³/(r + d)."""
        return self.axial_N * self.radius_m / (self.radius_m + self.lever_m)

    def spare_Nm(self, force_N: ArrayLike) -> Array:
        """What is left of the moment that folds the tube, under an actuator's pull."""
        pull = np.asarray(force_N, float)
        return (self.axial_N - pull) * self.radius_m - pull * self.lever_m

    def tip_load_N(self, length_m: float, force_N: ArrayLike = 0.0) -> Array:
        """The load across the tip that folds the tube at its base; π p r³/L, nothing else pulling."""
        return self.spare_Nm(force_N) / length_m

    def moment_Nm(self, curvature_per_m: ArrayLike) -> Array:
        """The moment at a curvature, nothing else pulling."""
        lever, held = _wrinkled()
        curvature = self.axial_N / (self.stiffness_N_per_m * self.radius_m**2 * held)
        moment = self.axial_N * self.radius_m * lever
        bent = np.asarray(curvature_per_m, float)
        return np.asarray(np.interp(bent, np.append(0.0, curvature), np.append(0.0, moment)))

    @cached_property
    def yielding(self) -> Yielding:
        """How it yields to an actuator: solved once for all forces, since each ν has one."""
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
