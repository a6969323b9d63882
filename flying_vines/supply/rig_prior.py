"""The prior of a rig before it flies: the estimate's start values and their standard deviations.

`nominal` uses the numbers of `[pneumatics]`, and wide priors for all others. The module `rig_file_prior` uses
a diagnosed rig file. Pouch: the bending pouch of the actuator (the control volume, CV).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from flying_vines.config.config import PneumaticsConfig
from flying_vines.physics.gas import ALPHA_KPA, STANDARD_PRESSURE_KPA
from flying_vines.physics.plant.flow import FlowLaw, Iso6358
from flying_vines.physics.plant.volume import Wall
from flying_vines.physics.rig import ControlVolume, Dvp, Evp, Reservoir, Rig

AMBIENT_KPA = STANDARD_PRESSURE_KPA
CRITICAL_RATIO = 0.3
"""b of ISO 6358 for a valve with fittings."""
MIN_RISE_SHARE = 0.65
"""Lower bound of the air for a rise, as a share of the calculated air.

A warm vine takes less air: gas that was compressed quickly has not cooled yet."""
PACKED_SHARE = 1.2
"""Uncertainty of the first inflation, as a share of the air for a flat pouch."""
VENTURI_SHARE = 0.7
"""The Venturi's flow as a share of its supply valve's flow: the nozzle restricts it, too."""
VENTURI_SHARE_SD = 0.2


def nominal_rig(numbers: PneumaticsConfig) -> Rig:
    """The numbers of `[pneumatics]` as a rig."""
    return Rig(
        reservoir=Reservoir(numbers.reservoir_volume_L),
        cv=ControlVolume(numbers.cv_volume_L),
        evp=Evp(numbers.evp_flow_resistance_kPa_s_per_SL),
        dvp=Dvp(numbers.dvp_flow_resistance_kPa_s_per_SL),
    )


class Prior(NamedTuple):
    """A number and its standard deviation."""

    mean: float
    sd: float


@dataclass(frozen=True)
class RigPrior:
    """The prior of one rig. Pressures are gauge, without sensor errors.

    Amounts of air are stated as the reservoir's loss of pressure, kPa.
    """

    pneumatics: PneumaticsConfig
    """The numbers for the formulas: those of the rig file, if there is one."""
    rise: Prior
    """Air for each kPa that the control volume's reading rises."""
    min_rise: float
    """Lower bound of `rise`."""
    flat: Prior
    """Additional air for an inflation from flat."""
    packed_kPa: float
    """The first inflation may take this much more or less air than later ones."""
    venturi: Prior
    """Air for each second with the Venturi's supply valve open, per kPa of absolute supply."""
    leak: Prior
    """Leak of the reservoir, per second and kPa."""
    cv_leak: Prior
    """Leak of the control volume, per second and kPa."""
    wall: Wall
    """The reservoir's wall."""
    warmth_sd: float
    """Standard deviation of ln(the wall's conductances)."""
    evp_law: FlowLaw
    """The inflation valve (EVP)."""
    rating_sd: float
    """Standard deviation of ln(the valve's flow / the reservoir's volume)."""
    dead_opening: float
    """Opening up to which the inflation valve stays shut."""
    partly_open_sd: float
    """Relative standard deviation of the flow through a slightly open valve."""
    response_s: float
    """Response time of regulator, valve and sensor together."""
    cycle_rise_kPa: float
    """Rise of the reading in a cycle of `[pneumatics]`."""
    cycle_venturi_s: float
    """Time for which the Venturi's valve is open in such a cycle."""
    reservoir_gain: float
    reservoir_offset_kPa: float
    zero_sd_kPa: float
    """Standard deviation of the reservoir sensor's zero and of the unmeasured ambient pressure."""

    def reservoir_kPa(self, reading_kPa: float) -> float:
        """The true pressure for a reading of the sensor."""
        return reading_kPa / self.reservoir_gain - self.reservoir_offset_kPa


def conductance_SL_per_s_kPa(flow_resistance_kPa_s_per_SL: float, at_kPa: float) -> float:
    """Conductance (per absolute kPa) of a choked valve that has the flow of Ohm's law at gauge `at_kPa`."""
    return at_kPa / flow_resistance_kPa_s_per_SL / (at_kPa + AMBIENT_KPA)


def pet_wall(volume_L: float) -> Wall:
    """The wall of a PET bottle of this size.

    For 2 L, natural convection inside gives 0.6 to 1.4 W/K, and 45 to 70 g of PET store 65 J/K.
    """
    size = (volume_L / 2.0) ** (2.0 / 3.0)
    return Wall(
        conductance_W_per_K=1.0 * size, capacity_J_per_K=65.0 * size, outer_conductance_W_per_K=1.0 * size
    )


def nominal(p: PneumaticsConfig) -> RigPrior:
    """The prior of a rig of which only these numbers are known."""
    rigid = p.cv_volume_L / p.reservoir_volume_L
    pouch_kPa = rigid * AMBIENT_KPA
    dvp = conductance_SL_per_s_kPa(p.dvp_flow_resistance_kPa_s_per_SL, p.full_kPa)
    venturi = ALPHA_KPA / p.reservoir_volume_L * dvp
    # By the paper's formula the Venturi takes as much air as a rigid control volume.
    rigid_SL = p.cv_volume_L * p.cycle_swing_kPa / AMBIENT_KPA
    return RigPrior(
        pneumatics=p,
        rise=Prior(1.3 * rigid, 0.7 * rigid),
        min_rise=MIN_RISE_SHARE * rigid,
        flat=Prior(0.3 * pouch_kPa, 0.5 * pouch_kPa),
        packed_kPa=PACKED_SHARE * pouch_kPa,
        venturi=Prior(VENTURI_SHARE * venturi, VENTURI_SHARE_SD * venturi),
        leak=Prior(3e-4, 1.5e-3),
        cv_leak=Prior(0.0, 1.5e-3),
        wall=pet_wall(p.reservoir_volume_L),
        warmth_sd=0.4,
        evp_law=Iso6358(
            conductance_SL_per_s_kPa(p.evp_flow_resistance_kPa_s_per_SL, p.full_kPa),
            CRITICAL_RATIO,
            laminar_ratio=1.0,
            temperature_dependent=False,
        ),
        rating_sd=0.25,
        dead_opening=0.3,
        partly_open_sd=0.7,
        response_s=0.1,
        cycle_rise_kPa=p.cycle_swing_kPa,
        cycle_venturi_s=rigid_SL / (dvp * (p.full_kPa + AMBIENT_KPA)),
        reservoir_gain=1.0,
        reservoir_offset_kPa=0.0,
        zero_sd_kPa=10.0,
    )
