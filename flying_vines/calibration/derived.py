"""The profile that a calibration moves the vine with: the user's, and what only the calibration needs."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec.structs import replace

from flying_vines.config.config import Config
from flying_vines.vine.profile import PressureProfile

VOLUME_FACTOR = 4.0
"""By how much the vine may be larger or smaller than believed: it is about to be measured."""
MOST_FACTOR = 10.0
LONGER_S = 30.0
"""Than the longest movement, before the vine is straightened."""


def derived(
    config: Config, profiles: Mapping[str, PressureProfile], longest_s: float, vessel_L: float = 0.0
) -> Config:
    """The user's profile with these movements.

    Limits of pressure and rate, losses and interlocks are the user's. Of the physics checks those that rest
    on the vine's volume take it to be up to `VOLUME_FACTOR` times as large or small; `vine_leak` tells what
    is about to be measured, and so only warns. All others stay as they are: a sensor that is stuck, a burst,
    or a bottle that empties vents the vine as in flight.
    """
    checks = config.checks
    cv_L = config.pneumatics.cv_volume_L
    factor = max(checks.volume_factor, VOLUME_FACTOR, 2.0 * vessel_L / cv_L)
    return replace(
        config,
        profiles={**config.profiles, **profiles},
        limits=replace(config.limits, max_bent_s=max(config.limits.max_bent_s, longest_s + LONGER_S)),
        checks=replace(checks, volume_factor=min(factor, MOST_FACTOR), vine_leak="warn"),
    )
