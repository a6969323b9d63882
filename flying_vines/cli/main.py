"""The `flying-vines` command: the parser of all commands. A command imports its modules when it runs."""

from __future__ import annotations

import argparse
import os
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


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="flying-vines", description="A soft robot arm on a drone.")
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and exit")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in COMMANDS:
        command.add(commands)
    return parser
