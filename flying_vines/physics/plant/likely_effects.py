"""The probable effects of a real phloSAR, with numbers of real parts if they are known."""

from __future__ import annotations

from flying_vines.physics.plant.coil import Coil
from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.flow import Iso6358, Ohm, conductance_from_rating_SL_per_s_kPa
from flying_vines.physics.plant.valve_response import CLIPPARD_DVP, CLIPPARD_EVP, HUAMEI_12V
from flying_vines.physics.plant.venturi import COVAL_VR09
from flying_vines.physics.plant.volume import Pouch
from flying_vines.physics.plant.wall import PET_BOTTLE_2L, Wall
from flying_vines.physics.rig import Hose

EVP = Iso6358(conductance_from_rating_SL_per_s_kPa(23.5, 690.0))
"""C from the rating; b = 0.3, usual for valves with fittings, is an assumption."""
DVP = Iso6358(conductance_from_rating_SL_per_s_kPa(67.0, 690.0))
SOLENOID = Iso6358(3.65e-3)
"""Assumption: C = 0.37 dm³/(s·bar), usual for small solenoids. At 20 kPa gauge this is 70 kPa·s/SL."""


def likely_effects(*, pouch: bool = True) -> Effects:
    """The probable effects. With a pouch the control volume must be larger than the flat pouch (0.01 L).

    The 2 L reservoir leaks 6 % of its gauge pressure in two minutes.
    """
    return Effects(
        evp_law=EVP,
        dvp_law=DVP,
        solenoid_law=SOLENOID,
        ejector=COVAL_VR09,
        reservoir_wall=PET_BOTTLE_2L,
        cv_wall=Wall(conductance_W_per_K=0.3, capacity_J_per_K=20.0, outer_conductance_W_per_K=0.5),
        evp_motion=CLIPPARD_EVP,
        dvp_motion=CLIPPARD_DVP,
        evp_coil=Coil(),
        dvp_coil=Coil(),
        solenoid_timing=HUAMEI_12V,
        tubing=Hose(),
        cv_shape=Pouch(per_kPa=0.002) if pouch else None,
        reservoir_leak=Ohm(100_000.0),
        cv_leak=Ohm(20_000.0),
    )
