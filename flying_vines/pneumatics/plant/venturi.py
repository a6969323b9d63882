"""The Venturi: how deep its vacuum is, how much it draws, and what its supply does to both.

The baseline's Venturi makes P_vac = full_vacuum · u_d · min(1, P_r / rated_supply) whatever it has to draw.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

from flying_vines.pneumatics.plant.flow import FlowFunction, FlowLaw, Iso6358, Ohm
from flying_vines.pneumatics.plant.gas import STANDARD_PRESSURE_KPA


@dataclass(frozen=True)
class Ejector:
    """What a Venturi does beyond the baseline's; as it stands it is the baseline's.

    `stall_supply_kPa`: below this supply (gauge) P_vac = 0.
    `nozzle_conductance_SL_per_s_kPa`: its nozzle in series with the supply valve, which then follows
    ISO 6358. The vacuum follows the pressure before it: P_vac = full_vacuum · min(1, P_n / rated_supply).
    `free_suction_per_motive`: at no vacuum it draws this share of its motive flow, falling straight to
    nothing at full vacuum: Q = Q_free (1 − vacuum at the port / P_vac). What is pushed out beyond Q_free, or
    comes back through a Venturi at rest, meets `passage_resistance_kPa_s_per_SL`.
    `scales_with_ambient`: thin air makes less vacuum, P_vac · p_a / 101.325.

    Straight characteristic and passage are assumptions; makers' curves are nearly straight.
    """

    stall_supply_kPa: float = 0.0
    nozzle_conductance_SL_per_s_kPa: float | None = None
    free_suction_per_motive: float | None = None
    passage_resistance_kPa_s_per_SL: float = 5.0
    scales_with_ambient: bool = False

    def __post_init__(self) -> None:
        if not self.stall_supply_kPa >= 0.0:
            raise ValueError("a stalling supply pressure is not negative")
        for what in (
            self.nozzle_conductance_SL_per_s_kPa,
            self.free_suction_per_motive,
            self.passage_resistance_kPa_s_per_SL,
        ):
            if what is not None and not what > 0.0:
                raise ValueError("a nozzle, a suction and a passage are positive")


COVAL_VR09 = Ejector(
    nozzle_conductance_SL_per_s_kPa=1.185e-3, free_suction_per_motive=0.6, scales_with_ambient=True
)
"""A 0.9 mm nozzle (45.7 SLPM from 643 kPa abs), free suction 0.4 to 0.8 of the consumption. Assumption."""


def nozzle_supply(
    valve_SL_per_s_kPa: float, nozzle_SL_per_s_kPa: float, supply_kPa_abs: float, ambient_kPa: float
) -> tuple[float, float]:
    """Motive flow in SL/s (at standard temperature) and absolute pressure before the nozzle, kPa.

    Two openings in series, each with Q = C √(p₁² − p₂²), which is ISO 6358 with b = 0:
    Q² = (p₁² − p_a²) / (1/C_v² + 1/C_n²), p_n² = p_a² + Q²/C_n². Assumption: against b = 0.3 it passes 7 %
    less at 690 kPa, and it is smooth down to no pressure at all.
    """
    if valve_SL_per_s_kPa <= 0.0 or supply_kPa_abs <= ambient_kPa:
        return 0.0, ambient_kPa
    valve, nozzle = valve_SL_per_s_kPa * valve_SL_per_s_kPa, nozzle_SL_per_s_kPa * nozzle_SL_per_s_kPa
    drop = supply_kPa_abs * supply_kPa_abs - ambient_kPa * ambient_kPa
    # Not as sums of 1/C²: a valve may be open by next to nothing.
    return (
        sqrt(drop * nozzle / (valve + nozzle) * valve),
        sqrt(ambient_kPa * ambient_kPa + drop * valve / (valve + nozzle)),
    )


OutletFunction = Callable[[float, float, float, float, float, float], float]
"""(p, θ, p_a, θ_a, P_vac, Q_free) → flow out of the control volume, SL/s."""


def outlet_into(ejector: Ejector, solenoid: FlowLaw) -> OutletFunction:
    """The outlet through a solenoid into an ejector that draws only what it can.

    Both flows are the same and the pressure between them follows; with Ohm's solenoid that is two straight
    lines.
    """
    passage = ejector.passage_resistance_kPa_s_per_SL
    if isinstance(solenoid, Ohm):
        resistance = solenoid.flow_resistance_kPa_s_per_SL

        def ohmic(
            p: float, theta: float, ambient: float, ambient_theta: float, vacuum: float, free: float
        ) -> float:
            gauge = p - ambient
            if gauge + vacuum <= 0.0:
                return (gauge + vacuum) / (resistance + passage)
            if free > 0.0 and gauge < free * resistance:
                return (gauge + vacuum) / (resistance + vacuum / free)
            return (gauge + free * passage) / (resistance + passage)

        return ohmic
    if solenoid.subsonic_index == 0.5 and solenoid.cracking_kPa == 0.0:
        return _elliptic_outlet(passage, solenoid)
    return _iterated_outlet(passage, solenoid.function())


def _elliptic_outlet(passage: float, solenoid: Iso6358) -> OutletFunction:
    """With m = 1/2 the law is an ellipse in r and the ejector a straight line: where they cross."""
    law, hot = solenoid.function(), solenoid.temperature_dependent
    b, laminar, conductance = (
        solenoid.critical_pressure_ratio,
        solenoid.laminar_ratio,
        solenoid.sonic_conductance_SL_per_s_kPa,
    )
    stretch = 1.0 / ((1.0 - b) * (1.0 - b))
    end = (1.0 - (laminar - b) ** 2 * stretch) ** 0.5
    backwards = _iterated_outlet(passage, law)

    def outlet(
        p: float, theta: float, ambient: float, ambient_theta: float, vacuum: float, free: float
    ) -> float:
        if p <= ambient - vacuum or (p <= ambient and free <= 0.0):
            return backwards(p, theta, ambient, ambient_theta, vacuum, free)
        # The line has its corner at ambient pressure. It is start + slope · r, r the pressure between over p.
        beyond = p > ambient and law(p, ambient, theta, ambient_theta) > free
        per_kPa = 1.0 / passage if beyond or vacuum <= 0.0 else free / vacuum
        start, slope = free - per_kPa * ambient, per_kPa * p
        choked = conductance * p / sqrt(theta) if hot else conductance * p
        if choked - start <= b * slope:
            return choked
        squared = choked * choked
        wide = squared * stretch
        half = wide * b - start * slope
        both = wide + slope * slope
        rest = start * start + wide * b * b - squared
        r = (half + sqrt(max(0.0, half * half - both * rest))) / both
        if r > laminar:
            steep = choked * end / (1.0 - laminar)
            r = (steep - start) / (steep + slope)
        return start + slope * r

    return outlet


def _iterated_outlet(passage: float, law: FlowFunction) -> OutletFunction:
    def outlet(
        p: float, theta: float, ambient: float, ambient_theta: float, vacuum: float, free: float
    ) -> float:
        near, far = ambient - vacuum, p

        def surplus(port: float) -> float:
            gauge = port - ambient
            if far <= near:
                drawn = (port - near) / passage
            elif gauge >= 0.0 or vacuum <= 0.0:
                drawn = free + gauge / passage
            else:
                drawn = free * (1.0 + gauge / vacuum)
            return law(p, port, theta, ambient_theta) - drawn

        # The ejector's line has its corner at ambient pressure: the root is on one side of it.
        lower, upper = near, far
        if near < ambient < far:
            if surplus(ambient) > 0.0:
                lower = ambient
            else:
                upper = ambient
        return law(p, _root(surplus, lower, upper), theta, ambient_theta)

    return outlet


def vacuum_share(ambient_kPa: float) -> float:
    """What is left of a vacuum in thin air: p_a / 101.325. The lowest ratio of pressures stays."""
    return ambient_kPa / STANDARD_PRESSURE_KPA


def _root(function: Callable[[float], float], a: float, b: float) -> float:
    """Where a falling or rising function is zero between a and b (Illinois)."""
    at_a, at_b = function(a), function(b)
    if at_a == 0.0 or a == b:
        return a
    if at_b == 0.0:
        return b
    x = a
    side = 0
    for _ in range(60):
        x = (a * at_b - b * at_a) / (at_b - at_a)
        at_x = function(x)
        if at_x == 0.0:
            return x
        if (at_x > 0.0) == (at_b > 0.0):
            done = abs(b - x) < 1e-9
            b, at_b = x, at_x
            if side == -1:
                at_a *= 0.5
            side = -1
        else:
            done = abs(a - x) < 1e-9
            a, at_a = x, at_x
            if side == 1:
                at_b *= 0.5
            side = 1
        if done or abs(b - a) < 1e-9:
            return x
    return x
