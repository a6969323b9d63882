"""`flying-vines calibrate`: options and exit status."""

from __future__ import annotations

import argparse
import asyncio
import sys
from pathlib import Path
from typing import Any

from flying_vines.cli.common import FLIGHTS, add_option, bad_input, file_errors, needs_analysis, phlosar_only
from flying_vines.config import config as configuration

NOT_DONE = 1
INTERRUPTED = 130
LIKELY = Path()
"""Value of `--fake` without a file: a likely vine."""


def add(commands: Any) -> None:
    """Add `calibrate` to the parsers of the command line."""
    parser = commands.add_parser("calibrate", help="measure a rig's volumes, valves, leaks and bend curve")
    add_option(parser, "--config", help="the configuration of the rig")
    parser.add_argument(
        "--fake",
        type=Path,
        nargs="?",
        const=LIKELY,
        metavar="RIG.toml",
        help="a simulated rig instead, in simulated time (default: a likely vine)",
    )
    add_option(parser, "--cause")
    add_option(parser, "--out", default=FLIGHTS, help=f"folder for the log ({FLIGHTS})")
    parser.add_argument("--only", type=_names, default=(), metavar="STAGE,…", help="only these stages")
    add_option(parser, "--yes", help="ask nothing; then no angles are measured")
    parser.add_argument(
        "--reservoir-empty",
        action="store_true",
        help="the reservoir is empty and open: first measure its sensor's zero",
    )
    parser.add_argument(
        "--reservoir-volume-L", type=float, metavar="L", help="volume of the reservoir, as weighed with water"
    )
    parser.add_argument(
        "--vessel-L",
        type=float,
        metavar="L",
        help="volume of a rigid vessel that first takes the vine's place, to measure the reservoir",
    )
    parser.add_argument(
        "--angles", type=Path, metavar="PAIRS.csv", help="angles measured before, in the format of `vine fit`"
    )
    parser.add_argument(
        "--set-firmware", action="store_true", help="save the proposed settings in the firmware"
    )
    parser.add_argument("--in-place", action="store_true", help="also change the configuration file itself")
    parser.add_argument("--no-diagnosis", action="store_true", help="do not look for hidden causes")
    parser.set_defaults(run=run)


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def run(arguments: argparse.Namespace) -> int:
    """0: everything was measured; 1: the calibration ended early; 130: it was interrupted.

    Raises `ConfigError` if the configuration cannot be read.
    """
    with needs_analysis():
        from flying_vines.calibration.rig import CalibrateError
        from flying_vines.physics.rig import RigError
        from flying_vines.service.link_settings import SettingsError, SettingsInterruptedError

        try:
            with file_errors(arguments.out, CalibrateError, RigError):
                return _run(arguments)
        except SettingsInterruptedError:
            return INTERRUPTED
        except SettingsError as error:
            return bad_input(f"phloSAR: {error}")


def _run(arguments: argparse.Namespace) -> int:
    from rich.console import Console

    from flying_vines.calibration.plan import CalibrationRequest
    from flying_vines.calibration.results import write_results
    from flying_vines.calibration.rig import (
        CalibrateError,
        CalibrationRun,
        UserConfiguration,
        calibrate_real,
        calibrate_simulated,
    )
    from flying_vines.calibration.terminal import CalibrationTerminal

    path: Path | None = arguments.config
    fake = arguments.fake is not None
    if path is None and (arguments.in_place or not fake):
        needs = (
            "--in-place changes the configuration file: "
            if fake
            else "give --fake for a simulated rig; for yours "
        )
        raise CalibrateError(f"{needs}give --config FILE")
    if fake and arguments.set_firmware:
        raise CalibrateError("--set-firmware needs a real board; it does not work with --fake")
    text = configuration.text_of(path) if path else configuration.default_text()
    user = UserConfiguration(text, path, configuration.parse(text, str(path or "the built-in configuration")))
    interactive = not (fake or arguments.yes)
    if interactive and not sys.stdin.isatty():
        raise CalibrateError("no terminal to ask whether the vine may bend: give --yes")
    request = CalibrationRequest(
        only=arguments.only,
        reservoir_empty=arguments.reservoir_empty,
        reservoir_volume_L=arguments.reservoir_volume_L,
        vessel_L=arguments.vessel_L,
        angles=_pairs(arguments.angles) if arguments.angles else None,
        asks_angles=interactive or fake,
    )
    terminal = CalibrationTerminal(Console(markup=False, highlight=False), interactive)
    if fake:
        rig = None if arguments.fake == LIKELY else arguments.fake
        done: CalibrationRun | None = asyncio.run(
            calibrate_simulated(user, request, arguments.out, terminal, rig)
        )
    else:
        phlosar_only(user.config, "calibrate")
        done = asyncio.run(calibrate_real(user, request, arguments.out, terminal, arguments.set_firmware))
    if done is None:
        return INTERRUPTED
    diagnose = not (arguments.no_diagnosis or done.interrupted)
    write_results(done, user, terminal, diagnose, arguments.in_place and done.done)
    terminal.firmware(done.firmware, user.config.firmware.link, done.is_set)
    if done.interrupted:
        return INTERRUPTED
    return 0 if done.done else NOT_DONE


def _pairs(path: Path) -> Any:
    from flying_vines.calibration.rig import CalibrateError
    from flying_vines.identification.bend_curve import PairsError, load_pairs

    try:
        return load_pairs(path)
    except PairsError as error:
        raise CalibrateError(str(error)) from None
