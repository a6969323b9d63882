"""How much air is left, and how many cycles it buys: learned from telemetry, with an interval.

`belief` is where the estimate starts, `known_rig` where it starts for a diagnosed rig. `features` reads
telemetry once. `reservoir` follows air and heat; `flying` finds what was flown; `supply` finds the pressure
below which it can no longer be flown; `estimate` puts them together. `formula` is the paper's.
"""

from flying_vines.supply.belief import Belief, nominal, nominal_rig
from flying_vines.supply.estimate import AirNeeded, CyclesLeft, ReservoirEstimate
from flying_vines.supply.features import Features, TelemetryReader
from flying_vines.supply.formula import n_cycles

__all__ = [
    "AirNeeded",
    "Belief",
    "CyclesLeft",
    "Features",
    "ReservoirEstimate",
    "TelemetryReader",
    "n_cycles",
    "nominal",
    "nominal_rig",
]
