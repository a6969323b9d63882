"""The series pouch motor: two flat films sealed into bending pouches, which shorten as they fill.

Each inflated film is an arc of half angle θ and length s. With the chord L = s sin θ/θ, the area between the
arcs s² (θ − sin θ cos θ)/(2 θ²) and the width w, virtual work gives F = p w s cos θ/θ. The force is zero at
θ = 90°, where a pouch of inextensible film (s = L₀, the flat length) has shortened by 1 − 2/π = 36.3 %
(Niiyama et al. 2015, "Pouch motors").

The film tension T = p s/(2 θ) has no bound as the pouch becomes flat, so an inextensible film would have an
unlimited force even at a low pressure. A real film stretches: s = L₀ (1 + T/(E t)).
"""

from __future__ import annotations

from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import ArrayLike

from flying_vines.studies.bending.actuator import ActuatorState, Size


class PouchMotor(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="pouch_motor", tag_field="kind"
):
    """Pouches in a row, all of one size."""

    pouch_length_mm: Size
    """Flat length along the vine, between the seams."""
    width_mm: Size
    """Width across the vine, between the side seams."""
    count: Annotated[int, Meta(ge=1, le=1000)]
    film_um: Size
    modulus_MPa: Size
    strength_N_per_mm: Size
    """Strength of film or seam, whichever is weaker."""

    @property
    def length_m(self) -> float:
        return self.count * self.pouch_length_mm / 1000.0

    def state(self, pressure_kPa: ArrayLike, bulge: ArrayLike) -> ActuatorState:
        """The state at `bulge`, 0 (flat) to 1 (θ = 90°, no force): θ is 90° times `bulge`."""
        p, theta = 1000.0 * np.asarray(pressure_kPa, float), 0.5 * np.pi * np.asarray(bulge, float)
        flat, width = self.pouch_length_mm / 1000.0, self.width_mm / 1000.0
        stiffness = self.modulus_MPa * self.film_um
        left = 1.0 - p * flat / (2.0 * theta * stiffness)
        arc = flat / np.where(left > 0.0, left, np.nan)
        tension = p * arc / (2.0 * theta)
        sin, cos = np.sin(theta), np.cos(theta)
        area = arc**2 * (theta - sin * cos) / (2.0 * theta**2)
        # If no tension balances the pressure, the film would stretch without limit.
        return ActuatorState(
            contraction=np.where(left > 0.0, 1.0 - arc * sin / (theta * flat), -np.inf),
            force_N=np.where(left > 0.0, 2.0 * tension * width * cos, np.inf),
            volume_L=1000.0 * self.count * width * area,
            elastic_J=self.count * width * flat * tension**2 / stiffness,
            film_N_per_m=tension,
        )
