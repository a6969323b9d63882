"""A Runge-Kutta step of a plant with tubing. The step may be longer than the tubing's time constant.

`tick` does not need this step, because it makes its own steps as short as the tubing requires. A fit with a
short hose needs it: a hose of 3 kPa·s/SL and 3 mL has a time constant of 0.09 ms.
"""

from __future__ import annotations

from math import exp

from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.physics.plant.ambient import Air
from flying_vines.physics.plant.numbers import PlantNumbers
from flying_vines.physics.plant.plant import Held
from flying_vines.physics.plant.rates import Floats, rates
from flying_vines.physics.plant.valve_response import opening_after, opening_midway
from flying_vines.physics.plant.volume import pressure_and_volume


def tubing_per_s(numbers: PlantNumbers, air: Air, state: Floats, held: Held) -> tuple[float, float]:
    """The rate constant of the balance of tubing and control volume; d(p V)/dp of the control volume, L.

    The rate constant is 0 without tubing.
    """
    if not numbers.has_tubing:
        return 0.0, 0.0
    cv, own = numbers.cv, numbers.cv_heat.own_temperature
    kPa, volume_L = pressure_and_volume(cv, state[4] if own else ALPHA_KPA * state[3] * air.ratio, air.kPa)
    if kPa > air.kPa:
        volume_L += (1.0 + cv.g) * kPa * cv.full_L * cv.per_kPa
    out = numbers.solenoid.conductance_SL_per_s_kPa if held.solenoid_open and numbers.solenoid.ohmic else 0.0
    line = numbers.line_SL_per_s_kPa
    warmth = ALPHA_KPA * air.ratio * (numbers.gamma if own else 1.0)
    return (line + out) * numbers.line_kPa_per_SL + line * warmth / volume_L, volume_L


def exponential_runge_kutta(
    numbers: PlantNumbers,
    air: Air,
    at_s: float,
    state: Floats,
    held: Held,
    dt_s: float,
    per_s: float,
    volume_L: float,
) -> Floats:
    """A Runge-Kutta step with tubing of any time constant; the last arguments are from `tubing_per_s`.

    The slow variables are two sums over tubing and control volume: the sum of their air, and the sum of their
    p V. The flow between tubing and control volume cancels in a sum, so no step loses air. The fast variable
    is the air in the tubing minus its value in balance, which is `kappa` times the sum of p V. The fast
    variable decays exponentially (ETDRK4, Cox & Matthews 2002).
    """
    s0, s1, s2, s3, s4, s5, s6, s7, s8, s9 = state
    decay = per_s * dt_s
    half, whole = exp(-decay / 2.0), exp(-decay)
    reach = (1.0 - half) / per_s
    cube = -decay * decay * decay
    first = dt_s * (-4.0 + decay + whole * (4.0 + 3.0 * decay + decay * decay)) / cube
    middle = dt_s * 2.0 * (2.0 - decay - whole * (2.0 + decay)) / cube
    last = dt_s * (-4.0 + 3.0 * decay - decay * decay + whole * (4.0 + decay)) / cube
    # Isothermal: p V is `warmth` times the air. Otherwise each litre of the tubing's air carries the enthalpy
    # `warmth`.
    own = numbers.cv_heat.own_temperature
    warmth = ALPHA_KPA * air.ratio * (numbers.gamma if own else 1.0)
    pV = (s4 if own else warmth * s3) + warmth * s6
    kappa = numbers.line_SL_per_s_kPa / (volume_L * per_s)
    start = s6 - kappa * pV

    h = dt_s / 2.0
    evp = opening_midway(numbers.evp.lag_per_s, s7, held.evp_target, dt_s)
    dvp = opening_midway(numbers.dvp.lag_per_s, s8, held.dvp_target, dt_s)
    a0, a1, a2, a3, a4, a5, a6, _, _, a9 = rates(numbers, air, at_s, state, held)
    a_pV = (a4 if own else warmth * a3) + warmth * a6
    into_a = a6 - kappa * a_pV + per_s * start
    near_a = half * start + reach * into_a
    moved = near_a + kappa * (pV + h * a_pV) - s6
    stage = (
        s0 + h * a0, s1 + h * a1, s2 + h * a2,
        s3 + h * (a3 + a6) - moved, s4 + h * (a4 + warmth * a6) - warmth * moved,
        s5 + h * a5, s6 + moved, evp, dvp, s9,
    )  # fmt: skip
    b0, b1, b2, b3, b4, b5, b6, _, _, b9 = rates(numbers, air, at_s + h, stage, held)
    b_pV = (b4 if own else warmth * b3) + warmth * b6
    into_b = b6 - kappa * b_pV + per_s * near_a
    near_b = half * start + reach * into_b
    moved = near_b + kappa * (pV + h * b_pV) - s6
    stage = (
        s0 + h * b0, s1 + h * b1, s2 + h * b2,
        s3 + h * (b3 + b6) - moved, s4 + h * (b4 + warmth * b6) - warmth * moved,
        s5 + h * b5, s6 + moved, evp, dvp, s9,
    )  # fmt: skip
    c0, c1, c2, c3, c4, c5, c6, _, _, c9 = rates(numbers, air, at_s + h, stage, held)
    c_pV = (c4 if own else warmth * c3) + warmth * c6
    into_c = c6 - kappa * c_pV + per_s * near_b
    h = dt_s
    near_c = half * near_a + reach * (2.0 * into_c - into_a)
    moved = near_c + kappa * (pV + h * c_pV) - s6
    evp = opening_after(numbers.evp.lag_per_s, s7, held.evp_target, dt_s)
    dvp = opening_after(numbers.dvp.lag_per_s, s8, held.dvp_target, dt_s)
    stage = (
        s0 + h * c0, s1 + h * c1, s2 + h * c2,
        s3 + h * (c3 + c6) - moved, s4 + h * (c4 + warmth * c6) - warmth * moved,
        s5 + h * c5, s6 + moved, evp, dvp, s9,
    )  # fmt: skip
    d0, d1, d2, d3, d4, d5, d6, _, _, d9 = rates(numbers, air, at_s + h, stage, held)
    d_pV = (d4 if own else warmth * d3) + warmth * d6
    into_d = d6 - kappa * d_pV + per_s * near_c
    h = dt_s / 6.0
    near = whole * start + first * into_a + middle * (into_b + into_c) + last * into_d
    moved = near + kappa * (pV + h * (a_pV + 2.0 * (b_pV + c_pV) + d_pV)) - s6
    return (
        s0 + h * (a0 + 2.0 * (b0 + c0) + d0),
        s1 + h * (a1 + 2.0 * (b1 + c1) + d1),
        s2 + h * (a2 + 2.0 * (b2 + c2) + d2),
        s3 + h * (a3 + a6 + 2.0 * (b3 + b6 + c3 + c6) + d3 + d6) - moved,
        s4 + h * (a4 + 2.0 * (b4 + c4) + d4 + warmth * (a6 + 2.0 * (b6 + c6) + d6)) - warmth * moved,
        s5 + h * (a5 + 2.0 * (b5 + c5) + d5),
        s6 + moved,
        evp,
        dvp,
        s9 + h * (a9 + 2.0 * (b9 + c9) + d9),
    )
