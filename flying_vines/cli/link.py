"""`flying-vines link`: monitors the phloSAR's serial line, and reads and writes the firmware's settings.

The line is shown as lines, JSON objects or a screen. EVP: inflation valve. DVP: the Venturi's supply valve.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import signal
import sys
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from enum import Enum
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from firmware_link.host import SessionState
from firmware_link.monitor import SeenFrame
from firmware_link.protocol import Fault, Message, Mode, Ping, Pong, Setting, Telemetry, Welcome, fault_names
from firmware_link.statistics import LinkStatistics
from flying_vines.cli.common import add_option, fail, phlosar_only
from flying_vines.config import config as configuration
from flying_vines.config.address import FORMS, Address, parse_address
from flying_vines.service.link_settings import SettingsError, exchange_settings
from flying_vines.service.link_watch import LinkEvent, LinkNote, LinkWatch
from flying_vines.service.persistent_state import PersistentState
from flying_vines.terminal.screen import bar, can_redraw, number

_REFRESH_PER_S = 8
STALE_S = 0.3
LINES = 12
"""Lines of the live screen for events."""
_MODE_STYLE = {Mode.VENT: "green", Mode.REGULATE: "bold yellow", Mode.FAULT: "bold red"}


def add(commands: Any) -> None:
    """Add `link` to the parsers of the command line."""
    link = commands.add_parser("link", help="monitor the phloSAR's serial line; read or write its settings")
    link.add_argument("address", nargs="?", metavar="ADDRESS", help=f"(default: the configuration's) {FORMS}")
    add_option(link, "--config")
    add_option(link, "--seconds", help="stop after this time; exit status 1 without an answer")
    add_option(link, "--json", help="print one JSON object per line")
    link.add_argument("--raw", action="store_true", help="print the bytes, too")
    link.add_argument("--settings", action="store_true", help="print the firmware's settings")
    link.add_argument(
        "--set",
        action="append",
        default=[],
        dest="changes",
        metavar="NAME=VALUE",
        help="store a setting in the firmware; may be repeated",
    )
    link.set_defaults(run=_link)


def _link(arguments: argparse.Namespace) -> int:
    title: str | None = arguments.address
    state: PersistentState | None = None
    if title is None:
        config = configuration.load_or_default(arguments.config)
        phlosar_only(config, "link")
        title = config.firmware.link
        if arguments.config is not None:
            state = PersistentState.of(arguments.config, config)
    if arguments.seconds is not None and not arguments.seconds > 0.0:
        fail("--seconds must be above 0")
    try:
        address = parse_address(title)
        changes = dict(map(_change, arguments.changes))
        if arguments.settings or changes:
            asyncio.run(settings(address, changes, arguments.json, state))
            return 0
    except (ValueError, SettingsError) as error:
        fail(str(error))
    answered = asyncio.run(monitor(address, title, arguments.seconds, arguments.json, arguments.raw))
    return 0 if answered else 1


def _change(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError:
        raise ValueError(f"--set {text}: give NAME=VALUE, with a number") from None


async def monitor(address: Address, title: str, seconds: float | None, objects: bool, raw: bool) -> bool:
    """Watch until interrupted, or for `seconds`. Returns True if the firmware answered."""
    watch = LinkWatch(address)
    stopped = _stopped()

    def over() -> bool:
        return stopped.is_set() or (seconds is not None and watch.t >= seconds)

    console = Console(markup=False)
    if objects or raw or not can_redraw(console):
        await watch.run(_printer(console, objects, raw), over)
        if objects:
            print(json.dumps({"t": round(watch.t, 6), "statistics": watch.statistics._asdict()}))
        else:
            console.print(statistics_line(watch.statistics), soft_wrap=True, highlight=False)
        return _answered(watch, stopped)
    view = LinkView(title)
    with Live(view.render(watch), console=console, refresh_per_second=_REFRESH_PER_S, screen=True) as screen:
        drawn_at = 0.0

        def show(events: Sequence[LinkEvent]) -> None:
            nonlocal drawn_at
            view.take(events)
            if watch.t - drawn_at >= 1.0 / _REFRESH_PER_S:
                drawn_at = watch.t
                screen.update(view.render(watch))

        await watch.run(show, over)
    console.print(statistics_line(watch.statistics), soft_wrap=True, highlight=False)
    return _answered(watch, stopped)


def _answered(watch: LinkWatch, stopped: asyncio.Event) -> bool:
    if stopped.is_set():
        raise KeyboardInterrupt
    return watch.answered


async def settings(
    address: Address, changes: Mapping[str, float], objects: bool, state: PersistentState | None = None
) -> None:
    """Write `changes`, then print all settings. `state` as in `exchange_settings`. Raises `SettingsError`."""
    known = await exchange_settings(address, changes, _stopped(), state)
    if objects:
        for setting in known:
            named = {name: getattr(setting, name) for name in ("name", "value", "least", "most", "standard")}
            print(json.dumps(named))
    else:
        Console(markup=False).print(settings_table(known))


def _stopped() -> asyncio.Event:
    """Set by Ctrl-C and SIGTERM."""
    stopped = asyncio.Event()
    for name in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(name, stopped.set)
    return stopped


def _printer(console: Console, objects: bool, raw: bool) -> Callable[[Sequence[LinkEvent]], None]:
    def show(events: Sequence[LinkEvent]) -> None:
        for each in events:
            if objects:
                print(json.dumps(as_json(each, raw), allow_nan=False))
            else:
                text = line(each, raw)
                if console.is_terminal:
                    console.print(text, soft_wrap=True)
                else:
                    print(text.plain)
        sys.stdout.flush()

    return show


def describe(message: Message) -> str:
    """A message as text."""
    if isinstance(message, Telemetry):
        opening = f"EVP {message.evp_opening:.0%}, DVP {message.dvp_opening:.0%}"
        solenoid = "open" if message.solenoid else "shut"
        faults = f", {fault_names(message.faults)}" if message.faults else ""
        return (
            f"{message.device_time_ms / 1000:.3f} s, {message.mode.name} #{message.number}{faults}, "
            f"setpoint {message.setpoint_kPa:.2f}, vine {message.cv_kPa:.2f}, "
            f"reservoir {message.reservoir_kPa:.1f} kPa, {opening}, solenoid {solenoid}"
        )
    return ", ".join(f"{name} {_plain(value)}" for name, value in asdict(message).items())


def _plain(value: object) -> str:
    if isinstance(value, Enum):
        return value.name
    return f"{value:g}" if isinstance(value, float) else str(value)


def line(event: LinkEvent, raw: bool = False) -> Text:
    """One line for a terminal or a pipe."""
    if isinstance(event, LinkNote):
        return Text(f"{event.t:9.3f}   {event.text}", style="green" if event.good else "bold red")
    text = Text(f"{event.t:9.3f} ", no_wrap=True, overflow="ellipsis")
    text.append("→ " if event.sent else "← ", style="yellow" if event.sent else "cyan")
    if event.message is None:
        text.append(f"{len(event.wire)} bytes: {event.problem}", style="red")
    else:
        text.append(f"{type(event.message).__name__:<10} ", style="bold")
        text.append(describe(event.message))
    if raw or event.message is None:
        text.append(f"  [{event.wire.hex(' ')}]", style="dim")
    return text


def as_json(event: LinkEvent, raw: bool = False) -> dict[str, Any]:
    """The event as a JSON object; NaN and infinities become null."""
    if isinstance(event, LinkNote):
        return {"t": round(event.t, 6), "told": event.text}
    entry: dict[str, Any] = {"t": round(event.t, 6), "to": "device" if event.sent else "host"}
    if event.message is None:
        entry |= {"message": None, "problem": event.problem}
    else:
        entry["message"] = type(event.message).__name__
        entry |= {name: _for_json(value) for name, value in asdict(event.message).items()}
    if raw or event.message is None:
        entry["wire"] = event.wire.hex()
    return entry


def _for_json(value: object) -> object:
    if isinstance(value, Fault):
        return int(value)
    if isinstance(value, Enum):
        return value.name
    return None if isinstance(value, float) and not math.isfinite(value) else value


def settings_table(settings: Sequence[Setting]) -> Table:
    """Values, limits and defaults; a changed setting is highlighted."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("setting")
    for name in ("value", "least", "most", "standard"):
        table.add_column(name, justify="right")
    for setting in settings:
        table.add_row(
            setting.name,
            *(f"{value:.5g}" for value in (setting.value, setting.least, setting.most, setting.standard)),
            style="" if setting.value == setting.standard else "bold yellow",
        )
    return table


