"""Reads and checks scenario files."""

from __future__ import annotations

import difflib
import re
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, get_args

import msgspec
from msgspec import Meta

from flying_vines.files.toml_text import OneLineError, dotted, expectation, not_finite, parsed, read_text
from flying_vines.simulation.scenario.run_kinds import RunKind, ScenarioSegment, Valves

_EXAMPLES = resources.files("flying_vines.simulation.scenario") / "examples"
_KINDS = {str(kind.__struct_config__.tag): kind for kind in get_args(RunKind)}
_SEGMENTS = tuple(str(segment.__struct_config__.tag) for segment in get_args(ScenarioSegment))


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
    content = parsed(text, source, ScenarioError)
    for key in not_finite(content):
        raise ScenarioError(f"{source}: {dotted(key)}: is not a finite number")
    try:
        return msgspec.convert(content, Scenario)
    except msgspec.ValidationError as error:
        raise ScenarioError(f"{source}: {_explained(content, str(error))}") from None


def _explained(content: dict[str, Any], error: str) -> str:
    """`key: reason` for msgspec's `... - at `$.a[1].b``."""
    reason, _, place = error.partition(" - at `$")
    key = place.rstrip("`").removeprefix(".")
    if named := re.search(r"(?:unknown|required) field `(.+)`", reason):
        key = f"{key}.{named[1]}".removeprefix(".")
        if "required" in reason:
            reason = "is missing"
        else:
            near = difflib.get_close_matches(named[1], _keys_of_run(content, key), n=1)
            reason = "unknown key" + (f"; did you mean '{near[0]}'?" if near else "")
    elif own := re.match(r"([a-z]\w*(?:\[\d+\])?(?:\.\w+)?): (.+)", reason):
        # Our own checks put the key first.
        key, reason = f"{key}.{own[1]}".removeprefix("."), own[2]
    elif reason.startswith("Invalid value") and key.endswith("].kind"):
        choices = _KINDS if key.count("[") == 1 else _SEGMENTS
        reason = f"{reason[0].lower()}{reason[1:]}; give one of {', '.join(choices)}"
    elif wanted := expectation(reason, None):
        reason = wanted
    reason = reason.replace("Expected", "expected").replace("Object", "the table").replace("`", "")
    return f"{key}: {reason}" if key else reason


def _keys_of_run(content: dict[str, Any], key: str) -> tuple[str, ...]:
    """The valid keys at the place of `key`."""
    at = re.fullmatch(r"runs\[(\d+)\]\.(?:(valves|segments)\[\d+\]\.)?[^.\[]+", key)
    if at is None:
        return Scenario.__struct_fields__
    if at[2]:
        parts = (Valves,) if at[2] == "valves" else get_args(ScenarioSegment)
        return tuple(field for part in parts for field in part.__struct_fields__)
    kind = content["runs"][int(at[1])].get("kind")
    return _KINDS[kind].__struct_fields__ if kind in _KINDS else ()
