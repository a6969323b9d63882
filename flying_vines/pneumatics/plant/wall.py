"""Heat between the gas of a volume and its wall.

    m c_v dT/dt |heat = hA (T_w − T)         C_w dT_w/dt = hA (T − T_w) + h_o A_o (T_a − T_w)

Two ways to say how much: a conductance hA in W/K that stays as it is, or a time constant τ = m c_v / hA that
stays as it is (hA then goes with the mass of gas inside). Both may be given; they add.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isinf


@dataclass(frozen=True)
class Wall:
    """A wall; as it stands it passes no heat (adiabatic). A volume without a wall is isothermal.

    With an infinite capacity the wall is at ambient temperature.
    """

    time_constant_s: float = inf
    conductance_W_per_K: float = 0.0
    capacity_J_per_K: float = inf
    outer_conductance_W_per_K: float = 1.0

    def __post_init__(self) -> None:
        if not (self.time_constant_s > 0.0 and self.capacity_J_per_K > 0.0):
            raise ValueError("a wall's time constant and capacity are positive")
        if not (self.conductance_W_per_K >= 0.0 and self.outer_conductance_W_per_K >= 0.0):
            raise ValueError("a wall's conductances are not negative")

    @property
    def follows_ambient(self) -> bool:
        return isinf(self.capacity_J_per_K)


PET_BOTTLE_2L = Wall(conductance_W_per_K=1.0, capacity_J_per_K=70.0, outer_conductance_W_per_K=1.0)
"""A 2 L bottle: natural convection inside 0.6 W/K at 2 bar to 1.4 at 8; 45 to 70 g of PET. Assumption."""
