"""The air left and the cycles that it is enough for: learned from telemetry, with an interval.

`belief` is the prior of a rig, `known_rig` that of a diagnosed rig. `features` reads telemetry once.
`reservoir` models air and heat. `flying` detects inflations. `supply` finds the minimum pressure for them.
`estimate` combines these, and `told` is what a person is told of it. `formula` has the paper's equations.
"""

from flying_vines.supply.belief import Belief, nominal, nominal_rig
from flying_vines.supply.estimate import AirNeeded, CyclesLeft, ReservoirEstimate
from flying_vines.supply.features import Features, TelemetryReader
from flying_vines.supply.formula import n_cycles
from flying_vines.supply.told import ToldCycles

__all__ = [
    "AirNeeded",
    "Belief",
    "CyclesLeft",
    "Features",
    "ReservoirEstimate",
    "TelemetryReader",
    "ToldCycles",
    "n_cycles",
    "nominal",
    "nominal_rig",
]
