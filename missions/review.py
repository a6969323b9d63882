"""All that can be said of a mission before it flies."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from flying_vines.config.config import Config
from flying_vines.physics.plant.true_rig import load_true_rig
from flying_vines.simulation.autopilot import Home
from flying_vines.simulation.mission_flight import fly
from flying_vines.supply import Belief
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.mission.storage import Kind
from missions.budget import budget
from missions.checks import Case, check
from missions.report import Report
from missions.timeline import timeline


def review(
    name: str,
    items: Sequence[MissionItem],
    kind: Kind,
    home: Home,
    config: Config,
    belief: Belief,
    reservoir_kPa: float,
    rig: Path | None = None,
    flies: bool = False,
) -> Report:
    """Check the items, with a bottle at `reservoir_kPa` (gauge); `flies` flies them in simulation.

    Missions with errors are not flown: what an autopilot would refuse cannot be.
    """
    plan = timeline(items, kind, home)
    air = budget(plan, config, belief, reservoir_kPa)
    findings = check(Case(items, kind, config, plan, air))
    trial = None
    if flies and not any(finding.severity == "error" for finding in findings):
        true_rig = load_true_rig(rig) if rig else None
        trial = fly(items, config, kind, home, reservoir_kPa, plan.length_s, true_rig)
    return Report(name, items, kind, home, plan, air, findings, trial)
