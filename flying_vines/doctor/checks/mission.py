"""The mission that the vehicle holds: does the profile understand each item that is meant for the vine?"""

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
    "it could not be read: its items would do nothing",
    "try again with more --seconds; see whether a ground station is uploading",
)
NOT_HEARD = FindingText("mission", "skipped", "not read: no autopilot was heard")
NONE = FindingText("mission", "good", "the vehicle holds none")
NO_VINE = FindingText("mission", "good", "{items} items, none for the vine")
UNDERSTOOD = FindingText("mission", "good", "{items} items, of which for the vine: {vine}")
NOT_UNDERSTOOD = FindingText(
    "mission",
    "bad",
    "item {seq}: {why}",
    "correct the item, or give it a rule in [[items]]; `flying-vines mission check` knows more",
)


def check(mission: Mapping[int, MissionItem] | None, heard: bool, config: Config) -> list[DoctorFinding]:
    """`mission` is None where it was not read, `heard` whether an autopilot was there at all."""
    if not heard:
        return [NOT_HEARD()]
    if mission is None:
        return [NOT_READ()]
    if not mission:
        return [NONE()]
    rules, planner = Rules(config), MotionPlanner(config)
    found, understood = [], []
    for seq, item in sorted(mission.items()):
        if item.command not in rules.commands:
            continue
        intent, problem = rules.for_command(item.command, item.params)
        if intent is not None:
            problem = planner.problem(intent)
        if problem:
            found.append(NOT_UNDERSTOOD(seq=seq, why=problem))
        else:
            understood.append(f"{seq} ({intent})")
    if understood:
        found.append(UNDERSTOOD(items=len(mission), vine=", ".join(understood)))
    return found or [NO_VINE(items=len(mission))]
