"""The differential equations of the plant: all flows, and the rate of the state.

    dn/dt     = ΣQ                                          air of each volume, SL
    dE/dt     = γ α Σθ Q + q + (γ−1) (V − V_min) dp_a/dt    if the gas has its own temperature, kPa·L/s
    q         = (α n / τ + (γ−1) hA · 293.15 K) (θ_w − θ)   kPa·L/s
    C_w dT_w/dt = −q/(γ−1) + h_o A_o (T_a − T_w)
    dx/dt     = (target − x) / τ                            valves with lag

Every flow has the temperature of its source, because throttling does not change the temperature of an ideal
gas. (`Wall.inflow_at_ambient` is an exception.) In the reservoir E = p V. In the control volume
E = p V + (γ−1) · (work on wall and ambient), see `volume.py`. So only a change of ambient pressure adds a
work term.

These are plain functions over tuples of numbers, so that `compiled` can compile them.
"""

from __future__ import annotations

from flying_vines.physics.gas import ALPHA_KPA, STANDARD_TEMPERATURE_K
from flying_vines.physics.plant.ambient import Air
from flying_vines.physics.plant.flow import flow_SL_per_s
from flying_vines.physics.plant.leak import leak_SL_per_s
from flying_vines.physics.plant.numbers import PlantNumbers
from flying_vines.physics.plant.plant import Conditions, Held
from flying_vines.physics.plant.venturi import outlet_SL_per_s, supply
from flying_vines.physics.plant.volume import heat_kPa_L_per_s, pressure_and_volume, wall_K_per_s

Floats = tuple[float, ...]
"""The numbers of a state, without names."""


def rates(numbers: PlantNumbers, air: Air, at_s: float, state: Floats, held: Held) -> Floats:
    """Derivative of the state at time `at_s` after the start of `air`."""
    (
        evp, evp_ratio, motive, motive_ratio, outlet, outlet_ratio,
        leak_r, leak_r_ratio, leak_c, leak_c_ratio, onward, onward_ratio,
        heat_r, heat_c, lost, ratio_a, volume,
    ) = balance(numbers, air, at_s, state, held)  # fmt: skip
    reservoir_pV = reservoir_wall = cv_energy = cv_wall = cv_air = line_air = 0.0
    vented = motive + outlet + leak_r + leak_c + lost
    drawn = evp
    if numbers.pump_stall_kPa > 0.0:
        drawn = 0.0
        vented -= evp
    if numbers.reservoir_heat.own_temperature:
        reservoir_pV = heat_r - numbers.gamma * ALPHA_KPA * (
            evp_ratio * drawn + motive_ratio * motive + leak_r_ratio * leak_r
        )
        reservoir_wall = wall_K_per_s(numbers.reservoir_heat, heat_r, state[2], ratio_a)
    if not numbers.has_cv:
        vented += evp
    else:
        if numbers.has_tubing:
            line_air = evp - outlet - onward - lost
            cv_air = onward - leak_c
            enthalpy = onward_ratio * onward - leak_c_ratio * leak_c
        else:
            cv_air = evp - outlet - leak_c
            if numbers.cv_heat.inflow_at_ambient and evp > 0.0:
                evp_ratio = ratio_a
            enthalpy = evp_ratio * evp - outlet_ratio * outlet - leak_c_ratio * leak_c
        if numbers.cv_heat.own_temperature:
            cv_energy = (
                numbers.gamma * ALPHA_KPA * enthalpy
                + heat_c
                + (numbers.gamma - 1.0) * (volume - numbers.cv.flat_L) * air.kPa_per_s
            )
            cv_wall = wall_K_per_s(numbers.cv_heat, heat_c, state[5], ratio_a)
    return (
        -(drawn + motive + leak_r),
        reservoir_pV,
        reservoir_wall,
        cv_air,
        cv_energy,
        cv_wall,
        line_air,
        (held.evp_target - state[7]) * numbers.evp.lag_per_s,
        (held.dvp_target - state[8]) * numbers.dvp.lag_per_s,
        vented,
    )


