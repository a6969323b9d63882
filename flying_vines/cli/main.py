"""The `flying-vines` command: the parser of all commands. A command imports its modules when it runs."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Sequence
from typing import NoReturn

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
from flying_vines.cli.common import add_own_causes, fail
from flying_vines.config.config import ConfigError
from flying_vines.config.plugins import PluginError
from flying_vines.files.toml_text import one_line
from flying_vines.simulation.phlosar import FirmwareBuildError

COMMANDS = (
    *(demo, run, replay, buttons, config, paper, simulate, import_, diagnose, design, vine),
    *(doctor, calibrate, mission, log, watch, install, link, fake),
)
"""In the order of the help page."""


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """The `flying-vines` command. Exit status 2 and one line on standard error for bad input."""
    arguments = _parser().parse_args(argv)
    try:
        add_own_causes(getattr(arguments, "causes", ()))
        status = arguments.run(arguments)
    except (ConfigError, PluginError, FirmwareBuildError, watch.WatchError) as error:
        fail(str(error))
    except KeyboardInterrupt:
        status = 130
    except BrokenPipeError:
        # The reader of our output has closed the pipe; Python's flush at exit must not raise again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 0
    sys.exit(status)


class _Version(argparse.Action):
    """Looks up the version only on request, because this takes longer than the rest of the parser."""

    def __call__(self, parser: argparse.ArgumentParser, *what: object) -> NoReturn:
        from importlib.metadata import version

        print(f"flying-vines {version('flying-vines')}")
        parser.exit()


class _Parser(argparse.ArgumentParser):
    """Says in one line what is wrong and what to do. The parsers of the commands are of this class, too."""

    def error(self, message: str) -> NoReturn:
        if wrong := re.fullmatch(r"argument (\S+): invalid (\w+) value: (.*)", message):
            kind = "a whole number" if wrong[2] == "int" else "a number"
            message = f"{wrong[1]} must be {kind}, not {wrong[3]}"
        self.exit(2, f"{self.prog}: {one_line(message)} ({self.prog} --help shows all options)\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="flying-vines", description="A soft robot arm on a drone.")
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and exit")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in COMMANDS:
        command.add(commands)
    return parser
