"""Follows a vehicle's mission: the present item, the vine's texts and its values."""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from flying_vines.vehicle.autopilots import AUTOPILOTS
from flying_vines.vehicle.component.texts import CHUNK_LENGTH
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.notice import Severity
from missions.checks import name_of
from missions.link import ReceivedMessage, VehicleLinkError, vehicle

SILENT_S = 10.0
MISSION_CURRENT, MISSION_CURRENT_INTERVAL_US = 42, 200_000
SET_MESSAGE_INTERVAL = 511

_AUTOPILOT = 1
_ARMED = 128
_UNKNOWN, _ACTIVE, _COMPLETE = 0, 3, 5
_ITEM_TEXT = re.compile(r"Mission: (\d+) ")
_REACHED_TEXT = "Reached command #"
_DISARMING = "Disarming motors"
_ITEM_VALUES = ("BEND_DEG", "RES_KPA", "CYC_LEFT")
_SHOWN_ITEMS, _BEFORE = 14, 5
_SHOWN_TEXTS = 6
_NAMES = (
    *("HEARTBEAT", "MISSION_CURRENT", "MISSION_ITEM_REACHED"),
    *("STATUSTEXT", "NAMED_VALUE_FLOAT"),
)


@dataclass(frozen=True, slots=True)
class WatchLine:
    """An event as one line."""

    t: float
    text: str
    style: str = ""


@dataclass
class MissionView:
    """The state of a flown mission, from the vehicle's messages. No I/O.

    Once the mission has been active, the view ends when the autopilot reports it as complete or disarms.
    """

    items: Sequence[MissionItem]
    current: int | None = None
    begun: set[int] = field(default_factory=set)
    values: dict[str, float] = field(default_factory=dict)
    ended: bool = False
    last_message_at: float = 0.0
    """Time of the autopilot's last message."""
    _reached: int | None = None
    _armed: bool | None = None
    _was_active: bool = False
    _announced: set[int] = field(default_factory=set)
    """Items already shown because of a status text, which may come before MISSION_CURRENT."""
    _shown_values: str = ""
    _unfinished: dict[int, tuple[int, str]] = field(default_factory=dict)
    """For each component: id and first chunks of a text whose last chunk has not arrived."""

    def handle(self, t: float, message: ReceivedMessage) -> list[WatchLine]:
        """The new lines from a message."""
        if self.ended:
            return []
        from_autopilot = message.component == _AUTOPILOT
        if from_autopilot:
            self.last_message_at = t
        match message.name:
            case "HEARTBEAT" if from_autopilot:
                return self._heartbeat(t, bool(message.fields["base_mode"] & _ARMED))
            case "MISSION_CURRENT" if from_autopilot:
                return self._progress(t, message.fields["seq"], message.fields.get("mission_state", 0))
            case "MISSION_ITEM_REACHED" if from_autopilot:
                return self._item_reached(t, message.fields["seq"])
            case "STATUSTEXT":
                return self._text(t, message)
            case "NAMED_VALUE_FLOAT" if not from_autopilot:  # PX4 repeats received values
                value = message.fields["value"]
                if isinstance(value, int | float):
                    self.values[message.fields["name"]] = float(value)
        return []

    def values_text(self, names: Iterable[str] | None = None) -> str:
        """The vine's values: all, or those in `names`."""
        names = sorted(self.values) if names is None else names
        return "  ".join(f"{name} {self.values[name]:z.1f}" for name in names if name in self.values)

    def _heartbeat(self, t: float, armed: bool) -> list[WatchLine]:
        before, self._armed = self._armed, armed
        if armed == before:
            return []
        if before and self._was_active:
            self.ended = True
        return [WatchLine(t, "armed" if armed else "disarmed")] if before is not None or armed else []

    def _progress(self, t: float, seq: int, state: int) -> list[WatchLine]:
        if state == _COMPLETE and self._was_active:
            self.ended = True
        # Older ArduPilot leaves the state at 0, also on the ground.
        active = state == _ACTIVE or (state == _UNKNOWN and self._armed)
        if not active or seq == self.current:
            return []
        self._was_active = True
        self.current = seq
        was_announced = seq in self._announced
        self._announced = {seq}
        return [] if was_announced else self._begin(t, seq)

    def _begin(self, t: float, seq: int) -> list[WatchLine]:
        self.begun.add(seq)
        values = self.values_text(_ITEM_VALUES)
        news = f"   {values}" if values and values != self._shown_values else ""
        self._shown_values = values
        item = self.items[seq] if seq < len(self.items) else None
        what = name_of(item) if item is not None else "not in the downloaded mission"
        return [WatchLine(t, f"item {seq}: {what}{news}", "bold")]

    def _item_reached(self, t: float, seq: int) -> list[WatchLine]:
        if seq == self._reached:  # PX4 repeats it
            return []
        self._reached = seq
        # For an item that ends at once, PX4 sends only this message.
        return [WatchLine(t, f"item {seq} reached")] if seq in self.begun else self._begin(t, seq)

    def _text(self, t: float, message: ReceivedMessage) -> list[WatchLine]:
        text = self._complete_text(message)
        if text is None:
            return []
        if message.component == _AUTOPILOT:
            if found := _ITEM_TEXT.match(text):
                seq = int(found[1])
                if seq in self._announced:
                    return []
                self._announced.add(seq)
                return self._begin(t, seq)
            if text == _DISARMING and self._was_active:
                self.ended = True  # later texts are about the mission that restarts on the ground
            if text.startswith(_REACHED_TEXT):
                return []
            text = f"autopilot: {text}"
        style = "red" if message.fields["severity"] < Severity.WARNING else "cyan"
        return [WatchLine(t, text, style)]

    def _complete_text(self, message: ReceivedMessage) -> str | None:
        """The complete text; None until its last chunk has arrived."""
        text, number = message.fields["text"], message.fields.get("id", 0)
        if not number:
            return str(text)
        begun, before = self._unfinished.pop(message.component, (number, ""))
        if begun != number or not message.fields.get("chunk_seq", 0):
            before = ""  # another text begins: the unfinished one is dropped
        if len(text) < CHUNK_LENGTH:
            return f"{before}{text}"
        self._unfinished[message.component] = number, before + text
        return None


