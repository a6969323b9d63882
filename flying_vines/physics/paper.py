"""The models of the paper "phloSAR", equation by equation.

Equations have the paper's numbers, (1) to (8). Pressures are kPa gauge unless named otherwise, volumes
litres, flows standard litres per second, flow resistances kPa·s/SL.

The first argument of a function may be an array if its type is `Value`. numpy is imported only for arrays:
the companion computer, which needs only Eq. 4, works without numpy.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeVar

from flying_vines.physics.gas import ALPHA_KPA, STANDARD_PRESSURE_KPA, STANDARD_TEMPERATURE_K

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Value = TypeVar("Value", float, "NDArray[np.float64]")
"""A number, or an array of them."""

GAS_CONSTANT_J_PER_MOL_K = 8.314462618
AIR_MOLAR_MASS_KG_PER_MOL = 0.0289652
STANDARD_DENSITY_KG_PER_M3 = 1.2041
"""Density of air at 101.325 kPa and 20 °C, the usual standard state of flows in SLPM."""


def alpha_kPa() -> float:
    """α = ρ Rᵤ T / M, kPa (paper, below Eq. 1 and 3): the pressure that a standard litre adds to one litre.

    By the gas law, α equals the standard pressure. The equations below use `ALPHA_KPA`.
    """
    density = STANDARD_DENSITY_KG_PER_M3
    return density * GAS_CONSTANT_J_PER_MOL_K * STANDARD_TEMPERATURE_K / AIR_MOLAR_MASS_KG_PER_MOL / 1000.0


def flow_for_rate_SL_per_s(rate_kPa_per_s: Value, volume_L: float) -> Value:
    """Q = V dP/dt / α, standard litres per second (paper, Eq. 1, solved for Q).

    Args:
        rate_kPa_per_s: dP/dt, kPa/s.
        volume_L: V, litres.
    """
    return volume_L * rate_kPa_per_s / ALPHA_KPA


def flow_SL_per_s(pressure_difference_kPa: Value, flow_resistance_kPa_s_per_SL: float) -> Value:
    """Q = ΔP / R_v, standard litres per second (paper, Eq. 2): Ohm's law of flow.

    Args:
        pressure_difference_kPa: ΔP across the valve, kPa.
        flow_resistance_kPa_s_per_SL: R_v, kPa·s/SL.
    """
    return pressure_difference_kPa / flow_resistance_kPa_s_per_SL


def flow_resistance_kPa_s_per_SL(pressure_difference_kPa: float, flow_SLPM: float) -> float:
    """R_v = ΔP / Q, kPa·s/SL, of a valve rated in standard litres per minute (paper, Eq. 2).

    Args:
        pressure_difference_kPa: ΔP across the valve, kPa.
        flow_SLPM: Q, standard litres per minute.
    """
    return 60.0 * pressure_difference_kPa / flow_SLPM


def discharge_time_constant_s(flow_resistance_kPa_s_per_SL: float, reservoir_volume_L: float) -> float:
    """τ_dis = R_v V_r / α, s (paper, below Eq. 3).

    Args:
        flow_resistance_kPa_s_per_SL: R_v of the outlet valve, kPa·s/SL.
        reservoir_volume_L: V_r, litres.
    """
    return flow_resistance_kPa_s_per_SL * reservoir_volume_L / ALPHA_KPA


def discharge_kPa(time_s: Value, initial_kPa: float, time_constant_s: float) -> Value:
    """P_r(t) = P_r0 exp(−t / τ_dis), kPa gauge (paper, Eq. 3): a reservoir that empties to atmosphere.

    Args:
        time_s: t since the valve opened, s.
        initial_kPa: P_r0, kPa gauge.
        time_constant_s: τ_dis, s.
    """
    if isinstance(time_s, (int, float)):
        return initial_kPa * math.exp(-time_s / time_constant_s)
    import numpy as np

    return initial_kPa * np.exp(-time_s / time_constant_s)


def inflation_rate_kPa_per_s(
    reservoir_kPa: Value,
    flow_resistance_kPa_s_per_SL: float,
    cv_volume_L: float,
) -> Value:
    """dP_cv/dt = α P_r / (R_v V_cv), kPa/s (paper, Eq. 4), for P_r ≫ P_cv.

    Args:
        reservoir_kPa: P_r, kPa gauge.
        flow_resistance_kPa_s_per_SL: R_v of the inflation valve, kPa·s/SL.
        cv_volume_L: V_cv, litres.
    """
    return ALPHA_KPA * reservoir_kPa / (flow_resistance_kPa_s_per_SL * cv_volume_L)


def min_reservoir_kPa(
    rate_kPa_per_s: Value,
    flow_resistance_kPa_s_per_SL: float,
    cv_volume_L: float,
) -> Value:
    """P_r = R_v V_cv dP_cv/dt / α, kPa gauge: the minimum for a rate (paper, Eq. 4, Sec. VI-B).

    Args:
        rate_kPa_per_s: the wanted dP_cv/dt, kPa/s.
        flow_resistance_kPa_s_per_SL: R_v of the inflation valve, kPa·s/SL.
        cv_volume_L: V_cv, litres.
    """
    return flow_resistance_kPa_s_per_SL * cv_volume_L * rate_kPa_per_s / ALPHA_KPA


def sine_peak_rate_kPa_per_s(frequency_Hz: Value, amplitude_kPa: float) -> Value:
    """The steepest slope 2 π A ω of the command A sin(2 π ω t) + c, kPa/s (paper, Eq. 5).

    Args:
        frequency_Hz: ω, Hz.
        amplitude_kPa: A, half of peak to peak, kPa. (The paper's A is peak to peak.)
    """
    return 2.0 * math.pi * amplitude_kPa * frequency_Hz


def triangle_rate_kPa_per_s(frequency_Hz: Value, peak_to_peak_kPa: float) -> Value:
    """The slope 2 ω ΔP of a triangle, kPa/s: the slowest inflation that still reaches ΔP in half a cycle.

    Args:
        frequency_Hz: ω, Hz.
        peak_to_peak_kPa: ΔP, kPa.
    """
    return 2.0 * peak_to_peak_kPa * frequency_Hz


def frequency_gain(frequency_Hz: Value, cutoff_Hz: float) -> Value:
    """G = 1 up to the cut-off ω_c and ω_c / ω above it (paper, Eq. 6).

    Args:
        frequency_Hz: ω, Hz.
        cutoff_Hz: ω_c, Hz.
    """
    if isinstance(frequency_Hz, (int, float)):
        return 1.0 if frequency_Hz <= cutoff_Hz else cutoff_Hz / frequency_Hz
    import numpy as np

    return np.asarray(cutoff_Hz / np.maximum(frequency_Hz, cutoff_Hz))


def cutoff_Hz(rate_kPa_per_s: Value, amplitude_kPa: float) -> Value:
    """ω_c = (dP_cv/dt)_max / (2 π A), Hz (paper, Eq. 7).

    Args:
        rate_kPa_per_s: the greatest dP_cv/dt, kPa/s.
        amplitude_kPa: A, half of peak to peak, kPa. (The paper's A is peak to peak.)
    """
    return rate_kPa_per_s / (2.0 * math.pi * amplitude_kPa)


def n_cycles(
    reservoir_kPa: Value,
    *,
    reservoir_volume_L: float,
    cv_volume_L: float,
    swing_kPa: float,
    rate_kPa_per_s: float,
    flow_resistance_kPa_s_per_SL: float,
) -> Value:
    """n = ½ (P_r0 / V_cv − R_v dP_cv/dt / α) V_r / ΔP_cv (paper, Eq. 8): cycles left.

    n is negative below `min_reservoir_kPa`, where the reservoir cannot give the wanted rate. Eq. 8 assumes a
    rigid control volume, and a Venturi that uses as much air as the inflation.

    Args:
        reservoir_kPa: P_r0, kPa gauge.
        reservoir_volume_L: V_r, litres.
        cv_volume_L: V_cv, litres.
        swing_kPa: ΔP_cv, of one inflation, kPa.
        rate_kPa_per_s: the wanted dP_cv/dt, kPa/s.
        flow_resistance_kPa_s_per_SL: minimum R_v of the inflation valve, kPa·s/SL.
    """
    spare = reservoir_kPa / cv_volume_L - flow_resistance_kPa_s_per_SL * rate_kPa_per_s / ALPHA_KPA
    return 0.5 * spare * reservoir_volume_L / swing_kPa


def rigid_fill_SL(swing_kPa: float, cv_volume_L: float) -> float:
    """V_cv ΔP / α, standard litres: the air that Eq. 8 counts for one inflation of a rigid control volume.

    Args:
        swing_kPa: ΔP_cv, kPa.
        cv_volume_L: V_cv, litres.
    """
    return cv_volume_L * swing_kPa / ALPHA_KPA


def pouch_fill_SL(
    swing_kPa: float,
    cv_volume_L: float,
    ambient_kPa: float = STANDARD_PRESSURE_KPA,
) -> float:
    """V_cv (P_a + ΔP) / α, standard litres: the air for a pouch that is flat before each inflation.

    The pouch is the part of the actuator that bends. The paper has no pouch: Sec. VI-B assumes a rigid
    control volume.

    Args:
        swing_kPa: ΔP_cv, kPa gauge at the end of the inflation.
        cv_volume_L: V_cv, inflated, litres.
        ambient_kPa: P_a, kPa absolute.
    """
    return cv_volume_L * (ambient_kPa + swing_kPa) / ALPHA_KPA
