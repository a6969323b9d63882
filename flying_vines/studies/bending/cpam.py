"""The cylindrical (series) pneumatic artificial muscle, cPAM or sPAM: a film tube gathered at regular necks.

A pleated, inextensible film only carries tension along its meridians. With the total tension 𝒯 of the
meridians, axial balance at radius y is 𝒯 cos ψ = F + p π y². From the neck (y = 0) to the widest radius R
this is the curve of a mylar balloon, with complete elliptic integrals of m = p π R²/(2 𝒯):

    arc length σ R, σ = K/(2 √m)        shortened by δ R, δ = (K − E)/√m
    F = p π R² (1/(2m) − 1)             volume π R³ ((1−m) K − (1−2m) E)/(6 m^1.5)

The force is zero at m = 1/2. Up to the film's own radius r₀ each half chamber is one such curve; then a
cylinder of r₀ grows between the two halves. A chamber that does not reach r₀ shortens by at most 54 %. One
that reaches r₀ shortens by 1.424 r₀: 30 to 40 % of its length, if r₀ is the usual 0.21 to 0.28 of the length.
The meridians stretch by 𝒯/k, with k = 2π r₀ E t of the film. Greer et al. 2017 describe the sPAM, Kübler et
al. 2023 compare it as cPAM; the shape is computed here.
"""

from __future__ import annotations

import math
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import ArrayLike

from flying_vines.physics.arrays import Array
from flying_vines.studies.bending.actuator import ActuatorState, Size


class Cpam(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="cpam", tag_field="kind"):
    """Chambers in a row, all of one size."""

    chamber_length_mm: Size
    """Flat length along the vine, from neck to neck."""
    flat_width_mm: Size
    """Width of the flat tube: half its circumference."""
    count: Annotated[int, Meta(ge=1, le=1000)]
    film_um: Size
    modulus_MPa: Size
    strength_N_per_mm: Size

    @property
    def length_m(self) -> float:
        return self.count * self.chamber_length_mm / 1000.0

    def state(self, pressure_kPa: ArrayLike, bulge: ArrayLike) -> ActuatorState:
        """m is half the bulge."""
        p, m = np.broadcast_arrays(1000.0 * np.asarray(pressure_kPa, float), 0.5 * np.asarray(bulge, float))
        flat, film_radius = self.chamber_length_mm / 1000.0, self.flat_width_mm / 1000.0 / math.pi
        stiffness = 2.0 * math.pi * film_radius * self.modulus_MPa * self.film_um
        first, second = complete_elliptic(m)
        root = np.sqrt(m)
        sigma, delta = first / (2.0 * root), (first - second) / root
        # Without a cylinder both halves, 2 σ R, are as long as the stretched meridian, flat (1 + 𝒯/k). R is
        # the smaller root of this quadratic equation. Without a root the film would stretch without limit.
        pull = p * math.pi / (2.0 * m * stiffness)
        inside = sigma**2 - pull * flat**2
        balloon = flat / (sigma + np.sqrt(np.maximum(inside, 0.0)))
        radius = np.where(inside > 0.0, np.minimum(balloon, film_radius), film_radius)
        meridian = flat * (1.0 + pull * radius**2)
        cylinder = np.maximum(0.0, meridian - 2.0 * sigma * radius)
        cap = math.pi * radius**3 / (6.0 * m * root) * ((1.0 - m) * first - (1.0 - 2.0 * m) * second)
        tension = p * math.pi * radius**2 / (2.0 * m)
        return ActuatorState(
            contraction=1.0 - (meridian - 2.0 * delta * radius) / flat,
            force_N=tension - p * math.pi * radius**2,
            volume_L=1000.0 * self.count * (2.0 * cap + math.pi * radius**2 * cylinder),
            elastic_J=self.count * 0.5 * tension**2 * flat / stiffness,
            film_N_per_m=np.maximum(
                tension / (2.0 * math.pi * film_radius), np.where(cylinder > 0.0, p * film_radius, 0.0)
            ),
        )


def complete_elliptic(m: ArrayLike) -> tuple[Array, Array]:
    """K(m) and E(m) of the parameter m in [0, 1), by the arithmetic-geometric mean."""
    parameter = np.asarray(m, float)
    a, b, c = np.ones_like(parameter), np.sqrt(1.0 - parameter), np.sqrt(parameter)
    rest, weight = 0.5 * c**2, 0.5
    while np.max(np.abs(c)) > 1e-9:
        a, b, c = 0.5 * (a + b), np.sqrt(a * b), 0.5 * (a - b)
        weight *= 2.0
        rest = rest + weight * c**2
    first = 0.5 * math.pi / a
    return first, first * (1.0 - rest)
