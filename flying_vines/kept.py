"""What survives the service: the parameters that a pilot set, and the clock that messages are signed with.

Both are files in one folder, named after the profile, so that several rigs can share it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from flying_vines.config import Config
from flying_vines.vehicle import parameter_file
from flying_vines.vehicle.signing import Signing
from flying_vines.vehicle.signing_key import TimestampFile, read_key


@dataclass(frozen=True, slots=True)
class Kept:
    """The files of one profile."""

    profile: Path
    parameters: Path
    signing_timestamp: Path

    @classmethod
    def of(cls, profile: Path, config: Config) -> Kept:
        """`state.folder` of the profile may be relative to it; by default it is the profile's own."""
        folder = profile.parent / config.state.folder
        stem = profile.name.removesuffix(".toml")
        return cls(profile, folder / f"{stem}.parameters.toml", folder / f"{stem}.signing-timestamp")

    def read_parameters(self, config: Config) -> dict[str, float]:
        """Raises `ParameterFileError`, one line."""
        return parameter_file.read(self.parameters, config)

    def read_signing(self, config: Config) -> tuple[Signing | None, str]:
        """The signing that the profile asks for, if any, and a sentence where its clock was not kept.

        Raises `SigningKeyError`, one line.
        """
        if not config.vehicle.signing_key:
            return None, ""
        key = read_key(self.profile.parent / config.vehicle.signing_key)
        timestamp, problem = TimestampFile(self.signing_timestamp).load()
        return Signing(key, link_id=config.vehicle.component_id, timestamp=timestamp), problem
