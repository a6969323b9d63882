"""The fabric pneumatic artificial muscle (fPAM): a tube of bias-cut fabric, a McKibben without a braid.

The threads have a constant length and an angle α to the axis, so the tube shortens as it widens. With α₀ and
r₀ as attached and the contraction ε, virtual work with V = π r₀² L₀ (1−ε) (1 − (1−ε)² cos² α₀)/sin² α₀ gives
F = π r₀² p [a (1−ε)² − b], a = 3/tan² α₀, b = 1/sin² α₀ (Chou and Hannaford 1996; review: Tondu 2012). The
force is zero at ε = 1 − 1/(√3 cos α₀): 18.4 % for α₀ = 45°, a third for 30°. So fabric cut at 45° is
stretched before it is attached, which makes α₀ smaller. The elastic force of the coated fabric is linear
here, as in models of the fPAM (Naclerio and Hawkes 2020). Measure its stiffness: the stiffness of the example
is a guess.
"""

from __future__ import annotations

import math
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import ArrayLike

from flying_vines.studies.bending.actuator import ActuatorState, Size


class Fpam(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="fpam", tag_field="kind"):
    """One tube along the vine."""

    tube_length_mm: Size
    radius_mm: Size
    """Inflated radius at the length as attached."""
    angle_deg: Annotated[float, Meta(ge=5, le=54)]
    """Angle between threads and axis, as attached. From 54.7° on the tube does not shorten."""
    strength_N_per_mm: Size
    stiffness_N: Annotated[float, Meta(ge=0, le=1e5)] = 0.0
    """Elastic force divided by contraction: at a contraction of 0.1 the force is a tenth of this number."""

    @property
    def length_m(self) -> float:
        return self.tube_length_mm / 1000.0

    @property
    def ideal_contraction(self) -> float:
        """The contraction at which the force of the pressure is zero."""
        return 1.0 - 1.0 / (math.sqrt(3.0) * math.cos(math.radians(self.angle_deg)))

    def state(self, pressure_kPa: ArrayLike, bulge: ArrayLike) -> ActuatorState:
        """The contraction is the ideal one times the bulge."""
        p, share = 1000.0 * np.asarray(pressure_kPa, float), np.asarray(bulge, float)
        contraction = self.ideal_contraction * share + 0.0 * p
        left = 1.0 - contraction
        angle, radius = math.radians(self.angle_deg), self.radius_mm / 1000.0
        a, b = 3.0 / math.tan(angle) ** 2, 1.0 / math.sin(angle) ** 2
        section = math.pi * radius**2
        widening = b * (1.0 - (left * math.cos(angle)) ** 2)
        return ActuatorState(
            contraction=contraction,
            force_N=section * p * (a * left**2 - b) - self.stiffness_N * contraction,
            volume_L=1000.0 * section * self.length_m * left * widening,
            elastic_J=0.5 * self.stiffness_N * self.length_m * contraction**2,
            film_N_per_m=p * radius * np.sqrt(widening),
        )
