"""What the vine does about an intent, planned as the service plans it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from flying_vines.config import Config
from flying_vines.intent import BendTo, Intent, StartProfile
from flying_vines.vine.profile import Segment, Step, Trajectory, flatten, plan, top_kPa

AT_REST_KPA = 0.5
"""Gauge; less is a vine that is straight."""


@dataclass(frozen=True, slots=True)
class Move:
    """A movement of the vine. Gauge kPa."""

    trajectory: Trajectory
    peak_kPa: float
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


class Mover:
    """Plans movements for one profile."""

    def __init__(self, config: Config) -> None:
        self._limits = config.limits
        self._profiles: Mapping[str, tuple[Segment, ...]] = {
            name: tuple(flatten(config.profiles, name)) for name in config.profiles
        }
        self._rates = {name: profile.rate_kPa_per_s for name, profile in config.profiles.items()}
        self.curve = config.vine.bend_curve()

    def problem(self, intent: Intent) -> str:
        """Why the vine cannot do it at all, or nothing."""
        if isinstance(intent, StartProfile) and intent.name not in self._profiles:
            return f"there is no profile '{intent.name}'"
        if isinstance(intent, BendTo) and not self.curve.min_deg <= intent.angle_deg <= self.curve.max_deg:
            angles = f"{self.curve.min_deg:g}…{self.curve.max_deg:g}°"
            return f"{intent.angle_deg:g}° is outside the vine's {angles}; calibrate further, or bend less"
        return ""

    def move(self, intent: Intent, start_kPa: float, bent_kPa: float, rate_scale: float = 1.0) -> Move:
        """The movement from `start_kPa`; ValueError for what `problem` names."""
        rate = self._limits.max_rate_kPa_per_s
        if problem := self.problem(intent):
            raise ValueError(problem)
        match intent:
            case StartProfile(name):
                segments: tuple[Segment, ...] = self._profiles[name]
                rate = min(rate, self._rates[name] or rate)
            case BendTo(angle_deg):
                segments = (Step(to_deg=angle_deg),)
            case _:
                raise ValueError(f"a mission item cannot ask for {intent}")
        limit = self._limits.max_kPa
        trajectory = plan(segments, self.curve, start_kPa, rate * rate_scale, limit, bent_kPa)
        bent = self.curve.bent_kPa(trajectory.peak_kPa, bent_kPa)
        return Move(
            trajectory,
            top_kPa(segments, self.curve, limit),
            rate,
            self.curve.bent_kPa(trajectory.final_kPa, bent),
        )
