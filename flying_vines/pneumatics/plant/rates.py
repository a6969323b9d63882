"""The right-hand side: what flows where, and how the state changes.

    dn/dt     = ΣQ                                          air of each volume, SL
    dE/dt     = γ α Σθ Q + q + (γ−1) (V − V_min) dp_a/dt    where gas has a temperature of its own, kPa·L/s
    q         = (α n / τ + (γ−1) hA · 293.15 K) (θ_w − θ)   kPa·L/s
    C_w dT_w/dt = −q/(γ−1) + h_o A_o (T_a − T_w)
    dx/dt     = (target − x) / τ                            valves with lag

Every flow carries the temperature of where it comes from; throttling changes none (ideal gas). E is p V, in
the control volume with (γ−1) times the work done on wall and ambient (see `shape`): the first law, in which
that work then appears only where ambient pressure changes.
"""

from __future__ import annotations

from collections.abc import Callable
from math import isinf
from typing import NamedTuple

from flying_vines.pneumatics.baseline import ALPHA_KPA
from flying_vines.pneumatics.plant.ambient import Steady
from flying_vines.pneumatics.plant.flow import FlowFunction, FlowLaw, Iso6358, Ohm
from flying_vines.pneumatics.plant.gas import GAMMA, STANDARD_TEMPERATURE_K
from flying_vines.pneumatics.plant.plant import Conditions, Held, Plant
from flying_vines.pneumatics.plant.venturi import nozzle_supply, outlet_into, vacuum_share
from flying_vines.pneumatics.plant.wall import Wall

Floats = tuple[float, ...]
RateFunction = Callable[[float, Floats, Held], Floats]
_G1 = GAMMA - 1.0
_GAMMA_ALPHA = GAMMA * ALPHA_KPA


class Flows(NamedTuple):
    """Standard litres per second, and heat into the gas in W.

    Each flow's `…_ratio` is the temperature ratio (to 293.15 K) of what flows.
    """

    inflation_SL_per_s: float
    inflation_ratio: float
    motive_SL_per_s: float
    motive_ratio: float
    outlet_SL_per_s: float
    outlet_ratio: float
    reservoir_leak_SL_per_s: float
    reservoir_leak_ratio: float
    cv_leak_SL_per_s: float
    cv_leak_ratio: float
    line_to_cv_SL_per_s: float
    line_to_cv_ratio: float
    reservoir_heat_W: float
    cv_heat_W: float


class Model(NamedTuple):
    """A plant made ready for work: each is a function of time in s, a state, and what holds."""

    derivatives: RateFunction
    flows: Callable[[float, Floats, Held], Flows]
    conditions: Callable[[float, Floats], Conditions]
    edges: Callable[[float, Floats], Floats]
    """Each changes its sign where the right-hand side has a kink or jump; the first is the Venturi's
    stalling."""


