"""Parts from installed packages: actuators, physics checks, triggers, profile segments.

A package is loaded only if the configuration names it. The installed packages are searched only for a name
that is not built in, because a search takes tenths of a second on a small computer.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, Literal

import msgspec

from flying_vines.vine.profile import MAX_PIECES, Segment

Group = Literal["actuators", "checks", "triggers", "segments"]


class PluginError(ValueError):
    """A named part cannot be used; one sentence for people."""


def find(group: Group, name: str, key: str, *needs: str) -> Callable[..., Any]:
    """The entry point `name` of the group `flying_vines.GROUP`: a class or function, to call with settings.

    The object that it makes must have the attributes `needs`. Raises `PluginError`, which names the `key` of
    the configuration, if no package or several have this name, or if the entry point cannot be imported. The
    returned function raises the same error if the call fails, or if an attribute is missing.
    """
    from importlib.metadata import entry_points

    points = tuple(entry_points(group=f"flying_vines.{group}", name=name))
    if len(points) != 1:
        number = "several packages have" if points else "no installed package has"
        have = ", ".join(installed(group)) or "none"
        raise PluginError(f"{key}: {number} '{name}' in flying_vines.{group}; installed: {have}")
    (point,) = points
    where = f"{key}: {point.value}" + (f" of package {point.dist.name}" if point.dist else "")
    make = _one_line(where, point.load)

    def checked(*arguments: Any, **settings: Any) -> Any:
        made = _one_line(where, lambda: make(*arguments, **settings))
        if missing := [need for need in needs if not hasattr(made, need)]:
            raise PluginError(f"{where} has no {', '.join(missing)}")
        return made

    return checked


def _one_line(where: str, call: Callable[[], Any]) -> Any:
    try:
        return call()
    except (Exception, SystemExit) as error:
        text = " ".join(str(error).split())
        raise PluginError(f"{where}: {type(error).__name__}: {text}") from error


def installed(group: Group) -> list[str]:
    """The names that installed packages have in a group."""
    from importlib.metadata import entry_points

    return sorted({point.name for point in entry_points(group=f"flying_vines.{group}")})


def with_own_segments(profile: Any, built_in: Collection[str]) -> tuple[Any, dict[int, list[Any]]]:
    """Replaces a raw profile's segments of installed packages by placeholders.

    Returns the profile, and the built-in segments for each placeholder, by its index. A package makes them
    from the segment's settings; it is called here, once. A segment whose kind is not installed stays as it
    is. Raises `PluginError`.
    """
    raw = profile.get("segments") if isinstance(profile, dict) else None
    segments: list[Any] = raw if isinstance(raw, list) else []
    kinds = {
        index: segment["kind"]
        for index, segment in enumerate(segments)
        if isinstance(segment, dict) and str(segment.get("kind", "step")) not in built_in
    }
    own = set(installed("segments")).intersection(kinds.values()) if kinds else ()
    replaced = {index: _made(segments[index]) for index, kind in kinds.items() if kind in own}
    if not replaced:
        return profile, {}
    placeholder = {"kind": "hold", "for_s": 1.0}
    filled = [placeholder if index in replaced else segment for index, segment in enumerate(segments)]
    return {**profile, "segments": filled}, replaced


def put_in(profile: Any, replaced: Mapping[int, Sequence[Any]]) -> Any:
    """The profile with the built-in segments in the place of the placeholders."""
    parts = [replaced.get(index, [segment]) for index, segment in enumerate(profile["segments"])]
    return {**profile, "segments": [segment for part in parts for segment in part]}


def _made(segment: Mapping[str, Any]) -> list[Any]:
    kind = segment["kind"]
    try:
        made = msgspec.convert(list(find("segments", kind, "segments")(**_settings(segment))), list[Segment])
    except (TypeError, msgspec.ValidationError) as error:
        raise PluginError(f"segments: {kind} does not return segments: {error}") from None
    if not 1 <= len(made) <= MAX_PIECES:
        raise PluginError(f"segments: {kind} returns {len(made)} segments, not 1…{MAX_PIECES}")
    return list(msgspec.to_builtins(made))


def _settings(segment: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in segment.items() if key != "kind"}
