"""The effects of a rig, and those of a real phloSAR with numbers of real parts if they are known."""

from __future__ import annotations

from dataclasses import dataclass

from flying_vines.physics.plant.ambient import Ambient
from flying_vines.physics.plant.flow import (
    ChokedPump,
    FlowLaw,
    Iso6358,
    Ohm,
    conductance_from_rating_SL_per_s_kPa,
)
from flying_vines.physics.plant.leak import Curve, LeakLaw, Viscous, leak_of
from flying_vines.physics.plant.valve_response import (
    CLIPPARD_DVP,
    CLIPPARD_EVP,
    HUAMEI_12V,
    Coil,
    SolenoidTiming,
    ValveMotion,
)
from flying_vines.physics.plant.venturi import COVAL_VR09, Ejector
from flying_vines.physics.plant.volume import PET_BOTTLE_2L, Pouch, Shape, Wall
from flying_vines.physics.rig import Hose


@dataclass(frozen=True)
class Effects:
    """Effects of a rig; each one may be left out.

    `*_law`: flow of a fully open valve (None: Ohm's law with the rig's resistance). `pump_curve`: the
    flow of a pump against pressure (None: it falls linearly). `*_wall`: heat between wall and gas (None:
    isothermal gas). `*_motion`, `*_coil`: how a valve follows its command. `*_leak`: permanent openings
    to ambient; those of one volume add up. `ambient`: None is 101.325 kPa and 293.15 K.
    """

    evp_law: FlowLaw | None = None
    dvp_law: FlowLaw | None = None
    solenoid_law: FlowLaw | None = None
    pump_curve: ChokedPump | None = None
    ejector: Ejector | None = None
    reservoir_wall: Wall | None = None
    cv_wall: Wall | None = None
    evp_motion: ValveMotion | None = None
    dvp_motion: ValveMotion | None = None
    evp_coil: Coil | None = None
    dvp_coil: Coil | None = None
    solenoid_timing: SolenoidTiming | None = None
    tubing: Hose | None = None
    cv_shape: Shape | None = None
    reservoir_leak: LeakLaw | None = None
    cv_leak: LeakLaw | None = None
    reservoir_viscous_leak: Viscous | None = None
    cv_viscous_leak: Viscous | None = None
    reservoir_orifice_leak: Iso6358 | None = None
    cv_orifice_leak: Iso6358 | None = None
    reservoir_leak_curve: Curve | None = None
    cv_leak_curve: Curve | None = None
    ambient: Ambient | None = None

    def __post_init__(self) -> None:
        nozzle = self.ejector is not None and self.ejector.nozzle_conductance_SL_per_s_kPa is not None
        if nozzle and not isinstance(self.dvp_law, Iso6358):
            raise ValueError("a nozzle in series needs a supply valve that follows ISO 6358")
        # `leak_of` raises if a volume has two orifices.
        leak_of(self.reservoir_leaks)
        leak_of(self.cv_leaks)

    @property
    def reservoir_leaks(self) -> tuple[LeakLaw | Curve | None, ...]:
        """All leaks of the reservoir."""
        return (
            self.reservoir_leak,
            self.reservoir_viscous_leak,
            self.reservoir_orifice_leak,
            self.reservoir_leak_curve,
        )

    @property
    def cv_leaks(self) -> tuple[LeakLaw | Curve | None, ...]:
        """All leaks of the control volume."""
        return self.cv_leak, self.cv_viscous_leak, self.cv_orifice_leak, self.cv_leak_curve


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
