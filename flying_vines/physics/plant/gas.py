"""The ideal gas law.

Air is counted in standard litres (101.325 kPa, 293.15 K): a volume V with n SL at the temperature ratio
θ = T / 293.15 K has the absolute pressure α n θ / V. A kPa·L is a joule; p V / (γ − 1) is internal energy.
"""

from __future__ import annotations

from flying_vines.physics.constants import ALPHA_KPA, STANDARD_TEMPERATURE_K


def air_SL(pressure_kPa_abs: float, volume_L: float, temperature_K: float = STANDARD_TEMPERATURE_K) -> float:
    """Standard litres in a volume: n = p V / (α θ), the ideal gas law."""
    return pressure_kPa_abs * volume_L * STANDARD_TEMPERATURE_K / (ALPHA_KPA * temperature_K)
