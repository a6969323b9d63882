"""A physics check: the vine is driven towards a setpoint, and its pressure stays where it is."""

from firmware_link.protocol import Mode
from flying_vines.supply import Features

FAR_KPA, MOVED_KPA, WITHIN_S = 3.0, 0.5, 1.5


class Stuck:
    def __init__(self, rig: object) -> None:
        self._since_s, self._from_kPa = 0.0, 0.0

    def look(self, now: Features) -> str | None:
        told, kPa = now.telemetry, now.cv_median_kPa
        far = told.mode is Mode.REGULATE and abs(told.setpoint_kPa - kPa) > FAR_KPA
        if not far or abs(kPa - self._from_kPa) > MOVED_KPA:
            self._since_s, self._from_kPa = now.t, kPa
        return f"vine stays at {kPa:.0f} kPa" if now.t - self._since_s > WITHIN_S else None