def balance(
    numbers: PlantNumbers, air: Air, at_s: float, state: Floats, held: Held
) -> tuple[
    float, float, float, float, float, float, float, float, float,
    float, float, float, float, float, float, float, float,
]:  # fmt: skip
    """Six flows in SL/s, each with the temperature of its gas over 293.15 K: inflation, motive, outlet, the
    leaks of reservoir and control volume, tubing to control volume. Then two heats in kPa·L/s, the leak of
    the line, the ambient temperature ratio, and the control volume in L."""
    n_r, e_r, wall_r, n_c, e_c, wall_c, n_l, x_e, x_d, _ = state
    if numbers.evp.lag_per_s == 0.0:
        x_e = held.evp_target
    if numbers.dvp.lag_per_s == 0.0:
        x_d = held.dvp_target
    ambient = air.kPa + air.kPa_per_s * at_s
    ratio_a = air.ratio + air.ratio_per_s * at_s

    ratio_r, heat_r = ratio_a, 0.0
    if numbers.reservoir_heat.own_temperature:
        ratio_r = e_r / (ALPHA_KPA * n_r)
        heat_r = heat_kPa_L_per_s(numbers.reservoir_heat, n_r, ratio_r, wall_r, ratio_a)
    else:
        e_r = ALPHA_KPA * n_r * ratio_a
    p_r = e_r * numbers.reservoir_per_L

    leak_r = leak_SL_per_s(numbers.reservoir_leak, p_r, ambient, ratio_r, ratio_a)
    motive = vacuum = 0.0
    if x_d > 0.0:
        motive, vacuum = supply(numbers.venturi, numbers.dvp.law, x_d, p_r, ambient, ratio_r, ratio_a)
        if held.venturi_stalled:
            vacuum = 0.0

    evp = outlet = leak_c = onward = heat_c = lost = volume = 0.0
    ratio_c = ratio_near = ratio_a
    if not numbers.has_cv:
        if x_e > 0.0:
            evp = x_e * flow_SL_per_s(numbers.evp.law, p_r, ambient, ratio_r, ratio_a)
    else:
        if not numbers.cv_heat.own_temperature:
            e_c = ALPHA_KPA * n_c * ratio_a
        p_c, volume = pressure_and_volume(numbers.cv, e_c, ambient)
        if numbers.cv_heat.own_temperature:
            ratio_c = p_c * volume / (ALPHA_KPA * n_c)
            heat_c = heat_kPa_L_per_s(numbers.cv_heat, n_c, ratio_c, wall_c, ratio_a)
        if numbers.has_tubing:
            near = n_l * ratio_a * numbers.line_kPa_per_SL
            onward = (near - p_c) * numbers.line_SL_per_s_kPa
            if numbers.line_hole.conductance_SL_per_s_kPa > 0.0:
                lost = flow_SL_per_s(numbers.line_hole, near, ambient, ratio_near, ratio_a)
        else:
            near, ratio_near = p_c, ratio_c
        if x_e > 0.0:
            if numbers.pump_stall_kPa > 0.0:
                # The pump draws from ambient; `rates` takes nothing from the reservoir.
                stall_kPa_abs = numbers.pump_stall_kPa + ambient
                if near < stall_kPa_abs:
                    evp = x_e * flow_SL_per_s(numbers.evp.law, stall_kPa_abs, near, ratio_a, ratio_near)
            else:
                evp = x_e * flow_SL_per_s(numbers.evp.law, p_r, near, ratio_r, ratio_near)
        # As in the baseline: no backflow while the Venturi runs, free flow both ways while it is off.
        if held.solenoid_open and (near > ambient - vacuum or held.dvp_target <= 0.0):
            outlet = outlet_SL_per_s(
                numbers.venturi, numbers.solenoid, near, ratio_near, ambient, ratio_a, vacuum, motive
            )
        leak_c = leak_SL_per_s(numbers.cv_leak, p_c, ambient, ratio_c, ratio_a)
    return (
        evp, ratio_r if evp >= 0.0 else ratio_near,
        motive, ratio_r if motive >= 0.0 else ratio_a,
        outlet, ratio_near if outlet >= 0.0 else ratio_a,
        leak_r, ratio_r if leak_r >= 0.0 else ratio_a,
        leak_c, ratio_c if leak_c >= 0.0 else ratio_a,
        onward, ratio_a if onward >= 0.0 else ratio_c,
        heat_r, heat_c, lost, ratio_a, volume,
    )  # fmt: skip