def verdict(now: LinkStatistics, since: LinkStatistics | None) -> Text:
    """The line's quality since the firmware's first answer (`since`)."""
    if since is None:
        return Text("not known: no answer yet", style="dim")
    wrong = {
        "corrupt": now.bad_frames - since.bad_frames,
        "lost": now.lost_frames - since.lost_frames,
        "unknown": now.unknown_messages - since.unknown_messages,
        "gaps in telemetry": now.telemetry_gaps - since.telemetry_gaps,
    }
    good = now.good_frames - since.good_frames
    if not any(wrong.values()):
        return Text(f"clean: {good} frames, all good", style="green")
    counts = ", ".join(f"{count} {what}" for what, count in wrong.items() if count)
    # A corrupt frame also leaves a gap in the sequence numbers and so counts as lost.
    bad = max(wrong["corrupt"], wrong["lost"])
    return Text(f"not clean: {counts}; {bad / max(1, bad + good):.2%} of all frames", style="bold red")


def statistics_line(now: LinkStatistics) -> str:
    """All counts in one line."""
    return (
        f"{now.good_frames} good, {now.bad_frames} corrupt, {now.lost_frames} lost, "
        f"{now.unknown_messages} unknown frames; {now.telemetry_gaps} gaps in telemetry; "
        f"{now.reconnects} reconnects; {now.received_bytes} bytes in, {now.sent_bytes} out, "
        f"{now.dropped_bytes} dropped"
    )


