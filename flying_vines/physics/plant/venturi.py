"""The Venturi: its vacuum and its suction flow, and how both depend on the supply.

The Venturi of the baseline gives P_vac = full_vacuum · u_d · min(1, P_r / rated_supply) at any suction flow.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

from flying_vines.physics.gas import AIR, STANDARD_PRESSURE_KPA, GasProperties, sonic_conductance_ratio
from flying_vines.physics.plant.flow import Opening, flow_SL_per_s
from flying_vines.physics.rig import Venturi


class Suction(NamedTuple):
    """The numbers of a Venturi."""

    full_vacuum_kPa: float
    rated_supply_kPa: float
    stall_supply_kPa: float
    nozzle_SL_per_s_kPa: float
    """0: no nozzle, as in the baseline."""
    unlimited: bool
    """True if the suction flow does not reduce the vacuum."""
    free_per_motive: float
    passage_resistance_kPa_s_per_SL: float
    scales_with_ambient: bool


@dataclass(frozen=True)
class Ejector:
    """Effects of a Venturi. With the defaults it is the Venturi of the baseline.

    `stall_supply_kPa`: below this supply (gauge) P_vac = 0.
    `nozzle_conductance_SL_per_s_kPa`: the nozzle in series with the supply valve, which must then follow ISO
    6358. The vacuum follows the pressure before the nozzle: P_vac = full_vacuum · min(1, P_n / rated_supply).
    `free_suction_per_motive`: suction flow Q_free without vacuum, as a share of the motive flow. The suction
    flow falls linearly to 0 at full vacuum: Q = Q_free (1 − vacuum at the port / P_vac).
    `passage_resistance_kPa_s_per_SL`: resistance for flow beyond Q_free, and for backflow.
    `scales_with_ambient`: thin air gives less vacuum, P_vac · p_a / 101.325.

    The linear characteristic and the passage are assumptions; manufacturers' curves are nearly linear.
    """

    stall_supply_kPa: float = 0.0
    nozzle_conductance_SL_per_s_kPa: float | None = None
    free_suction_per_motive: float | None = None
    passage_resistance_kPa_s_per_SL: float = 5.0
    scales_with_ambient: bool = False

    def __post_init__(self) -> None:
        if not self.stall_supply_kPa >= 0.0:
            raise ValueError("a stalling supply pressure must not be negative")
        for what in (
            self.nozzle_conductance_SL_per_s_kPa,
            self.free_suction_per_motive,
            self.passage_resistance_kPa_s_per_SL,
        ):
            if what is not None and not what > 0.0:
                raise ValueError("nozzle, suction and passage must be positive")

    def numbers(self, venturi: Venturi, gas: GasProperties = AIR) -> Suction:
        return Suction(
            venturi.full_vacuum_kPa,
            venturi.rated_supply_kPa,
            self.stall_supply_kPa,
            (self.nozzle_conductance_SL_per_s_kPa or 0.0) * sonic_conductance_ratio(gas),
            self.free_suction_per_motive is None,
            self.free_suction_per_motive or 0.0,
            self.passage_resistance_kPa_s_per_SL,
            self.scales_with_ambient,
        )


COVAL_VR09 = Ejector(
    nozzle_conductance_SL_per_s_kPa=1.185e-3, free_suction_per_motive=0.6, scales_with_ambient=True
)
"""A nozzle of 0.9 mm: 45.7 SLPM from 643 kPa absolute. Assumption: free suction is 0.6 of the consumption,
within the usual 0.4 to 0.8."""


def nozzle_supply(
    valve_SL_per_s_kPa: float, nozzle_SL_per_s_kPa: float, supply_kPa_abs: float, ambient_kPa: float
) -> tuple[float, float]:
    """Motive flow in SL/s (at standard temperature) and absolute pressure before the nozzle, kPa.

    Two openings in series, each with Q = C √(p₁² − p₂²), which is ISO 6358 with b = 0:
    Q² = (p₁² − p_a²) / (1/C_v² + 1/C_n²), p_n² = p_a² + Q²/C_n². b = 0 is an assumption: the flow at 690 kPa
    is 6 % lower than with b = 0.3, but the law is smooth down to zero pressure.
    """
    if valve_SL_per_s_kPa <= 0.0 or supply_kPa_abs <= ambient_kPa:
        return 0.0, ambient_kPa
    valve, nozzle = valve_SL_per_s_kPa * valve_SL_per_s_kPa, nozzle_SL_per_s_kPa * nozzle_SL_per_s_kPa
    drop = supply_kPa_abs * supply_kPa_abs - ambient_kPa * ambient_kPa
    # No sums of 1/C²: they overflow if a valve is almost shut.
    return (
        sqrt(drop * nozzle / (valve + nozzle) * valve),
        sqrt(ambient_kPa * ambient_kPa + drop * valve / (valve + nozzle)),
    )


def supply(
    venturi: Suction,
    valve: Opening,
    opening: float,
    supply_kPa_abs: float,
    ambient_kPa: float,
    ratio: float,
    ambient_ratio: float,
) -> tuple[float, float]:
    """Motive flow in SL/s, and maximum vacuum in kPa below ambient, at an opening above 0."""
    if venturi.nozzle_SL_per_s_kPa == 0.0:
        motive = opening * flow_SL_per_s(valve, supply_kPa_abs, ambient_kPa, ratio, ambient_ratio)
        vacuum = opening * min(1.0, (supply_kPa_abs - ambient_kPa) / venturi.rated_supply_kPa)
    else:
        motive, before = nozzle_supply(
            opening * valve.conductance_SL_per_s_kPa,
            venturi.nozzle_SL_per_s_kPa,
            supply_kPa_abs,
            ambient_kPa,
        )
        motive /= sqrt(ratio)
        vacuum = min(1.0, (before - ambient_kPa) / venturi.rated_supply_kPa)
    # The lowest pressure that the Venturi reaches is the same share of ambient pressure at any altitude.
    if venturi.scales_with_ambient:
        vacuum *= ambient_kPa / STANDARD_PRESSURE_KPA
    return motive, venturi.full_vacuum_kPa * vacuum


def outlet_SL_per_s(
    venturi: Suction,
    solenoid: Opening,
    p: float,
    ratio: float,
    ambient_kPa: float,
    ambient_ratio: float,
    vacuum_kPa: float,
    motive_SL_per_s: float,
) -> float:
    """Flow out of the control volume (absolute pressure `p`) through the open solenoid and the ejector.

    Solenoid and ejector have the same flow; this condition gives the pressure between them. With an ohmic
    solenoid both flows are linear in this pressure.
    """
    if venturi.unlimited:
        return flow_SL_per_s(solenoid, p, ambient_kPa - vacuum_kPa, ratio, ambient_ratio)
    free = venturi.free_per_motive * motive_SL_per_s if vacuum_kPa > 0.0 else 0.0
    if solenoid.ohmic:
        passage = venturi.passage_resistance_kPa_s_per_SL
        resistance = 1.0 / solenoid.conductance_SL_per_s_kPa
        gauge = p - ambient_kPa
        if gauge + vacuum_kPa <= 0.0:
            return (gauge + vacuum_kPa) / (resistance + passage)
        if free > 0.0 and gauge < free * resistance:
            return (gauge + vacuum_kPa) / (resistance + vacuum_kPa / free)
        return (gauge + free * passage) / (resistance + passage)
    if solenoid.subsonic_index != 0.5 or solenoid.cracking_kPa > 0.0:
        port = _port(venturi, solenoid, p, ratio, ambient_kPa, ambient_ratio, vacuum_kPa, free)
        return flow_SL_per_s(solenoid, p, port, ratio, ambient_ratio)
    near = ambient_kPa - vacuum_kPa
    if p > near:
        return _elliptic(venturi, solenoid, p, ratio, ambient_kPa, ambient_ratio, vacuum_kPa, free)
    return -_elliptic_back(venturi, solenoid, p, near, ambient_ratio)


def _elliptic(
    venturi: Suction,
    solenoid: Opening,
    p: float,
    ratio: float,
    ambient_kPa: float,
    ambient_ratio: float,
    vacuum_kPa: float,
    free: float,
) -> float:
    """The flow that solenoid and ejector have in common, if the solenoid follows ISO 6358 with m = 1/2.

    r is the pressure between solenoid and ejector, divided by p. Over r, the solenoid's flow is an ellipse
    and the ejector's flow is a line. Both cross at the result.
    """
    b, laminar = solenoid.critical_pressure_ratio, solenoid.laminar_ratio
    # The ejector's flow is start + slope · r. It has a kink at ambient pressure.
    if vacuum_kPa <= 0.0 or (
        p > ambient_kPa and flow_SL_per_s(solenoid, p, ambient_kPa, ratio, ambient_ratio) > free
    ):
        per_kPa = 1.0 / venturi.passage_resistance_kPa_s_per_SL
    else:
        per_kPa = free / vacuum_kPa
    start, slope = free - per_kPa * ambient_kPa, per_kPa * p
    choked = solenoid.conductance_SL_per_s_kPa * p
    if solenoid.temperature_dependent:
        choked /= sqrt(ratio)
    if choked - start <= b * slope:
        return choked
    if laminar < 1.0:
        steep = choked * solenoid.laminar_share / (1.0 - laminar)
        r = (steep - start) / (steep + slope)
        if r >= laminar:
            return start + slope * r
    squared = choked * choked
    wide = squared / ((1.0 - b) * (1.0 - b))
    half = wide * b - start * slope
    both = wide + slope * slope
    rest = start * start + wide * b * b - squared
    return start + slope * (half + sqrt(max(0.0, half * half - both * rest))) / both


def _elliptic_back(venturi: Suction, solenoid: Opening, p: float, near: float, ambient_ratio: float) -> float:
    """The backflow through the passage, from a pressure `near`, and then through the solenoid to `p`."""
    if solenoid.one_way:
        return 0.0
    b, laminar = solenoid.critical_pressure_ratio, solenoid.laminar_ratio
    per_kPa = 1.0 / venturi.passage_resistance_kPa_s_per_SL
    conductance = solenoid.conductance_SL_per_s_kPa
    if solenoid.temperature_dependent:
        conductance /= sqrt(ambient_ratio)
    port = near * per_kPa / (conductance + per_kPa)
    if p <= b * port:
        return conductance * port
    if laminar < 1.0:
        steep = conductance * solenoid.laminar_share / (1.0 - laminar)
        port = (steep * p + per_kPa * near) / (steep + per_kPa)
        if p >= laminar * port:
            return steep * (port - p)
    # c² (port² − ((p − b port)/(1 − b))²) = ((near − port)/R)²
    squared = conductance * conductance
    wide = squared / ((1.0 - b) * (1.0 - b))
    line = per_kPa * per_kPa
    half = wide * b * p + line * near
    rest = wide * p * p + line * near * near
    port = rest / (half + sqrt(max(0.0, half * half + (squared - wide * b * b - line) * rest)))
    return per_kPa * (near - port)


def _port(
    venturi: Suction,
    solenoid: Opening,
    p: float,
    ratio: float,
    ambient_kPa: float,
    ambient_ratio: float,
    vacuum_kPa: float,
    free: float,
) -> float:
    """The pressure between solenoid and ejector at which both flows are equal."""
    a, b = ambient_kPa - vacuum_kPa, p
    # The ejector's flow has a kink at ambient pressure: find the side with the root.
    if a < ambient_kPa < b:
        if (
            _surplus(venturi, solenoid, ambient_kPa, p, ratio, ambient_kPa, ambient_ratio, vacuum_kPa, free)
            > 0.0
        ):
            a = ambient_kPa
        else:
            b = ambient_kPa
    at_a = _surplus(venturi, solenoid, a, p, ratio, ambient_kPa, ambient_ratio, vacuum_kPa, free)
    at_b = _surplus(venturi, solenoid, b, p, ratio, ambient_kPa, ambient_ratio, vacuum_kPa, free)
    if at_a == 0.0 or a == b:
        return a
    if at_b == 0.0:
        return b
    # Regula falsi, Illinois variant.
    x = a
    side = 0
    for _ in range(60):
        x = (a * at_b - b * at_a) / (at_b - at_a)
        at_x = _surplus(venturi, solenoid, x, p, ratio, ambient_kPa, ambient_ratio, vacuum_kPa, free)
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


def _surplus(
    venturi: Suction,
    solenoid: Opening,
    port: float,
    p: float,
    ratio: float,
    ambient_kPa: float,
    ambient_ratio: float,
    vacuum_kPa: float,
    free: float,
) -> float:
    """Flow through the solenoid minus the suction of the ejector at this port pressure."""
    near, gauge = ambient_kPa - vacuum_kPa, port - ambient_kPa
    if p <= near:
        drawn = (port - near) / venturi.passage_resistance_kPa_s_per_SL
    elif gauge >= 0.0 or vacuum_kPa <= 0.0:
        drawn = free + gauge / venturi.passage_resistance_kPa_s_per_SL
    else:
        drawn = free * (1.0 + gauge / vacuum_kPa)
    return flow_SL_per_s(solenoid, p, port, ratio, ambient_ratio) - drawn
