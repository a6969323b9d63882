"""The air left, and for how many cycles it is enough: learned from telemetry, with an interval.

`rig_prior` has the prior of a rig, `rig_file_prior` the prior from a rig file. `telemetry_features` reads
telemetry once. `reservoir_filter` models air and heat. `air_use` detects inflations. `min_supply` computes
the pressure that an inflation needs. `cycles_left` combines all of them. `reported_cycles` makes the numbers
that people see.
"""

from flying_vines.supply.cycles_left import AirNeeded, CyclesLeft, ReservoirEstimate
from flying_vines.supply.reported_cycles import ReportedCycles
from flying_vines.supply.rig_prior import RigPrior, nominal, nominal_rig
from flying_vines.supply.telemetry_features import Features, TelemetryReader

__all__ = [
    "AirNeeded",
    "CyclesLeft",
    "Features",
    "ReportedCycles",
    "ReservoirEstimate",
    "RigPrior",
    "TelemetryReader",
    "nominal",
    "nominal_rig",
]
