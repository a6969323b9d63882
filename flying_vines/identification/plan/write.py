"""Writes a plan as files: a scenario for the simulator, profiles for the service."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec

from flying_vines.identification.plan.planning import PlannedRun, Recording, RecordingPlan
from flying_vines.simulation.scenario.scenario import ProfileRun

SCENARIO, PROFILES = "scenario.toml", "profiles.toml"
_FIRST_NUMBER = 101
_HEADER = """\
# Append this to the service's configuration, and check it: flying-vines config check FILE
# For each run: vent the vine, bring the reservoir to the pressure in the run's comment, and wait 2 s. Start
# the run with the command USER_1 and its number as param1. After the run vent, and wait 6 s.
"""


def write_plan(plan: RecordingPlan, folder: Path) -> list[Path]:
    """Write the best runs as a scenario, and those that the service can do as profiles. Returns the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = {SCENARIO: scenario_text(plan.best)}
    if plan.by_commands.runs:
        texts[PROFILES] = profiles_text(plan.by_commands)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return [folder / name for name in texts]


def scenario_text(recording: Recording) -> str:
    """A scenario file."""
    lines = [f"name = {_value(recording.scenario.name)}"]
    for run in recording.runs:
        lines += ["", f"# {run.shows}", "[[runs]]", *_lines(msgspec.to_builtins(run.kind))]
    return "\n".join([*lines, ""])


def profiles_text(recording: Recording) -> str:
    """Profiles of the service's configuration, and the commands that start them."""
    lines = [_HEADER.rstrip()]
    for number, run in enumerate(recording.runs, start=_FIRST_NUMBER):
        name = f"plan-{number}-{run.name.replace('_', '-')}"
        lines += ["", f"# {run.shows}; {run.seconds:.0f} s, reservoir at {run.kind.reservoir_kPa:g} kPa"]
        lines += ["[[items]]", 'command = "user_1"', f"match = {{ param1 = {number} }}"]
        lines += [f"profile = {_value(name)}", "", f"[profiles.{name}]", *_segments(run)]
    return "\n".join([*lines, ""])


def _segments(run: PlannedRun) -> list[str]:
    assert isinstance(run.kind, ProfileRun)
    segments = list(msgspec.to_builtins(run.kind.segments))
    if segments[-2:-1] != (end := [{"kind": "step", "to_kPa": 0.0}]):
        segments += end
    return _lines({"segments": segments, "rate_kPa_per_s": run.kind.rate_kPa_per_s})


def _lines(table: dict[str, Any]) -> list[str]:
    return [f"{key} = {_value(value)}" for key, value in table.items() if value is not None]


def _value(value: Any) -> str:
    if isinstance(value, dict):
        entries = [f"{key} = {_value(item)}" for key, item in value.items() if item is not None]
        return "{ " + ", ".join(entries) + " }"
    if isinstance(value, list | tuple):
        return "\n".join(["[", *(f"    {_value(item)}," for item in value), "]"])
    return json.dumps(value)