def model_of(plant: Plant) -> Model:
    """The functions of a plant. What it is made of is looked up once, here; they only calculate."""
    rig, effects = plant.rig, plant.effects
    ambient_at = plant.ambient.at
    steady = isinstance(plant.ambient, Steady)
    steady_air = ambient_at(0.0)
    has_cv = rig.cv is not None
    reservoir_L = rig.reservoir.volume_L
    tubing = effects.tubing if has_cv else None
    line_L = tubing.volume_L if tubing else 1.0
    line_resistance = tubing.flow_resistance_kPa_s_per_SL if tubing else 1.0

    evp_law = _law(effects.evp_law, rig.evp.flow_resistance_kPa_s_per_SL).function()
    dvp_law = _law(effects.dvp_law, rig.dvp.flow_resistance_kPa_s_per_SL).function()
    solenoid = _law(effects.solenoid_law, rig.solenoid.flow_resistance_kPa_s_per_SL)
    solenoid_law = solenoid.function()
    reservoir_leak_law = _maybe(effects.reservoir_leak)
    cv_leak_law = _maybe(effects.cv_leak) if has_cv else None

    full_vacuum_kPa, rated_supply_kPa = rig.venturi.full_vacuum_kPa, rig.venturi.rated_supply_kPa
    ejector = effects.ejector
    thin_air = ejector is not None and ejector.scales_with_ambient
    suction = ejector.free_suction_per_motive if ejector else None
    nozzle = ejector.nozzle_conductance_SL_per_s_kPa if ejector else None
    dvp_conductance = (
        effects.dvp_law.sonic_conductance_SL_per_s_kPa if isinstance(effects.dvp_law, Iso6358) else 0.0
    )
    outlet_law = outlet_into(ejector, solenoid) if ejector and suction is not None else None

    evp_lag_s = effects.evp_motion.time_constant_s if effects.evp_motion else 0.0
    dvp_lag_s = effects.dvp_motion.time_constant_s if effects.dvp_motion else 0.0
    reservoir_wall, cv_wall = effects.reservoir_wall, effects.cv_wall if has_cv else None
    reservoir_own, cv_own = reservoir_wall is not None, cv_wall is not None
    shape = plant.shape.function(plant.cv_volume_L, _G1 if cv_own else 0.0)
    shape_edges = plant.shape.edges(plant.cv_volume_L, _G1 if cv_own else 0.0)
    smallest_L = plant.shape.smallest_L(plant.cv_volume_L)
    stall_kPa = ejector.stall_supply_kPa if ejector else 0.0
    reservoir_per_air, reservoir_fixed, reservoir_capacity, reservoir_outer = _heat(reservoir_wall)
    cv_per_air, cv_fixed, cv_capacity, cv_outer = _heat(cv_wall)

    def balance(t_s: float, state: Floats, held: Held) -> Floats:
        n_r, e_r, wall_r, n_c, e_c, wall_c, n_l, x_e, x_d, _ = state
        target_e, target_d, solenoid_open, stalled = held
        if evp_lag_s == 0.0:
            x_e = target_e
        if dvp_lag_s == 0.0:
            x_d = target_d
        ambient, ambient_K, ambient_rate = steady_air if steady else ambient_at(t_s)
        theta_a = ambient_K / STANDARD_TEMPERATURE_K

        if reservoir_own:
            theta_r = e_r / (ALPHA_KPA * n_r)
            heat_r = (reservoir_per_air * n_r + reservoir_fixed) * (
                (wall_r / STANDARD_TEMPERATURE_K if reservoir_capacity else theta_a) - theta_r
            )
            p_r = e_r / reservoir_L
        else:
            theta_r = theta_a
            heat_r = 0.0
            p_r = ALPHA_KPA * n_r * theta_a / reservoir_L

        leak_r = reservoir_leak_law(p_r, ambient, theta_r, theta_a) if reservoir_leak_law else 0.0
        motive = 0.0
        supply = p_r - ambient
        vacuum = 0.0
        if x_d > 0.0:
            if nozzle is None:
                motive = x_d * dvp_law(p_r, ambient, theta_r, theta_a)
                vacuum = full_vacuum_kPa * x_d * min(1.0, supply / rated_supply_kPa)
            else:
                motive, before = nozzle_supply(x_d * dvp_conductance, nozzle, p_r, ambient)
                motive /= theta_r**0.5
                vacuum = full_vacuum_kPa * min(1.0, (before - ambient) / rated_supply_kPa)
            if thin_air:
                vacuum *= vacuum_share(ambient)
            if stalled:
                vacuum = 0.0

        if not has_cv:
            evp = x_e * evp_law(p_r, ambient, theta_r, theta_a) if x_e > 0.0 else 0.0
            return (
                evp, theta_r if evp >= 0.0 else theta_a,
                motive, theta_r if motive >= 0.0 else theta_a,
                0.0, theta_a,
                leak_r, theta_r if leak_r >= 0.0 else theta_a,
                0.0, theta_a, 0.0, theta_a,
                heat_r, 0.0, theta_a, theta_a, ambient_rate, 0.0,
            )  # fmt: skip

        if cv_own:
            p_c, volume = shape(e_c, ambient)
            theta_c = p_c * volume / (ALPHA_KPA * n_c)
            heat_c = (cv_per_air * n_c + cv_fixed) * (
                (wall_c / STANDARD_TEMPERATURE_K if cv_capacity else theta_a) - theta_c
            )
        else:
            theta_c = theta_a
            heat_c = 0.0
            p_c, volume = shape(ALPHA_KPA * n_c * theta_a, ambient)
        if tubing:
            near, theta_near = ALPHA_KPA * n_l * theta_a / line_L, theta_a
            onward = (near - p_c) / line_resistance
        else:
            near, theta_near = p_c, theta_c
            onward = 0.0

        evp = x_e * evp_law(p_r, near, theta_r, theta_near) if x_e > 0.0 else 0.0
        outlet = 0.0
        if solenoid_open:
            if outlet_law is not None and suction is not None:
                outlet = outlet_law(
                    near, theta_near, ambient, theta_a, vacuum, suction * motive if vacuum > 0.0 else 0.0
                )
            else:
                outlet = solenoid_law(near, ambient - vacuum, theta_near, theta_a)
            # As the baseline: a running Venturi lets nothing back in, a Venturi at rest is an open pipe.
            if outlet < 0.0 and target_d > 0.0:
                outlet = 0.0
        leak_c = cv_leak_law(p_c, ambient, theta_c, theta_a) if cv_leak_law else 0.0
        return (
            evp, theta_r if evp >= 0.0 else theta_near,
            motive, theta_r if motive >= 0.0 else theta_a,
            outlet, theta_near if outlet >= 0.0 else theta_a,
            leak_r, theta_r if leak_r >= 0.0 else theta_a,
            leak_c, theta_c if leak_c >= 0.0 else theta_a,
            onward, theta_a if onward >= 0.0 else theta_c,
            heat_r, heat_c, theta_a, theta_c, ambient_rate, volume,
        )  # fmt: skip

    def derivatives(t_s: float, state: Floats, held: Held) -> Floats:
        (
            evp, evp_theta, motive, motive_theta, outlet, outlet_theta,
            leak_r, leak_r_theta, leak_c, leak_c_theta, onward, onward_theta,
            heat_r, heat_c, theta_a, _, ambient_rate, volume,
        ) = balance(t_s, state, held)  # fmt: skip
        reservoir_pV = reservoir_wall_rate = cv_energy = cv_wall_rate = cv_air = line_air = 0.0
        vented = motive + outlet + leak_r + leak_c
        if reservoir_own:
            reservoir_pV = heat_r - _GAMMA_ALPHA * (
                evp_theta * evp + motive_theta * motive + leak_r_theta * leak_r
            )
            if reservoir_capacity:
                reservoir_wall_rate = (
                    reservoir_outer * (theta_a * STANDARD_TEMPERATURE_K - state[2]) - heat_r / _G1
                ) / reservoir_capacity
        if not has_cv:
            vented += evp
        elif tubing:
            line_air = evp - outlet - onward
            cv_air = onward - leak_c
            enthalpy = onward_theta * onward - leak_c_theta * leak_c
        else:
            cv_air = evp - outlet - leak_c
            enthalpy = evp_theta * evp - outlet_theta * outlet - leak_c_theta * leak_c
        if cv_own:
            cv_energy = _GAMMA_ALPHA * enthalpy + heat_c + _G1 * (volume - smallest_L) * ambient_rate
            if cv_capacity:
                cv_wall_rate = (
                    cv_outer * (theta_a * STANDARD_TEMPERATURE_K - state[5]) - heat_c / _G1
                ) / cv_capacity
        return (
            -(evp + motive + leak_r),
            reservoir_pV,
            reservoir_wall_rate,
            cv_air,
            cv_energy,
            cv_wall_rate,
            line_air,
            (held[0] - state[7]) / evp_lag_s if evp_lag_s else 0.0,
            (held[1] - state[8]) / dvp_lag_s if dvp_lag_s else 0.0,
            vented,
        )

    def flows(t_s: float, state: Floats, held: Held) -> Flows:
        found = balance(t_s, state, held)
        return Flows._make((*found[:12], found[12] / _G1, found[13] / _G1))

    def conditions(t_s: float, state: Floats) -> Conditions:
        n_r, e_r, _, n_c, e_c, _, n_l, _, _, _ = state
        ambient, ambient_K, _ = ambient_at(t_s)
        theta_a = ambient_K / STANDARD_TEMPERATURE_K
        if not reservoir_own:
            e_r = ALPHA_KPA * n_r * theta_a
        if not has_cv:
            kPa = e_r / reservoir_L - ambient
            kelvin = e_r / (ALPHA_KPA * n_r) * STANDARD_TEMPERATURE_K
            return Conditions(kPa, 0.0, 0.0, kelvin, ambient_K, 0.0, ambient, ambient_K)
        if not cv_own:
            e_c = ALPHA_KPA * n_c * theta_a
        p_c, volume = shape(e_c, ambient)
        cv_kPa = p_c - ambient
        return Conditions(
            e_r / reservoir_L - ambient,
            cv_kPa,
            ALPHA_KPA * n_l * theta_a / line_L - ambient if tubing else cv_kPa,
            e_r / (ALPHA_KPA * n_r) * STANDARD_TEMPERATURE_K,
            p_c * volume / (ALPHA_KPA * n_c) * STANDARD_TEMPERATURE_K,
            volume,
            ambient,
            ambient_K,
        )

    def edges(t_s: float, state: Floats) -> Floats:
        ambient, ambient_K, _ = ambient_at(t_s)
        theta_a = ambient_K / STANDARD_TEMPERATURE_K
        pV = state[1] if reservoir_own else ALPHA_KPA * state[0] * theta_a
        stall = pV / reservoir_L - ambient - stall_kPa if stall_kPa else 1.0
        energy = state[4] if cv_own else ALPHA_KPA * state[3] * theta_a
        return stall, *[energy - edge * ambient for edge in shape_edges]

    return Model(derivatives, flows, conditions, edges)


