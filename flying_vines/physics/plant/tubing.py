"""The tube between the valves and the control volume: a small volume of its own, and a resistance.

Valves and the pressure sensor sit at its near end. Its gas is at ambient temperature (much wall, little gas:
assumption), and Q = (P_line − P_cv) / R into the control volume.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

_VISCOSITY_PA_S = 1.81e-5
"""Air at 20 °C."""


@dataclass(frozen=True)
class Tubing:
    """Litres, and kPa·s per standard litre. The default: 1 m of 4 mm tube, and twice its laminar
    resistance."""

    volume_L: float = 0.0126
    flow_resistance_kPa_s_per_SL: float = 6.0

    def __post_init__(self) -> None:
        if not (self.volume_L > 0.0 and self.flow_resistance_kPa_s_per_SL > 0.0):
            raise ValueError("a tube has volume and resistance")


def tubing_of(length_m: float, bore_mm: float) -> Tubing:
    """Volume π d² l / 4 and Hagen–Poiseuille's 128 μ l / (π d⁴) at 20 °C and near ambient pressure.

    Turbulent from about 0.1 SL/s in 4 mm on: the resistance is then two or three times as high.
    """
    bore_m = bore_mm / 1000.0
    resistance_Pa_s_per_m3 = 128.0 * _VISCOSITY_PA_S * length_m / (pi * bore_m**4)
    return Tubing(pi * bore_m**2 / 4.0 * length_m * 1000.0, resistance_Pa_s_per_m3 / 1e6)
