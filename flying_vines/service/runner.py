"""Runs the service with its watchers: recorder, screen, gateway and systemd."""

from __future__ import annotations

import asyncio
import gc
import sys
from dataclasses import dataclass

from rich.console import Console
from rich.live import Live
from rich.text import Text

from flying_vines.config.config import Config
from flying_vines.core.events import StoredState
from flying_vines.core.watcher import EachAction
from flying_vines.gateway.gateway import Gateway
from flying_vines.record.recorder import Recorder
from flying_vines.service.persistent_state import PersistentState
from flying_vines.service.service import Service, on_stop_signals
from flying_vines.service.systemd import service_manager
from flying_vines.supply import RigPrior
from flying_vines.terminal.screen import LiveView, can_redraw, plain_printer
from flying_vines.vehicle.mavlink.signing import Signing
from flying_vines.vehicle.notice import Severity

SNAPSHOT_S = 0.05
NEWS_S = 0.2
"""Interval of the checks for news of the log and the links, without a live view."""
SWITCH_S = 0.0005
"""Maximum time that the recorder's thread keeps the interpreter while the loop waits for it. Python's default
of 5 ms is longer than any step of the recorder. So the loop would wait until the end of the step."""


@dataclass(frozen=True)
class Remembered:
    """The persistent state, as read at the start."""

    persistent: PersistentState
    stored: StoredState
    signing: Signing | None
    page_token: str


async def serve(
    config: Config,
    prior: RigPrior | None,
    remembered: Remembered,
    log: Recorder,
    console: Console,
    live: bool,
    page: str,
) -> None:
    """Serve until a stop signal, or until the service ends. `page` is a line with the page's address."""
    loop = asyncio.get_running_loop()
    view = LiveView(loop.time(), config.limits.max_kPa, config.pneumatics.full_kPa)
    live = live and can_redraw(console)
    shown = EachAction(view.take if live else plain_printer(console, loop.time()))
    gateway = Gateway(
        config,
        ask=lambda *request: service.ask(*request),
        say=lambda text: service.say(Severity.WARNING, text),
        page_token=remembered.page_token,
        flights=str(log.folder.parent.resolve()),
    )
    watchers = (log, shown, gateway, *service_manager())
    service = Service(
        config,
        watchers,
        prior,
        remembered.stored,
        remembered.signing,
        remembered.persistent,
    )
    # Modules stay until the end: exclude them from garbage collection, which would pause the loop in flight.
    gc.freeze()
    gc.enable()
    sys.setswitchinterval(SWITCH_S)
    on_stop_signals(service.stop)
    if page:
        view.say(Text(page))
    serving = asyncio.create_task(service.run())
    gateway_task = asyncio.create_task(gateway.run()) if Gateway.wanted(config) else None
    try:
        await _show(serving, service, log, console, view, live)
        await serving
    finally:
        if gateway_task:
            gateway_task.cancel()
            await asyncio.wait([gateway_task])
        log.close()


async def _show(
    serving: asyncio.Task[None], service: Service, log: Recorder, console: Console, view: LiveView, live: bool
) -> None:
    """Until `serving` ends, show the live view or the links' news, and report news of the log."""
    screen = Live(console=console, refresh_per_second=5, screen=True) if live else None
    problems: dict[str, str] = {}
    log_reported = ""
    if screen:
        screen.start()
    try:
        while not serving.done():
            if log_reported != log.news:
                log_reported = log.news
                service.say(Severity.WARNING, log_reported)
            if screen:
                snapshot = service.core.snapshot(service.now)
                try:
                    screen.update(view.render(snapshot, problems=service.link_problems))
                except Exception as error:
                    service.failed("screen", error)
                    screen.stop()
                    screen = None
            elif problems != service.link_problems:
                problems = dict(service.link_problems)
                for link, why in problems.items():
                    console.print(f"{link} link: {why or 'open'}", soft_wrap=True)
            await asyncio.wait([serving], timeout=SNAPSHOT_S if screen else NEWS_S)
    finally:
        if screen:
            screen.stop()