class LinkView:
    """The live screen. Call `take` with new events and `render` to draw."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._lines: deque[Text] = deque(maxlen=LINES)
        self._telemetry: Telemetry | None = None

    def take(self, events: Sequence[LinkEvent]) -> None:
        """Add lines for the events; pings and unchanged telemetry show only in the rows above."""
        for each in events:
            message = each.message if isinstance(each, SeenFrame) else None
            if isinstance(message, (Ping, Pong)):
                continue
            if isinstance(message, Telemetry):
                before, self._telemetry = self._telemetry, message
                if before is not None and (message.mode, message.faults) == (before.mode, before.faults):
                    continue
            self._lines.append(line(each))

    def render(self, watch: LinkWatch) -> Panel:
        """The whole screen."""
        session, now = watch.monitor.session, watch.statistics
        fresh = session.telemetry if session.telemetry_age(watch.t) <= STALE_S else None
        welcome = session.welcome if session.state is SessionState.READY else None
        grid = Table.grid(padding=(0, 2))
        grid.add_column(style="dim", no_wrap=True)
        grid.add_column()
        grid.add_row("port", Text(watch.port.text, style="green" if watch.port.good else "bold red"))
        grid.add_row("firmware", _firmware(session.state, welcome, fresh))
        grid.add_row("limits", _limits(welcome))
        grid.add_row("", "")
        grid.add_row("mode", _mode(fresh))
        full_kPa = welcome.cv_limit_kPa if welcome else math.inf
        grid.add_row("vine", _pressure(fresh.cv_kPa if fresh else math.nan, full_kPa, "blue"))
        full_kPa = welcome.reservoir_limit_kPa if welcome else math.inf
        grid.add_row("reservoir", _pressure(fresh.reservoir_kPa if fresh else math.nan, full_kPa, "cyan"))
        grid.add_row("valves", _valves(fresh))
        grid.add_row("", "")
        grid.add_row("line", verdict(now, watch.clean_since))
        grid.add_row("traffic", f"in {_rate(now.received_bytes_per_s)}, out {_rate(now.sent_bytes_per_s)}")
        grid.add_row("clock", _clock(now))
        grid.add_row("counts", statistics_line(now))
        return Panel(
            Group(
                grid, Text(""), Rule("frames except pings and steady telemetry", style="dim"), *self._lines
            ),
            title=f"phloSAR link   {self._title}   {watch.t:.1f} s",
        )


def _firmware(state: SessionState, welcome: Welcome | None, telemetry: Telemetry | None) -> Text:
    if welcome is None:
        return Text({SessionState.CLOSED: "no port"}.get(state, state.value), style="red")
    uptime = f", up {telemetry.device_time_ms / 1000:.0f} s" if telemetry else ""
    return Text.assemble(
        ("ready", "bold green"),
        f"   {welcome.firmware_build or 'no name'}, protocol {welcome.protocol_version}, "
        f"boot {welcome.boot_id:08x}{uptime}",
    )


def _limits(welcome: Welcome | None) -> str:
    if welcome is None:
        return "–"
    return (
        f"vine {welcome.cv_limit_kPa:g} kPa (setpoints to {welcome.setpoint_limit_kPa:g}), "
        f"reservoir {welcome.reservoir_limit_kPa:g} kPa, {welcome.rate_limit_kPa_per_s:g} kPa/s, "
        f"dead-man {welcome.dead_man_ms} ms, telemetry {welcome.telemetry_Hz} Hz"
    )


def _mode(telemetry: Telemetry | None) -> Text:
    if telemetry is None:
        return Text("no telemetry", style="red")
    faults = (fault_names(telemetry.faults), "bold red") if telemetry.faults else ("no faults", "dim")
    return Text.assemble((telemetry.mode.name, _MODE_STYLE[telemetry.mode]), "   ", faults)


def _pressure(value_kPa: float, full_kPa: float, style: str) -> Text:
    return Text.assemble(bar(value_kPa, full_kPa, style), f"  {number(value_kPa, 2)} kPa")


def _valves(telemetry: Telemetry | None) -> str:
    if telemetry is None:
        return "–"
    solenoid = "open" if telemetry.solenoid else "shut"
    return f"EVP {telemetry.evp_opening:4.0%}   DVP {telemetry.dvp_opening:4.0%}   solenoid {solenoid}"


def _rate(bytes_per_s: int) -> str:
    return f"{bytes_per_s / 1000:.1f} kB/s" if bytes_per_s >= 1000 else f"{bytes_per_s} B/s"


def _clock(now: LinkStatistics) -> str:
    if now.round_trip_s is None or now.clock_offset_s is None:
        return "–"
    drift = "" if now.clock_drift_ppm is None else f", gains {now.clock_drift_ppm:+.0f} ppm"
    trip = f"round trip {1000 * now.round_trip_s:.1f} ms"
    return f"{trip}, device clock {now.clock_offset_s:+.3f} s from ours{drift}"
