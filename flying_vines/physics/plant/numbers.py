"""A plant as plain numbers, for its differential equations in `rates`.

An effect that the plant does not have gets neutral numbers. So the functions of `rates` and `tick` are the
same for every plant, and numba can compile them.
"""

from __future__ import annotations

from typing import NamedTuple

from flying_vines.physics.gas import ALPHA_KPA, STANDARD_TEMPERATURE_K, GasProperties
from flying_vines.physics.plant.flow import FlowLaw, Ohm, Opening, pump_law
from flying_vines.physics.plant.leak import TOP_KPA, Leak, leak_of
from flying_vines.physics.plant.plant import Plant
from flying_vines.physics.plant.valve_response import Coil, ValveMotion, ticks
from flying_vines.physics.plant.venturi import Ejector, Suction
from flying_vines.physics.plant.volume import Chamber, Heat


class ValveNumbers(NamedTuple):
    """A proportional valve: its flow when fully open, and its motion."""

    law: Opening
    motion: ValveMotion
    delay_ticks: int
    lag_per_s: float
    """1/τ; 0 without a lag."""
    has_coil: bool
    coil: Coil
    stuck_opening: float = -1.0
    """0…1: the valve moves to this opening and stays, whatever its command is. Below 0: not stuck."""


class PlantNumbers(NamedTuple):
    """A plant, for ticks of `tick_s`."""

    tick_s: float
    gamma: float
    reservoir_per_L: float
    reservoir_heat: Heat
    reservoir_leak: Leak
    pump_stall_kPa: float
    """Gauge pressure at which the pump delivers nothing; 0: no pump. With a pump, `evp` has the law of
    its flow."""
    evp: ValveNumbers
    dvp: ValveNumbers
    venturi: Suction
    solenoid: Opening
    solenoid_opening_ticks: int
    solenoid_closing_ticks: int
    has_cv: bool
    cv: Chamber
    cv_heat: Heat
    cv_leak: Leak
    has_tubing: bool
    line_kPa_per_SL: float
    line_SL_per_s_kPa: float
    line_hole: Opening
    """A leak from the valve end of the tubing to ambient."""
    has_edges: bool
    """True if the rates have kinks or jumps, at which an integration step must end."""
    standing_per_s: float
    """Upper bound of the rate constants of reservoir, walls and valve lags, at any valve openings."""


def numbers_of(plant: Plant, tick_s: float) -> PlantNumbers:
    """The numbers of a plant."""
    rig, effects = plant.rig, plant.effects
    gas, pump = rig.gas.properties, rig.pump if rig.cv else None
    evp = _valve(
        pump_law(pump, effects.pump_curve, gas) if pump else effects.evp_law,
        rig.evp.flow_resistance_kPa_s_per_SL,
        effects.evp_motion,
        effects.evp_coil,
        tick_s,
        gas,
    )
    dvp = _valve(
        effects.dvp_law,
        rig.dvp.flow_resistance_kPa_s_per_SL,
        effects.dvp_motion,
        effects.dvp_coil,
        tick_s,
        gas,
    )
    timing, tubing = effects.solenoid_timing, plant.tubing if rig.cv else None
    venturi = (effects.ejector or Ejector()).numbers(rig.venturi, gas)
    # The reservoir of a rig with a pump stays at ambient pressure and temperature.
    reservoir_wall = None if pump else effects.reservoir_wall
    reservoir_heat = reservoir_wall.numbers(gas.gamma) if reservoir_wall else Heat()
    cv_heat = effects.cv_wall.numbers(gas.gamma) if effects.cv_wall and rig.cv else Heat()
    cv = plant.shape.numbers(plant.cv_volume_L, gas.gamma - 1.0 if cv_heat.own_temperature else 0.0)
    reservoir_leak = Leak() if pump else leak_of(effects.reservoir_leaks, gas)
    reservoir_gas = gas.gamma if reservoir_wall else 1.0
    steepest = evp.law.steepest_SL_per_s_kPa + dvp.law.steepest_SL_per_s_kPa
    standing_per_s = max(
        ALPHA_KPA
        * reservoir_gas
        * (steepest + reservoir_leak.steepest_SL_per_s_kPa)
        / rig.reservoir.volume_L,
        heat_per_s(reservoir_heat, rig.reservoir.volume_L, rig.reservoir.volume_L),
        heat_per_s(cv_heat, cv.flat_L, cv.full_L),
        evp.lag_per_s,
        dvp.lag_per_s,
    )
    return PlantNumbers(
        tick_s=tick_s,
        gamma=gas.gamma,
        reservoir_per_L=1.0 / rig.reservoir.volume_L,
        reservoir_heat=reservoir_heat,
        reservoir_leak=reservoir_leak,
        pump_stall_kPa=pump.stall_pressure_kPa if pump else 0.0,
        evp=evp,
        dvp=dvp,
        venturi=venturi,
        solenoid=_opening(effects.solenoid_law, rig.solenoid.flow_resistance_kPa_s_per_SL, gas),
        solenoid_opening_ticks=ticks(timing.opening_s, tick_s) if timing else 0,
        solenoid_closing_ticks=ticks(timing.closing_s, tick_s) if timing else 0,
        has_cv=rig.cv is not None,
        cv=cv,
        cv_heat=cv_heat,
        cv_leak=leak_of(effects.cv_leaks, gas),
        has_tubing=tubing is not None,
        line_kPa_per_SL=ALPHA_KPA / tubing.volume_L if tubing else 0.0,
        line_SL_per_s_kPa=1.0 / tubing.flow_resistance_kPa_s_per_SL if tubing else 0.0,
        line_hole=Opening(),
        has_edges=venturi.stall_supply_kPa > 0.0 or cv.full_edge_L > 0.0,
        standing_per_s=standing_per_s,
    )


def _opening(law: FlowLaw | None, flow_resistance_kPa_s_per_SL: float, gas: GasProperties) -> Opening:
    return (Ohm(flow_resistance_kPa_s_per_SL) if law is None else law).numbers(gas)


def _valve(
    law: FlowLaw | None,
    resistance: float,
    motion: ValveMotion | None,
    coil: Coil | None,
    tick_s: float,
    gas: GasProperties,
) -> ValveNumbers:
    motion = motion or ValveMotion()
    return ValveNumbers(
        _opening(law, resistance, gas),
        motion,
        ticks(motion.delay_s, tick_s),
        1.0 / motion.time_constant_s if motion.time_constant_s > 0.0 else 0.0,
        coil is not None,
        coil or Coil(),
    )


def heat_per_s(heat: Heat, least_L: float, most_L: float) -> float:
    """Upper bound of the rate constants of heat exchange (gas and wall), at 0.5 to 10 atmospheres.

    `least_L`, `most_L`: the volume of the gas.
    """
    most_J_per_K = TOP_KPA * most_L * heat.per_g1 / STANDARD_TEMPERATURE_K
    gas_per_s = heat.per_air / ALPHA_KPA
    return (
        gas_per_s * (1.0 + most_J_per_K * heat.per_capacity_K_per_J)
        + heat.fixed / (0.5 * ALPHA_KPA * least_L)
        + heat.wall_per_s
    )
