"""The wall of a volume; the shape of the control volume: rigid, compliant, or a bending pouch.

A pouch first fills at ambient pressure.

The state of the gas is E = p V + g W. W = ∫ p dV is the work on wall and ambient, from the smallest volume
on. g is γ − 1 for gas with its own temperature, and 0 for isothermal gas. E is the state, and not p V,
because the rate of E is continuous. The rate of p V jumps when a pouch becomes full.

`numbers(volume_L, g)` converts each shape to the numbers of a pouch, for `pressure_and_volume`. A compliant
or rigid shape is a pouch whose flat volume equals its full volume.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, sqrt
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from flying_vines.physics.gas import ALPHA_KPA, GAMMA, STANDARD_TEMPERATURE_K

if TYPE_CHECKING:
    from flying_vines.physics.arrays import Array


_NO_EDGE_L = -1.0


class Chamber(NamedTuple):
    """The numbers of a shape."""

    flat_L: float
    """The smallest volume, also under vacuum. W is 0 at this volume."""
    full_L: float
    per_kPa: float
    g: float
    flat_edge_L: float
    """E / p_a at which the pouch becomes flat; below 0 without this kink."""
    full_edge_L: float
    """E / p_a at which the pouch becomes full; below 0 without this kink."""


def pressure_and_volume(chamber: Chamber, energy: float, ambient_kPa: float) -> tuple[float, float]:
    """Absolute pressure in kPa and volume in L, from E in kPa·L."""
    g, flat, full = chamber.g, chamber.flat_L, chamber.full_L
    beyond = energy - g * (full - flat) * ambient_kPa
    rigid_kPa = beyond / full
    if rigid_kPa >= ambient_kPa:
        k = chamber.per_kPa
        if k == 0.0:
            return rigid_kPa, full
        rigid_kPa -= ambient_kPa
        # The positive root of k (1 + g/2) P² + (1 + (1 + g) k p_a) P = rigid, in a form valid for k → 0.
        linear = 1.0 + (1.0 + g) * k * ambient_kPa
        gauge = 2.0 * rigid_kPa / (linear + sqrt(linear * linear + 4.0 * k * (1.0 + 0.5 * g) * rigid_kPa))
        return ambient_kPa + gauge, full * (1.0 + k * gauge)
    if energy >= ambient_kPa * flat:
        return ambient_kPa, (energy / ambient_kPa + g * flat) / (1.0 + g)
    return energy / flat, flat


def volume_and_work(
    chamber: Chamber, gauge_kPa: float, ambient_kPa: float, fill_L: float
) -> tuple[float, float]:
    """Volume in L and work W in J at a gauge pressure; at 0 kPa a pouch has the volume `fill_L`."""
    flat, full = chamber.flat_L, chamber.full_L
    if gauge_kPa > 0.0:
        stretch = full * chamber.per_kPa
        work = stretch * (ambient_kPa * gauge_kPa + gauge_kPa * gauge_kPa / 2.0)
        return full + stretch * gauge_kPa, work + ambient_kPa * (full - flat)
    volume = flat
    if gauge_kPa == 0.0:
        volume = min(full, max(flat, fill_L))
    return volume, ambient_kPa * (volume - flat)


@dataclass(frozen=True)
class Compliant:
    """V = V₀ (1 + k P) for gauge pressures P > 0, V₀ below; W = V₀ k (p_a P + P²/2). k = 0 is rigid."""

    per_kPa: float = 0.0

    def __post_init__(self) -> None:
        if not self.per_kPa >= 0.0:
            raise ValueError("a compliance must not be negative")

    def numbers(self, volume_L: float, g: float) -> Chamber:
        edge_L = volume_L if self.per_kPa > 0.0 else _NO_EDGE_L
        return Chamber(volume_L, volume_L, self.per_kPa, g, _NO_EDGE_L, edge_L)


@dataclass(frozen=True)
class Pouch:
    """Fills from its flat to its full volume at ambient pressure; above ambient it is compliant or rigid."""

    flat_volume_L: float = 0.01
    per_kPa: float = 0.0

    def __post_init__(self) -> None:
        if not (self.flat_volume_L > 0.0 and self.per_kPa >= 0.0):
            raise ValueError("a pouch needs a positive flat volume, and a compliance that is not negative")

    def numbers(self, volume_L: float, g: float) -> Chamber:
        flat_L = self.flat_volume_L
        if not flat_L < volume_L:
            raise ValueError("a pouch's flat volume must be smaller than its full volume")
        return Chamber(flat_L, volume_L, self.per_kPa, g, flat_L, volume_L + g * (volume_L - flat_L))


Shape = Compliant | Pouch


Number = TypeVar("Number", float, "Array")
_PER_K = 1.0 / STANDARD_TEMPERATURE_K


COOLING_K = (GAMMA - 1.0) * STANDARD_TEMPERATURE_K
"""(γ−1) T of air. If a small share s of the gas flows out adiabatically, the rest cools by s times this."""


def heat_capacity_J_per_K(kPa_abs: Number, volume_L: float) -> Number:
    """m c_v = p V / ((γ−1) T) of air near ambient temperature."""
    return kPa_abs * volume_L / COOLING_K


class HeatRates(NamedTuple):
    """dg/dt = −gas_per_s (g − w), dw/dt = wall_per_s (g − w) − outer_per_s w.

    The gas is g kelvins colder than ambient air, and the wall is w kelvins colder.
    """

    gas_per_s: float
    wall_per_s: float
    outer_per_s: float


class Heat(NamedTuple):
    """The numbers of a wall. The defaults are isothermal gas."""

    own_temperature: bool = False
    """False for isothermal gas."""
    per_air: float = 0.0
    """Heat flow in kPa·L/s for each SL of gas and each 293.15 K between wall and gas."""
    fixed: float = 0.0
    """Heat flow in kPa·L/s for each 293.15 K between wall and gas."""
    per_capacity_K_per_J: float = 0.0
    """Inverse heat capacity of the wall; 0: the wall is at ambient temperature."""
    outer_conductance_W_per_K: float = 0.0
    wall_per_s: float = 0.0
    """Rate constant of the wall's temperature, without the conductance that `per_air` gives."""
    inflow_at_ambient: bool = False
    per_g1: float = 0.0
    """1/(γ−1): J for each kPa·L."""


