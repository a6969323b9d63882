"""`flying-vines link`: the monitor on a screen or in a pipe, and the firmware's settings."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
from collections.abc import Callable, Mapping, Sequence

from rich.console import Console
from rich.live import Live

from firmware_link.host import SessionState
from firmware_link.protocol import Setting
from firmware_link.settings import SettingsTalk
from flying_vines.config.address import Address
from flying_vines.terminal.link_view import LinkView, as_json, line, settings_table, statistics_line
from flying_vines.terminal.link_watch import Heard, LinkWatch

ANSWERS_WITHIN_S = 5.0
"""A board that starts up, two greetings and the sentence that says who is silent. One that goes away half-way
has as long to come back."""
_REFRESH_PER_S = 8


class SettingsError(Exception):
    """The settings cannot be read or changed; the text is a sentence."""


class SettingsInterruptedError(SettingsError):
    """Nobody wants it any more."""


async def monitor(address: Address, title: str, seconds: float | None, objects: bool, raw: bool) -> bool:
    """Watch until interrupted, or for `seconds`; whether the firmware answered."""
    watch = LinkWatch(address)
    stopped = _stopped()

    def over() -> bool:
        return stopped.is_set() or (seconds is not None and watch.t >= seconds)

    console = Console()
    if objects or raw or not console.is_terminal:
        await watch.run(_printer(console, objects, raw), over)
        if objects:
            print(json.dumps({"t": round(watch.t, 6), "statistics": watch.statistics._asdict()}))
        else:
            console.print(statistics_line(watch.statistics), soft_wrap=True, highlight=False)
        return watch.answered
    view = LinkView(title)
    with Live(view.render(watch), console=console, refresh_per_second=_REFRESH_PER_S, screen=True) as screen:
        drawn_at = 0.0

        def show(heard: Sequence[Heard]) -> None:
            nonlocal drawn_at
            view.take(heard)
            if watch.t - drawn_at >= 1.0 / _REFRESH_PER_S:
                drawn_at = watch.t
                screen.update(view.render(watch))

        await watch.run(show, over)
    console.print(statistics_line(watch.statistics), soft_wrap=True, highlight=False)
    return watch.answered


async def settings(address: Address, changes: Mapping[str, float], objects: bool) -> None:
    """Change what is to be changed and print what is set then; SettingsError."""
    known = await talk_about_settings(address, changes, _stopped())
    if objects:
        for setting in known:
            named = {name: getattr(setting, name) for name in ("name", "value", "least", "most", "standard")}
            print(json.dumps(named))
    else:
        Console().print(settings_table(known))


async def talk_about_settings(
    address: Address, changes: Mapping[str, float], stopped: asyncio.Event
) -> Sequence[Setting]:
    """Change what is to be changed: all that is set then. SettingsError, also once `stopped`."""
    talk = SettingsTalk(changes)
    watch = LinkWatch(address, talk)
    there_s = 0.0

    def over() -> bool:
        nonlocal there_s
        if watch.monitor.session.state is SessionState.READY:
            there_s = watch.t
        gone = watch.t - there_s >= ANSWERS_WITHIN_S
        return talk.done or bool(talk.problem) or gone or stopped.is_set()

    await watch.run(lambda heard: None, over)
    if not talk.done:
        if stopped.is_set() and not talk.problem:
            raise SettingsInterruptedError("interrupted")
        raise SettingsError(talk.problem or watch.port.text)
    return talk.settings


def _stopped() -> asyncio.Event:
    """Set by Ctrl-C and SIGTERM."""
    stopped = asyncio.Event()
    for name in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(name, stopped.set)
    return stopped


def _printer(console: Console, objects: bool, raw: bool) -> Callable[[Sequence[Heard]], None]:
    def show(heard: Sequence[Heard]) -> None:
        for each in heard:
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
