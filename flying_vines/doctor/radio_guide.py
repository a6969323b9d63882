"""Runs the radio test on a link and guides a person through its steps."""

from __future__ import annotations

import asyncio
import os
import sys
import termios
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.status import Status
from rich.table import Table
from rich.text import Text

from flying_vines.config.address import Address
from flying_vines.config.config import Config
from flying_vines.doctor.radio_test import LOSSES, RadioLearned, RadioStep, RadioTest, Sign, TransmitterLoss
from flying_vines.doctor.vehicle_probe import TICK_S, VehicleProbe, VehicleWatch
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.mavlink.signing import Signing

BEGIN = (
    "Take the props off. Disconnect the vine or shut the reservoir. The test moves nothing. Ctrl-C ends it."
)
STEPS = 1 + 2 * LOSSES
MARK_WIDTH = 4


Hand = Callable[[RadioTest, float], None]
"""Acts in place of a person: gets the test and the present time, again and again."""


class NobodyThereError(Exception):
    """There is no person to press Enter."""


class RadioProbe(VehicleProbe):
    """Sends the doctor's usual requests, and forwards the autopilot's messages to the test."""

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self.test = RadioTest(config)

    def take(self, t: float, unix_s: float, message: MavlinkMessage) -> None:
        super().take(t, unix_s, message)
        if self._state.is_ours(message):
            self.test.take(t, message)


class Guide:
    """Prints prompts and the observed signs."""

    def __init__(self, test: RadioTest, config: Config, console: Console) -> None:
        self._test, self._console = test, console
        self._channel, self._names = config.switch.channel, config.switch.positions
        self._at: tuple[int, RadioStep] | None = None
        self._signs = 0
        self._losses = 0
        self._reported_early = False

    def follow(self, t: float) -> str:
        """Print what is new. Returns the status line."""
        test = self._test
        self._show_signs(test.signs)
        losses = test.learned.losses
        if len(losses) > self._losses:
            self._show_signs(losses[-1].signs)
            self._show_loss(losses[-1])
            self._losses = len(losses)
        if test.came_back_early and not self._reported_early:
            self._note("RC was good again too soon. Keep the transmitter off until you are asked.", "yellow")
        self._reported_early = test.came_back_early
        now = test.round, test.step
        if now != self._at:
            before, self._at = self._at, now
            self._step_changed(before, t)
        return self._meanwhile(t)

    def _step_changed(self, before: tuple[int, RadioStep] | None, t: float) -> None:
        test = self._test
        if before is not None and before[1] == "on" and test.learned.losses[-1].back is not None:
            self._show_return(test.learned.losses[-1])
        number = 2 * test.round + 2
        match test.step:
            case "ready" if not (test.round and test.position == test.target):
                self._ask(number - 1 if not test.round else None, self._get_ready())
            case "off":
                if not test.round:
                    self._note(f"✓ position {test.target + 1}, {test.switch_us} µs", "green")
                self._signs = 0
                self._ask(number, "Press Enter and switch the transmitter OFF, both at once.")
            case "on":
                self._ask(number + 1, self._switch_on())

    def _get_ready(self) -> str:
        where = f"the switch (channel {self._channel}) to {self._position(self._test.target)}"
        return f"Put {where}." if self._test.round else f"Switch the transmitter on, and put {where}."

    def _switch_on(self) -> str:
        test = self._test
        if test.round or test.position == test.target:
            return "Switch the transmitter ON again."
        where = self._position(test.target)
        return f"While it is off, put the switch to {where}. Then switch the transmitter ON."

    def _position(self, index: int) -> str:
        return f"position {index + 1} ({self._names[index] or 'nothing'})"

    def _meanwhile(self, t: float) -> str:
        test = self._test
        if test.step == "off":
            return "waiting for Enter"
        if test.step == "lost":
            return "keep it off: waiting for signs of the loss"
        trouble = test.trouble(t)
        position = "–" if test.position is None else test.position + 1
        return trouble or f"channel {self._channel}: {test.switch_us} µs, position {position}"

    def _show_signs(self, signs: tuple[Sign, ...]) -> None:
        for sign in signs[self._signs :]:
            self._note(f"{sign.after_s:+.1f} s  {sign.said}", "cyan")
        self._signs = max(self._signs, len(signs))

    def _show_loss(self, loss: TransmitterLoss) -> None:
        if not loss.seen:
            self._note("no sign of the loss", "yellow")
            return
        said = f"channel {self._channel} stays at" if loss.held else f"channel {self._channel} now reads"
        others = f"; channels {', '.join(map(str, loss.jumped))} jumped, too" if loss.jumped else ""
        self._note(f"{said} {loss.lost_us} µs{others}", "cyan")

    def _show_return(self, loss: TransmitterLoss) -> None:
        back = loss.back
        assert back is not None
        said = f"✓ back, channel {self._channel} at {back.switch_us} µs"
        if back.good_after_s is not None:
            when = "before" if back.good_after_s >= 0.0 else "after"
            said += f"; it moved {abs(back.good_after_s):.1f} s {when} the autopilot reported good RC"
        self._note(said, "green")

    def _ask(self, number: int | None, text: str) -> None:
        self._line(Text(f"{number}/{STEPS}" if number else "", style="dim"), Text(text, style="bold"))

    def _note(self, text: str, style: str) -> None:
        self._line(Text(), Text(text, style=style))

    def _line(self, mark: Text, text: Text) -> None:
        """Print a line. It is wrapped within its column on a terminal, and not wrapped in a pipe."""
        if not self._console.is_terminal:
            self._console.print(Text(f"{mark.plain:<{MARK_WIDTH}} {text.plain}"), soft_wrap=True)
            return
        grid = Table.grid(padding=(0, 1))
        grid.add_column(width=MARK_WIDTH)
        grid.add_column(overflow="fold")
        grid.add_row(mark, text)
        self._console.print(grid)


