"""The vine's motion: which trajectory runs, since when, and what it wants now."""

from __future__ import annotations

from dataclasses import dataclass

from flying_vines.vine.profile import Trajectory


@dataclass(frozen=True, slots=True)
class Motion:
    """A trajectory under way."""

    trajectory: Trajectory
    started_at: float
    rate_kPa_per_s: float
    name: str

    def setpoint_kPa(self, t: float) -> float:
        """The gauge pressure wanted at time `t`."""
        return self.trajectory.pressure_kPa(t - self.started_at)

    def over(self, t: float) -> bool:
        return t - self.started_at >= self.trajectory.duration_s

    @property
    def only_lets_out(self) -> bool:
        """Whether it goes to no pressure and nowhere else."""
        return self.trajectory.rise_kPa <= 0.0 and self.trajectory.final_kPa <= 0.0

    def releases(self, t: float) -> bool:
        """Whether it has come to its end, and that end is no pressure."""
        return self.over(t) and self.trajectory.final_kPa <= 0.0
