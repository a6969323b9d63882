"""A terminal: a program runs in it, a test types, and its output becomes a picture."""

from __future__ import annotations

import fcntl
import io
import os
import pty
import re
import signal
import struct
import subprocess
import termios
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from threading import Thread
from time import monotonic, sleep

from rich.console import Console
from rich.text import Text

MAX_WAIT_S = 120.0
SCREEN = b"\x1b[?1049h"
HOME = b"\x1b[H"
MOVES = re.compile(r"(\r|\n|\x1b\[2K|\x1b\[1A|\x1b\[\?[0-9]+[hl])")
FONT = re.compile(r"@font-face \{.*?\}", re.DOTALL)
CODE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\r")


class Ended(AssertionError):
    """A program that did not do what the test expects."""


class Terminal:
    """A terminal with a program. Leaving the context kills the program."""

    def __init__(
        self,
        words: Sequence[str | Path],
        folder: Path,
        environment: Mapping[str, str],
        size: tuple[int, int] = (100, 32),
    ) -> None:
        self.size = size
        self._words = [str(word) for word in words]
        self._shown = b""
        columns, lines = size
        self._keyboard, screen = pty.openpty()
        fcntl.ioctl(screen, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
        self._process = subprocess.Popen(
            self._words,
            cwd=folder,
            env={**environment, "TERM": "xterm-256color", "COLORTERM": "truecolor"},
            stdin=screen,
            stdout=screen,
            stderr=screen,
            start_new_session=True,
            # Ctrl-C reaches the program only from its controlling terminal. A test that a shell runs in the
            # background ignores Ctrl-C, and the program would inherit this.
            preexec_fn=lambda: (
                signal.signal(signal.SIGINT, signal.default_int_handler),
                fcntl.ioctl(0, termios.TIOCSCTTY, 0),
            ),
        )
        os.close(screen)
        self._reading = Thread(target=self._read, daemon=True)
        self._reading.start()

    def __enter__(self) -> Terminal:
        return self

    def __exit__(self, *error: object) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._reading.join()
        os.close(self._keyboard)

    def _read(self) -> None:
        # The read fails when the last program has closed the terminal.
        with suppress(OSError):
            while data := os.read(self._keyboard, 1 << 16):
                self._shown += data

    @property
    def output(self) -> str:
        """All output, without colours."""
        return CODE.sub("", self._shown.decode(errors="replace"))

    @property
    def now(self) -> Text:
        """What the terminal shows now: the latest screen, or all lines."""
        shown = self._shown
        if SCREEN in shown:
            _, _, shown = shown.rpartition(SCREEN)
            screens = shown.split(HOME)
            # The last screen may be incomplete.
            shown = screens[-2] if len(screens) > 2 else screens[-1]
        return Text.from_ansi(_lines(shown.decode(errors="replace")))

    def wait_for(self, pattern: str, seconds: float = MAX_WAIT_S) -> re.Match[str]:
        """Wait until the program has printed this."""
        until = monotonic() + seconds
        while not (found := re.search(pattern, self.output)):
            if self._process.poll() is not None or monotonic() > until:
                raise Ended(f"never showed {pattern!r}:\n{self.now.plain}")
            sleep(0.05)
        return found

    def type(self, line: str) -> None:
        os.write(self._keyboard, f"{line}\n".encode())

    def interrupt(self) -> None:
        os.write(self._keyboard, b"\x03")

    def end(self, status: int = 0, seconds: float = 600.0) -> str:
        """Wait for the end. Returns all output."""
        ended = self._process.wait(seconds)
        self._reading.join()
        if ended != status or "Traceback" in self.output:
            raise Ended(f"{self._words[-1]}: ended with {ended}:\n{self.now.plain}")
        return self.output

    def svg(self, title: str) -> str:
        """A picture of what the terminal shows now."""
        shown = self.now
        console = Console(width=self.size[0], record=True, file=io.StringIO(), force_terminal=True)
        console.print(shown, soft_wrap=False)
        # Remove the template's fonts, which are on the network.
        return FONT.sub("", console.export_svg(title=title)).replace("Fira Code", "DejaVu Sans Mono")


def _lines(text: str) -> str:
    """The text without spinners and progress bars that were erased."""
    lines, at, anew = [""], 0, False
    for part in MOVES.split(text):
        if part == "\n":
            at += 1
            lines += [""] * (at == len(lines))
        elif part == "\x1b[1A":
            at = max(0, at - 1)
        elif part == "\x1b[2K":
            lines[at] = ""
        elif part and part != "\r" and not MOVES.fullmatch(part):
            lines[at] = part if anew else lines[at] + part
        anew = part == "\r" or (anew and not part)
    return "\n".join(lines)
