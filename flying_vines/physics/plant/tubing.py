"""The tube between the valves and the control volume: a small volume and a resistance.

The valves and the pressure sensor are at its near end. Its gas is at ambient temperature (assumption: the
wall is large for so little gas), and Q = (P_line − P_cv) / R flows into the control volume.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

from flying_vines.physics.rig import Rig

_AIR_VISCOSITY_PA_S = 1.81e-5
"""Viscosity of air at 20 °C."""


@dataclass(frozen=True)
class Tubing:
    """The default is 1 m of 4 mm tube with twice its laminar resistance."""

    volume_L: float = 0.0126
    flow_resistance_kPa_s_per_SL: float = 6.0

    def __post_init__(self) -> None:
        if not (self.volume_L > 0.0 and self.flow_resistance_kPa_s_per_SL > 0.0):
            raise ValueError("a tube's volume and resistance must be positive")


def hose_of(rig: Rig) -> Tubing | None:
    """The hose of a rig; None if it has none."""
    return Tubing(rig.hose.volume_L, rig.hose.flow_resistance_kPa_s_per_SL) if rig.hose else None


def tubing_of(length_m: float, bore_mm: float) -> Tubing:
    """Volume π d² l / 4 and resistance 128 μ l / (π d⁴) (Hagen-Poiseuille) at 20 °C near ambient pressure.

    In a 4 mm tube the flow is turbulent from about 0.1 SL/s on; the resistance is then 2 to 3 times as high.
    """
    bore_m = bore_mm / 1000.0
    resistance_Pa_s_per_m3 = 128.0 * _AIR_VISCOSITY_PA_S * length_m / (pi * bore_m**4)
    return Tubing(pi * bore_m**2 / 4.0 * length_m * 1000.0, resistance_Pa_s_per_m3 / 1e6)
