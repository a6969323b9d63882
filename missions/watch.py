"""Watch a vehicle fly its mission: which item is on, what the vine did, what is left in the bottle."""

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
from flying_vines.vehicle.mission.item import MissionItem
from missions.checks import name_of
from missions.link import HeardMessage, VehicleLinkError, vehicle

SILENT_S = 10.0
MISSION_CURRENT, MISSION_CURRENT_INTERVAL_US = 42, 200_000
SET_MESSAGE_INTERVAL = 511

_AUTOPILOT = 1
_ARMED = 128
_ACTIVE, _COMPLETE = 3, 5
_WARNING = 4
_ITEM_TEXT = re.compile(r"Mission: (\d+) ")
_REACHED_TEXT = "Reached command #"
_DISARMING = "Disarming motors"
_FULL_CHUNK = 50
_TOLD_VALUES = ("BEND_DEG", "RES_KPA", "CYC_LEFT")
_SHOWN_ITEMS, _BEFORE = 14, 5
_SHOWN_TEXTS = 6
_NAMES = (
    *("HEARTBEAT", "MISSION_CURRENT", "MISSION_ITEM_REACHED"),
    *("STATUSTEXT", "NAMED_VALUE_FLOAT"),
)


@dataclass(frozen=True, slots=True)
class WatchLine:
    """Something that happened, for people."""

    t: float
    text: str
    style: str = ""


@dataclass
class MissionView:
    """What is known of a mission being flown, from what the vehicle's components say; without IO.

    It ends when the autopilot calls the mission complete or disarms, after it was active or armed.
    """

    items: Sequence[MissionItem]
    current: int | None = None
    begun: set[int] = field(default_factory=set)
    """Items that were seen to run or to be flown."""
    values: dict[str, float] = field(default_factory=dict)
    ended: bool = False
    heard_at: float = 0.0
    """When the autopilot was last heard."""
    _reached: int | None = None
    _armed: bool | None = None
    _was_active: bool = False
    _said: set[int] = field(default_factory=set)
    """Items told since the mission moved on, by a status text, which may come before MISSION_CURRENT."""
    _told_values: str = ""
    _chunks: dict[tuple[int, int], str] = field(default_factory=dict)

    def handle(self, t: float, heard: HeardMessage) -> list[WatchLine]:
        """What a message says that is new."""
        if self.ended:
            return []
        from_autopilot = heard.component == _AUTOPILOT
        if from_autopilot:
            self.heard_at = t
        match heard.name:
            case "HEARTBEAT" if from_autopilot:
                return self._heartbeat(t, bool(heard.fields["base_mode"] & _ARMED))
            case "MISSION_CURRENT" if from_autopilot:
                return self._progress(t, heard.fields["seq"], heard.fields.get("mission_state", 0))
            case "MISSION_ITEM_REACHED" if from_autopilot:
                return self._item_reached(t, heard.fields["seq"])
            case "STATUSTEXT":
                return self._text(t, heard)
            case "NAMED_VALUE_FLOAT" if not from_autopilot:  # PX4 says what it was told again
                value = heard.fields["value"]
                if isinstance(value, int | float):
                    self.values[heard.fields["name"]] = float(value)
        return []

    def values_text(self, names: Iterable[str] | None = None) -> str:
        """The vine's values, all or those named."""
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
        if state != _ACTIVE or seq == self.current:
            return []
        self._was_active = True
        self.current = seq
        was_said = seq in self._said
        self._said = {seq}
        return [] if was_said else self._begin(t, seq)

    def _begin(self, t: float, seq: int) -> list[WatchLine]:
        self.begun.add(seq)
        values = self.values_text(_TOLD_VALUES)
        news = f"   {values}" if values and values != self._told_values else ""
        self._told_values = values
        item = self.items[seq] if seq < len(self.items) else None
        what = name_of(item) if item is not None else "not in the mission that was read"
        return [WatchLine(t, f"item {seq}: {what}{news}", "bold")]

    def _item_reached(self, t: float, seq: int) -> list[WatchLine]:
        if seq == self._reached:  # PX4 repeats it
            return []
        self._reached = seq
        # PX4 tells of an item that is over at once only like this.
        return [WatchLine(t, f"item {seq} reached")] if seq in self.begun else self._begin(t, seq)

    def _text(self, t: float, heard: HeardMessage) -> list[WatchLine]:
        text = self._whole(heard)
        if text is None:
            return []
        if heard.component == _AUTOPILOT:
            if found := _ITEM_TEXT.match(text):
                seq = int(found[1])
                if seq in self._said:
                    return []
                self._said.add(seq)
                return self._begin(t, seq)
            if text == _DISARMING and self._was_active:
                self.ended = True  # what it says from now on is of the mission restarted on the ground
            if text.startswith(_REACHED_TEXT):
                return []
            text = f"autopilot: {text}"
        style = "red" if heard.fields["severity"] < _WARNING else "cyan"
        return [WatchLine(t, text, style)]

    def _whole(self, heard: HeardMessage) -> str | None:
        """The text, once its last chunk is there."""
        text, number = heard.fields["text"], heard.fields.get("id", 0)
        if not number:
            return str(text)
        key = heard.component, number
        begun = self._chunks.pop(key, "") if heard.fields.get("chunk_seq", 0) else ""
        if len(text) < _FULL_CHUNK:
            return f"{begun}{text}"
        self._chunks = {key: begun + text}  # one at a time: what was left unfinished stays so
        return None


