"""The service on a terminal: a live view, or one line per event.

EVP: inflation valve. DVP: the Venturi's supply valve.
"""

from __future__ import annotations

import io
import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import IO, cast

from rich.console import Console, ConsoleOptions, Group, RenderResult
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from flying_vines.core.events import Action, Decision, InternalError, carried_out_unrequested
from flying_vines.core.snapshot import Snapshot
from flying_vines.files.background_writer import BackgroundWriter
from flying_vines.supply import CyclesLeft
from flying_vines.supply.cycles_left import MAX_MINUTES
from flying_vines.vehicle.notice import Notice, Severity

VERDICT_STYLE = {"accepted": "green", "limited": "yellow", "refused": "red"}
SEVERITY_STYLE = {Severity.ERROR: "bold red", Severity.WARNING: "yellow", Severity.NOTICE: "cyan"}
BAR_WIDTH = 24
FRAME = 2
"""Lines of the panel's frame."""
BAR_TEXT_WIDTH = 36
"""Characters around a bar: its label, the pressure, and the bend."""
MAX_QUEUED = 64 * 1024
"""Maximum characters queued for a blocked terminal: some seconds of screens. Later text is dropped."""
CLOSING_S = 0.5
EVENT_LINES = 12


def describe(what: dict[str, object]) -> str:
    """The details of a trigger, to be shown after its kind, e.g. "ch9 position 2" after "switch"."""
    if "channel" in what:
        return f"ch{what['channel']} position {what['position']}"
    if "loss" in what:
        return str(what["loss"]).replace("_", " ")
    if "event" in what:
        return str(what["event"])
    parts = []
    if "seq" in what:
        parts.append(f"#{'?' if what['seq'] is None else what['seq']}")
    if "command" in what:
        parts.append(str(what["command"]))
    params = what.get("params")
    if isinstance(params, list):
        parts.append("(" + ", ".join(map(_param, params)) + ")")
    return " ".join(parts)


def _param(value: float | None) -> str:
    """A parameter as text. NaN means that it is not used; the page and the log have None instead."""
    return "–" if value is None or math.isnan(value) else f"{value:g}"


