"""The control volume is larger than nominal: tubing, fittings, the sensor's port."""

from __future__ import annotations

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.plant import Setup
from flying_vines.physics.rig import ControlVolume


def apply(base: Setup, volume_L: float) -> Setup:
    cv = base.plant.rig.cv
    if cv is None:
        raise ValueError("a rig without a control volume has no dead volume")
    return base.with_rig(cv=ControlVolume(cv.volume_L + volume_L))


CAUSE = Cause(
    name="dead_volume",
    what="The control volume is larger than nominal.",
    parameters=(
        Parameter(
            "volume_L",
            low=1e-5,
            high=2.0,
            seeds=(0.003, 0.03),
            neutral=0.0,
            logarithmic=True,
            source="from a fitting (0.01 mL) to 10 m of 16 mm hose (2 L)",
        ),
    ),
    experiment="Weigh the control volume and its tubing full of water; or inflate it through a known flow.",
    apply=apply,
    needs=("cv",),
)
