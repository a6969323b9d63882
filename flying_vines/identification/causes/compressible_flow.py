"""Both proportional valves follow ISO 6358 and choke:

    Q = u C p₁ φ(p₂/p₁),   φ = 1 for p₂/p₁ ≤ b, else √(1 − ((p₂/p₁ − b)/(1 − b))²)

with absolute pressures, C such that an open valve passes at 690 kPa into 0 kPa what Ohm's law gives there
(at 101.325 kPa ambient); nothing flows back. ISO 6358-1:2013.
"""

from __future__ import annotations

from math import sqrt

from flying_vines.identification.cause import Cause, Parameter
from flying_vines.identification.model import Array, Flows, Moment, Numbers
from flying_vines.physics.baseline import ALPHA_KPA


def _share(ratio: float, b: float) -> float:
    if ratio <= b:
        return 1.0
    if ratio >= 1.0:
        return 0.0
    x = (ratio - b) / (1.0 - b)
    return sqrt(1.0 - x * x)


def flows(numbers: Numbers, moment: Moment, flows: Flows, x: Array) -> Flows:
    b = x[0]
    upstream = moment.reservoir_kPa + moment.ambient_kPa
    # Standard pressure is 101.325 kPa, as α is.
    matched = 690.0 / ((690.0 + ALPHA_KPA) * _share(ALPHA_KPA / (690.0 + ALPHA_KPA), b)) * upstream
    inflation = moment.evp / numbers.evp_flow_resistance_kPa_s_per_SL * matched
    motive = moment.dvp / numbers.dvp_flow_resistance_kPa_s_per_SL * matched
    inflation *= _share((moment.cv_kPa + moment.ambient_kPa) / upstream, b)
    motive *= _share(moment.ambient_kPa / upstream, b)
    return Flows(inflation, motive, flows.outlet, flows.reservoir_loss, flows.cv_loss)


CAUSE = Cause(
    name="compressible_flow",
    what="The proportional valves choke, as compressible flow does.",
    parameters=(
        Parameter(
            "critical_pressure_ratio",
            low=0.0,
            high=0.95,
            seeds=(0.3,),
            neutral=None,
            typical=(0.35, 0.12),
            source="ISO 6358: 0.5 for an orifice, 0.2 to 0.4 with fittings, 0 for long tubes",
        ),
    ),
    experiment="Discharge the reservoir from full to empty through the open inflation valve.",
    flows=flows,
)
