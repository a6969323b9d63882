"""What an upload looks at before and after the vehicle has the mission."""

from __future__ import annotations

from pathlib import Path

import pytest

from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.mission.storage import Kind, Params
from missions.files import load_items
from missions.mission import MissionError
from missions.upload import compare, refuse_wrong_home

EXAMPLES = Path(__file__).parents[2] / "missions" / "examples"


def held(kind: Kind, seq: int, command: int, params: Params, frame: int) -> list[MissionItem]:
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
def test_what_is_kept_is_compared_with_what_was_expected(kept: Params, changed: int, unexpected: int) -> None:
    sent = held("ardupilot", 1, 217, (1.9, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0), 3)
    found = compare("ardupilot", sent, held("ardupilot", 1, 217, kept, 0))
    assert (len(found.changed), len(found.unexpected)) == (changed, unexpected)
    assert all(sentence.startswith("item 1 (script message (1.9, 0.1)): ") for sentence in found.changed)


def test_items_too_few_and_items_that_were_not_known_to_be_taken_are_unexpected() -> None:
    sent = held("px4", 0, 31010, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 2)
    assert "taken, which PX4 was not known to do" in compare("px4", sent, sent).unexpected[0]
    assert compare("px4", sent, []).unexpected == ("The vehicle holds 0 items, 1 were sent.",)


@pytest.mark.parametrize("suffix", [".plan", ".waypoints"])
@pytest.mark.parametrize(
    ("kind", "other", "says"),
    [
        ("ardupilot", "px4", "begins with a home, which PX4 would fly to: build it for PX4"),
        (
            "px4",
            "ardupilot",
            "begins with take-off, which ArduPilot would take for home: build it for ArduPilot",
        ),
    ],
)
def test_a_mission_for_the_other_autopilot_is_not_sent(
    kind: Kind, other: Kind, says: str, suffix: str
) -> None:
    path = EXAMPLES / f"canopy_sampling-{kind}{suffix}"
    items = load_items(path, kind).items
    refuse_wrong_home(path, items, kind)
    with pytest.raises(MissionError, match=f"{path.name}: {says}$"):
        refuse_wrong_home(path, items, other)
