"""The flow laws of a valve and of a pump: Ohm's law and ISO 6358.

`numbers()` converts both to an `Opening`, for `flow_SL_per_s`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

from flying_vines.physics.gas import AIR, STANDARD_PRESSURE_KPA, GasProperties, sonic_conductance_ratio
from flying_vines.physics.rig import Pump


class Opening(NamedTuple):
    """The numbers of a flow law. The defaults are a shut valve."""

    ohmic: bool = True
    conductance_SL_per_s_kPa: float = 0.0
    """1/R, or C."""
    critical_pressure_ratio: float = 0.0
    subsonic_index: float = 0.5
    cracking_kPa: float = 0.0
    laminar_ratio: float = 1.0
    temperature_dependent: bool = False
    one_way: bool = False
    laminar_share: float = 0.0
    """φ at the laminar ratio, without a cracking pressure."""
    steepest_SL_per_s_kPa: float = 0.0
    """Maximum change of the flow per kPa."""


def flow_SL_per_s(law: Opening, p1: float, p2: float, theta1: float, theta2: float) -> float:
    """Flow from 1 to 2; absolute pressures in kPa, temperatures as ratios to 293.15 K."""
    if law.ohmic:
        return (p1 - p2) * law.conductance_SL_per_s_kPa
    if p1 >= p2:
        return _directed(law, p1, p2, theta1)
    return 0.0 if law.one_way else -_directed(law, p2, p1, theta2)


def _directed(law: Opening, upstream: float, downstream: float, theta: float) -> float:
    flow = law.conductance_SL_per_s_kPa * upstream
    if downstream > law.critical_pressure_ratio * upstream or law.cracking_kPa > 0.0:
        flow *= choked_share(law, upstream, downstream)
    return flow / sqrt(theta) if law.temperature_dependent else flow


def choked_share(law: Opening, upstream: float, downstream: float) -> float:
    """φ of ISO 6358: the flow as a share of the choked flow."""
    if upstream <= downstream:
        return 0.0
    b = law.critical_pressure_ratio
    r = downstream / upstream
    closing = 1.0 - law.cracking_kPa / upstream
    if r >= closing:
        return 0.0
    laminar = law.laminar_ratio * closing
    if laminar <= b:
        # Near the cracking pressure the flow never chokes: only the last, linear part of the law is left.
        return min(1.0, (closing - r) / (closing - laminar)) if closing > laminar else 1.0
    if r <= b:
        return 1.0
    x = (min(r, laminar) - b) / (closing - b)
    whole = 1.0 - x * x
    share = sqrt(whole) if law.subsonic_index == 0.5 else whole**law.subsonic_index
    return share * (closing - r) / (closing - laminar) if r > laminar else share


@dataclass(frozen=True)
class Ohm:
    """Q = (p₁ − p₂) / R, the paper's Eq. 2. R is that of the rig's gas."""

    flow_resistance_kPa_s_per_SL: float

    def __post_init__(self) -> None:
        if not self.flow_resistance_kPa_s_per_SL > 0.0:
            raise ValueError("a flow resistance must be positive")

    def numbers(self, gas: GasProperties = AIR) -> Opening:
        per_kPa = 1.0 / self.flow_resistance_kPa_s_per_SL
        return Opening(conductance_SL_per_s_kPa=per_kPa, steepest_SL_per_s_kPa=per_kPa)


@dataclass(frozen=True)
class Iso6358:
    """Q = C p₁ φ(p₂/p₁) / √θ₁, with r = p₂/p₁ and the closing ratio r_c = 1 − Δp_c/p₁:

        φ = 1                                    r ≤ b
        φ = [1 − ((r − b)/(r_c − b))²]^m          b < r < r_c
        φ = φ(r_l) (r_c − r)/(r_c − r_l)          r_l = laminar_ratio · r_c < r: a linear end
        φ = 0                                    r ≥ r_c

    ISO 6358-1:2013 as in MathWorks' "Orifice ISO 6358 (G)" and MapleSim's "Air Orifice ISO6358".
    The terms with the cracking pressure Δp_c were not checked against the standard.
    `temperature_dependent=False` leaves out √θ₁. C is given for air, as in a data sheet; `numbers` converts
    it to the rig's gas.
    """

    sonic_conductance_SL_per_s_kPa: float
    critical_pressure_ratio: float = 0.3
    subsonic_index: float = 0.5
    cracking_kPa: float = 0.0
    laminar_ratio: float = 0.995
    temperature_dependent: bool = True
    one_way: bool = False

    def __post_init__(self) -> None:
        if not self.sonic_conductance_SL_per_s_kPa > 0.0:
            raise ValueError("a sonic conductance must be positive")
        if not 0.0 <= self.critical_pressure_ratio < self.laminar_ratio <= 1.0:
            raise ValueError("a critical pressure ratio must be in 0…1 and below the laminar ratio")
        if not self.subsonic_index > 0.0 or not self.cracking_kPa >= 0.0:
            raise ValueError("a subsonic index must be positive, a cracking pressure not negative")

    def numbers(self, gas: GasProperties = AIR) -> Opening:
        opening = Opening(
            False,
            self.sonic_conductance_SL_per_s_kPa * sonic_conductance_ratio(gas),
            self.critical_pressure_ratio,
            self.subsonic_index,
            self.cracking_kPa,
            self.laminar_ratio,
            self.temperature_dependent,
            self.one_way,
        )
        plain = opening._replace(cracking_kPa=0.0)
        # At standard temperature. Over the downstream pressure, the flow is steepest in the laminar part.
        laminar = min(self.laminar_ratio, 0.999)
        steepest = max(1.0, choked_share(plain, 1.0, laminar) / (1.0 - laminar))
        return opening._replace(
            laminar_share=choked_share(plain, 1.0, self.laminar_ratio),
            steepest_SL_per_s_kPa=opening.conductance_SL_per_s_kPa * steepest,
        )


FlowLaw = Ohm | Iso6358


def conductance_from_rating_SL_per_s_kPa(flow_SLPM: float, supply_kPa: float) -> float:
    """C = Q / (60 p₁), from a manufacturer's choked flow to atmosphere at a gauge supply pressure."""
    return flow_SLPM / 60.0 / (supply_kPa + STANDARD_PRESSURE_KPA)


