"""Does the physics answer as predicted? What is wrong with the hardware and no sensor reports.

`expected` is what the rig does at least and at most, `moment` is what telemetry says of one moment; then one
file for each thing that is watched: `filling`, `venting`, `vine_sensor`, `bottle`, `leak`. `checks` puts them
together.
"""

from flying_vines.supply.physics_checks.checks import CHECKS, Finding, PhysicsChecks

__all__ = ["CHECKS", "Finding", "PhysicsChecks"]
