"""Checks the vehicle's mission: does a rule of the configuration match each vine item?"""

from __future__ import annotations

from collections.abc import Mapping

from flying_vines.config.config import Config
from flying_vines.core.motion_planner import MotionPlanner
from flying_vines.doctor.finding import DoctorFinding, FindingText
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.triggers import Rules

NOT_READ = FindingText(
    "mission",
    "warning",
    "it could not be read, so its items would not move the vine",
    "try again with more --seconds; check whether a ground station is uploading",
)
NO_AUTOPILOT = FindingText("mission", "skipped", "not read: no autopilot was found")
NONE = FindingText("mission", "good", "the vehicle has no mission")
NO_VINE = FindingText("mission", "good", "{items} items, none for the vine")
UNDERSTOOD = FindingText("mission", "good", "{items} items; for the vine: {vine}")
NOT_UNDERSTOOD = FindingText(
    "mission",
    "bad",
    "item {seq}: {why}",
    "correct the item, or add a rule to [[items]]; `flying-vines mission check` shows details",
)


def check(mission: Mapping[int, MissionItem] | None, found: bool, config: Config) -> list[DoctorFinding]:
    """`mission` is None if it was not read; `found` is True if there is an autopilot."""
    if not found:
        return [NO_AUTOPILOT()]
    if mission is None:
        return [NOT_READ()]
    if not mission:
        return [NONE()]
    rules, planner = Rules(config), MotionPlanner(config)
    findings, understood = [], []
    for seq, item in sorted(mission.items()):
        if item.command not in rules.commands:
            continue
        intent, problem = rules.for_command(item.command, item.params)
        if intent is not None:
            problem = planner.problem(intent)
        if problem:
            findings.append(NOT_UNDERSTOOD(seq=seq, why=problem))
        else:
            understood.append(f"{seq} ({intent})")
    if understood:
        findings.append(UNDERSTOOD(items=len(mission), vine=", ".join(understood)))
    return findings or [NO_VINE(items=len(mission))]
