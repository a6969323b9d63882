"""A seam that opens under pressure: no leak below a threshold, above it a hole that chokes (ISO 6358)."""

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.flow import Iso6358


def apply(rig, sonic_conductance_SL_per_s_kPa, opens_at_kPa):
    seam = Iso6358(sonic_conductance_SL_per_s_kPa, critical_pressure_ratio=0.5, cracking_kPa=opens_at_kPa)
    return rig.with_effects(cv_orifice_leak=seam)


C = "sonic_conductance_SL_per_s_kPa"
CAUSE = Cause(
    name="seam_leak",
    what="A seam of the control volume opens under pressure.",
    parameters=(
        Parameter(
            C, 1e-7, 1e-2, seeds=(1e-5, 1e-4), neutral=0.0, logarithmic=True, source="slits of 0.01 to 1 mm²"
        ),
        Parameter("opens_at_kPa", 0.0, 40.0, seeds=(10.0,), neutral=None, source="peel tests of our seams"),
    ),
    experiment="Inflate to the highest pressure, shut all valves, and record a minute.",
    apply=apply,
    needs=("cv",),
)
