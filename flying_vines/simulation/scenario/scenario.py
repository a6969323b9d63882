"""Reads and checks scenario files."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from flying_vines.files.toml_text import OneLineError, converted, read_text
from flying_vines.simulation.scenario.run_kinds import RunKind

_EXAMPLES = resources.files("flying_vines.simulation.scenario") / "examples"


class ScenarioError(OneLineError, ValueError):
    """A scenario is invalid; the text is one line, `file: key: reason`."""


class Scenario(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Runs in order; each starts at rest."""

    runs: Annotated[tuple[RunKind, ...], Meta(min_length=1, max_length=20)]
    name: Annotated[str, Meta(max_length=100)] = ""
    """The picture's title."""


def examples() -> tuple[str, ...]:
    """The names of the built-in scenarios."""
    names = (entry.name for entry in _EXAMPLES.iterdir())
    return tuple(sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml")))


def load_scenario(source: Path | str) -> Scenario:
    """The scenario in a TOML file, or the built-in one of this name. Raises `ScenarioError`."""
    path = Path(source)
    if not path.exists() and str(source) in examples():
        return parse_scenario((_EXAMPLES / f"{source}.toml").read_text(encoding="utf-8"), str(source))
    absent = f" and no such example; the examples are {', '.join(examples())}"
    return parse_scenario(read_text(path, ScenarioError, absent), str(path))


def parse_scenario(text: str, source: str) -> Scenario:
    """Check a scenario's text. Errors name the text by `source`."""
    scenario: Scenario = converted(text, source, Scenario, ScenarioError)
    return scenario
