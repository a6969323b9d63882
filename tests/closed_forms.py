"""Closed forms: discharges of a vessel, and the standard atmosphere."""

from __future__ import annotations

import math

from flying_vines.physics.gas import ALPHA_KPA, GAMMA, STANDARD_PRESSURE_KPA


def choked_time_constant_s(volume_L: float, sonic_conductance_SL_per_s_kPa: float) -> float:
    """τ = V / (α C), s: time constant of a discharge through a choked valve, at standard temperature."""
    return volume_L / (ALPHA_KPA * sonic_conductance_SL_per_s_kPa)


def isothermal_choked_discharge_kPa_abs(start_kPa_abs: float, t_s: float, time_constant_s: float) -> float:
    """p = p₀ exp(−t/τ): absolute pressure with choked flow and isothermal gas."""
    return start_kPa_abs * math.exp(-t_s / time_constant_s)


def adiabatic_choked_discharge_kPa_abs(
    start_kPa_abs: float, t_s: float, time_constant_s: float, gamma: float = GAMMA
) -> float:
    """p = p₀ [1 + (γ−1)/2 · t/τ]^(−2γ/(γ−1)): absolute pressure with choked flow ∝ 1/√T and adiabatic gas.

    Textbook vessel blow-down, e.g. aefarrell.github.io/2025/01/24/vessel_blowdown_ideal_gases.
    """
    exponent = -2.0 * gamma / (gamma - 1.0)
    return start_kPa_abs * float((1.0 + (gamma - 1.0) / 2.0 * t_s / time_constant_s) ** exponent)


def polytropic_temperature_K(
    start_K: float, start_kPa_abs: float, kPa_abs: float, exponent: float = GAMMA
) -> float:
    """T = T₀ (p/p₀)^((n−1)/n): temperature of the gas in a vessel that empties; n = γ if adiabatic."""
    return start_K * float((kPa_abs / start_kPa_abs) ** ((exponent - 1.0) / exponent))


def isa_pressure_kPa(altitude_m: float) -> float:
    """p = 101.325 (1 − 0.0065 h / 288.15)^5.25588: the ICAO standard atmosphere below 11 km."""
    return STANDARD_PRESSURE_KPA * float((1.0 - 0.0065 * altitude_m / 288.15) ** 5.25588)
