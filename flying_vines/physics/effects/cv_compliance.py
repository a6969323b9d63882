"""The control volume stretches: V = V₀ (1 + k P) for P > 0 (gauge); its air is conserved."""

from __future__ import annotations

from functools import partial

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.plant import Setup
from flying_vines.physics.plant.volume import Compliant


def apply(base: Setup, per_kPa: float) -> Setup:
    return base.with_effects(cv_shape=partial(Compliant, per_kPa=per_kPa))


CAUSE = Cause(
    name="cv_compliance",
    what="The control volume grows with its pressure.",
    parameters=(
        Parameter(
            "per_kPa",
            low=1e-7,
            high=0.5,
            seeds=(1e-5, 1e-3, 1e-2),
            neutral=0.0,
            logarithmic=True,
            source="from a steel bottle to a rubber balloon whose volume doubles in 2 kPa",
        ),
    ),
    experiment="Inflate in several steps to the highest pressure, each with the same opening and duration.",
    apply=apply,
    needs=("cv",),
)
