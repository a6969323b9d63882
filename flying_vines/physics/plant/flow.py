"""What flows through an opening: Ohm's law, or ISO 6358.

A law is a description; `numbers()` are what `flow_SL_per_s` calculates with, the same for every law.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

from flying_vines.physics.constants import STANDARD_PRESSURE_KPA

_ANR_SL = STANDARD_PRESSURE_KPA / 100.0
"""ISO 6358 counts at 100 kPa and 20 °C what we count at 101.325 kPa and 20 °C."""


class Opening(NamedTuple):
    """The numbers of a law, and those of an opening that is not there."""

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
    """φ at the laminar ratio, where nothing has to crack."""
    steepest_SL_per_s_kPa: float = 0.0
    """The most that the flow changes per kPa."""


def flow_SL_per_s(law: Opening, p1: float, p2: float, theta1: float, theta2: float) -> float:
    """From 1 to 2 (negative: from 2 to 1); absolute pressures in kPa, temperatures as ratios to 293.15 K."""
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
    """φ of ISO 6358, for flow in this direction."""
    if upstream <= downstream:
        return 0.0
    b = law.critical_pressure_ratio
    r = downstream / upstream
    closing = 1.0 - law.cracking_kPa / upstream
    if r >= closing:
        return 0.0
    laminar = law.laminar_ratio * closing
    if laminar <= b:
        # Too little pressure to choke before it cracks: what is left of the law is its last, straight piece.
        return min(1.0, (closing - r) / (closing - laminar)) if closing > laminar else 1.0
    if r <= b:
        return 1.0
    x = (min(r, laminar) - b) / (closing - b)
    whole = 1.0 - x * x
    share = sqrt(whole) if law.subsonic_index == 0.5 else whole**law.subsonic_index
    return share * (closing - r) / (closing - laminar) if r > laminar else share


@dataclass(frozen=True)
class Ohm:
    """Q = (p₁ − p₂) / R, the paper's Eq. 2."""

    flow_resistance_kPa_s_per_SL: float

    def __post_init__(self) -> None:
        if not self.flow_resistance_kPa_s_per_SL > 0.0:
            raise ValueError("a flow resistance is positive")

    def numbers(self) -> Opening:
        per_kPa = 1.0 / self.flow_resistance_kPa_s_per_SL
        return Opening(conductance_SL_per_s_kPa=per_kPa, steepest_SL_per_s_kPa=per_kPa)


@dataclass(frozen=True)
class Iso6358:
    """Q = C p₁ φ(p₂/p₁) / √θ₁, with r = p₂/p₁ and the closing ratio r_c = 1 − Δp_c/p₁:

        φ = 1                                    r ≤ b
        φ = [1 − ((r − b)/(r_c − b))²]^m          b < r < r_c
        φ = φ(r_l) (r_c − r)/(r_c − r_l)          r_l = laminar_ratio · r_c < r: a straight end
        φ = 0                                    r ≥ r_c

    ISO 6358-1:2013 as in MathWorks' "Orifice ISO 6358 (G)" and MapleSim's "Air Orifice ISO6358"; the place of
    the cracking pressure Δp_c is from memory of the standard. `temperature_dependent=False` leaves out √θ₁.
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
            raise ValueError("a sonic conductance is positive")
        if not 0.0 <= self.critical_pressure_ratio < self.laminar_ratio <= 1.0:
            raise ValueError("a critical pressure ratio lies in 0…1, below the laminar ratio")
        if not self.subsonic_index > 0.0 or not self.cracking_kPa >= 0.0:
            raise ValueError("a subsonic index is positive, a cracking pressure not negative")

    def numbers(self) -> Opening:
        b = self.critical_pressure_ratio

        def share(r: float) -> float:
            return float(max(0.0, 1.0 - ((r - b) / (1.0 - b)) ** 2) ** self.subsonic_index)

        # Steepest in the laminar piece, at standard temperature.
        laminar = min(self.laminar_ratio, 0.999)
        return Opening(
            False,
            self.sonic_conductance_SL_per_s_kPa,
            b,
            self.subsonic_index,
            self.cracking_kPa,
            self.laminar_ratio,
            self.temperature_dependent,
            self.one_way,
            share(self.laminar_ratio),
            self.sonic_conductance_SL_per_s_kPa * max(1.0, share(laminar) / (1.0 - laminar)),
        )


FlowLaw = Ohm | Iso6358


def conductance_from_rating_SL_per_s_kPa(flow_SLPM: float, supply_kPa: float) -> float:
    """C = Q / (60 p₁): from a maker's choked flow into the open at a gauge supply pressure."""
    return flow_SLPM / 60.0 / (supply_kPa + STANDARD_PRESSURE_KPA)


def conductance_dm3_per_s_bar(sonic_conductance_SL_per_s_kPa: float) -> float:
    """The same C in ISO 6358's dm³/(s·bar), which counts at 100 kPa: 1 SL/(s·kPa) = 101.325 dm³/(s·bar)."""
    return sonic_conductance_SL_per_s_kPa * 100.0 * _ANR_SL


def iso6358_matching(
    flow_resistance_kPa_s_per_SL: float,
    at_kPa: float = 690.0,
    *,
    critical_pressure_ratio: float = 0.3,
    subsonic_index: float = 0.5,
    laminar_ratio: float = 0.995,
    temperature_dependent: bool = True,
    one_way: bool = False,
) -> Iso6358:
    """The ISO 6358 valve that passes from `at_kPa` (gauge) into the open what Ohm's law gives there."""
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
    return Iso6358(
        at_kPa / flow_resistance_kPa_s_per_SL / unit,
        critical_pressure_ratio,
        subsonic_index,
        laminar_ratio=laminar_ratio,
        temperature_dependent=temperature_dependent,
        one_way=one_way,
    )
