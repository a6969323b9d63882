"""Reviews a mission: timeline, air budget and checks."""

from __future__ import annotations

from collections.abc import Sequence

from flying_vines.config.config import Config
from flying_vines.supply import RigPrior
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.mission.reference_vehicle import Home
from flying_vines.vehicle.mission.storage import AutopilotKind
from missions.budget import budget
from missions.checks import CheckedMission, check
from missions.report import Report
from missions.timeline import timeline


def review(
    name: str,
    items: Sequence[MissionItem],
    kind: AutopilotKind,
    home: Home,
    config: Config,
    prior: RigPrior,
    reservoir_kPa: float,
) -> Report:
    """Review the items, with the reservoir at `reservoir_kPa` (gauge)."""
    plan = timeline(items, kind, home)
    air = budget(plan, config, prior, reservoir_kPa)
    findings = check(CheckedMission(items, kind, config, plan, air))
    return Report(name, items, kind, home, plan, air, findings)
