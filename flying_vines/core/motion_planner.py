"""How the vine moves to do what is wanted: planned alike in flight and before it.

The core moves the vine by it, and a mission's budget and builder look ahead by it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from flying_vines.config.config import Config, no_profile
from flying_vines.core.safety import Demand
from flying_vines.supply import Belief, ReservoirEstimate, floor_kPa
from flying_vines.vine.intent import BendTo, Intent, SetPressure, StartProfile
from flying_vines.vine.profile import Segment, Step, Trajectory, flatten, plan, top_kPa

MIN_RATE_KPA_PER_S = 1.0
AT_REST_KPA = 0.5
"""Gauge; less is a vine that is straight."""


@dataclass(frozen=True, slots=True)
class Move:
    """A movement of the vine. Gauge kPa."""

    trajectory: Trajectory
    peak_kPa: float
    wanted_kPa: float
    """The peak that was asked for, before the limits clipped it."""
    rate_kPa_per_s: float
    bent_kPa: float
    """How far it has bent the vine in the end, as `BendCurve.bent_kPa` names bends."""

    @property
    def releases(self) -> bool:
        """Whether it only lets air out."""
        return self.trajectory.rise_kPa <= 0.0 and self.trajectory.final_kPa <= 0.0

    @property
    def stays_bent(self) -> bool:
        return self.trajectory.final_kPa > AT_REST_KPA

    def demand(self, reservoir: ReservoirEstimate, belief: Belief) -> Demand:
        """What safety has to know of it, with the bottle as estimated."""
        return Demand(
            releases=self.releases,
            peak_kPa=self.peak_kPa,
            wanted_kPa=self.wanted_kPa,
            spending_kPa=reservoir.spending_kPa(self.trajectory.rise_kPa),
            floor_kPa=floor_kPa(belief.pneumatics, self.rate_kPa_per_s),
        )


class Mover:
    """Plans movements within one configuration."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._profiles = {name: tuple(flatten(config.profiles, name)) for name in config.profiles}
        self.curve = config.vine.bend_curve()

    def problem(self, intent: Intent) -> str:
        """Why the vine cannot do it at all, or nothing."""
        match intent:
            case StartProfile(name) if name not in self._profiles:
                return no_profile(self._config, name)
            case BendTo(angle_deg) if not self.curve.min_deg <= angle_deg <= self.curve.max_deg:
                angles = f"{self.curve.min_deg:g}…{self.curve.max_deg:g}°"
                return f"{angle_deg:g}° is outside the vine's {angles}"
            case SetPressure(target_kPa) if target_kPa < 0.0:
                return f"{target_kPa:g} kPa is below ambient"
        return ""

    def move(
        self,
        intent: Intent,
        start_kPa: float,
        bent_kPa: float,
        limit_kPa: float = math.inf,
        rate_scale: float = 1.0,
    ) -> Move:
        """The movement that carries out what `problem` does not name.

        Args:
            intent: one that takes air.
            start_kPa: from where, gauge.
            bent_kPa: how far the vine is bent, as `BendCurve.bent_kPa` names bends.
            limit_kPa: of the firmware, where that is below the configuration's.
            rate_scale: how much slower than it could be, 0…1.
        """
        limit_kPa = min(limit_kPa, self._config.limits.max_kPa)
        segments = self._segments(intent)
        rate_kPa_per_s = self._rate_kPa_per_s(intent)
        if rate_scale < 1.0:
            rate_kPa_per_s = max(MIN_RATE_KPA_PER_S, rate_kPa_per_s * rate_scale)
        trajectory = plan(segments, self.curve, start_kPa, rate_kPa_per_s, limit_kPa, bent_kPa)
        furthest_kPa = self.curve.bent_kPa(trajectory.peak_kPa, bent_kPa)
        return Move(
            trajectory,
            peak_kPa=top_kPa(segments, self.curve, limit_kPa),
            wanted_kPa=top_kPa(segments, self.curve, math.inf),
            rate_kPa_per_s=rate_kPa_per_s,
            bent_kPa=self.curve.bent_kPa(trajectory.final_kPa, furthest_kPa),
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
