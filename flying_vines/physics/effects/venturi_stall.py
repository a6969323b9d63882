"""The Venturi gives no vacuum below a supply pressure (gauge)."""

from __future__ import annotations

from functools import partial

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.plant import Setup
from flying_vines.physics.plant.venturi import Ejector


def apply(base: Setup, supply_pressure_kPa: float) -> Setup:
    return base.with_effects(ejector=partial(Ejector, stall_supply_kPa=supply_pressure_kPa))


CAUSE = Cause(
    name="venturi_stall",
    what="The Venturi stalls below a supply pressure.",
    parameters=(
        Parameter(
            "supply_pressure_kPa",
            low=30.0,
            high=700.0,
            seeds=tuple(range(60, 700, 20)),
            neutral=0.0,
            source="ejectors are rated at 300 to 600 kPa; below about 300 kPa the vacuum falls",
        ),
    ),
    experiment="Empty the control volume with the Venturi repeatedly, until the reservoir is empty.",
    apply=apply,
    needs=("venturi",),
)
