"""Functions that several commands share."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from flying_vines.config import config as configuration
from flying_vines.config.config import Config
from flying_vines.files.extras import lacks
from flying_vines.vehicle.mission.item import MissionItem

if TYPE_CHECKING:
    from rich.console import Console

    from flying_vines.supply.rig_file_prior import RigFilePrior

BAD_INPUT = 2
FLIGHTS = Path("flights")

_OPTIONS: dict[str, dict[str, Any]] = {
    "--config": {"type": Path, "metavar": "FILE", "help": "the configuration (default: the built-in one)"},
    "--rig": {"type": Path, "metavar": "RIG.toml", "help": "the rig (default: the configuration's)"},
    "--cause": {
        "type": Path,
        "action": "append",
        "default": [],
        "metavar": "FILE.py",
        "help": "a file with your own causes; may be repeated",
    },
    "--mission": {"type": Path, "metavar": "FILE.waypoints"},
    "--reservoir-kPa": {"type": float, "metavar": "P"},
    "--seconds": {"type": float, "metavar": "N"},
    "--out": {"type": Path, "metavar": "DIR"},
    "--plain": {"action": "store_true", "help": "print lines instead of the live view"},
    "--yes": {"action": "store_true"},
    "--json": {"action": "store_true", "help": "print one JSON object instead"},
}
"""Options of several commands."""
FLIGHT_LOGS: dict[str, Any] = {"default": FLIGHTS, "help": f"the folder for flight logs ({FLIGHTS})"}
"""For `--out`."""


def add_option(parser: argparse.ArgumentParser, *names: str, **own: Any) -> None:
    """Add an option that several commands have. `own`: what is different in this command."""
    parser.add_argument(*names, **{**_OPTIONS[names[-1]], **own})


def bad_input(sentences: str) -> int:
    """Print each sentence as a line on standard error; returns the exit status."""
    sys.stdout.flush()
    for sentence in sentences.splitlines():
        print(f"flying-vines: {sentence}", file=sys.stderr)
    return BAD_INPUT


def fail(sentences: str) -> NoReturn:
    sys.exit(bad_input(sentences))


def add_own_causes(paths: Sequence[Path]) -> None:
    """Add the causes of these files to the catalogue."""
    if paths:
        from flying_vines.physics.cause import CauseError, read_causes
        from flying_vines.physics.effects import add_causes

        with file_errors(None, CauseError):
            for path in paths:
                add_causes(read_causes(path))


def phlosar_only(config: Config, command: str) -> None:
    """Fails if the configured actuator is not a phloSAR: such a device must get no bytes from us."""
    if not config.firmware.is_phlosar:
        fail(f"{command} needs a phloSAR; firmware.kind is '{config.firmware.kind}'")


@contextmanager
def needs_analysis() -> Iterator[None]:
    """Turn an import error of the block into one line that names the package to install."""
    try:
        yield
    except ModuleNotFoundError as error:
        fail(lacks(error))
    except ImportError as error:
        fail(str(error))


@contextmanager
def file_errors(where: Path | None, *kinds: type[Exception]) -> Iterator[None]:
    """Turn file errors and errors of `kinds` into one line. `where`: the file, if the error names none."""
    try:
        yield
    except kinds as error:
        fail(str(error))
    except OSError as error:
        fail(f"{error.filename or where}: {error.strerror}")


@contextmanager
def progress_bar() -> Iterator[Callable[[str, float], None]]:
    """A progress bar on the terminal. Call it with the current step and the fraction that is done, 0…1."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = BarColumn(), TimeElapsedColumn(), TextColumn("{task.description}")
    console = Console(markup=False, stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("reading", total=1.0)
        yield lambda step, share: bar.update(task, description=step, completed=share)


def show_found(
    as_json: bool,
    found: Callable[[], dict[str, Any]],
    show: Callable[[Console], None],
    figures: Sequence[Path],
) -> int:
    """Print the results as one JSON object or for people, and the paths of the figures."""
    if as_json:
        print(json.dumps({**found(), "figures": [str(path) for path in figures]}, allow_nan=False))
        return 0
    from rich.console import Console

    console = Console(markup=False)
    show(console)
    for path in figures:
        console.print(f"Figure   {path}", highlight=False, soft_wrap=True)
    return 0


def rig_file_prior(config: Config, config_file: Path | None, rig: Path | None = None) -> RigFilePrior | None:
    """The given rig file, or the one that the configuration names; None if there is none."""
    rig = rig or configuration.rig_named(config, config_file)
    if rig is None:
        return None
    from flying_vines.physics.rig import RigError
    from flying_vines.supply.rig_file_prior import load_rig_file_prior

    with file_errors(rig, RigError):
        return load_rig_file_prior(rig, config.pneumatics)


def read_mission(path: Path | None) -> Sequence[MissionItem]:
    if path is None:
        return ()
    from missions.waypoints import WaypointsError, read_waypoints

    with file_errors(path, WaypointsError):
        return read_waypoints(path)
