"""The pump's flow falls along a curve, as that of a valve at a constant supply:

    Q = u Q_max φ(r) / φ(r₀),   r = (P_cv + p_a)/(P_max + p_a),   r₀ = p_a/(P_max + p_a)

φ is that of ISO 6358, Q_max the free flow and P_max the stall pressure: the pressure of the supply. In the
baseline the flow falls linearly.
"""

from __future__ import annotations

from flying_vines.physics.cause import Cause
from flying_vines.physics.effects.compressible_flow import CRITICAL_PRESSURE_RATIO
from flying_vines.physics.plant.flow import ChokedPump
from flying_vines.physics.plant.plant import Setup


def apply(base: Setup, critical_pressure_ratio: float) -> Setup:
    return base.with_effects(pump_curve=ChokedPump(critical_pressure_ratio))


CAUSE = Cause(
    name="pump_curve",
    what="The flow of the pump or supply valve does not fall linearly: it chokes.",
    parameters=(CRITICAL_PRESSURE_RATIO,),
    experiment="Fill the empty control volume until the pressure no longer rises.",
    apply=apply,
    needs=("pump",),
    is_flow_law=True,
)