def iso6358_matching(
    flow_resistance_kPa_s_per_SL: float,
    at_kPa: float = 690.0,
    *,
    critical_pressure_ratio: float = 0.3,
    subsonic_index: float = 0.5,
    laminar_ratio: float = 0.995,
    temperature_dependent: bool = True,
    one_way: bool = False,
    gas: GasProperties = AIR,
) -> Iso6358:
    """The ISO 6358 valve with the flow of Ohm's law from `at_kPa` (gauge) to atmosphere, with this gas."""
    shape = Iso6358(
        1.0,
        critical_pressure_ratio,
        subsonic_index,
        laminar_ratio=laminar_ratio,
        temperature_dependent=temperature_dependent,
        one_way=one_way,
    )
    supply_kPa_abs = at_kPa + STANDARD_PRESSURE_KPA
    unit = supply_kPa_abs * choked_share(shape.numbers(), supply_kPa_abs, STANDARD_PRESSURE_KPA)
    unit *= sonic_conductance_ratio(gas)
    return Iso6358(
        at_kPa / flow_resistance_kPa_s_per_SL / unit,
        critical_pressure_ratio,
        subsonic_index,
        laminar_ratio=laminar_ratio,
        temperature_dependent=temperature_dependent,
        one_way=one_way,
    )


def choked_law(
    flow_resistance_kPa_s_per_SL: float,
    at_kPa: float,
    critical_pressure_ratio: float,
    gas: GasProperties,
    one_way: bool = True,
) -> Iso6358:
    """ISO 6358 as the causes use it: no influence of temperature, and linear above p₂/p₁ = 0.999.

    It has the flow of Ohm's law from `at_kPa` (gauge) to atmosphere.
    """
    return iso6358_matching(
        flow_resistance_kPa_s_per_SL,
        at_kPa,
        critical_pressure_ratio=critical_pressure_ratio,
        laminar_ratio=0.999,
        temperature_dependent=False,
        one_way=one_way,
        gas=gas,
    )


@dataclass(frozen=True)
class ChokedPump:
    """The flow of ISO 6358 from a constant supply at the stall pressure P_max:

        Q = u Q_max φ(r) / φ(r₀),   r = (P_cv + p_a)/(P_max + p_a),   r₀ = p_a/(P_max + p_a)

    Q_max is the free flow, into 0 kPa gauge, p_a = 101.325 kPa. φ: see `Iso6358`.
    """

    critical_pressure_ratio: float = 0.3


def pump_law(pump: Pump, curve: ChokedPump | None, gas: GasProperties) -> FlowLaw:
    """The law of the flow from P_max to the chamber. Without a curve it falls linearly to 0 at P_max."""
    if curve is None:
        return Ohm(pump.flow_resistance_kPa_s_per_SL)
    stall_kPa, ratio = pump.stall_pressure_kPa, curve.critical_pressure_ratio
    return choked_law(pump.flow_resistance_kPa_s_per_SL, stall_kPa, ratio, gas)
