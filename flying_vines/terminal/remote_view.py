"""Shows another service on a screen, as lines or as JSON, with a key that vents."""

from __future__ import annotations

import asyncio
from contextlib import ExitStack

from rich.console import Console, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.text import Text
from yarl import URL

from flying_vines.terminal import keys
from flying_vines.terminal.page_protocol import LATE_S, InvalidMessageError, PageDecoder, VentRequest
from flying_vines.terminal.page_socket import PageSocket
from flying_vines.terminal.screen import LiveView, can_redraw, event_line

POLL_S = 0.1
SECOND_PRESS_S = 3.0
"""Maximum time between the first and the second press of the key."""
KEYS = "press v twice to vent, q to end"


class RemoteView:
    """Shows the service with its page's WebSocket at `url`."""

    def __init__(self, url: URL, token: str, plain: bool, as_json: bool) -> None:
        self._page = url.origin()
        self._console = Console(markup=False)
        self._live = can_redraw(self._console) and not plain and not as_json
        self._as_json = as_json
        self._decoder = PageDecoder()
        self._view: LiveView | None = None
        self._vent = VentRequest()
        self._pressed_at: float | None = None
        self._socket = PageSocket(url, token, self._take)
        self._shown_problem = "connecting"
        self._over = False

    async def run(self, seconds: float | None) -> bool:
        """Returns True if the service answered. Raises `NotAdmittedError`."""
        ends_at = None if seconds is None else self._now + seconds
        following = asyncio.create_task(self._socket.run())
        with ExitStack() as stack:
            screen = None
            if self._live:
                stack.enter_context(keys.pressed(self._press))
                screen = stack.enter_context(Live(console=self._console, refresh_per_second=10, screen=True))
            while not self._over and (ends_at is None or self._now < ends_at):
                await asyncio.wait([following], timeout=POLL_S)
                if following.done():
                    break
                if request := self._vent.pop_message(self._now):
                    self._socket.send(request)
                self._show_link()
                if screen:
                    screen.update(self._rendered())
        following.cancel()
        await asyncio.wait([following])
        if not following.cancelled():
            following.result()
        return self._decoder.vine is not None

    # Receiving.

    def _take(self, text: str) -> None:
        if self._as_json:
            print(text, flush=True)
        try:
            news = self._decoder.take(self._now, text)
            vented = self._vent.take(self._now, text)
        except InvalidMessageError as error:
            self._say(Text(str(error), style="red"))
            return
        if self._view is None and self._decoder.vine:
            self._view = LiveView(
                self._decoder.began, self._decoder.vine.max_kPa, self._decoder.vine.full_kPa
            )
        for action in news:
            if line := event_line(action, self._decoder.began):
                self._say(line)
        if vented:
            self._say(Text(vented, style="bold green" if vented.startswith("VENT confirmed") else "bold red"))

    def _show_link(self) -> None:
        problem = self._problem
        if problem != self._shown_problem:
            self._shown_problem = problem
            self._say(Text(f"link: {problem or 'open'}", style="bold red" if problem else "green"))

    @property
    def _problem(self) -> str:
        if self._socket.problem:
            return self._socket.problem
        silent = self._decoder.snapshot is not None and self._decoder.snapshot_age_s(self._now) > LATE_S
        return "the service is silent" if silent else ""

    # Showing.

    def _say(self, line: Text) -> None:
        if self._live:
            if self._view:
                self._view.say(line)
        elif not self._as_json:
            self._console.print(line, soft_wrap=True)

    def _rendered(self) -> RenderableType:
        if self._view is None or self._decoder.snapshot is None:
            return Panel(
                Text(f"{self._page}: {self._problem or 'no data from the service yet'}"), title="Flying Vines"
            )
        problem = self._problem
        title = f"Flying Vines   {self._page}"
        panel = self._view.render(self._decoder.snapshot, title, {"page": problem})
        panel.subtitle = self._hint
        if problem:
            panel.title = f"These data are {self._decoder.snapshot_age_s(self._now):.0f} s old"
            panel.border_style, panel.style = "bold red not dim", "dim"
        return panel

    @property
    def _hint(self) -> Text:
        if self._vent.pressed_at is not None:
            return Text(
                f"VENT not confirmed, trying for {self._now - self._vent.pressed_at:.0f} s", style="bold red"
            )
        if self._pressed_at is not None and self._now - self._pressed_at < SECOND_PRESS_S:
            return Text("press v again to vent", style="bold yellow not dim")
        return Text(KEYS, style="dim")

    # Keys.

    def _press(self, key: str) -> None:
        if key == "q":
            self._over = True
        elif key == "v" and self._pressed_at is not None and self._now - self._pressed_at < SECOND_PRESS_S:
            self._pressed_at = None
            self._vent.press(self._now, self._decoder.snapshot)
        else:
            self._pressed_at = self._now if key == "v" else None

    @property
    def _now(self) -> float:
        return asyncio.get_running_loop().time()
