"""`flying-vines buttons`: QGroundControl's buttons for the vine."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from flying_vines.cli.common import file_errors
from flying_vines.config import config as configuration


def add(commands: Any) -> None:
    """Add `buttons` to the parsers of the command line."""
    buttons = commands.add_parser("buttons", help="write QGroundControl's buttons for the vine")
    buttons.add_argument(
        "--config", type=Path, metavar="FILE", help="the configuration (default: the built-in one)"
    )
    file = Path("FlyingVines.json")
    buttons.add_argument("--out", type=Path, default=file, metavar="FILE.json", help=f"the new file ({file})")
    buttons.set_defaults(run=_buttons)


def _buttons(arguments: argparse.Namespace) -> int:
    from missions.buttons import write_buttons

    config = configuration.load_or_default(arguments.config)
    with file_errors(arguments.out):
        write_buttons(config, arguments.out)
    print(f"{arguments.out}: put it in QGroundControl's MavlinkActions; choose it in the Fly View settings")
    return 0
