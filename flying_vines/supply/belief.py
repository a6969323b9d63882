"""What is believed of a rig before it flies: where the estimate starts, and how certain that is.

`nominal` knows only the numbers of `[pneumatics]`; all else may be as on any rig. `known_rig` reads what a
diagnosed rig file says beyond them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from flying_vines.config.config import PneumaticsConfig
from flying_vines.physics.constants import ALPHA_KPA, STANDARD_PRESSURE_KPA
from flying_vines.physics.plant.flow import FlowLaw, Iso6358
from flying_vines.physics.plant.wall import Wall
from flying_vines.physics.rig import ControlVolume, Dvp, Evp, Reservoir, Rig

AMBIENT_KPA = STANDARD_PRESSURE_KPA
CRITICAL_RATIO = 0.3
"""b of a valve with fittings."""
LEAST_RISE = 0.65
"""The least that any control volume takes, as a share of what a rigid one of the believed size takes."""
PACKED_SHARE = 1.2
"""How far the first inflation may differ, as a share of what a flat pouch takes."""
VENTURI_SHARE = 0.7
VENTURI_SHARE_SD = 0.2
"""Of its supply valve's flow, because the nozzle restricts it too."""


def nominal_rig(numbers: PneumaticsConfig) -> Rig:
    """What `[pneumatics]` says of a rig, as a rig file has it."""
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
class Belief:
    """Of one rig. Air is counted in kPa of its reservoir; gauge pressures are true ones."""

    pneumatics: PneumaticsConfig
    """The numbers that the formulas take, the rig file's where there is one."""
    rise: Prior
    """For every kPa that the control volume's reading rises."""
    least_rise: float
    flat: Prior
    """For an inflation from flat."""
    packed_kPa: float
    """By how much the first inflation may differ from later ones."""
    venturi: Prior
    """For each second with its valve open, per kPa of absolute supply."""
    leak: Prior
    """Of the reservoir, per second and kPa."""
    cv_leak: Prior
    """Of the control volume, per second and kPa."""
    wall: Wall
    """Of the bottle."""
    warmth_sd: float
    """Of ln of its conductances."""
    evp_law: FlowLaw
    rating_sd: float
    """Of ln of what the valve passes for what the bottle holds."""
    dead_opening: float
    """Opening up to which the inflation valve stays shut."""
    partly_open_sd: float
    """Of the flow through a valve that is just open, relative to it."""
    response_s: float
    """Response time of regulator, valve and sensor together."""
    cycle_rise_kPa: float
    """By how much the reading rises in a cycle of `[pneumatics]`."""
    cycle_venturi_s: float
    """How long the Venturi's valve is open in it."""
    reservoir_gain: float
    reservoir_offset_kPa: float
    zero_sd_kPa: float
    """Of the zero of the reservoir's sensor, and of the ambient pressure, which is not measured."""

    def reservoir_kPa(self, reading_kPa: float) -> float:
        """The true pressure for a reading of the sensor."""
        return reading_kPa / self.reservoir_gain - self.reservoir_offset_kPa


def conductance_SL_per_s_kPa(flow_resistance_kPa_s_per_SL: float, at_kPa: float) -> float:
    """Of a choked valve, per kPa of absolute supply, that passes at gauge `at_kPa` what Ohm's law gives."""
    return at_kPa / flow_resistance_kPa_s_per_SL / (at_kPa + AMBIENT_KPA)


def bottle_wall(volume_L: float) -> Wall:
    """Of a PET bottle of this size.

    Natural convection inside gives 0.6 to 1.4 W/K for 2 L, 45 to 70 g of PET hold 65 J/K.
    """
    size = (volume_L / 2.0) ** (2.0 / 3.0)
    return Wall(
        conductance_W_per_K=1.0 * size, capacity_J_per_K=65.0 * size, outer_conductance_W_per_K=1.0 * size
    )


def nominal(p: PneumaticsConfig) -> Belief:
    """Of a rig of which only these numbers are known."""
    rigid = p.cv_volume_L / p.reservoir_volume_L
    pouch_kPa = rigid * AMBIENT_KPA
    dvp = conductance_SL_per_s_kPa(p.dvp_flow_resistance_kPa_s_per_SL, p.full_kPa)
    venturi = ALPHA_KPA / p.reservoir_volume_L * dvp
    # By the paper's formula the Venturi takes as much as a rigid control volume.
    rigid_SL = p.cv_volume_L * p.cycle_swing_kPa / AMBIENT_KPA
    return Belief(
        pneumatics=p,
        rise=Prior(1.3 * rigid, 0.7 * rigid),
        least_rise=LEAST_RISE * rigid,
        flat=Prior(0.3 * pouch_kPa, 0.5 * pouch_kPa),
        packed_kPa=PACKED_SHARE * pouch_kPa,
        venturi=Prior(VENTURI_SHARE * venturi, VENTURI_SHARE_SD * venturi),
        leak=Prior(3e-4, 1.5e-3),
        cv_leak=Prior(0.0, 1.5e-3),
        wall=bottle_wall(p.reservoir_volume_L),
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
