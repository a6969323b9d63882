"""The checks before an upload, and the comparison with the stored mission after it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from flying_vines.vehicle.autopilots import AUTOPILOTS
from flying_vines.vehicle.mission.item import AutopilotKind, MissionItem, Params
from missions.files import load_items
from missions.item_for_intent import over_the_wire
from missions.mission import MissionError
from missions.transfer import compare, refuse_wrong_home

EXAMPLES = Path(__file__).parents[2] / "missions" / "examples"


def held(kind: AutopilotKind, seq: int, command: int, params: Params, frame: int) -> list[MissionItem]:
    first = [MissionItem(0, 16, (0.0,) * 7)] if kind == "ardupilot" else []
    return [*first, MissionItem(seq, command, params, frame)]


@pytest.mark.parametrize(
    ("kept", "changed", "unexpected"),
    [
        ((1.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0), 1, 0),
        ((1.0, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0), 0, 1),
        ((1.9, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0), 0, 1),
    ],
)
def test_the_stored_mission_is_compared_with_the_sent_one(
    kept: Params, changed: int, unexpected: int
) -> None:
    sent = held("ardupilot", 1, 217, (1.9, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0), 3)
    found = compare("ardupilot", sent, held("ardupilot", 1, 217, kept, 0))
    assert (len(found.changed), len(found.unexpected)) == (changed, unexpected)
    assert all(sentence.startswith("item 1 (script message (1.9, 0.1)): ") for sentence in found.changed)


def test_missing_items_and_unexpectedly_accepted_items_are_reported() -> None:
    sent = held("px4", 0, 31010, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 2)
    assert "accepted, although PX4 was expected to refuse it" in compare("px4", sent, sent).unexpected[0]
    assert compare("px4", sent, []).unexpected == ("The vehicle has 0 items, but 1 were sent.",)


@pytest.mark.parametrize("suffix", [".plan", ".waypoints"])
@pytest.mark.parametrize(
    ("kind", "other", "says"),
    [
        ("ardupilot", "px4", "begins with a home item, to which PX4 would fly: build it for PX4"),
        (
            "px4",
            "ardupilot",
            "begins with take-off, which ArduPilot would use as home: build it for ArduPilot",
        ),
    ],
)
def test_a_mission_for_the_other_autopilot_is_not_sent(
    kind: AutopilotKind, other: AutopilotKind, says: str, suffix: str
) -> None:
    path = EXAMPLES / f"canopy_sampling-{kind}{suffix}"
    items = load_items(path, kind).items
    refuse_wrong_home(path, items, kind)
    with pytest.raises(MissionError, match=f"{path.name}: {says}$"):
        refuse_wrong_home(path, items, other)


@pytest.mark.parametrize("frame", [0, 5])
def test_home_in_either_frame_above_the_sea_is_home(frame: int) -> None:
    path = EXAMPLES / "canopy_sampling-ardupilot.waypoints"
    home, *others = load_items(path, "ardupilot").items
    items = [replace(home, frame=frame), *others]
    refuse_wrong_home(path, items, "ardupilot")
    with pytest.raises(MissionError, match="begins with a home item"):
        refuse_wrong_home(path, items, "px4")


def as_read_from_a_vehicle(items: list[MissionItem]) -> list[MissionItem]:
    """The items as ArduCopter 4.6 returned them."""
    held = [AUTOPILOTS["ardupilot"].store(over_the_wire(item)) for item in items]
    return [
        replace(item, frame=0)
        if item.command == 20
        else replace(item, params=(*item.params[:3], 1.0, *item.params[4:]))
        if item.command == 21
        else item
        for item in held
    ]


@pytest.mark.parametrize("last", [20, 21])
def test_values_that_ardupilot_adds_to_a_return_or_landing_are_expected(last: int) -> None:
    path = EXAMPLES / "canopy_sampling-ardupilot.waypoints"
    *items, _ = load_items(path, "ardupilot").items
    sent = [*items, MissionItem(len(items), last, (0.0,) * 7, frame=3)]
    found = compare("ardupilot", sent, as_read_from_a_vehicle(sent))
    assert found.unexpected == ()
    assert not any(sentence.startswith(f"item {len(items)} ") for sentence in found.changed)


@pytest.mark.parametrize(
    ("kind", "sent", "kept"),
    [
        ("ardupilot", MissionItem(1, 20, (0.0,) * 7, 3), MissionItem(1, 21, (0.0,) * 7, 0)),
        ("ardupilot", MissionItem(1, 21, (0.0,) * 7, 3), MissionItem(1, 21, (0.0,) * 7, 0)),
        ("ardupilot", MissionItem(1, 21, (0.0,) * 7, 3), MissionItem(1, 21, (*(0.0,) * 6, 9.0), 3)),
        (
            "px4",
            MissionItem(1, 21, (0.0,) * 7, 6),
            MissionItem(1, 21, (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0), 6),
        ),
    ],
)
def test_another_difference_of_a_landing_is_reported(
    kind: AutopilotKind, sent: MissionItem, kept: MissionItem
) -> None:
    first = MissionItem(0, 16, (0.0,) * 7, 6 if kind == "px4" else 0)
    assert len(compare(kind, [first, sent], [first, kept]).unexpected) == 1
