"""The baseline simulation: isothermal gas, Ohm's law of flow, flow proportional to opening, rigid volumes.

    Q_e = u_e (P_r − P_cv) / R_evp      into the control volume
    Q_m = u_d P_r / R_dvp               motive air through the Venturi
    Q_o = s (P_cv + P_vac) / R_sol      out of the control volume
    Q_e = u_e free_flow max(0, 1 − P_cv / stall)      with a pump from ambient, in place of the first line
    P_vac = full_vacuum u_d min(1, P_r / rated_supply)

    dP_r/dt  = −α (Q_e + Q_m) / V_r
    dP_cv/dt =  α (Q_e − Q_o) / V_cv

Pressures in kPa gauge, flows in standard litres per second. The numbers are plain floats: arrays would be too
slow for 1000 steps a second.
"""

from __future__ import annotations

from typing import NamedTuple

from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.physics.rig import Rig


class BaselineState(NamedTuple):
    """Pressures, kPa gauge."""

    reservoir_kPa: float
    cv_kPa: float


class Inputs(NamedTuple):
    """Openings 0…1 of EVP (inflation valve) and DVP (Venturi's supply valve); solenoid: True if open."""

    evp: float
    dvp: float
    solenoid: bool


class BaselineFlows(NamedTuple):
    """Flows, standard litres per second."""

    evp_SL_per_s: float
    motive_SL_per_s: float
    outlet_SL_per_s: float


def flows(rig: Rig, state: BaselineState, inputs: Inputs) -> BaselineFlows:
    """The flow through each valve. Without a control volume the inflation valve opens to atmosphere."""
    reservoir_kPa, cv_kPa = state
    evp, dvp, solenoid = inputs
    if rig.pump is not None:
        inflation = (
            evp * max(0.0, rig.pump.stall_pressure_kPa - cv_kPa) / rig.pump.flow_resistance_kPa_s_per_SL
        )
    else:
        inflation = evp * (reservoir_kPa - cv_kPa) / rig.evp.flow_resistance_kPa_s_per_SL
    motive = dvp * reservoir_kPa / rig.dvp.flow_resistance_kPa_s_per_SL
    if not solenoid or rig.cv is None:
        return BaselineFlows(inflation, motive, 0.0)
    venturi = rig.venturi
    vacuum_kPa = venturi.full_vacuum_kPa * dvp * min(1.0, reservoir_kPa / venturi.rated_supply_kPa)
    outlet = (cv_kPa + vacuum_kPa) / rig.solenoid.flow_resistance_kPa_s_per_SL
    # No backflow while the Venturi runs; free flow both ways while it is off.
    if dvp > 0.0 and outlet < 0.0:
        outlet = 0.0
    return BaselineFlows(inflation, motive, outlet)


def derivatives(rig: Rig, state: BaselineState, inputs: Inputs) -> tuple[float, float]:
    """dP_r/dt and dP_cv/dt, kPa/s."""
    inflation, motive, outlet = flows(rig, state, inputs)
    drawn = motive if rig.pump is not None else inflation + motive
    reservoir = -ALPHA_KPA * drawn / rig.reservoir.volume_L
    if rig.cv is None:
        return reservoir, 0.0
    return reservoir, ALPHA_KPA * (inflation - outlet) / rig.cv.volume_L


def step(rig: Rig, state: BaselineState, inputs: Inputs, dt_s: float) -> BaselineState:
    """The state `dt_s` later with constant inputs: one fourth-order Runge-Kutta step.

    Accurate if `dt_s` is much shorter than the fastest time constant, R_sol V_cv / α: 69 ms for the vine.
    """
    reservoir, cv = state
    half = dt_s / 2.0
    r1, c1 = derivatives(rig, state, inputs)
    r2, c2 = derivatives(rig, BaselineState(reservoir + half * r1, cv + half * c1), inputs)
    r3, c3 = derivatives(rig, BaselineState(reservoir + half * r2, cv + half * c2), inputs)
    r4, c4 = derivatives(rig, BaselineState(reservoir + dt_s * r3, cv + dt_s * c3), inputs)
    sixth = dt_s / 6.0
    return BaselineState(
        reservoir + sixth * (r1 + 2.0 * (r2 + r3) + r4),
        cv + sixth * (c1 + 2.0 * (c2 + c3) + c4),
    )
