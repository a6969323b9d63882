"""The bend of a vine over its actuator's pressure: the actuator's pull against the body. Needs numpy.

vine = load_vine("pouch")                   or load_vine(Path("my-vine.toml"))
found = bend(vine)                          arrays over the actuator's pressure
found.angle_deg, found.air_SL, found.tip_m, found.limits, found.end
force_N(vine.actuator, 20.7, 0.1)           the actuator alone
"""

from flying_vines.studies.bending.actuator import burst_kPa, force_N, free, held_at, volume_L
from flying_vines.studies.bending.description import BendingVine, VineError, examples, load_vine, parse_vine
from flying_vines.studies.bending.equilibrium import BendingCurve, Limit, bend

__all__ = [
    "BendingCurve",
    "BendingVine",
    "Limit",
    "VineError",
    "bend",
    "burst_kPa",
    "examples",
    "force_N",
    "free",
    "held_at",
    "load_vine",
    "parse_vine",
    "volume_L",
]
