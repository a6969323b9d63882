"""The `flying-vines` command: its process and the parser of all commands.

This module imports little, so that Ctrl-C finds `main` at work. A command imports its modules when it runs.
"""

from __future__ import annotations

import io
import os
import signal
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence
    from typing import Any, NoReturn, TextIO

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells give it."""


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """The `flying-vines` command. Exit status 2 and one line on standard error for bad input.

    Without `argv` it takes over the process: its arguments, standard streams, and errors at its end.
    """
    process = _Process() if argv is None else None
    status: int | str | None
    try:
        try:
            if process:
                process.prepare_streams()
            status = _run(argv)
        except SystemExit as stop:
            status = stop.code
        if process:
            process.end()
    except KeyboardInterrupt:
        status = INTERRUPTED
    except OSError as error:
        # A disk that is full, or a folder that may not be read, can stop any command anywhere.
        status = _file_error(error)
    if process and process.output_error:
        status = process.output_status()
    sys.exit(status)


class _Process:
    """The process of a command. `ended`: the command has ended, and the interpreter ends next."""

    def __init__(self) -> None:
        self.ended = False
        self.output_error: OSError | None = None
        self._report = sys.unraisablehook
        sys.unraisablehook = self._unraisable

    def prepare_streams(self) -> None:
        """Any terminal takes any text; a closed stream is like /dev/null.

        Otherwise the next file that is opened would get the number of the closed stream, and its texts.
        """
        for number in range(3):
            try:
                os.fstat(number)
            except OSError:
                os.open(os.devnull, os.O_RDWR)
        sys.stdin = sys.stdin or open(0, encoding="utf-8")  # noqa: SIM115  # the stream of the process
        sys.stdout = self._stream(1, sys.stdout)
        sys.stderr = self._stream(2, sys.stderr)

    def _stream(self, number: int, given: TextIO | None) -> TextIO:
        file = _Output(number, self)
        return io.TextIOWrapper(
            io.BufferedWriter(file),
            encoding=given.encoding if given else "utf-8",
            errors="replace",
            line_buffering=number == 2 or file.isatty(),
        )

    def end(self) -> None:
        """Write the rest of the output. Ctrl-C changes nothing any more, unless a thread still works."""
        self.ended = True
        sys.stdout.flush()
        if len(sys._current_frames()) == 1:
            signal.signal(signal.SIGINT, signal.SIG_IGN)

    def output_status(self) -> int:
        """The exit status of a command whose output could not be written. 0 if its reader is gone."""
        if isinstance(self.output_error, BrokenPipeError):
            return 0
        assert self.output_error is not None
        self.output_error.filename = "standard output"
        return _file_error(self.output_error)

    def _unraisable(self, lost: sys.UnraisableHookArgs) -> None:
        """Python drops an error in a callback, also Ctrl-C."""
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            self._report(lost)
        elif self.ended:
            os._exit(INTERRUPTED)
        else:
            import _thread

            # An error in this hook is lost, too, so Ctrl-C comes again from outside.
            _thread.start_new_thread(signal.pthread_kill, (_thread.get_ident(), signal.SIGINT))


class _Output(io.FileIO):
    """An output whose reader may be gone, or its disk full.

    For standard output, the command then ends as after Ctrl-C: in order, and nothing raises in a callback.
    """

    def __init__(self, number: int, process: _Process) -> None:
        super().__init__(number, "w", closefd=False)
        self._process = process

    def write(self, data: Any) -> int | None:  # type: ignore[override]  # mypy: any buffer
        try:
            return super().write(data)
        except OSError as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())
            # Without the stream of errors a flight goes on.
            if self.fileno() == 1 and self._process.output_error is None:
                self._process.output_error = error
                if not self._process.ended:
                    signal.raise_signal(signal.SIGINT)
            return len(data)


def _run(argv: Sequence[str] | None) -> int:
    arguments = _parser().parse_args(argv)

    from flying_vines.cli.common import add_own_causes, fail
    from flying_vines.cli.run import WatchError
    from flying_vines.config.config import ConfigError
    from flying_vines.config.plugins import PluginError
    from flying_vines.simulation.phlosar import FirmwareBuildError

    try:
        add_own_causes(getattr(arguments, "cause", ()))
        status: int = arguments.run(arguments)
    except (ConfigError, PluginError, FirmwareBuildError, WatchError) as error:
        fail(str(error))
    return status


def _file_error(error: OSError) -> int:
    from flying_vines.cli.common import bad_input

    where = "" if error.filename is None else f"{os.fsdecode(error.filename)}: "
    return bad_input(f"{where}{error.strerror or error}")


def _parser() -> argparse.ArgumentParser:
    import argparse
    import re

    from flying_vines.cli import (
        calibrate,
        config,
        diagnose,
        doctor,
        fake,
        import_,
        install,
        lab,
        link,
        log,
        mission,
        replay,
        run,
    )
    from flying_vines.files.toml_text import one_line

    class Parser(argparse.ArgumentParser):
        """Says in one line what is wrong and what to do; so do the parsers of the commands."""

        def error(self, message: str) -> NoReturn:
            if wrong := re.fullmatch(r"argument (\S+): invalid (\w+) value: (.*)", message):
                kind = "a whole number" if wrong[2] == "int" else "a number"
                message = f"{wrong[1]} must be {kind}, not {wrong[3]}"
            self.exit(2, f"{self.prog}: {one_line(message)} ({self.prog} --help shows all options)\n")

    class Version(argparse.Action):
        """Looks up the version only on request, because this takes longer than the rest of the parser."""

        def __call__(self, parser: argparse.ArgumentParser, *what: object) -> NoReturn:
            from importlib.metadata import version

            print(f"flying-vines {version('flying-vines')}")
            parser.exit()

    parser = Parser(prog="flying-vines", description="A soft robot arm on a drone.")
    parser.add_argument("--version", action=Version, nargs=0, help="print the version and exit")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    # In the order of the help page.
    for add in (
        *(run.add_demo, run.add, replay.add, config.add_buttons, config.add, lab.add_paper, lab.add_simulate),
        *(import_.add, diagnose.add, lab.add_design, lab.add_vine, doctor.add, calibrate.add, mission.add),
        *(log.add, run.add_watch, install.add, link.add, fake.add),
    ):
        add(commands)
    return parser
