"""Constants of air and of its standard state."""

from __future__ import annotations

GAMMA = 1.4
"""c_p / c_v of dry air."""
STANDARD_PRESSURE_KPA = 101.325
STANDARD_TEMPERATURE_K = 293.15
ALPHA_KPA = STANDARD_PRESSURE_KPA
"""α = ρ Rᵤ T / M: the pressure that a standard litre of air adds to a volume of one litre. By the gas law, α
equals the standard pressure."""
