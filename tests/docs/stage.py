"""A scratch folder in which the commands of one page run in order, with the programs that they need.

Each command of ours is a process of its own, forked from a process that has already imported the program. A
command that does not end by itself is started, checked and interrupted. If a command needs a vehicle, a
phloSAR or a service, the stage starts one.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import re
import runpy
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from io import TextIOWrapper
from multiprocessing.process import BaseProcess
from pathlib import Path
from time import monotonic, sleep
from typing import Any, NoReturn, TypeVar

from ports import free_port
from waiting import MAX_WAIT_S

from docs.documented_commands import ROOT
from flying_vines.cli.main import main

T = TypeVar("T")


LASTING = {
    "run": r"phloSAR ready",
    "demo": r"phloSAR ready",
    "fake phlosar": r"\w",
    "fake autopilot": r"Ctrl-C ends it",
    "link": r"Welcome",
    "watch": r"\w",
    "mission watch": r"\w",
}
"""Commands that run until they are interrupted, with the text that they print when they are ready."""
ENDS = ("--seconds", "--settings", "--set")
"""With these options the commands of `LASTING` end by themselves."""
NEEDS = {
    "run": ("phlosar", "autopilot"),
    "link": ("phlosar",),
    "watch": ("phlosar", "autopilot", "service"),
    "mission upload": ("autopilot", "for a ground station"),
    "mission watch": ("autopilot", "for a ground station"),
    "mission download": ("autopilot", "for a ground station"),
}
"""The programs that a command needs while it runs."""
AROUND = {
    "phlosar": "fake phlosar --link phlosar",
    "autopilot": "fake autopilot --to 127.0.0.1:14540",
    "ardupilot": "fake autopilot --to 127.0.0.1:14541 --gcs 127.0.0.1:14550",
    "px4": "fake autopilot --kind px4 --to 127.0.0.1:14541 --gcs 127.0.0.1:14550",
    "service": "run --config around.toml",
}
BY_DEFAULT = {
    "watch": "--url http://127.0.0.1:8017",
    "fake autopilot": "--to 127.0.0.1:14540",
    "mission upload": "--link udpin:0.0.0.0:14550",
    "mission watch": "--link udpin:0.0.0.0:14550",
    "mission download": "--link udpin:0.0.0.0:14550",
    "link": "--config around.toml",
}
"""Options for the addresses of this stage, if the page gives none."""
FIXED = re.compile(r"\b(14540|14541|14550|8017)\b")
"""Ports that may be used by other tests at the same time."""
WRITES = ("--out", "--write-rig", "-o", ">", "init", "download")
"""The next word is a file that is written, and need not exist."""

FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(
    [
        "flying_vines.service.service",
        "flying_vines.simulation.demo",
        "flying_vines.terminal.screen",
        "flying_vines.simulation.autopilot_server",
        "flying_vines.identification.report",
        "flying_vines.simulation.scenario.picture",
        "flying_vines.record.picture",
        "flying_vines.terminal.remote_view",
        "missions.report",
        "matplotlib.backends.backend_agg",
        "rich.progress",
    ]
)


class Ended(AssertionError):
    """A command that did not do what the page says."""


class Stage:
    """A page's folder, with a vehicle of this kind for a ground station's commands.

    Leaving the context interrupts the programs that the stage has started, and checks that they end without
    an error.
    """

    def __init__(
        self, folder: Path, maker_of: Callable[[str], Callable[[Path], object] | None], kind: str
    ) -> None:
        self.folder = folder
        self._at = folder
        self._kind = kind
        self._maker_of = maker_of
        self._around = ExitStack()
        self._there: set[str] = set()
        self._ports: dict[str, str] = {}
        for name in ("missions", "tests"):
            (folder / name).symlink_to(ROOT / name)
        self._fetch(["flights", "around.toml"])

    def __enter__(self) -> Stage:
        return self

    def __exit__(self, *error: object) -> None:
        self._around.close()

    def run(self, words: Sequence[str], status: int = 0) -> None:
        """Run a command of ours to its end, or until it is ready and interrupted. Raises `Ended` for another
        status."""
        self._have_around(_named(words, NEEDS) or ())
        if (option := _named(words, BY_DEFAULT)) and option.split()[0] not in words:
            words = [*words, *option.split()]
        self._fetch(words)
        up = _named(words, LASTING)
        with Running(self._at, self._here(words)) as running:
            if up and not any(option in words for option in ENDS):
                running.wait_for(up)
                running.interrupt()
            running.end(status)
        if words[:2] == ["config", "init"]:
            given = [word for word in words[2:] if not word.startswith("-")]
            self._turn_here(self._at / (given or ["flying-vines.toml"])[0])

    def shell(self, line: str, seconds: float = 4.0) -> None:
        """Run a line that needs a shell. Endless commands are interrupted, missing programs skipped."""
        first, _, then = line.partition(" | ")
        line = line if not then or shutil.which(then.split()[0]) else first
        words = line.split(" ")
        self._have_around(_named(words[1:], NEEDS) or () if words[0] == "flying-vines" else ())
        self._fetch(words)
        path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        command = ("timeout", "-s", "INT", f"{seconds:g}", "bash", "-o", "pipefail", "-c")
        line = f"{self.here(line)} && pwd >{self.folder}/.at"
        environment = os.environ | surroundings(self.folder) | {"PATH": path}
        done = subprocess.run((*command, line), cwd=self._at, env=environment, capture_output=True, text=True)
        if done.returncode not in (0, 124):
            raise Ended(f"ended with {done.returncode}: {done.stderr or done.stdout}")
        if done.returncode == 0:
            self._at = Path((self.folder / ".at").read_text(encoding="utf-8").strip())
            self._fetch(["flights"])

    def parse_only(self, script: Sequence[str]) -> None:
        """Run a script of the project until its parser has read its arguments."""
        with Running(self._at, script, parse_only) as running:
            running.end(0)

    def here(self, text: str) -> str:
        """The text with the addresses of this stage."""
        text = re.sub(r"usb:16c0:0483|serial:/dev/ttyACM0", f"serial:{self.folder}/phlosar", text)
        text = re.sub(r"(?<!\S)/tmp/phlosar", "another-phlosar", text)
        text = text.replace("tcp:127.0.0.1:5760", "udpin:0.0.0.0:14550")
        text = re.sub(r"http://[\w.]+:8017", "http://127.0.0.1:8017", text)
        return FIXED.sub(lambda port: self._ports.setdefault(port[0], str(free_port())), text)

    def _turn_here(self, config_file: Path) -> None:
        """Change a file as the pages say: the addresses of the stand-ins, and bends on the ground."""
        text = config_file.read_text(encoding="utf-8").replace("bench_mode = false", "bench_mode = true")
        config_file.write_text(self.here(text), encoding="utf-8")

    def _here(self, words: Sequence[str]) -> list[str]:
        return [self.here(word) for word in words]

    def _have_around(self, names: Sequence[str]) -> None:
        for name in names:
            if name in self._there:
                continue
            words = AROUND.get(name, AROUND[self._kind]).split()
            running = self._around.enter_context(Running(self.folder, self._here(words)))
            self._there.add(name)
            running.wait_for(_named(words, LASTING) or "")

            def end(running: Running = running) -> None:
                running.interrupt()
                running.end(0)

            self._around.callback(end)

    def _fetch(self, words: Sequence[str]) -> None:
        """Create the files that a command reads and that do not exist yet."""
        for before, word in zip(("", *words), words, strict=False):
            path = self._at / word
            if before in WRITES or path.exists() or (make := self._maker_of(word)) is None:
                continue
            path.parent.mkdir(parents=True, exist_ok=True)
            make(path)
            if path.suffix == ".toml" and "[vehicle]" in path.read_text(encoding="utf-8"):
                self._turn_here(path)


class Running:
    """A command of ours as a process. Leaving the context ends everything that it has started."""

    def __init__(self, folder: Path, words: Sequence[str], run: Callable[[list[str]], None] = main) -> None:
        self._output = folder / f".output-{len(list(folder.glob('.output-*')))}"
        self._output.touch()
        self._process: BaseProcess = FORKS.Process(
            target=_become, args=(folder, self._output, list(words), run)
        )
        self._process.start()

    def __enter__(self) -> Running:
        return self

    def __exit__(self, *error: object) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self._pid, signal.SIGKILL)
        self._process.join(MAX_WAIT_S)

    @property
    def _pid(self) -> int:
        assert self._process.pid is not None
        return self._process.pid

    @property
    def output(self) -> str:
        return self._output.read_text(encoding="utf-8", errors="replace")

    def wait_for(self, pattern: str) -> None:
        """Wait until the command has printed this."""
        deadline = monotonic() + MAX_WAIT_S
        while not re.search(pattern, self.output):
            if not self._process.is_alive() or monotonic() > deadline:
                raise Ended(f"was never up: {self.output}")
            sleep(0.02)

    def interrupt(self) -> None:
        """Interrupt the terminal's foreground processes, as Ctrl-C does."""
        with suppress(ProcessLookupError):
            os.killpg(self._pid, signal.SIGINT)

    def end(self, status: int) -> None:
        """Wait for the end of the command; status 130 means Ctrl-C."""
        self._process.join(MAX_WAIT_S)
        if self._process.exitcode not in (status, 130 if status == 0 else status):
            raise Ended(f"ended with {self._process.exitcode} instead of {status}: {self.output}")
        if "Traceback" in self.output:
            raise Ended(self.output)