async def watch(link: str, console: Console, live: bool) -> int:
    """Follow the mission to its end, on a live screen or in lines. Raises `VehicleLinkError`."""
    async with vehicle(link) as peer:
        queue = peer.listen(*_NAMES)
        items = await peer.download()
        name = AUTOPILOTS[peer.kind].title
        if not items:
            raise VehicleLinkError(f"{name} has no mission to watch")
        view = MissionView(items, last_message_at=time.monotonic())
        began = time.monotonic()
        lines: list[WatchLine] = []
        console.print(f"Watching {name}, system {peer.system_id}: {len(items)} items. Ctrl-C ends it.")
        await peer.command(SET_MESSAGE_INTERVAL, MISSION_CURRENT, MISSION_CURRENT_INTERVAL_US)
        with Live(console=console, auto_refresh=False, transient=True) if live else nullcontext() as screen:
            while not view.ended:
                for message in await queue.receive(0.5):
                    fresh = view.handle(time.monotonic(), message)
                    lines = [*lines, *fresh][-_SHOWN_TEXTS:]
                    if not live:
                        for line in fresh:
                            console.print(_line_text(line, began), soft_wrap=True)
                if time.monotonic() - view.last_message_at > SILENT_S:
                    raise VehicleLinkError(f"{link}: no message from the vehicle for {SILENT_S:g} s")
                if isinstance(screen, Live):
                    screen.update(picture(view, lines, began), refresh=True)
    length_s = time.monotonic() - began
    console.print(f"The mission ended after {length_s:.0f} s. {view.values_text()}".rstrip(), soft_wrap=True)
    return 0


def _line_text(line: WatchLine, began: float) -> Text:
    return Text(f"{line.t - began:8.2f}  {line.text}", style=line.style)


def picture(view: MissionView, lines: Sequence[WatchLine], began: float) -> RenderableType:
    """The items around the present one, the vine's values, and the last events."""
    table = Table(box=None, pad_edge=False, show_header=False)
    first = max(0, min((view.current or 0) - _BEFORE, len(view.items) - _SHOWN_ITEMS))
    for item in view.items[first : first + _SHOWN_ITEMS]:
        mark = "▶" if item.seq == view.current else "✓" if item.seq in view.begun else ""
        style = "bold" if item.seq == view.current else "dim" if item.seq in view.begun else ""
        table.add_row(mark, str(item.seq), name_of(item), style=style)
    return Group(table, Text(view.values_text(), style="green"), *(_line_text(line, began) for line in lines))
