"""The live view in small terminals: a fault and the latest events are shown in full."""

from __future__ import annotations

import io
import math

import pytest
from page_bench import snapshot
from rich.console import Console
from rich.screen import Screen

from flying_vines.core.events import Decision
from flying_vines.core.pending_bend import PendingBend
from flying_vines.supply import CyclesLeft
from flying_vines.terminal.screen import LiveView, event_line
from flying_vines.vehicle.notice import Notice, Severity

FAULTS = {
    "firmware_fault": "firmware fault: dead-man timer ran out, over-pressure in the vine, watchdog reset",
    "rc": "RC lost: the receiver hears no transmitter",
}
WAITING = PendingBend("vent by the page", "switch down, then up")
PLENTY = CyclesLeft(1234.0, 1000.0, 1500.0, 3.0, 9.0, 80.0, 15.0, 1.2, 600.0, 450.0, 600.0)
UNASKED = Decision(2.0, "failsafe", {"loss": "rc"}, "vent", "accepted", FAULTS["rc"], 0.0)


def lines(width: int, **shown: object) -> list[str]:
    """The screen's lines without its frame."""
    view = LiveView(0.0, 25.0, 690.0)
    for _ in range(14):
        view.take(UNASKED)
    view.take(Notice(3.0, Severity.WARNING, "Vine: the latest event"))
    console = Console(width=width, height=24, file=io.StringIO(), record=True)
    console.print(Screen(view.render(snapshot(4.0, **shown))))
    return [line.strip("│ ") for line in console.export_text().splitlines()]


@pytest.mark.parametrize("width", [60, 80, 120])
def test_a_fault_and_the_latest_event_are_whole(width: int) -> None:
    shown = lines(
        width, safe_state=FAULTS, waiting=WAITING, rc="the receiver hears no transmitter", cycles=PLENTY
    )
    text = " ".join(shown)
    assert all(fault in text for fault in FAULTS.values())
    assert f"waiting for: {WAITING.awaited}" in text and "the latest event" in text
    labels = ("vehicle", "RC", "phloSAR", "valves", "command", "vine", "reservoir", "bends", "air")
    assert [line.split()[0] for line in shown[1:10]] == list(labels)
    assert shown[8].endswith("1481 (1200…1800) to 15 kPa, like the last")
    assert shown[9].endswith("10 h or more without a bend (at least 450)")
    assert any(line.startswith("╰") for line in shown)


@pytest.mark.parametrize("width", [60, 80, 120])
def test_without_a_fault_it_shows_what_vented_and_the_awaited_request(width: int) -> None:
    text = " ".join(lines(width, waiting=WAITING))
    assert "vented: vent by the page waiting for: switch down, then up" in " ".join(text.split())


@pytest.mark.parametrize(
    ("trigger", "style"), [("failsafe", "yellow"), ("link", "yellow"), ("page", "green")]
)
def test_only_a_request_is_accepted_in_green(trigger: str, style: str) -> None:
    line = event_line(Decision(2.0, trigger, {}, "vent", "accepted", "", 0.0), 0.0)
    assert line is not None and style in {str(span.style) for span in line.spans}


@pytest.mark.parametrize("unused", [math.nan, None])
def test_params_have_six_digits_and_an_unused_one_is_a_dash(unused: float | None) -> None:
    """0.1 is a 32-bit float. The page and the log write NaN as null."""
    item = {"seq": 3, "command": 31010, "params": [0.10000000149011612, unused, -45.0, 2.0]}
    line = event_line(Decision(2.0, "mission_item", item, "wave", "accepted", "", 20.0), 0.0)
    assert line is not None
    assert "mission item #3 31010 (0.1, –, -45, 2) → wave: accepted" in line.plain
