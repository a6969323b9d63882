"""The vine in a flight's figure and in the live view."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from rich.console import Console
from rich.text import Text

from flying_vines.plots.vine import draw_vine
from flying_vines.record import picture
from flying_vines.record.mcap_file import McapFile
from flying_vines.record.picture import DRAWN_WIDTH, _side_by_side, draw_flight
from flying_vines.record.reader import FlightLog
from flying_vines.record.topics import NUMBERS, TOPICS
from flying_vines.simulation.demo import MIN_WIDTH_FOR_VINE, _with_vine
from flying_vines.vine.shape import tip

shares = st.lists(st.floats(0.0, 1.0), max_size=int(1 / DRAWN_WIDTH)).map(sorted)


@given(shares)
def test_drawn_vines_stand_side_by_side_within_the_picture(wanted: list[float]) -> None:
    places = _side_by_side(wanted)
    assert len(places) == len(wanted)
    assert all(0.5 * DRAWN_WIDTH - 1e-9 <= place <= 1.0 - 0.5 * DRAWN_WIDTH + 1e-9 for place in places)
    assert all(b - a >= DRAWN_WIDTH - 1e-9 for a, b in pairwise(places))


def test_a_lone_vine_stands_at_its_moment() -> None:
    assert _side_by_side([0.5]) == [0.5]


def snapshot(t: float, bend_deg: float) -> dict[str, Any]:
    values = dict.fromkeys(("command_kPa", "cv_kPa", "evp_opening", "dvp_opening", "reservoir_kPa"), 0.0)
    known = None if math.isnan(bend_deg) else bend_deg
    return (
        {"kind": "snapshot", "t": t, "bend_deg": known, "solenoid": False, "cycles": None}
        | values
        | {"safe_state": {}}
    )


def decision(t: float) -> dict[str, Any]:
    return {
        "kind": "decision",
        "t": t,
        "safety": "accepted",
        "trigger": "switch",
        "intent": "bend",
        "reason": "",
    }


def written(said: list[dict[str, Any]], path: Path) -> FlightLog:
    """A log with these values. Unknown values are left out."""
    with path.open("wb") as file:
        log = McapFile(file, TOPICS, "test")
        for entry in said:
            known = {key: value for key, value in entry.items() if value == value and value is not None}
            log.add(NUMBERS[known.pop("kind")], round(entry["t"] * 1e9), msgspec.json.encode(known))
        log.finish()
    return FlightLog(path)


@pytest.mark.parametrize(
    ("bends_deg", "moments", "drawn"),
    [
        ([math.nan] * 10 + [0.0] * 10 + [30.0] * 10 + [60.0] * 10, [0.5, 2.0, 3.0, 3.5], [0.0, 30.0, 60.0]),
        ([float(10 * (i // 5 % 2)) for i in range(300)], [0.5 * i for i in range(1, 60)], None),
    ],
)
def test_a_flights_picture_shows_each_bend_once(
    bends_deg: list[float],
    moments: list[float],
    drawn: list[float] | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shown: list[float] = []

    def note(axis: Any, angle_deg: float, *args: Any) -> tuple[float, float]:
        shown.append(angle_deg)
        return draw_vine(axis, angle_deg, *args)

    monkeypatch.setattr(picture, "draw_vine", note)
    said = [snapshot(0.1 * i, deg) for i, deg in enumerate(bends_deg)] + [decision(t) for t in moments]
    draw_flight(written(said, tmp_path / "flight.mcap"), tmp_path / "flight.png", "made up")
    assert (tmp_path / "flight.png").stat().st_size > 10_000
    if drawn is None:
        assert 4 <= len(shown) <= 1 / DRAWN_WIDTH
    else:
        assert shown == drawn


def test_a_long_reason_is_cut_between_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    labels: list[str] = []
    write = Axes.text

    def note(axis: Axes, x: float, y: float, text: str, **style: Any) -> Any:
        labels.append(text)
        return write(axis, x, y, text, **style)

    monkeypatch.setattr(Axes, "text", note)
    said = [snapshot(0.1 * i, 0.0) for i in range(10)]
    for reason in (
        "not filling: valve, hose or actuator",
        "the reservoir loses more and more air since then",
    ):
        said.append(decision(0.5) | {"trigger": "failsafe", "intent": "vent", "reason": reason})
    draw_flight(written(said, tmp_path / "flight.mcap"), tmp_path / "flight.png", "made up")
    assert "failsafe: vent\nnot filling: valve, hose or actuator" in labels
    assert "failsafe: vent\nthe reservoir loses more and more air …" in labels


@pytest.mark.parametrize("angle_deg", [-90.0, 0.0, 60.0, 170.0])
def test_the_drawn_tip_is_the_computed_one(angle_deg: float) -> None:
    figure, axis = plt.subplots()
    x, y = draw_vine(axis, angle_deg, 0.5, 0.05, "black")
    assert (x, -y) == pytest.approx(tip(angle_deg, 0.5)[:2])
    assert any(isinstance(patch, Polygon) for patch in axis.patches)
    plt.close(figure)


@pytest.mark.parametrize(("width", "beside"), [(MIN_WIDTH_FOR_VINE, True), (MIN_WIDTH_FOR_VINE - 1, False)])
def test_the_live_view_has_the_vine_where_there_is_room(width: int, beside: bool) -> None:
    console = Console(width=width, record=True, force_terminal=True, quiet=True)
    assert isinstance(_with_vine(Text("view"), 40.0, console), Text) != beside


def test_a_terminal_with_ascii_only_gets_ascii() -> None:
    class Ascii(Console):
        encoding = "ascii"

    console = Ascii(width=MIN_WIDTH_FOR_VINE)
    with console.capture() as shown:
        console.print(_with_vine(Text("view"), 40.0, console))
    assert "##" in shown.get()
    assert shown.get().isascii()
