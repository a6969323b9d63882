"""Plans the motion for an intent: for the core in flight, and for checks of a mission before the flight."""

from __future__ import annotations

import math
from collections.abc import Sequence

from flying_vines.config.config import Config, no_profile
from flying_vines.vine.intent import BendTo, Intent, SetPressure, StartProfile
from flying_vines.vine.motion import Motion, plan
from flying_vines.vine.profile import Segment, Step, flatten

MIN_RATE_KPA_PER_S = 1.0


class MotionPlanner:
    """Plans motions with the profiles, limits and bend curve of one configuration."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._profiles = {name: tuple(flatten(config.profiles, name)) for name in config.profiles}
        self.curve = config.vine.bend_curve()

    def problem(self, intent: Intent) -> str:
        """Why the intent is invalid (unknown profile, angle out of range, negative pressure); else empty."""
        match intent:
            case StartProfile(name) if name not in self._profiles:
                return no_profile(self._config, name)
            case BendTo(angle_deg) if not self.curve.min_deg <= angle_deg <= self.curve.max_deg:
                angles = f"{self.curve.min_deg:g}…{self.curve.max_deg:g}°"
                return f"{angle_deg:g}° is outside the vine's {angles}"
            case SetPressure(target_kPa) if target_kPa < 0.0:
                return f"{target_kPa:g} kPa is below ambient"
        return ""

    def plan(
        self,
        intent: Intent,
        start_kPa: float,
        bent_kPa: float,
        limit_kPa: float = math.inf,
        rate_scale: float = 1.0,
        started_at: float = 0.0,
    ) -> Motion:
        """The motion that carries out an intent for which `problem` is empty.

        Args:
            intent: `StartProfile`, `BendTo` or `SetPressure`.
            start_kPa: pressure at the start, gauge.
            bent_kPa: the pressure that gives the present bend during inflation (`BendCurve.bent_kPa`).
            limit_kPa: the firmware's pressure limit. If `limits.max_kPa` is lower, that limit applies.
            rate_scale: share of the maximum rate, 0…1.
            started_at: start time of the motion.
        """
        rate_kPa_per_s = self._rate_kPa_per_s(intent)
        if rate_scale < 1.0:
            rate_kPa_per_s = max(MIN_RATE_KPA_PER_S, rate_kPa_per_s * rate_scale)
        return plan(
            self._segments(intent),
            self.curve,
            start_kPa,
            rate_kPa_per_s,
            min(limit_kPa, self._config.limits.max_kPa),
            bent_kPa,
            name=str(intent),
            started_at=started_at,
        )

    def _segments(self, intent: Intent) -> Sequence[Segment]:
        match intent:
            case StartProfile(name):
                return self._profiles[name]
            case BendTo(angle_deg):
                return (Step(to_deg=angle_deg),)
            case SetPressure(target_kPa):
                return (Step(to_kPa=target_kPa),)
        raise AssertionError(intent)

    def _rate_kPa_per_s(self, intent: Intent) -> float:
        fastest = self._config.limits.max_rate_kPa_per_s
        if isinstance(intent, StartProfile):
            return min(fastest, self._config.profiles[intent.name].rate_kPa_per_s or fastest)
        return fastest