def heat_kPa_L_per_s(heat: Heat, air_SL: float, ratio: float, wall_K: float, ambient_ratio: float) -> float:
    """Heat flow into the gas; a `ratio` is a temperature over 293.15 K."""
    wall_ratio = wall_K * _PER_K if heat.per_capacity_K_per_J > 0.0 else ambient_ratio
    return (heat.per_air * air_SL + heat.fixed) * (wall_ratio - ratio)


def wall_K_per_s(heat: Heat, into_gas_kPa_L_per_s: float, wall_K: float, ambient_ratio: float) -> float:
    """Rate of the wall's temperature."""
    from_outside_W = heat.outer_conductance_W_per_K * (ambient_ratio * STANDARD_TEMPERATURE_K - wall_K)
    return (from_outside_W - into_gas_kPa_L_per_s * heat.per_g1) * heat.per_capacity_K_per_J


@dataclass(frozen=True)
class Wall:
    """A wall: heat between it and the gas. With the defaults it is adiabatic. Without a wall: isothermal.

        m c_v dT/dt |heat = hA (T_w − T)         C_w dT_w/dt = hA (T − T_w) + h_o A_o (T_a − T_w)

    The exchange is either a constant conductance hA in W/K, or a constant time constant τ = m c_v / hA (hA is
    then proportional to the mass of the gas). If both are given, their conductances add. A wall with an
    infinite capacity is at ambient temperature. `inflow_at_ambient`: valve and tubing bring inflowing gas to
    ambient temperature.
    """

    time_constant_s: float = inf
    conductance_W_per_K: float = 0.0
    capacity_J_per_K: float = inf
    outer_conductance_W_per_K: float = 1.0
    inflow_at_ambient: bool = False

    def __post_init__(self) -> None:
        if not (self.time_constant_s > 0.0 and self.capacity_J_per_K > 0.0):
            raise ValueError("a wall's time constant and capacity must be positive")
        if not (self.conductance_W_per_K >= 0.0 and self.outer_conductance_W_per_K >= 0.0):
            raise ValueError("a wall's conductances must not be negative")

    def inner_W_per_K(self, gas_J_per_K: float, scale: float = 1.0) -> float:
        """Conductance between the wall and gas of this heat capacity. `scale` multiplies the constant hA."""
        return scale * self.conductance_W_per_K + gas_J_per_K / self.time_constant_s

    def rates(self, gas_J_per_K: float, scale: float = 1.0) -> HeatRates:
        """Rate constants of gas of this heat capacity and the wall. `scale` multiplies both conductances."""
        inner_W_per_K = self.inner_W_per_K(gas_J_per_K, scale)
        return HeatRates(
            inner_W_per_K / gas_J_per_K,
            inner_W_per_K / self.capacity_J_per_K,
            scale * self.outer_conductance_W_per_K / self.capacity_J_per_K,
        )

    def numbers(self, gamma: float = GAMMA) -> Heat:
        return Heat(
            True,
            ALPHA_KPA / self.time_constant_s,
            (gamma - 1.0) * self.conductance_W_per_K * STANDARD_TEMPERATURE_K,
            1.0 / self.capacity_J_per_K,
            self.outer_conductance_W_per_K,
            (self.conductance_W_per_K + self.outer_conductance_W_per_K) / self.capacity_J_per_K,
            self.inflow_at_ambient,
            1.0 / (gamma - 1.0),
        )


PET_BOTTLE_2L = Wall(conductance_W_per_K=1.0, capacity_J_per_K=70.0, outer_conductance_W_per_K=1.0)
"""A 2 L PET bottle of 45 to 70 g. Natural convection inside: 0.6 W/K at 2 bar, 1.4 W/K at 8. Assumption."""
