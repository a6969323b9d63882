"""The flow of a pump, or of a valve at a supply of constant pressure, against the pressure in the chamber."""

from __future__ import annotations

from dataclasses import dataclass

from flying_vines.physics.gas import GasProperties
from flying_vines.physics.plant.flow import FlowLaw, Ohm, choked_law
from flying_vines.physics.rig import Pump


@dataclass(frozen=True)
class ChokedPump:
    """The flow of ISO 6358 from a constant supply at the stall pressure P_max:

        Q = u Q_max φ(r) / φ(r₀),   r = (P_cv + p_a)/(P_max + p_a),   r₀ = p_a/(P_max + p_a)

    Q_max is the free flow, into 0 kPa gauge, p_a = 101.325 kPa. φ: see `Iso6358`.
    """

    critical_pressure_ratio: float = 0.3


def pump_law(pump: Pump, curve: ChokedPump | None, gas: GasProperties) -> FlowLaw:
    """The law of the flow from P_max to the chamber. Without a curve it falls linearly to 0 at P_max."""
    if curve is None:
        return Ohm(pump.flow_resistance_kPa_s_per_SL)
    stall_kPa, ratio = pump.stall_pressure_kPa, curve.critical_pressure_ratio
    return choked_law(pump.flow_resistance_kPa_s_per_SL, stall_kPa, ratio, gas)
