"""The air left and the cycles that it is enough for: learned from telemetry, with an interval.

`belief` has the prior of a rig, `known_rig` that of a diagnosed rig. `features` reads telemetry once.
`reservoir_filter` models air and heat. `air_use` detects inflations. `min_supply` computes the pressure that
they need. `cycles_left` combines these. `reported_cycles` makes the numbers that people see.
"""

from flying_vines.supply.belief import Belief, nominal, nominal_rig
from flying_vines.supply.cycles_left import AirNeeded, CyclesLeft, ReservoirEstimate
from flying_vines.supply.features import Features, TelemetryReader
from flying_vines.supply.reported_cycles import ReportedCycles

__all__ = [
    "AirNeeded",
    "Belief",
    "CyclesLeft",
    "Features",
    "ReportedCycles",
    "ReservoirEstimate",
    "TelemetryReader",
    "nominal",
    "nominal_rig",
]