async def watch(link: str, console: Console, live: bool) -> int:
    """Follow the mission to its end: as a picture that renews itself, or one line an event.

    Raises LinkError when there is no vehicle, or it falls silent.
    """
    async with vehicle(link) as peer:
        ears = peer.listen(*_NAMES)
        items = await peer.download()
        name = AUTOPILOTS[peer.kind].title
        if not items:
            raise VehicleLinkError(f"{name} holds no mission to watch")
        view = MissionView(items, heard_at=time.monotonic())
        began = time.monotonic()
        lines: list[WatchLine] = []
        console.print(f"Watching {name}, system {peer.system_id}: {len(items)} items. Ctrl-C ends it.")
        await peer.command(SET_MESSAGE_INTERVAL, MISSION_CURRENT, MISSION_CURRENT_INTERVAL_US)
        with Live(console=console, auto_refresh=False, transient=True) if live else nullcontext() as screen:
            while not view.ended:
                for heard in await ears.hear(0.5):
                    fresh = view.handle(time.monotonic(), heard)
                    lines = [*lines, *fresh][-_SHOWN_TEXTS:]
                    if not live:
                        for line in fresh:
                            console.print(_told(line, began), soft_wrap=True)
                if time.monotonic() - view.heard_at > SILENT_S:
                    raise VehicleLinkError(f"{link}: the vehicle was not heard for {SILENT_S:g} s")
                if isinstance(screen, Live):
                    screen.update(picture(view, lines, began), refresh=True)
    length_s = time.monotonic() - began
    console.print(
        f"The mission has ended after {length_s:.0f} s. {view.values_text()}".rstrip(), soft_wrap=True
    )
    return 0


def _told(line: WatchLine, began: float) -> Text:
    return Text(f"{line.t - began:8.2f}  {line.text}", style=line.style)


def picture(view: MissionView, lines: Sequence[WatchLine], began: float) -> RenderableType:
    """The mission around where it is, the vine's values, and the last things that happened."""
    table = Table(box=None, pad_edge=False, show_header=False)
    first = max(0, min((view.current or 0) - _BEFORE, len(view.items) - _SHOWN_ITEMS))
    for item in view.items[first : first + _SHOWN_ITEMS]:
        mark = "▶" if item.seq == view.current else "✓" if item.seq in view.begun else ""
        style = "bold" if item.seq == view.current else "dim" if item.seq in view.begun else ""
        table.add_row(mark, str(item.seq), name_of(item), style=style)
    return Group(table, Text(view.values_text(), style="green"), *(_told(line, began) for line in lines))
