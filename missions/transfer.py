"""Uploads a mission, reads it back and reports the differences; downloads a mission to a file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from flying_vines.vehicle.autopilots import AUTOPILOTS
from flying_vines.vehicle.mission.item import LAND, RETURN, AutopilotKind, MissionItem, MissionRefused
from missions.checks import name_of
from missions.files import load_items
from missions.home import home_fits
from missions.item_for_intent import described, over_the_wire
from missions.link import MissionVehicle, UploadRefused, VehicleLinkError, vehicle
from missions.mission import MissionError
from missions.plan_file import write_plan
from missions.waypoints import write_waypoints

DONE, DIFFERS, REFUSED = 0, 1, 2

_NUMBERS = ("param1", "param2", "param3", "param4", "x", "y", "z")
_HOME = 0


@dataclass(frozen=True, slots=True)
class MissionComparison:
    """Differences between the sent and the stored mission, one sentence each."""

    changed: tuple[str, ...]
    """Known changes by the autopilot's storage."""
    unexpected: tuple[str, ...]
    """Differences from the expected storage."""


async def upload(path: Path, link: str, console: Console) -> int:
    """Upload the mission in a .plan or .waypoints file, and compare the stored mission with it.

    Returns 0 if the vehicle stores the expected items, 1 if it stores others, 2 if it refused the mission.
    The console shows details.

    Raises:
        MissionError: the file cannot be read, or is for another autopilot.
        VehicleLinkError: no vehicle, or it does not answer.
    """
    found = load_items(path, None if path.suffix.casefold() == ".plan" else "ardupilot")
    async with vehicle(link) as peer:
        name = AUTOPILOTS[peer.kind].title
        if path.suffix.casefold() == ".plan" and found.kind != peer.kind:
            raise MissionError(
                f"{path}: is for {AUTOPILOTS[found.kind].title}, the vehicle is {name}: build it for {name}"
            )
        refuse_wrong_home(path, found.items, peer.kind)
        console.print(f"Uploading {len(found.items)} items to {name}, system {peer.system_id}")
        try:
            await _send(peer, found.items, console if console.is_terminal else None)
        except UploadRefused as refused:
            console.print(_sentence(found.items, refused), style="red", soft_wrap=True, markup=False)
            for line in await _held_after_refusal(peer, found.items, refused.seq or 0):
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
        f"Uploaded and read back: {name} stores the mission as expected.", style="green", soft_wrap=True
    )
    return DONE


async def download(path: Path, link: str, console: Console) -> int:
    """Write the vehicle's mission to `path`, a .plan or .waypoints file.

    Raises:
        MissionError: there is no mission, or the file cannot be written.
        VehicleLinkError: no vehicle, or it does not answer.
    """
    if path.suffix.casefold() not in (".plan", ".waypoints"):
        raise MissionError(f"{path}: the file must be a .plan or .waypoints")
    async with vehicle(link) as peer:
        items = await peer.download()
    if not items:
        raise MissionError(f"{AUTOPILOTS[peer.kind].title} has no mission")
    try:
        if path.suffix.casefold() == ".plan":
            write_plan(path, items, peer.kind)
        else:
            write_waypoints(path, items)
    except OSError as error:
        raise MissionError(f"{path}: cannot be written: {error.strerror}") from None
    except ValueError as error:
        raise MissionError(f"{path}: cannot be written: {error}; use a .waypoints file") from None
    console.print(f"Written  {path}: {len(items)} items of {AUTOPILOTS[peer.kind].title}", soft_wrap=True)
    return 0


def refuse_wrong_home(path: Path, items: Sequence[MissionItem], kind: AutopilotKind) -> None:
    """Refuses a mission for the other autopilot: ArduPilot would skip item 0, PX4 would fly to home."""
    if home_fits(items, kind):
        return
    if kind == "ardupilot":
        what = f"begins with {name_of(items[0])}, which ArduPilot would use as home"
    else:
        what = "begins with a home item, to which PX4 would fly"
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


