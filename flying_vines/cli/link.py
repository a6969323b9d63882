"""`flying-vines link`: monitors the phloSAR's serial line, and reads and writes the firmware's settings."""

from __future__ import annotations

import argparse
import asyncio
import json
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live

from flying_vines.cli.common import fail, phlosar_only
from flying_vines.cli.link_view import LinkView, as_json, line, settings_table, statistics_line
from flying_vines.config import config as configuration
from flying_vines.config.address import FORMS, Address, parse_address
from flying_vines.service.link_settings import SettingsError, exchange_settings
from flying_vines.service.link_watch import LinkEvent, LinkWatch
from flying_vines.service.persistent_state import PersistentState
from flying_vines.terminal.screen import can_redraw

_REFRESH_PER_S = 8


def add(commands: Any) -> None:
    """Add `link` to the parsers of the command line."""
    link = commands.add_parser("link", help="monitor the phloSAR's serial line; read or write its settings")
    link.add_argument("address", nargs="?", metavar="ADDRESS", help=f"(default: the configuration's) {FORMS}")
    link.add_argument(
        "--config", type=Path, metavar="FILE", help="the configuration (default: the built-in one)"
    )
    link.add_argument(
        "--seconds", type=float, metavar="N", help="stop after this time; exit status 1 without an answer"
    )
    link.add_argument("--json", action="store_true", help="print one JSON object per line")
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
