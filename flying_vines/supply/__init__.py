"""How much air is left, and how many cycles it buys: learned from telemetry, with an interval.

`belief` is where it starts, `calibration` where it starts when a diagnosis has looked at the rig.
`bottle` keeps the books of air and warmth; `flying` reads from telemetry what was flown; `supply` knows the
pressure below which it can no longer be flown; `estimate` puts them together. `formula` is the paper's.
"""

from flying_vines.supply.belief import Belief, nominal, nominal_rig
from flying_vines.supply.estimate import AirNeeded, CyclesLeft, ReservoirEstimate
from flying_vines.supply.formula import n_cycles

__all__ = ["AirNeeded", "Belief", "CyclesLeft", "ReservoirEstimate", "n_cycles", "nominal", "nominal_rig"]
