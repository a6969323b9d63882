"""What is known of a rig before it is calibrated: a pilot's settings, a rig file, whether it is disarmed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import msgspec

from flying_vines.config import config as configuration
from flying_vines.config.config import Config
from flying_vines.service.persistent_state import PersistentState
from flying_vines.supply import Belief
from flying_vines.supply.known_rig import load_calibration
from flying_vines.vehicle.component.parameters import Parameters
from flying_vines.vehicle.mavlink.signing import Signing


@dataclass(frozen=True)
class KnownBeforehand:
    """Beyond the profile."""

    belief: Belief | None = None
    rig_text: str = ""
    """Of the rig file that the belief is of."""
    disarmed: bool = False
    """Whether the pneumatics are."""
    signing: Signing | None = None
    kept: PersistentState | None = None
    """What outlives us."""


def with_kept(path: Path, config: Config) -> tuple[Config, KnownBeforehand]:
    """A profile as `run` would fly it, with what is kept beside it.

    Raises `ParameterFileError`, `SigningKeyError` or `RigError`: one line.
    """
    kept = PersistentState.of(path, config)
    flown = Parameters(config, kept.read_parameters(config)).config
    signing, _ = kept.read_signing(config)
    belief, rig_text = None, ""
    if rig := configuration.rig_named(config, path):
        belief = load_calibration(rig, config.pneumatics).belief
        rig_text = rig.read_text(encoding="utf-8")
        flown = msgspec.structs.replace(flown, pneumatics=belief.pneumatics)
    return flown, KnownBeforehand(belief, rig_text, kept.disarmed, signing, kept)
