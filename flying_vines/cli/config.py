"""`flying-vines config`: writes or checks a configuration. `buttons`: QGroundControl's buttons from it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from flying_vines.cli.common import add_option, fail, file_errors
from flying_vines.config import config as configuration


def add(commands: Any) -> None:
    """Add `config` to the parsers of the command line."""
    config = commands.add_parser("config", help="write or check a configuration file")
    actions = config.add_subparsers(required=True, metavar="ACTION")
    init = actions.add_parser("init", help="write a commented configuration file")
    new = Path("flying-vines.toml")
    init.add_argument(
        "file", type=Path, nargs="?", default=new, metavar="FILE", help=f"the new file ({new}); -: print it"
    )
    init.add_argument("--force", action="store_true", help="overwrite an existing file")
    init.set_defaults(run=_config_init)
    check = actions.add_parser("check", help="show the errors of a configuration file")
    check.add_argument("file", type=Path, metavar="FILE", help="the configuration file")
    add_option(check, "--cause")
    check.set_defaults(run=_config_check)


def _config_init(arguments: argparse.Namespace) -> int:
    path: Path = arguments.file
    if str(path) == "-":
        print(configuration.default_text(), end="")
        return 0
    try:
        with path.open("w" if arguments.force else "x", encoding="utf-8") as file:
            file.write(configuration.default_text())
    except FileExistsError:
        fail(f"{path} exists already; use --force to overwrite it")
    except OSError as error:
        fail(f"{path}: cannot be written: {error.strerror}")
    print(f"Wrote {path}. Check it with: flying-vines config check {path}")
    return 0


def _config_check(arguments: argparse.Namespace) -> int:
    from flying_vines.service.starting import read_inputs

    read = read_inputs(arguments.file, broker_files=True)
    config, known = read.config, read.known
    print(
        f"{arguments.file}: good. RC switch on channel {config.switch.channel}, {len(config.profiles)} "
        f"profiles, {len(config.items)} item rules, up to {config.limits.max_kPa:g} kPa."
    )
    print(f"Vehicle link {config.vehicle.who_can_command}.")
    if known:
        print(f"{known.path}: good. {known.summary[0].upper()}{known.summary[1:]}.")
    for note in read.notes:
        print(note)
    return 0


def add_buttons(commands: Any) -> None:
    """Add `buttons` to the parsers of the command line."""
    buttons = commands.add_parser("buttons", help="write QGroundControl's buttons for the vine")
    add_option(buttons, "--config")
    file = Path("FlyingVines.json")
    add_option(buttons, "--out", default=file, metavar="FILE.json", help=f"the new file ({file})")
    buttons.set_defaults(run=_buttons)


def _buttons(arguments: argparse.Namespace) -> int:
    from missions.buttons import write_buttons

    config = configuration.load_or_default(arguments.config)
    with file_errors(arguments.out):
        write_buttons(config, arguments.out)
    print(f"{arguments.out}: put it in QGroundControl's MavlinkActions; choose it in the Fly View settings")
    return 0
