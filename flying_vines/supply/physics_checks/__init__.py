"""Finds hardware faults that no sensor reports: the physics differs from the prediction.

`expected` has the bounds of a healthy rig. `filling`, `venting`, `setpoint`, `vine_sensor`, `reservoir`,
`reservoir_sensor` and `leak` each hold one kind of check. `checks` runs them all. EVP: inflation valve. DVP:
valve that supplies the Venturi.
"""

from flying_vines.supply.physics_checks.checks import (
    AIR_LOSSES,
    CHECKS,
    Check,
    PhysicsChecks,
    PhysicsFinding,
    own_checks,
)
from flying_vines.supply.physics_checks.expected import Expected, expected
from flying_vines.supply.physics_checks.reservoir_sensor import ReservoirSensor

__all__ = [
    "AIR_LOSSES",
    "CHECKS",
    "Check",
    "Expected",
    "PhysicsChecks",
    "PhysicsFinding",
    "ReservoirSensor",
    "expected",
    "own_checks",
]
