"""The laws of leaks, and the total leak of one volume to ambient:

    Q = (p − p_a) (1/R + (p + p_a)/C) + the flow of an orifice + a curve over p − p_a

Leaks by Ohm's law add up exactly, and so do viscous leaks. A volume has at most one orifice and one curve.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from flying_vines.physics.gas import AIR, GasProperties, nozzle_critical_ratio
from flying_vines.physics.plant.curve import Curve, CurveNumbers, curve_SL_per_s
from flying_vines.physics.plant.flow import Iso6358, Ohm, Opening, flow_SL_per_s

TOP_KPA = 1000.0
"""Absolute pressure up to which the plant's fastest rates are computed."""


@dataclass(frozen=True)
class Viscous:
    """Q = (p₁² − p₂²) / C, absolute pressures: laminar flow of a gas through a long, narrow gap.

    Isothermal Hagen-Poiseuille flow of an ideal gas, which EN 1779 uses for viscous leaks. C is that of the
    rig's gas.
    """

    conductance_constant_kPa2_s_per_SL: float

    def __post_init__(self) -> None:
        if not self.conductance_constant_kPa2_s_per_SL > 0.0:
            raise ValueError("a conductance constant must be positive")


LeakLaw = Ohm | Iso6358 | Viscous

ORIFICE_CRITICAL_RATIO = 0.5
"""Critical pressure ratio of a hole in a wall, for air. ISO 6358."""


def orifice(sonic_conductance_SL_per_s_kPa: float, gas: GasProperties = AIR) -> Iso6358:
    """A hole in a wall. For another gas, its critical ratio is scaled like that of an ideal nozzle."""
    share = nozzle_critical_ratio(gas.gamma) / nozzle_critical_ratio(AIR.gamma)
    return Iso6358(sonic_conductance_SL_per_s_kPa, ORIFICE_CRITICAL_RATIO * share)


class Leak(NamedTuple):
    """The numbers of a volume's leaks. The defaults are no leak."""

    ohmic_SL_per_s_kPa: float = 0.0
    viscous_SL_per_s_kPa2: float = 0.0
    orifice: Opening = Opening()
    curve: CurveNumbers = CurveNumbers()
    steepest_SL_per_s_kPa: float = 0.0
    """Maximum change of the flow per kPa of pressure."""


def leak_SL_per_s(leak: Leak, p: float, ambient_kPa: float, ratio: float, ambient_ratio: float) -> float:
    """Flow to ambient from the absolute pressure `p`; a `ratio` is a temperature over 293.15 K."""
    flow = (p - ambient_kPa) * (leak.ohmic_SL_per_s_kPa + leak.viscous_SL_per_s_kPa2 * (p + ambient_kPa))
    if leak.orifice.conductance_SL_per_s_kPa > 0.0:
        flow += flow_SL_per_s(leak.orifice, p, ambient_kPa, ratio, ambient_ratio)
    if leak.curve.up_to_kPa > 0.0:
        flow += curve_SL_per_s(leak.curve, p - ambient_kPa)
    return flow


def leak_of(laws: Iterable[LeakLaw | Curve | None], gas: GasProperties = AIR) -> Leak:
    """The leaks of a volume together. ValueError if two of them are orifices."""
    ohmic = viscous = 0.0
    orifice, curve = Opening(), CurveNumbers()
    for law in laws:
        if isinstance(law, Ohm):
            ohmic += 1.0 / law.flow_resistance_kPa_s_per_SL
        elif isinstance(law, Iso6358):
            if orifice != Opening():
                raise ValueError("a volume can have one orifice leak, not two")
            orifice = law.numbers(gas)
        elif isinstance(law, Curve):
            curve = law.numbers
        elif law is not None:
            viscous += 1.0 / law.conductance_constant_kPa2_s_per_SL
    steepest = ohmic + 2.0 * TOP_KPA * viscous + orifice.steepest_SL_per_s_kPa + curve.steepest_SL_per_s_kPa
    return Leak(ohmic, viscous, orifice, curve, steepest)
