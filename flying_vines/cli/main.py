"""The `flying-vines` command: its process and the parser of all commands.

This module imports little, so that Ctrl-C finds `main` at work. A command imports its modules when it runs.
"""

from __future__ import annotations

import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence
    from typing import NoReturn

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
            process.ended = True
        _flush_output()
    except KeyboardInterrupt:
        status = INTERRUPTED
    except BaseExceptionGroup as group:
        if not group.subgroup(BrokenPipeError):
            raise
        status = 0
    except BrokenPipeError:
        status = 0
    except OSError as error:
        # A disk that is full, or a folder that may not be read, can stop any command anywhere.
        status = _file_error(error)
    if process:
        process.ended = True
        process.drop_unwritten()
    sys.exit(status)


class _Process:
    """The process of a command. `ended`: the command has ended, and the interpreter ends next."""

    def __init__(self) -> None:
        self.ended = False
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
        sys.stdout = sys.stdout or open(1, "w", encoding="utf-8")  # noqa: SIM115
        sys.stderr = sys.stderr or open(2, "w", encoding="utf-8")  # noqa: SIM115
        for stream in (sys.stdout, sys.stderr):
            stream.reconfigure(errors="replace")  # type: ignore[union-attr]  # mypy: a TextIOWrapper

    def drop_unwritten(self) -> None:
        """The reader of our output may be gone, or its disk full: the interpreter must not try again."""
        for number, stream in ((1, sys.stdout), (2, sys.stderr)):
            try:
                stream.flush()
            except (OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), number)

    def _unraisable(self, lost: sys.UnraisableHookArgs) -> None:
        """Python drops an error in a callback, also Ctrl-C."""
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            self._report(lost)
        elif self.ended:
            os._exit(INTERRUPTED)
        else:
            import _thread

            _thread.interrupt_main()


def _run(argv: Sequence[str] | None) -> int:
    arguments = _parser().parse_args(argv)

    from flying_vines.cli.common import add_own_causes, fail
    from flying_vines.cli.watch import WatchError
    from flying_vines.config.config import ConfigError
    from flying_vines.config.plugins import PluginError
    from flying_vines.simulation.phlosar import FirmwareBuildError

    try:
        add_own_causes(getattr(arguments, "causes", ()))
        status: int = arguments.run(arguments)
    except (ConfigError, PluginError, FirmwareBuildError, WatchError) as error:
        fail(str(error))
    return status


def _flush_output() -> None:
    try:
        sys.stdout.flush()
    except OSError as error:
        error.filename = "standard output"
        raise


def _file_error(error: OSError) -> int:
    from flying_vines.cli.bad_input import bad_input

    where = "" if error.filename is None else f"{os.fsdecode(error.filename)}: "
    return bad_input(f"{where}{error.strerror or error}")


def _parser() -> argparse.ArgumentParser:
    import argparse

    from flying_vines.cli import (
        buttons,
        calibrate,
        config,
        demo,
        design,
        diagnose,
        doctor,
        fake,
        import_,
        install,
        link,
        log,
        mission,
        paper,
        replay,
        run,
        simulate,
        vine,
        watch,
    )

    class Version(argparse.Action):
        """Looks up the version only on request, because this takes longer than the rest of the parser."""

        def __call__(self, parser: argparse.ArgumentParser, *what: object) -> NoReturn:
            from importlib.metadata import version

            print(f"flying-vines {version('flying-vines')}")
            parser.exit()

    parser = argparse.ArgumentParser(prog="flying-vines", description="A soft robot arm on a drone.")
    parser.add_argument("--version", action=Version, nargs=0, help="print the version and exit")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    # In the order of the help page.
    for command in (
        *(demo, run, replay, buttons, config, paper, simulate, import_, diagnose, design, vine),
        *(doctor, calibrate, mission, log, watch, install, link, fake),
    ):
        command.add(commands)
    return parser
