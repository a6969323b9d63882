"""The tube between the valves and the control volume: a small volume and a resistance.

The valves and the pressure sensor are at one end of the tube, the control volume is at the other. The gas in
the tube is at ambient temperature (assumption: the wall is large for so little gas). The flow into the
control volume is Q = (P_line − P_cv) / R.
"""

from __future__ import annotations

from math import pi

from flying_vines.physics.rig import Hose

_AIR_VISCOSITY_PA_S = 1.81e-5
"""Viscosity of air at 20 °C."""


def tubing_of(length_m: float, bore_mm: float) -> Hose:
    """Volume π d² l / 4 and resistance 128 μ l / (π d⁴) (Hagen-Poiseuille) at 20 °C near ambient pressure.

    In a 4 mm tube the flow is turbulent from about 0.1 SL/s on; the resistance is then 2 to 3 times as high.
    """
    bore_m = bore_mm / 1000.0
    resistance_Pa_s_per_m3 = 128.0 * _AIR_VISCOSITY_PA_S * length_m / (pi * bore_m**4)
    return Hose(pi * bore_m**2 / 4.0 * length_m * 1000.0, resistance_Pa_s_per_m3 / 1e6)
