"""Does the physics answer as predicted? What is wrong with the hardware and no sensor reports.

`expected` is what the rig does at least and at most. There is one file for each thing that is checked:
`filling`, `venting`, `vine_sensor`, `reservoir`, `leak`. `checks` runs them all.
"""

from flying_vines.supply.physics_checks.checks import CHECKS, PhysicsChecks, PhysicsFinding

__all__ = ["CHECKS", "PhysicsChecks", "PhysicsFinding"]
