"""The gas of a rig: its ratio of specific heats and its molar mass; constants of air and its standard state.

One gas fills the whole rig. Ambient air that flows back into the rig counts as the same gas.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

GAMMA = 1.4
"""c_p / c_v of dry air."""
STANDARD_PRESSURE_KPA = 101.325
STANDARD_TEMPERATURE_K = 293.15
ALPHA_KPA = STANDARD_PRESSURE_KPA
"""α = ρ Rᵤ T / M: the pressure that a standard litre of air adds to a volume of one litre. By the gas law, α
equals the standard pressure."""


class GasProperties(NamedTuple):
    """γ = c_p / c_v, and the molar mass."""

    gamma: float
    molar_mass_g_per_mol: float


AIR = GasProperties(GAMMA, 28.96)
GASES = {
    "air": AIR,
    "N2": GasProperties(1.4, 28.01),
    "CO2": GasProperties(1.289, 44.01),
    "Ar": GasProperties(5.0 / 3.0, 39.95),
    "He": GasProperties(5.0 / 3.0, 4.003),
    "N2O": GasProperties(1.275, 44.01),
}
"""γ = c_p / (c_p − R) with c_p of the ideal gas at 25 °C in J/(mol K): CO2 37.1, N2O 38.6 (NIST WebBook)."""


@dataclass(frozen=True)
class Gas:
    """A gas by its name in `GASES` (default: air), or by its own two numbers."""

    name: str | None = None
    gamma: float | None = None
    molar_mass_g_per_mol: float | None = None

    def __post_init__(self) -> None:
        if (self.gamma is None) != (self.molar_mass_g_per_mol is None):
            raise ValueError("a gas with its own numbers needs both gamma and molar_mass_g_per_mol")
        if self.gamma is None and _key(self.name) not in _BY_NAME:
            raise ValueError(
                f"{self.name!r} is not a known gas: the gases are {', '.join(GASES)}; "
                "for another one give gamma and molar_mass_g_per_mol"
            )
        gamma, molar_mass_g_per_mol = self.properties
        if not 1.0 < gamma <= GASES["Ar"].gamma + 1e-3:
            raise ValueError(f"gamma of a gas must be between 1 and 5/3, not {gamma:g}")
        if not 1.0 <= molar_mass_g_per_mol <= 500.0:
            raise ValueError(
                f"the molar mass of a gas must be from 1 to 500 g/mol, not {molar_mass_g_per_mol:g}"
            )

    @property
    def properties(self) -> GasProperties:
        """The numbers of the gas."""
        if self.gamma is None or self.molar_mass_g_per_mol is None:
            return _BY_NAME[_key(self.name)]
        return GasProperties(self.gamma, self.molar_mass_g_per_mol)


def _key(name: str | None) -> str:
    return "air" if name is None else name.casefold()


_BY_NAME = {_key(name): properties for name, properties in GASES.items()}


def nozzle_critical_ratio(gamma: float) -> float:
    """b = (2/(γ+1))^(γ/(γ−1)) of an ideal nozzle: 0.528 for air."""
    return float((2.0 / (gamma + 1.0)) ** (gamma / (gamma - 1.0)))


def sonic_conductance_ratio(gas: GasProperties) -> float:
    """Sonic conductance of an opening for this gas, divided by its sonic conductance for air.

    The choked mass flow of an ideal nozzle is A p √(γ M/(R T)) (2/(γ+1))^((γ+1)/(2(γ−1))). The standard
    volume flow is the mass flow divided by the standard density, which is proportional to M. So √M becomes
    1/√M.
    """
    return _choked(gas) / _choked(AIR)


def _choked(gas: GasProperties) -> float:
    gamma, molar_mass = gas
    return float(sqrt(gamma / molar_mass) * (2.0 / (gamma + 1.0)) ** ((gamma + 1.0) / (2.0 * (gamma - 1.0))))