def parse_only(script: list[str]) -> None:
    """Run a script until its parser has read the arguments, and end then."""
    parse = argparse.ArgumentParser.parse_args

    def parse_and_end(*given: Any, **named: Any) -> NoReturn:
        parse(*given, **named)
        sys.exit()

    argparse.ArgumentParser.parse_args = parse_and_end  # type: ignore[method-assign]
    sys.argv = script
    # A new interpreter does not know the folder of the tests.
    tests = str(ROOT / "tests")
    sys.path[:] = [str(ROOT / "benchmarks"), *(place for place in sys.path if place != tests)]
    for name, module in list(sys.modules.items()):
        if (getattr(module, "__file__", None) or "").startswith(tests):
            del sys.modules[name]
    runpy.run_path(str(ROOT / script[0]), run_name="__main__")


def _become(folder: Path, said: Path, words: list[str], run: Callable[[list[str]], None]) -> None:
    """Run the command in this new process, in the folder, with stored output."""
    os.setsid()
    os.chdir(folder)
    os.environ.update(surroundings(folder))
    with said.open("w") as kept, Path(os.devnull).open() as nothing:
        for number, file in ((0, nothing), (1, kept), (2, kept)):
            os.dup2(file.fileno(), number)
    for stream in (sys.stdout, sys.stderr):
        assert isinstance(stream, TextIOWrapper)
        stream.reconfigure(encoding="utf-8", line_buffering=True)
    run(words)


def surroundings(folder: Path) -> dict[str, str]:
    """The environment: an empty home, but the machine's cache of compiled code."""
    cache = os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache"))
    return {"HOME": str(folder), "XDG_CACHE_HOME": cache, "COLUMNS": "120"}


def _named(words: Sequence[str], table: Mapping[str, T]) -> T | None:
    """The value of a table for the first words of a command."""
    found = (table.get(" ".join(words[:n])) for n in (2, 1))
    return next((value for value in found if value is not None), None)
