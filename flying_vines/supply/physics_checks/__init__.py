"""Finds hardware faults that no sensor reports: the physics differs from the prediction.

`expected` has the bounds of a healthy rig. `filling`, `venting`, `setpoint`, `vine_sensor`, `reservoir` and
`leak` each hold one kind of check. `checks` runs them all. EVP: inflation valve. DVP: valve that supplies the
Venturi.
"""

from flying_vines.supply.physics_checks.checks import (
    AIR_LOSSES,
    CHECKS,
    Check,
    PhysicsChecks,
    PhysicsFinding,
    own_checks,
)

__all__ = ["AIR_LOSSES", "CHECKS", "Check", "PhysicsChecks", "PhysicsFinding", "own_checks"]