def conditions(numbers: PlantNumbers, air: Air, state: Floats) -> Conditions:
    """Pressures, temperatures and volume of a state, at the start of `air`."""
    n_r, e_r, _, n_c, e_c, _, n_l, _, _, _ = state
    ambient, ambient_K = air.kPa, air.ratio * STANDARD_TEMPERATURE_K
    if not numbers.reservoir_heat.own_temperature:
        e_r = ALPHA_KPA * n_r * air.ratio
    reservoir_kPa = e_r * numbers.reservoir_per_L - ambient
    reservoir_K = e_r / (ALPHA_KPA * n_r) * STANDARD_TEMPERATURE_K
    if not numbers.has_cv:
        return Conditions(reservoir_kPa, 0.0, 0.0, reservoir_K, ambient_K, 0.0, ambient, ambient_K)
    if not numbers.cv_heat.own_temperature:
        e_c = ALPHA_KPA * n_c * air.ratio
    p_c, volume = pressure_and_volume(numbers.cv, e_c, ambient)
    near = n_l * air.ratio * numbers.line_kPa_per_SL if numbers.has_tubing else p_c
    return Conditions(
        reservoir_kPa,
        p_c - ambient,
        near - ambient,
        reservoir_K,
        p_c * volume / (ALPHA_KPA * n_c) * STANDARD_TEMPERATURE_K,
        volume,
        ambient,
        ambient_K,
    )


def edges(numbers: PlantNumbers, air: Air, at_s: float, state: Floats) -> tuple[float, float, float]:
    """Three functions that change sign at a jump or kink: Venturi stall, control volume flat, and full."""
    ambient = air.kPa + air.kPa_per_s * at_s
    ratio = air.ratio + air.ratio_per_s * at_s
    stall = 1.0
    if numbers.venturi.stall_supply_kPa > 0.0:
        pV = state[1] if numbers.reservoir_heat.own_temperature else ALPHA_KPA * state[0] * ratio
        stall = pV * numbers.reservoir_per_L - ambient - numbers.venturi.stall_supply_kPa
    energy = state[4] if numbers.cv_heat.own_temperature else ALPHA_KPA * state[3] * ratio
    return stall, energy - numbers.cv.flat_edge_L * ambient, energy - numbers.cv.full_edge_L * ambient


def quickest_per_s(numbers: PlantNumbers, air: Air, state: Floats, held: Held) -> float:
    """Upper bound of the fastest rate constant (1/s) in a tick from this state on. It sets the step size."""
    if not numbers.has_cv:
        return numbers.standing_per_s
    through = max(state[7], held.evp_target) * numbers.evp.law.steepest_SL_per_s_kPa
    if held.solenoid_open:
        through += numbers.solenoid.steepest_SL_per_s_kPa
    energy, gas = state[4], numbers.gamma
    if not numbers.cv_heat.own_temperature:
        energy, gas = ALPHA_KPA * state[3] * air.ratio, 1.0
    per_litre = gas / pressure_and_volume(numbers.cv, energy, air.kPa)[1]
    leak = numbers.cv_leak.steepest_SL_per_s_kPa
    if numbers.has_tubing:
        line = numbers.line_SL_per_s_kPa
        through += numbers.line_hole.steepest_SL_per_s_kPa
        quickest = (through + line) * numbers.line_kPa_per_SL + ALPHA_KPA * (line + leak) * per_litre
    else:
        quickest = ALPHA_KPA * (through + leak) * per_litre
    return max(numbers.standing_per_s, quickest)
