"""Which runs to record, before measuring: those that tell the causes of a discrepancy apart best.

made = plan(load_rig("rig.toml"), minutes=3.0)      the runs, and what they will tell apart
made.best.scenario                                  for `flying_vines.simulation.scenario`
recommend(rig, ("evp_lag", "line_delay"))           the one run that settles a doubt
"""

from __future__ import annotations

from flying_vines.identification.plan.planning import (
    CausePair,
    PlannedRun,
    Recommendation,
    Recording,
    RecordingPlan,
    RecordingPlanError,
    plan,
    recommend,
)

__all__ = [
    "CausePair",
    "PlannedRun",
    "Recommendation",
    "Recording",
    "RecordingPlan",
    "RecordingPlanError",
    "plan",
    "recommend",
]