async def guided(
    address: Address,
    config: Config,
    signing: Signing | None,
    console: Console,
    begin: str = BEGIN,
    hand: Hand | None = None,
) -> RadioLearned:
    """Runs the whole test. `begin`: its first line. `hand`: acts in place of a person.

    Raises `NobodyThereError`.
    """
    probe = RadioProbe(config)
    test = probe.test
    watch = VehicleWatch(address, config, signing, probe)
    guide = Guide(test, config, console)
    nobody, over = asyncio.Event(), asyncio.Event()
    console.print(Text(begin, style="yellow"), soft_wrap=not console.is_terminal)
    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(watch.run(over.is_set))
        with _live(console) as live, _enters(lambda: test.press(watch.t), nobody.set, hand is None):
            while test.step != "done":
                test.advance(watch.t)
                live(guide.follow(watch.t))
                if hand is not None:
                    hand(test, watch.t)
                elif nobody.is_set() and test.step == "off":
                    break
                await asyncio.sleep(TICK_S)
            guide.follow(watch.t)
        over.set()
    if test.step != "done":
        raise NobodyThereError
    return test.learned


@contextmanager
def _live(console: Console) -> Iterator[Callable[[str], None]]:
    """Yields a function that shows the status line on a terminal; in a pipe it does nothing."""
    if not console.is_terminal:
        yield lambda text: None
        return
    status = Status("", console=console)
    with status:
        yield lambda text: status.update(Text(text, style="dim"))


@contextmanager
def _enters(pressed: Callable[[], None], ended: Callable[[], None], wanted: bool) -> Iterator[None]:
    """In this block each typed line counts as Enter."""
    if not wanted:
        yield
        return
    loop = asyncio.get_running_loop()

    def read() -> None:
        data = os.read(number, 4096)
        if b"\n" in data:
            pressed()
        if not data:
            loop.remove_reader(number)
            ended()

    number = -1
    try:
        number = sys.stdin.fileno()
        loop.add_reader(number, read)
    except OSError:
        # No standard input, or a file: nobody types there.
        ended()
    try:
        with _without_echo(number):
            yield
    finally:
        if number >= 0:
            loop.remove_reader(number)


@contextmanager
def _without_echo(number: int) -> Iterator[None]:
    """Switch the terminal's echo off in this block: an echoed Enter would break the screen."""
    if number < 0 or not os.isatty(number):
        yield
        return
    before = termios.tcgetattr(number)
    quiet = [*before[:3], before[3] & ~termios.ECHO, *before[4:]]
    termios.tcsetattr(number, termios.TCSADRAIN, quiet)
    try:
        yield
    finally:
        termios.tcsetattr(number, termios.TCSADRAIN, before)