def fastest_rate_per_s(plant: Plant) -> float:
    """A bound on the quickest time constant's inverse: what an explicit integrator has to resolve."""
    rig, effects = plant.rig, plant.effects
    evp = _law(effects.evp_law, rig.evp.flow_resistance_kPa_s_per_SL).steepest_SL_per_s_kPa()
    dvp = _law(effects.dvp_law, rig.dvp.flow_resistance_kPa_s_per_SL).steepest_SL_per_s_kPa()
    solenoid = _law(effects.solenoid_law, rig.solenoid.flow_resistance_kPa_s_per_SL).steepest_SL_per_s_kPa()
    reservoir = evp + dvp + _steepest(effects.reservoir_leak)
    reservoir_gas = GAMMA if effects.reservoir_wall else 1.0
    rates = [
        ALPHA_KPA * reservoir_gas * reservoir / rig.reservoir.volume_L,
        _wall_rate(effects.reservoir_wall, rig.reservoir.volume_L),
    ]
    if rig.cv is not None:
        volume_L = plant.shape.smallest_L(rig.cv.volume_L)
        cv = _steepest(effects.cv_leak)
        if effects.tubing:
            line = 1.0 / effects.tubing.flow_resistance_kPa_s_per_SL
            rates.append(ALPHA_KPA * (evp + solenoid + line) / effects.tubing.volume_L)
            cv += line
        else:
            cv += evp + solenoid
        cv_gas = GAMMA if effects.cv_wall else 1.0
        rates += [ALPHA_KPA * cv_gas * cv / volume_L, _wall_rate(effects.cv_wall, volume_L)]
    for motion in (effects.evp_motion, effects.dvp_motion):
        if motion is not None and motion.time_constant_s > 0.0:
            rates.append(1.0 / motion.time_constant_s)
    return max(rates)


