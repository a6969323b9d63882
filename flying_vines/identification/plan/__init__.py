"""Plans which runs to record: those that best separate the causes of a discrepancy.

made = plan(load_rig("rig.toml"), minutes=3.0)      the runs, and the causes that they separate
made.best.scenario                                  for `flying_vines.simulation.scenario`
recommend(rig, causes)                              the runs that separate these causes
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
