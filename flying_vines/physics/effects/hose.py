"""A hose between the valves and the control volume: a volume of its own, and Q = (P_line − P_cv) / R.

The sensor of the control volume is at the valves. This hose replaces a hose of the rig file.
"""

from __future__ import annotations

from math import log

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.plant import Setup
from flying_vines.physics.rig import Hose


def apply(base: Setup, flow_resistance_kPa_s_per_SL: float, volume_L: float) -> Setup:
    return base.with_effects(tubing=Hose(volume_L, flow_resistance_kPa_s_per_SL))


CAUSE = Cause(
    name="hose",
    what="A hose with a volume and a resistance of its own lies before the control volume.",
    parameters=(
        Parameter(
            "flow_resistance_kPa_s_per_SL",
            low=3.0,
            high=1e4,
            seeds=(30.0, 300.0),
            neutral=None,
            logarithmic=True,
            source="Hagen-Poiseuille, 128 μ l/(π d⁴), 1 m: 3 for 4 mm bore (little effect), 6000 for 0.6 mm",
        ),
        Parameter(
            "volume_L",
            low=1e-3,
            high=10.0,
            seeds=(0.02,),
            neutral=0.0,
            logarithmic=True,
            # With a prior, a volume on its bound is no evidence against the hose. This is intended: there are
            # hoses of which only the resistance matters.
            typical=(log(0.0126), log(3.0)),
            source="from 8 cm of 4 mm bore (little effect) to a second vessel of 10 L; typical: 1 m, ×÷ 3",
        ),
    ),
    experiment="Inflate quickly, shut all valves at once, and record every millisecond.",
    apply=apply,
    needs=("cv",),
)
