"""Read and write QGroundControl's .plan files (JSON).

Home is not an item but `plannedHomePosition`; the ground station makes it item 0 for ArduPilot. NaN is null.
A jump names the `doJumpId` of its target; doJumpId counts from 1.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from flying_vines.files.bounded import MB
from flying_vines.files.toml_text import OneLineError, dotted, explained, read_text
from flying_vines.vehicle.autopilots import AUTOPILOTS
from flying_vines.vehicle.mission.item import (
    GLOBAL_FRAME,
    JUMP,
    MAX_NUMBER,
    MISSION_FRAME,
    WAYPOINT,
    AutopilotKind,
    MissionItem,
    has_place,
)
from missions.home import CRUISE_M_S, Home, home_of

PLAN_BYTES = 8 * MB
"""QGroundControl writes about 500 bytes an item; a survey also stores its whole path."""
_KINDS = {autopilot.mav_autopilot: kind for kind, autopilot in AUTOPILOTS.items()}
_MULTIROTOR = 2
_CRUISE_SPEED_M_S = 15
"""For fixed wings; QGroundControl writes it into every plan."""
_ABOVE_HOME, _ABOVE_SEA = 1, 2
_ALTITUDE_MODES = {3: _ABOVE_HOME, 6: _ABOVE_HOME, 0: _ABOVE_SEA, 5: _ABOVE_SEA}


class PlanFileError(OneLineError, ValueError):
    """A plan file cannot be read; the text is one line."""


@dataclass(frozen=True, slots=True)
class PlanFile:
    """The mission in a plan file. The items are as they are sent; on ArduPilot item 0 is home."""

    items: tuple[MissionItem, ...]
    kind: AutopilotKind | None
    """None if the caller gave no kind, and the plan names no autopilot or an unknown one."""
    home: Home


ItemNumber = Annotated[float, Meta(ge=-MAX_NUMBER, le=MAX_NUMBER)]


class _Item(msgspec.Struct):
    type: str
    command: Annotated[int, Meta(ge=0, le=65535)] = 0
    frame: Annotated[int, Meta(ge=0, le=255)] = MISSION_FRAME
    params: Annotated[tuple[ItemNumber | None, ...], Meta(min_length=7, max_length=7)] = (None,) * 7
    autoContinue: bool = True
    doJumpId: int | None = None
    complexItemType: str = ""
    TransectStyleComplexItem: dict[str, Any] | None = None


class _Mission(msgspec.Struct):
    version: Annotated[int, Meta(ge=2, le=2)]
    items: Annotated[tuple[_Item, ...], Meta(min_length=1)]
    plannedHomePosition: tuple[ItemNumber, ItemNumber, ItemNumber | None]
    firmwareType: int = 0


class _File(msgspec.Struct):
    fileType: str
    version: Annotated[int, Meta(ge=1, le=1)]
    mission: _Mission


def read_plan(path: Path, kind: AutopilotKind | None = None) -> PlanFile:
    """The mission in a plan file, for `kind`, or by default for the autopilot that the file names.

    Raises `PlanFileError` if it cannot be read, has no items, or has items that only QGroundControl can
    convert.
    """
    text = read_text(path, PlanFileError, most_bytes=PLAN_BYTES)
    try:
        raw = msgspec.json.decode(text.encode())
        content = msgspec.convert(raw, _File)
    except RecursionError:
        raise PlanFileError(f"{path}: not a plan of QGroundControl: nested too deeply") from None
    except msgspec.ValidationError as error:
        key, reason = explained(str(error), _File, raw=raw)
        raise PlanFileError(
            f"{path}: not a plan of QGroundControl: {dotted(key)}: {reason}; open it there and save it again"
        ) from None
    except msgspec.DecodeError as error:
        at = re.search(r"byte (\d+)", str(error))
        line = text.encode()[: int(at[1]) if at else None].count(b"\n") + 1
        raise PlanFileError(f"{path}:{line}: not a plan of QGroundControl: the JSON is damaged") from None
    if content.fileType != "Plan":
        raise PlanFileError(f"{path}: not a plan of QGroundControl: its fileType is {content.fileType!r}")
    mission = content.mission
    latitude, longitude, altitude_m = mission.plannedHomePosition
    home = Home(latitude, longitude, altitude_m or 0.0)
    named = _KINDS.get(mission.firmwareType)
    simple = list(_simple_items(path, mission.items))
    if not simple:  # only surveys without items
        raise PlanFileError(f"{path}: it contains no items")
    autopilot = kind or named
    first = int(autopilot is not None and AUTOPILOTS[autopilot].begins_with_home)
    numbers = {item.doJumpId: first + index for index, item in enumerate(simple) if item.doJumpId is not None}
    items = [_home_item(home)] if first else []
    for item in simple:
        items.append(_item(path, item, len(items), numbers))
    return PlanFile(tuple(items), autopilot, home)


def write_plan(
    path: Path, items: Sequence[MissionItem], kind: AutopilotKind, home: Home | None = None
) -> None:
    """Write items as they are sent; on ArduPilot item 0 is home. `home` is for PX4.

    Raises:
        ValueError: a PX4 mission without `home` and without any place.
        OSError: the file cannot be written.
    """
    path.write_text(plan_text(items, kind, home), encoding="utf-8")


def plan_text(items: Sequence[MissionItem], kind: AutopilotKind, home: Home | None = None) -> str:
    """The text that `write_plan` writes."""
    flown = list(items)
    if AUTOPILOTS[kind].begins_with_home and flown:
        first = flown.pop(0)
        home = home or Home(*first.params[4:])
    home = home or home_of(flown)
    if home is None:
        raise ValueError("the mission has no place that could be home")
    # QGroundControl itself writes the keys in alphabetical order.
    content = {
        "fileType": "Plan",
        "geoFence": {"circles": [], "polygons": [], "version": 2},
        "groundStation": "QGroundControl",
        "mission": {
            "cruiseSpeed": _CRUISE_SPEED_M_S,
            "firmwareType": AUTOPILOTS[kind].mav_autopilot,
            "globalPlanAltitudeMode": _ABOVE_HOME,
            "hoverSpeed": _number(CRUISE_M_S),
            "items": [_json(item, number, kind) for number, item in enumerate(flown, start=1)],
            "plannedHomePosition": [
                _number(home.latitude_deg),
                _number(home.longitude_deg),
                _number(home.altitude_amsl_m),
            ],
            "vehicleType": _MULTIROTOR,
            "version": 2,
        },
        "rallyPoints": {"points": [], "version": 2},
        "version": 1,
    }
    return json.dumps(content, indent=4, sort_keys=True, allow_nan=False) + "\n"


def _json(item: MissionItem, number: int, kind: AutopilotKind) -> dict[str, object]:
    params = list(item.params)
    if item.command == JUMP and not AUTOPILOTS[kind].begins_with_home:
        params[0] += 1.0  # seq counts from 0, doJumpId from 1
    entry: dict[str, object] = {
        "autoContinue": item.autocontinue,
        "command": item.command,
        "doJumpId": number,
        "frame": item.frame,
        "params": [_number(value) for value in params],
        "type": "SimpleItem",
    }
    if item.frame in _ALTITUDE_MODES:
        entry["AMSLAltAboveTerrain"] = None
        entry["Altitude"] = _number(params[6])
        entry["AltitudeMode"] = _ALTITUDE_MODES[item.frame]
    return entry


def _number(value: float) -> float | int | None:
    if not math.isfinite(value):
        return None
    return int(value) if value.is_integer() else value


def _home_item(home: Home) -> MissionItem:
    numbers = (0.0, 0.0, 0.0, 0.0, home.latitude_deg, home.longitude_deg, home.altitude_amsl_m)
    return MissionItem(0, WAYPOINT, numbers, GLOBAL_FRAME, current=True)


def _simple_items(path: Path, items: Sequence[_Item]) -> Iterator[_Item]:
    """All simple items; a survey contains its own list of them."""
    for index, item in enumerate(items):
        if item.type == "SimpleItem":
            yield item
            continue
        inner = (item.TransectStyleComplexItem or {}).get("Items")
        if not isinstance(inner, list):
            what = item.complexItemType or item.type
            raise PlanFileError(
                f"{path}: mission.items[{index}]: only the ground station can convert a '{what}'; "
                "upload the plan to the vehicle, download it again, and use the saved file"
            )
        try:
            yield from msgspec.convert(inner, list[_Item])
        except msgspec.ValidationError as error:
            key, reason = explained(str(error), list[_Item], raw=inner)
            raise PlanFileError(f"{path}: mission.items[{index}]: {dotted(key)}: {reason}") from None


def _item(path: Path, item: _Item, seq: int, numbers: dict[int, int]) -> MissionItem:
    values = [math.nan if value is None else value for value in item.params]
    if not has_place(item.command, item.frame):
        # Not a place: null is 0, because the ground station sends x and y as integers.
        values[4:6] = [0.0 if math.isnan(value) else value for value in values[4:6]]
    if item.command == JUMP:
        target = numbers.get(int(values[0])) if math.isfinite(values[0]) else None
        if target is None:
            raise PlanFileError(f"{path}: item {seq} jumps to doJumpId {values[0]:g}, which no item has")
        values[0] = float(target)
    p1, p2, p3, p4, x, y, z = values
    made = MissionItem(seq, item.command, (p1, p2, p3, p4, x, y, z), item.frame, current=seq == 0)
    return replace(made, autocontinue=item.autoContinue)