def _law(law: FlowLaw | None, flow_resistance_kPa_s_per_SL: float) -> FlowLaw:
    return Ohm(flow_resistance_kPa_s_per_SL) if law is None else law


def _maybe(law: FlowLaw | None) -> FlowFunction | None:
    return None if law is None else law.function()


def _steepest(law: FlowLaw | None) -> float:
    return 0.0 if law is None else law.steepest_SL_per_s_kPa()


def _heat(wall: Wall | None) -> tuple[float, float, float, float]:
    """q per (SL · θ), q per θ, the wall's capacity in J/K (0: at ambient), W/K to the outside."""
    if wall is None:
        return 0.0, 0.0, 0.0, 0.0
    capacity = 0.0 if isinf(wall.capacity_J_per_K) else wall.capacity_J_per_K
    per_air = ALPHA_KPA / wall.time_constant_s
    fixed = _G1 * wall.conductance_W_per_K * STANDARD_TEMPERATURE_K
    return per_air, fixed, capacity, wall.outer_conductance_W_per_K


def _wall_rate(wall: Wall | None, volume_L: float) -> float:
    """How quickly gas at half an atmosphere, and the wall, take the other's temperature."""
    if wall is None:
        return 0.0
    per_air, fixed, _, _ = _heat(wall)
    gas = per_air / ALPHA_KPA + fixed / (0.5 * ALPHA_KPA * volume_L)
    return gas + (wall.conductance_W_per_K + wall.outer_conductance_W_per_K) / wall.capacity_J_per_K
