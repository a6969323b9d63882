"""The persistent state: a pilot's parameters, disarmed pneumatics, the signing clock, the page's token.

Each is a file of one folder, named after the profile, so that several rigs can share it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from flying_vines.config import on_disk
from flying_vines.config.config import Config
from flying_vines.gateway import page_token
from flying_vines.vehicle.component import parameter_file
from flying_vines.vehicle.mavlink.signing import Signing
from flying_vines.vehicle.mavlink.signing_key import TimestampFile, read_key

DISARMED = """\
The pneumatics were disarmed: as long as this file is there nothing bends.
Arm them from a ground station (command USER_4, 3), or take the file away and start the service again.
"""


class PersistentStateError(Exception):
    """A state cannot be stored; the text is one line that says which file, and why."""


@dataclass(frozen=True, slots=True)
class PersistentState:
    """The files of one profile."""

    profile: Path
    parameters: Path
    disarming: Path
    """Exists while the pneumatics are disarmed. Its content does not matter: half a file is enough."""
    signing_timestamp: Path
    page_token: Path

    @classmethod
    def of(cls, profile: Path, config: Config) -> PersistentState:
        """`state.folder` of the profile may be relative to it; by default it is the profile's own."""
        folder = profile.parent / config.state.folder
        token_file = config.page.token_file
        stem = profile.name.removesuffix(".toml")
        return cls(
            profile,
            parameters=folder / f"{stem}.parameters.toml",
            disarming=folder / f"{stem}.disarmed",
            signing_timestamp=folder / f"{stem}.signing-timestamp",
            page_token=profile.parent / token_file if token_file else folder / f"{stem}.page-token",
        )

    def read_parameters(self, config: Config) -> dict[str, float]:
        """Raises `ParameterFileError`, one line."""
        return parameter_file.read(self.parameters, config)

    @property
    def disarmed(self) -> bool:
        """Whether the pneumatics were disarmed and not armed again; `OSError` if that cannot be read."""
        return self.disarming.exists()

    def store_disarmed(self, disarmed: bool) -> None:
        """Raises `PersistentStateError`."""
        try:
            if disarmed:
                on_disk.put(self.disarming, DISARMED)
            else:
                on_disk.take_away(self.disarming)
        except OSError as error:
            change = "written" if disarmed else "taken away"
            raise PersistentStateError(f"{self.disarming}: cannot be {change}: {error.strerror}") from None

    def read_page_token(self, config: Config) -> str:
        """Made if there is none; empty if the page needs none. Raises `PageTokenError`, one line."""
        return page_token.read_or_make(self.page_token) if config.page.needs_token else ""

    def read_signing(self, config: Config) -> tuple[Signing | None, str]:
        """The signing that the profile asks for, if any, and a sentence if its clock was not stored.

        Raises `SigningKeyError`, one line.
        """
        if not config.vehicle.signing_key:
            return None, ""
        key = read_key(self.profile.parent / config.vehicle.signing_key)
        memory, problem = TimestampFile(self.signing_timestamp).load()
        return Signing(key, config.vehicle.component_id, memory), problem