def decision_table(decisions: Sequence[Decision]) -> Table:
    """A table with one row per decision."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("t, s", "trigger", "what", "intent", "safety", "setpoint, kPa", "why"):
        table.add_column(name, justify="right" if "," in name else "left")
    for d in decisions:
        style = _verdict_style(d)
        table.add_row(
            f"{d.t:.2f}",
            d.trigger.replace("_", " "),
            describe(d.what),
            d.intent or "–",
            Text(d.safety, style=style),
            f"{d.setpoint_kPa:.1f}",
            d.reason,
        )
    return table


def _verdict_style(decision: Decision) -> str:
    unrequested = carried_out_unrequested(decision.trigger, decision.safety)
    return "yellow" if unrequested else VERDICT_STYLE[decision.safety]


def event_line(action: Action, began: float) -> Text | None:
    """The line for an action; None if it is not shown."""
    if isinstance(action, Decision):
        if not action.shown:
            return None
        line = Text(f"{action.t - began:7.2f}  ")
        line.append(f"{action.trigger.replace('_', ' ')} ", style="bold")
        line.append(f"{describe(action.what)} → {action.intent or '?'}: ".lstrip())
        line.append(action.safety, style=_verdict_style(action))
        if action.reason:
            line.append(f" ({action.reason})")
        return line
    if isinstance(action, Notice) and not action.of_decision and action.severity is not Severity.DEBUG:
        return Text(
            f"{action.t - began:7.2f}  {action.text}", style=SEVERITY_STYLE.get(action.severity, "dim")
        )
    if isinstance(action, InternalError):
        return Text(f"{action.t - began:7.2f}  {action.part}: {action.trace.rstrip()}", style="red")
    return None


class LiveView:
    """The live view. Call `take` with actions and `render` with a snapshot."""

    def __init__(self, began: float, max_kPa: float, full_kPa: float) -> None:
        self._began = began
        self._max_kPa = max_kPa
        self._full_kPa = full_kPa
        self._events: list[tuple[Text, bool]] = []
        """The lines, and if each is a decision."""

    def take(self, action: Action) -> None:
        # Tracebacks appear only in the log and in the line output.
        line = None if isinstance(action, InternalError) else event_line(action, self._began)
        if line is not None:
            self._add(line, is_decision=isinstance(action, Decision))

    def say(self, text: Text) -> None:
        self._add(text, is_decision=False)

    def _add(self, line: Text, is_decision: bool) -> None:
        """Add a line. If there is no room, the older lines of the kind that has more of them go first."""
        self._events.append((line, is_decision))
        if len(self._events) > EVENT_LINES:
            decisions = sum(decision for _, decision in self._events)
            more = decisions > EVENT_LINES / 2
            self._events.remove(next(event for event in self._events if event[1] is more))

    def render(
        self, s: Snapshot, title: str = "Flying Vines", problems: Mapping[str, str] | None = None
    ) -> Panel:
        """The whole screen. `problems`: a sentence for each link with a problem."""
        links = [f"{link} link: {why}" for link, why in (problems or {}).items() if why]
        screen = _Screen(s, links, tuple(line for line, _ in self._events), self._max_kPa, self._full_kPa)
        return Panel(screen, title=f"{title}   {s.t - self._began:6.1f} s")


@dataclass(frozen=True)
class _Screen:
    """The state, what is wrong, and as many of the latest events as there is room for."""

    s: Snapshot
    links: Sequence[str]
    events: Sequence[Text]
    max_kPa: float
    full_kPa: float

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        links = [Text(link, style="red") for link in self.links]
        top = Group(self._state(options.max_width), *_doing(self.s), *links, Text(""))
        yield top
        free = options.size.height - FRAME - len(console.render_lines(top, options, pad=False))
        shown: list[Text] = []
        for event in reversed(self.events):
            free -= len(event.wrap(console, options.max_width))
            if free < 0:
                break
            shown.append(event)
        yield from reversed(shown)

    def _state(self, width: int) -> Table:
        s = self.s
        bars = max(6, min(BAR_WIDTH, width - BAR_TEXT_WIDTH))
        grid = Table.grid(padding=(0, 2))
        grid.add_column(style="dim", no_wrap=True, min_width=len("bends left"))
        grid.add_column(overflow="fold")
        altitude = "" if math.isnan(s.altitude_m) else f"  {s.altitude_m:.1f} m"
        armed = Text("armed", style="bold yellow") if s.armed else Text("disarmed", style="dim")
        grid.add_row("vehicle", Text.assemble(f"{s.vehicle}  {s.mode}{altitude}  ", armed))
        rc_style = "green" if s.rc == "good" else "red"
        position = "–" if s.switch_position is None else str(s.switch_position)
        grid.add_row("RC", Text.assemble((s.rc, rc_style), f"  switch {position}"))
        firmware_style = "green" if s.firmware == "ready" else "red"
        grid.add_row(s.actuator, Text.assemble((s.firmware, firmware_style), (_health(s), "dim")))
        valves = "not known"
        if s.solenoid is not None:
            solenoid = "open" if s.solenoid else "shut"
            valves = f"EVP {s.evp_opening:4.0%}  DVP {s.dvp_opening:4.0%}  solenoid {solenoid}"
        grid.add_row("valves", valves)
        command, cv, reservoir = (
            bar(s.command_kPa, self.max_kPa, "yellow", bars),
            bar(s.cv_kPa, self.max_kPa, "blue", bars),
            bar(s.reservoir_kPa, self.full_kPa, "cyan", bars),
        )
        grid.add_row("command", command.append(f"  {number(s.command_kPa)} kPa", style="default"))
        bend = f"  {number(s.cv_kPa)} kPa   bend {number(s.bend_deg, 0)}°"
        grid.add_row("vine", cv.append(bend, style="default"))
        grid.add_row("reservoir", reservoir.append(f"  {number(s.reservoir_kPa, 0)} kPa", style="default"))
        bends, minutes = air(s.cycles)
        grid.add_row("bends left", bends)
        grid.add_row("air", minutes)
        return grid


def _doing(s: Snapshot) -> list[Text]:
    """What the vine does: red if something is wrong, yellow if a link is unstable or a request is awaited."""
    lines = [Text(f"doing       {s.doing}", style="bold")]
    if s.safe_state:
        lines = [Text(f"SAFE: {'; '.join(s.safe_state.values())}; {s.doing}", style="bold red")]
    if s.waiting:
        if not s.safe_state:
            lines = [Text(f"doing       {s.doing}: {s.waiting.stopped_by}", style="bold yellow")]
        lines.append(Text(f"waiting for: {s.waiting.awaited}", style="bold yellow"))
    return [*lines, *(Text(sentence, style="bold yellow") for sentence in s.unstable.values())]


def _health(s: Snapshot) -> str:
    if s.round_trip_s is None:
        return ""
    return f"  round trip {1000 * s.round_trip_s:.1f} ms, {s.telemetry_gaps} gaps"


def air(c: CyclesLeft | None) -> tuple[str, str]:
    """The number of bends left, each like the last one, and the time that the air lasts without a bend."""
    if c is None:
        return "not known", "not known"
    if c.lost:
        return "0", "counted as lost until you clear the fault"
    expected, low, high = (value * c.per_cycle for value in (c.expected, c.low, c.high))
    like = "like the last" if c.measured_cycles > 0 else "a guess"
    long = c.minutes >= MAX_MINUTES
    minutes = "10 h or more" if long else f"{c.minutes:.0f} min"
    return (
        f"{expected:.0f} ({low:.0f}…{high:.0f}) to {c.bend_kPa:.0f} kPa, {like}",
        f"{minutes} without a bend (at least {c.minutes_low:.0f})",
    )


def number(value: float, digits: int = 1) -> str:
    """The number as text; "–" if it is NaN."""
    return "–" if math.isnan(value) else f"{value:.{digits}f}"


def bar(value: float, full: float, style: str, width: int = BAR_WIDTH) -> Text:
    """A bar of length `value / full`, `width` characters at most."""
    share = 0.0 if math.isnan(value) else min(max(value / full, 0.0), 1.0)
    filled = round(share * width)
    return Text.assemble(("█" * filled, style), ("░" * (width - filled), "dim"))


class NonBlockingOutput(io.TextIOBase):
    """Standard output that never blocks, even if the terminal does (network, Ctrl-S)."""

    def __init__(self) -> None:
        # A live view replaces `sys.stdout`.
        self._stdout = sys.stdout
        self._writer: BackgroundWriter[str] = BackgroundWriter(self._print, MAX_QUEUED)

    def console(self) -> Console:
        # Rich compiles its patterns for highlights and loads its emoji at the first text: 20 ms of the start.
        return Console(markup=False, file=cast(IO[str], self), highlight=False, emoji=False)

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return self._stdout.encoding

    def isatty(self) -> bool:
        return self._stdout.isatty()

    def write(self, text: str) -> int:
        self._writer.write(text, len(text))
        return len(text)

    def close(self) -> None:
        """Write the queued text, if the terminal accepts it in time."""
        self._writer.close(CLOSING_S)

    def _print(self, texts: list[str]) -> None:
        """Write without the stream, because the interpreter waits for the stream's lock at exit."""
        data = "".join(texts).encode(self.encoding, "replace")
        while data:
            data = data[os.write(self._stdout.fileno(), data) :]


def can_redraw(console: Console) -> bool:
    """True for a terminal that the live view can redraw. On TERM=dumb rich would show nothing."""
    return console.is_terminal and not console.is_dumb_terminal


def plain_printer(console: Console, began: float) -> Callable[[Action], None]:
    """Returns a function that prints one line per event."""

    def show(action: Action) -> None:
        line = event_line(action, began)
        if line is not None:
            console.print(line, soft_wrap=True)

    return show
