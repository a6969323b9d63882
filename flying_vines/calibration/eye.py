"""Somebody who looks at a fake rig's vine: true curve, hysteresis and a hand's uncertainty."""

from __future__ import annotations

from random import Random

from flying_vines.vine.curve import BendCurve

CURVE = ((0.0, 0.0), (3.0, 0.0), (6.0, 17.0), (9.0, 30.0), (12.0, 40.0), (16.0, 50.0), (21.0, 58.0))
"""Of a vine that levels off; not the profile's."""
HYSTERESIS_KPA = 1.2
READS_TO_DEG = 1.0


class SimulatedEye:
    """Asked in the order in which the vine moves."""

    def __init__(self, seed: int = 1) -> None:
        self._curve = BendCurve(CURVE, HYSTERESIS_KPA)
        self._random = Random(seed)
        self._bent_kPa = 0.0

    def sees(self, cv_kPa: float) -> float:
        """The angle, degrees, at a true gauge pressure."""
        self._bent_kPa = self._curve.bent_kPa(cv_kPa, self._bent_kPa)
        seen_deg = self._curve.angle_deg(self._bent_kPa) + self._random.gauss(0.0, READS_TO_DEG)
        return round(max(0.0, seen_deg), 1)
