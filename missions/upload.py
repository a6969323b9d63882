"""Put a mission on a vehicle, read it back, and say what became of it on the way."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from flying_vines.vehicle.autopilots import AUTOPILOTS
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.mission.storage import AutopilotKind, MissionRefused
from missions.carriers import described, over_the_wire
from missions.checks import name_of
from missions.files import load_items
from missions.link import MissionVehicle, UploadRefused, VehicleLinkError, vehicle
from missions.mission import MissionError

DONE, DIFFERS, REFUSED = 0, 1, 2

_NUMBERS = ("param1", "param2", "param3", "param4", "x", "y", "z")
_HOME = 0
_WAYPOINT, _RETURN, _LAND, _TAKEOFF, _ABOVE_SEA = 16, 20, 21, 22, 0


@dataclass(frozen=True, slots=True)
class MissionComparison:
    """A mission that was sent and the one that is held, item by item; each a sentence."""

    changed: tuple[str, ...]
    """What the autopilot's storage was known to change."""
    unexpected: tuple[str, ...]
    """What it holds otherwise than it was expected to."""


async def upload(path: Path, link: str, console: Console) -> int:
    """Upload the mission in a .plan or .waypoints file, and compare what the vehicle then holds.

    0 when it holds what it was expected to hold, 1 when something else, 2 when it took the mission not at all
    or in part; the console says which.

    Raises:
        MissionError: the file cannot be read, or is for another autopilot.
        LinkError: no vehicle, or it fell silent.
    """
    found = load_items(path, None if path.suffix == ".plan" else "ardupilot")
    async with vehicle(link) as peer:
        name = AUTOPILOTS[peer.kind].title
        if path.suffix == ".plan" and found.kind != peer.kind:
            raise MissionError(
                f"{path}: is for {AUTOPILOTS[found.kind].title}, the vehicle is {name}: build it for {name}"
            )
        refuse_wrong_home(path, found.items, peer.kind)
        console.print(f"Uploading {len(found.items)} items to {name}, system {peer.system_id}")
        try:
            await _send(peer, found.items, console if console.is_terminal else None)
        except UploadRefused as refused:
            console.print(_sentence(found.items, refused), style="red", soft_wrap=True, markup=False)
            for line in await _left_behind(peer, found.items, refused.seq or 0):
                console.print(line, soft_wrap=True, markup=False)
            return REFUSED
        comparison = compare(peer.kind, found.items, await peer.download())
    for sentence in comparison.changed:
        console.print(sentence, style="yellow", soft_wrap=True, markup=False)
    for sentence in comparison.unexpected:
        console.print(sentence, style="red", soft_wrap=True, markup=False)
    if comparison.unexpected:
        return DIFFERS
    console.print(
        f"Uploaded. Read back: {name} holds what it was expected to hold.", style="green", soft_wrap=True
    )
    return DONE


def refuse_wrong_home(path: Path, items: Sequence[MissionItem], kind: AutopilotKind) -> None:
    """ArduPilot would lose the first item of a mission for PX4, which would fly to the home of the other."""
    looks_like_home = items[0].command == _WAYPOINT and items[0].frame == _ABOVE_SEA
    if kind == "ardupilot" and not looks_like_home:
        what = f"begins with {name_of(items[0])}, which ArduPilot would take for home"
    elif kind == "px4" and looks_like_home and len(items) > 1 and items[1].command == _TAKEOFF:
        what = "begins with a home, which PX4 would fly to"
    else:
        return
    raise MissionError(f"{path}: {what}: build it for {AUTOPILOTS[kind].title}")


