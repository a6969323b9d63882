"""The air left and the cycles that it is enough for: learned from telemetry, with an interval.

`belief` is the prior of a rig, `known_rig` that of a diagnosed rig. `features` reads telemetry once.
`reservoir` models air and heat. `air_use` detects inflations. `min_supply` is the pressure that they need.
`estimate` combines these. `reported_cycles` is what a person is told.
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
