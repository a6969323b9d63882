"""`flying-vines calibrate`: what it is given, and with which status it ends."""

from __future__ import annotations

import argparse
import asyncio
import sys
from pathlib import Path
from typing import Any

from flying_vines.cli.bad_input import bad_input
from flying_vines.cli.common import FLIGHTS, file_errors, needs_analysis
from flying_vines.config import config as configuration

NOT_DONE = 1
INTERRUPTED = 130
LIKELY = Path()
"""What stands for a likely vine, where a rig file may."""


def add(commands: Any) -> None:
    """Add `calibrate` to the parsers of the command line."""
    parser = commands.add_parser("calibrate", help="measure a rig's volumes, valves, leaks and bend curve")
    parser.add_argument("--config", type=Path, metavar="FILE", help="the profile of the rig")
    parser.add_argument(
        "--fake",
        type=Path,
        nargs="?",
        const=LIKELY,
        metavar="RIG.toml",
        help="a simulated rig instead, in simulated time (default: a likely vine)",
    )
    parser.add_argument(
        "--out", type=Path, default=FLIGHTS, metavar="DIR", help=f"where the log goes ({FLIGHTS})"
    )
    parser.add_argument("--only", type=_names, default=(), metavar="STAGE,…", help="these stages alone")
    parser.add_argument("--yes", action="store_true", help="ask nothing: no angles are typed, either")
    parser.add_argument(
        "--bottle-empty", action="store_true", help="it is empty and open: its sensor's zero first"
    )
    parser.add_argument(
        "--bottle-volume-L", type=float, dest="bottle_volume_L", metavar="L", help="as weighed with water"
    )
    parser.add_argument(
        "--vessel-L",
        type=float,
        dest="vessel_L",
        metavar="L",
        help="a rigid vessel that is first put in the vine's place: it measures the bottle",
    )
    parser.add_argument(
        "--angles", type=Path, metavar="PAIRS.csv", help="measured before, as `vine fit` reads them"
    )
    parser.add_argument(
        "--set-firmware", action="store_true", help="keep in the firmware what is proposed for it"
    )
    parser.add_argument("--in-place", action="store_true", help="change the profile itself, too")
    parser.add_argument("--no-diagnosis", action="store_true", help="do not look for hidden causes")
    parser.set_defaults(run=run)


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def run(arguments: argparse.Namespace) -> int:
    """0 where all was measured, 1 where it ended before; `ConfigError` where the profile cannot be read."""
    with needs_analysis():
        from flying_vines.calibration.course import CalibrateError
        from flying_vines.physics.rig import RigError
        from flying_vines.service.link_settings import SettingsError, SettingsInterruptedError
        from flying_vines.vehicle.component.parameter_file import ParameterFileError
        from flying_vines.vehicle.mavlink.signing_key import SigningKeyError

        try:
            with file_errors(arguments.out, CalibrateError, RigError, ParameterFileError, SigningKeyError):
                return _run(arguments)
        except SettingsInterruptedError:
            return INTERRUPTED
        except SettingsError as error:
            return bad_input(f"phloSAR: {error}")


def _run(arguments: argparse.Namespace) -> int:
    from rich.console import Console

    from flying_vines.calibration.conclude import UserProfile, conclude
    from flying_vines.calibration.course import CalibrateError, on_a_fake, on_a_rig
    from flying_vines.calibration.plan import CalibrationRequest
    from flying_vines.calibration.procedure import Walk

    path: Path | None = arguments.config
    fake = arguments.fake is not None
    if path is None and (arguments.in_place or not fake):
        needs = "--in-place changes a profile: " if fake else "for a simulated rig --fake, for yours "
        raise CalibrateError(f"{needs}give --config FILE")
    if fake and arguments.set_firmware:
        raise CalibrateError("--set-firmware is for a board that is there, not for --fake")
    text = configuration.text_of(path) if path else configuration.default_text()
    profile = UserProfile(text, path, configuration.parse(text, str(path or "the built-in profile")))
    asked = not (fake or arguments.yes)
    if asked and not sys.stdin.isatty():
        raise CalibrateError("nobody is at the terminal to say that the vine may bend: give --yes")
    wish = CalibrationRequest(
        only=arguments.only,
        bottle_empty=arguments.bottle_empty,
        bottle_volume_L=arguments.bottle_volume_L,
        vessel_L=arguments.vessel_L,
        angles=_pairs(arguments.angles) if arguments.angles else None,
        eye=asked or fake,
    )
    walk = Walk(Console(highlight=False), asked)
    if fake:
        rig = None if arguments.fake == LIKELY else arguments.fake
        carried = on_a_fake(profile, wish, arguments.out, walk, rig)
    else:
        going = on_a_rig(profile, wish, arguments.out, walk, arguments.set_firmware)
        begun = asyncio.run(going)
        if begun is None:
            return INTERRUPTED
        carried = begun
    diagnose = not (arguments.no_diagnosis or carried.interrupted)
    in_place = arguments.in_place and carried.done
    conclude(carried.conducted, profile, carried.believed, walk, diagnose, in_place)
    walk.firmware(carried.firmware, profile.config.firmware.link, carried.is_set)
    if carried.interrupted:
        return INTERRUPTED
    return 0 if carried.done else NOT_DONE


def _pairs(path: Path) -> Any:
    from flying_vines.calibration.course import CalibrateError
    from flying_vines.identification.bend_curve import PairsError, load_pairs

    try:
        return load_pairs(path)
    except PairsError as error:
        raise CalibrateError(str(error)) from None