async def _send(peer: MissionVehicle, items: Sequence[MissionItem], console: Console | None) -> None:
    columns = (TextColumn("items"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, console=console, transient=True, disable=console is None) as bar:
        task = bar.add_task("", total=len(items))
        await peer.upload(items, lambda share: bar.update(task, completed=round(share * len(items))))


def _sentence(items: Sequence[MissionItem], refused: UploadRefused) -> str:
    if refused.seq is None or refused.seq >= len(items):
        return f"Refused: {refused.why}."
    item = items[refused.seq]
    return f"Refused: item {item.seq} ({name_of(item)}, command {item.command}): {refused.why}."


async def _left_behind(peer: MissionVehicle, sent: Sequence[MissionItem], refused_seq: int) -> list[str]:
    """What the vehicle holds after a refusal, read from it: ArduPilot's missions are mixed then."""
    try:
        held = await peer.download()
    except VehicleLinkError as error:
        return [f"What it holds now is not known: {error}"]
    if peer.kind == "px4":
        return [f"The vehicle still holds the mission from before, {len(held)} items."]
    new = {item.seq for item in held if item.seq < refused_seq and _is_kept(peer.kind, sent[item.seq], item)}
    if not new - {_HOME}:
        return [f"The vehicle still holds the mission from before, {len(held)} items."]
    lines = [f"{item.seq:5}  {'new' if item.seq in new else 'before':6}  {name_of(item)}" for item in held]
    return ["The vehicle now holds a mixture. Do not fly it: upload a mission that it takes.", *lines]


def _is_kept(kind: AutopilotKind, sent: MissionItem, held: MissionItem) -> bool:
    if AUTOPILOTS[kind].begins_with_home and sent.seq == _HOME:
        return True
    try:
        return _same(kind, AUTOPILOTS[kind].store(over_the_wire(sent)), held)
    except MissionRefused:
        return False


def compare(
    kind: AutopilotKind, sent: Sequence[MissionItem], held: Sequence[MissionItem]
) -> MissionComparison:
    """What became of a mission; ArduPilot's item 0 is its home, which it sets itself."""
    changed: list[str] = []
    unexpected: list[str] = []
    if len(held) != len(sent):
        unexpected.append(f"The vehicle holds {len(held)} items, {len(sent)} were sent.")
    for before, after in zip(sent, held, strict=False):
        if AUTOPILOTS[kind].begins_with_home and before.seq == _HOME:
            continue
        try:
            expected = AUTOPILOTS[kind].store(over_the_wire(before))
        except MissionRefused:
            name = AUTOPILOTS[kind].title
            unexpected.append(
                f"item {before.seq} ({name_of(before)}): taken, which {name} was not known to do."
            )
            continue
        if not _same(kind, expected, after):
            unexpected.append(
                f"item {before.seq} ({name_of(before)}): the vehicle holds {_in_full(after)}, "
                f"expected was {_in_full(expected)}."
            )
        else:
            changed.extend(_changes(_meant(kind, before), _meant(kind, after)))
    return MissionComparison(tuple(changed), tuple(unexpected))


def _changes(before: MissionItem, after: MissionItem) -> list[str]:
    return [
        f"item {before.seq} ({name_of(before)}): {name} {sent:g} is kept as {kept:g}."
        for name, sent, kept in zip(_NUMBERS, before.params, after.params, strict=True)
        if not math.isnan(sent) and not _close(sent, kept)
    ]


def _meant(kind: AutopilotKind, item: MissionItem) -> MissionItem:
    """Without what the autopilot fills in whatever was sent, and what says nothing to the flight."""
    if kind == "ardupilot" and item.command == _RETURN:
        return replace(item, params=(0.0,) * 7, frame=0)
    if kind == "ardupilot" and item.command == _LAND:
        return replace(item, params=(*item.params[:3], 0.0, *item.params[4:]))
    return item


def _same(kind: AutopilotKind, one: MissionItem, other: MissionItem) -> bool:
    """Whether two items make the same flight and the same vine."""
    one, other = _meant(kind, one), _meant(kind, other)
    numbers = zip(one.params, other.params, strict=True)
    is_same = (one.command, one.frame) == (other.command, other.frame)
    return is_same and all(_close(a, b) for a, b in numbers)


def _close(a: float, b: float) -> bool:
    """The same 32-bit float, or the same ten-millionth of a degree."""
    return math.isclose(a, b, rel_tol=1e-6, abs_tol=2e-7) or (math.isnan(a) and math.isnan(b))


def _in_full(item: MissionItem) -> str:
    return f"{described(item)} in frame {item.frame}"
