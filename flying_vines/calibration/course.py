"""The course of a calibration: what is looked at before, what is carried out, and on which rig.

On a rig that is there nothing moves before a person has said so; whatever ends it, the vine is vented and the
firmware's telemetry is as it was.
"""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from flying_vines.calibration import session, simulated
from flying_vines.calibration.conclude import UserProfile
from flying_vines.calibration.conductor import Conducted
from flying_vines.calibration.known import KnownBeforehand, with_kept
from flying_vines.calibration.plan import CalibrationPlan, CalibrationRequest, plan
from flying_vines.calibration.procedure import Walk
from flying_vines.calibration.profile import proposed
from flying_vines.calibration.telemetry_rate import EVERY_STEP_HZ, RATE, every_step
from flying_vines.config.address import parse_address
from flying_vines.config.config import Config, PneumaticsConfig
from flying_vines.physics.plant.true_rig import load_true_rig
from flying_vines.service.link_settings import talk_about_settings
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar

READY = (
    "The vine will bend: props off, nobody near it, nothing in its way, the bottle full.\n"
    "Enter begins; Ctrl-C ends it at any time, and vents."
)


class CalibrateError(Exception):
    """What is wanted cannot be; the text is a sentence."""


@dataclass(frozen=True)
class Carried:
    """What came of it."""

    conducted: Conducted
    believed: PneumaticsConfig
    """Of the rig file, where the profile names one."""
    interrupted: bool
    firmware: Mapping[str, float]
    """What it had better be set to."""
    is_set: bool
    """And is."""

    @property
    def done(self) -> bool:
        return self.conducted.ended.outcome == "done"


async def on_a_rig(
    profile: UserProfile, wish: CalibrationRequest, out: Path, walk: Walk, set_firmware: bool
) -> Carried | None:
    """On the profile's ports; None where nobody wanted it to begin.

    Raises `CalibrateError`, `SettingsError` where the board does not answer, those of `with_kept`, `OSError`.
    """
    assert profile.path is not None
    believed, known = with_kept(profile.path, profile.config)
    _plan(believed, wish)
    address = parse_address(profile.config.firmware.link)
    stopped = asyncio.Event()
    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        asyncio.get_running_loop().add_signal_handler(name, stopped.set)
    with walk.typed():
        async with every_step(address, stopped, walk.warn) as settings:
            rate_Hz = round(next(setting.value for setting in settings if setting.name == RATE))
            planned = _plan(believed, replace(wish, telemetry_Hz=rate_Hz))
            walk.introduce(planned)
            if not await walk.confirmed(READY, stopped):
                return None
            with walk.under_way():
                conducted = await session.calibrate(planned, known, out, walk, stopped)
        wanted = proposed(conducted.findings.proposals, settings)
        to_set = set_firmware and bool(wanted) and conducted.ended.outcome == "done"
        if to_set:
            await talk_about_settings(address, wanted, stopped)
    return Carried(conducted, believed.pneumatics, stopped.is_set(), wanted, to_set)


def on_a_fake(
    profile: UserProfile, wish: CalibrationRequest, out: Path, walk: Walk, rig: Path | None
) -> Carried:
    """On a simulated rig: that of a file, or a likely one. Raises `CalibrateError`, `RigError`, `OSError`."""
    if wish.vessel_L is not None:
        raise CalibrateError("--vessel-L takes hands that change a hose: it is not for --fake")
    believed, known = (
        with_kept(profile.path, profile.config) if profile.path else (profile.config, KnownBeforehand())
    )
    planned = _plan(believed, wish)
    phlosar = SimulatedPhlosar(
        load_true_rig(rig) if rig else None,
        {"telemetry_Hz": EVERY_STEP_HZ},
        reservoir_kPa=0.0 if wish.bottle_empty else believed.pneumatics.full_kPa,
    )
    walk.introduce(planned)
    with _interruptions() as interrupted, walk.under_way():
        conducted = simulated.calibrate(planned, known, phlosar, out, walk, interrupted)
        return Carried(conducted, believed.pneumatics, interrupted(), {}, False)


def _plan(config: Config, wish: CalibrationRequest) -> CalibrationPlan:
    try:
        return plan(config, wish)
    except ValueError as error:
        raise CalibrateError(str(error)) from None


@contextmanager
def _interruptions() -> Iterator[Callable[[], bool]]:
    """Within it Ctrl-C only says so: what is under way ends in order."""
    seen: list[int] = []
    before = {
        name: signal.signal(name, lambda number, frame: seen.append(number))
        for name in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield lambda: bool(seen)
    finally:
        for name, handler in before.items():
            signal.signal(name, handler)