async def _held_after_refusal(
    peer: MissionVehicle, sent: Sequence[MissionItem], refused_seq: int
) -> list[str]:
    """Describes the vehicle's mission after a refusal: on ArduPilot it may be a mix of old and new items."""
    try:
        held = await peer.download()
    except VehicleLinkError as error:
        return [f"The vehicle's mission is now unknown: {error}"]
    if peer.kind == "px4":
        return [f"The vehicle still has its old mission of {len(held)} items."]
    new = {
        item.seq for item in held if item.seq < refused_seq and _is_stored(peer.kind, sent[item.seq], item)
    }
    if not new - {_HOME}:
        return [f"The vehicle still has its old mission of {len(held)} items."]
    lines = [f"{item.seq:5}  {'new' if item.seq in new else 'old':6}  {name_of(item)}" for item in held]
    return ["The vehicle now has a mix of old and new items. Do not fly: upload a valid mission.", *lines]


def _is_stored(kind: AutopilotKind, sent: MissionItem, held: MissionItem) -> bool:
    if AUTOPILOTS[kind].begins_with_home and sent.seq == _HOME:
        return True
    try:
        return _same(kind, AUTOPILOTS[kind].store(over_the_wire(sent)), held)
    except MissionRefused:
        return False


def compare(
    kind: AutopilotKind, sent: Sequence[MissionItem], held: Sequence[MissionItem]
) -> MissionComparison:
    """Compare the sent with the stored mission, without ArduPilot's item 0, which is its own home."""
    changed: list[str] = []
    unexpected: list[str] = []
    if len(held) != len(sent):
        unexpected.append(f"The vehicle has {len(held)} items, but {len(sent)} were sent.")
    for before, after in zip(sent, held, strict=False):
        if AUTOPILOTS[kind].begins_with_home and before.seq == _HOME:
            continue
        try:
            expected = AUTOPILOTS[kind].store(over_the_wire(before))
        except MissionRefused:
            name = AUTOPILOTS[kind].title
            unexpected.append(
                f"item {before.seq} ({name_of(before)}): accepted, although {name} was expected to refuse it."
            )
            continue
        if not _same(kind, expected, after):
            unexpected.append(
                f"item {before.seq} ({name_of(before)}): the vehicle has {_in_full(after)}, "
                f"expected {_in_full(expected)}."
            )
        else:
            changed.extend(_changes(_meant(kind, before), _meant(kind, after)))
    return MissionComparison(tuple(changed), tuple(unexpected))


def _changes(before: MissionItem, after: MissionItem) -> list[str]:
    return [
        f"item {before.seq} ({name_of(before)}): {name} {sent:g} is stored as {stored:g}."
        for name, sent, stored in zip(_NUMBERS, before.params, after.params, strict=True)
        if not math.isnan(sent) and not _close(sent, stored)
    ]


def _meant(kind: AutopilotKind, item: MissionItem) -> MissionItem:
    """The item without the values of RETURN and LAND that ArduPilot replaces or does not use."""
    if kind == "ardupilot" and item.command == RETURN:
        return replace(item, params=(0.0,) * 7, frame=0)
    if kind == "ardupilot" and item.command == LAND:
        return replace(item, params=(*item.params[:3], 0.0, *item.params[4:]))
    return item


def _same(kind: AutopilotKind, one: MissionItem, other: MissionItem) -> bool:
    """True if both items have the same effect on flight and vine."""
    one, other = _meant(kind, one), _meant(kind, other)
    numbers = zip(one.params, other.params, strict=True)
    is_same = (one.command, one.frame) == (other.command, other.frame)
    return is_same and all(_close(a, b) for a, b in numbers)


def _close(a: float, b: float) -> bool:
    """True if only the rounding to a 32-bit float or to 1e-7 degrees differs, or if both are NaN."""
    return math.isclose(a, b, rel_tol=1e-6, abs_tol=2e-7) or (math.isnan(a) and math.isnan(b))


def _in_full(item: MissionItem) -> str:
    return f"{described(item)} in frame {item.frame}"
