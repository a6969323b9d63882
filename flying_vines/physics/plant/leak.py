"""The laws of leaks, and the total leak of one volume to ambient:

    Q = (p − p_a) (1/R + (p + p_a)/C) + the flow of an orifice + a curve over p − p_a

Leaks by Ohm's law add up exactly, and so do viscous leaks. A volume has at most one orifice and one curve:
any function of pressure, as straight lines.

    rig.with_effects(cv_leak_curve=curve_of(lambda p_kPa: 1e-4 * max(0.0, p_kPa - 12.0) ** 0.5))
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from flying_vines.physics.gas import AIR, GasProperties, nozzle_critical_ratio
from flying_vines.physics.plant.flow import Iso6358, Ohm, Opening, flow_SL_per_s

PIECES = 64
"""Number of straight lines in a curve. They end at up_to · (i/PIECES)², so the first ones are short."""


class CurveNumbers(NamedTuple):
    """The numbers of a curve. The defaults are no flow."""

    up_to_kPa: float = 0.0
    steepest_SL_per_s_kPa: float = 0.0
    """Maximum change of the flow per kPa."""
    flow_SL_per_s: tuple[float, ...] = (0.0,) * (PIECES + 1)


def curve_SL_per_s(curve: CurveNumbers, gauge_kPa: float) -> float:
    """Flow out; below ambient pressure the same flow comes in. Beyond the curve its last line continues."""
    pressure = abs(gauge_kPa)
    piece = min(int(PIECES * math.sqrt(pressure / curve.up_to_kPa)), PIECES - 1)
    unit = curve.up_to_kPa / PIECES**2
    into = (pressure - unit * piece**2) / (unit * (2 * piece + 1))
    before = curve.flow_SL_per_s[piece]
    flow = before + into * (curve.flow_SL_per_s[piece + 1] - before)
    return flow if gauge_kPa >= 0.0 else -flow


@dataclass(frozen=True)
class Curve:
    """A leak to ambient by points: gauge pressure in kPa, flow in SL/s. The first is 0, 0."""

    points: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        if len(self.points) < 2 or self.points[0] != (0.0, 0.0):
            raise ValueError("a leak's curve needs its points, the first at 0 kPa without flow")
        for (p1, q1), (p2, q2) in pairwise(self.points):
            if not p1 < p2 < math.inf:
                raise ValueError(f"the pressures of a leak's curve must rise: {p2:g} kPa is after {p1:g} kPa")
            if not q1 <= q2 < math.inf:
                raise ValueError(f"the flow of a leak's curve must not fall: at {p2:g} kPa it is {q2:g} SL/s")

    @property
    def numbers(self) -> CurveNumbers:
        """The curve at the ends of its pieces."""
        up_to_kPa = self.points[-1][0]
        flow = tuple(map(self._flow_SL_per_s, _ends_kPa(up_to_kPa)))
        lines = zip(pairwise(_ends_kPa(up_to_kPa)), pairwise(flow), strict=True)
        return CurveNumbers(up_to_kPa, max((q2 - q1) / (p2 - p1) for (p1, p2), (q1, q2) in lines), flow)

    def _flow_SL_per_s(self, gauge_kPa: float) -> float:
        """The flow at a pressure, interpolated between two points."""
        after = min(bisect_right(self.points, (gauge_kPa, math.inf)), len(self.points) - 1)
        (p1, q1), (p2, q2) = self.points[after - 1 : after + 1]
        return q1 + (q2 - q1) * (gauge_kPa - p1) / (p2 - p1)


def curve_of(flow_SL_per_s: Callable[[float], float], up_to_kPa: float = 200.0) -> Curve:
    """The curve of a function from gauge pressure in kPa to flow in SL/s (20 °C, 101.325 kPa).

    The function is called at 65 pressures from 0 to `up_to_kPa`, closer together near 0. Beyond them the
    last line continues; below ambient pressure the same flow comes in. ValueError if the flow at 0 kPa
    is not 0, or if the flow falls or is infinite anywhere.
    """
    return Curve(tuple((p, float(flow_SL_per_s(p))) for p in _ends_kPa(up_to_kPa)))


def _ends_kPa(up_to_kPa: float) -> list[float]:
    return [up_to_kPa * (end / PIECES) ** 2 for end in range(PIECES + 1)]


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
