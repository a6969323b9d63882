"""Persistent state: parameters, disarmed pneumatics, latched faults, the board's known settings, learned
air, signing clock, page token.

Each is a file in one folder; only the page token may be elsewhere. The files' names begin with that of the
configuration file, so several rigs can share the folder.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import msgspec

from flying_vines.config import on_disk
from flying_vines.config.config import RENAMED, Config
from flying_vines.files.bounded import read_bytes
from flying_vines.gateway import page_token
from flying_vines.vehicle.component import parameter_file
from flying_vines.vehicle.mavlink.signing import Signing, TimestampFile, read_key

DISARMED = """\
The pneumatics were disarmed: the vine does not bend while this file exists.
Arm them from a ground station (command USER_4 with param1 = 3), or delete the file and restart the service.
"""


MAX_LATCHED_BYTES = 16_000
"""Far more than all faults together. Displays get the sentences whole, and longer ones stop the page."""
UNREADABLE = {"last_run": "the latched faults of the last run cannot be read"}
"""Latched if the stored faults cannot be read. Clearing this fault clears all stored faults."""

NO_BOARD = -1
"""The digest of no board: read from a damaged file, so that a person confirms the board's settings."""


class PersistentStateError(Exception):
    """A state cannot be stored; the text is one line with the file and the reason."""


@dataclass(frozen=True, slots=True)
class PersistentState:
    """The files of one configuration."""

    config_file: Path
    parameters: Path
    disarming: Path
    """Exists while the pneumatics are disarmed. Its content is not read: an incomplete file is enough."""
    learned: Path
    """The text of the last `KeepLearned`: what was learned about the rig's air."""
    latched: Path
    """The latched faults as a JSON object: a sentence for each fault's name. Exists while there are any."""
    board_settings: Path
    """The digest of the board's settings in the last flight, as a hexadecimal number. Missing before the
    first board."""
    signing_timestamp: Path
    page_token: Path

    @classmethod
    def of(cls, config_file: Path, config: Config) -> PersistentState:
        """The files in `state.folder`, by default the configuration file's folder.

        A relative `state.folder` starts from the configuration file's folder.
        """
        folder = config_file.parent / config.state.folder
        token_file = config.page.token_file
        stem = config_file.name.removesuffix(".toml")
        return cls(
            config_file,
            parameters=folder / f"{stem}.parameters.toml",
            disarming=folder / f"{stem}.disarmed",
            learned=folder / f"{stem}.air.json",
            latched=folder / f"{stem}.latched.json",
            board_settings=folder / f"{stem}.board-settings",
            signing_timestamp=folder / f"{stem}.signing-timestamp",
            page_token=config_file.parent / token_file if token_file else folder / f"{stem}.page-token",
        )

    def read_parameters(self, config: Config) -> dict[str, float]:
        """Raises `ParameterFileError` with one line."""
        return parameter_file.read(self.parameters, config)

    @property
    def disarmed(self) -> bool:
        """True if the pneumatics were disarmed and not armed again. Raises `OSError` if it cannot be read."""
        try:
            self.disarming.stat()  # `exists` returns False for an unreadable folder from Python 3.14 on
        except (FileNotFoundError, NotADirectoryError):
            return False
        return True

    def store_disarmed(self, disarmed: bool) -> None:
        """Raises `PersistentStateError`."""
        _store(self.disarming, DISARMED if disarmed else None)

    def read_learned(self) -> str:
        """The stored text. Empty if there is none or it cannot be read: then the air is learned again."""
        try:
            return read_bytes(self.learned).decode("utf-8", errors="replace")
        except OSError:
            return ""

    def store_learned(self, text: str) -> None:
        """Raises `PersistentStateError`."""
        _store(self.learned, text)

    def read_latched(self) -> dict[str, str]:
        """The faults that nobody has cleared."""
        try:
            stored = msgspec.json.decode(read_bytes(self.latched, MAX_LATCHED_BYTES), type=dict[str, str])
            return {RENAMED.get(("checks", name), name): why for name, why in stored.items()}
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, RecursionError):
            return dict(UNREADABLE)

    def store_latched(self, faults: dict[str, str]) -> None:
        """Raises `PersistentStateError`."""
        _store(self.latched, msgspec.json.encode(faults).decode() + "\n" if faults else None)

    def read_board_settings(self) -> int | None:
        """The known digest; None before the first board, `NO_BOARD` if the file is damaged."""
        try:
            text = self.board_settings.read_text(encoding="ascii")
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, UnicodeError):
            return NO_BOARD
        return int(text, 16) if re.fullmatch(r"[0-9a-f]{8}\n", text) else NO_BOARD

    def store_board_settings(self, digest: int) -> None:
        """Raises `PersistentStateError`."""
        _store(self.board_settings, f"{digest:08x}\n")

    def read_page_token(self, config: Config) -> str:
        """The token; a new one if there is none, empty if the page needs none. Raises `PageTokenError`."""
        return page_token.read_or_make(self.page_token) if config.page.needs_token else ""

    def read_signing(self, config: Config) -> tuple[Signing | None, str]:
        """The configured signing, and a sentence if the stored clock is damaged. Raises `SigningKeyError`."""
        if not config.vehicle.signing_key:
            return None, ""
        key = read_key(self.config_file.parent / config.vehicle.signing_key)
        memory, problem = TimestampFile(self.signing_timestamp).load()
        return Signing(key, config.vehicle.component_id, memory), problem


def _store(file: Path, text: str | None) -> None:
    """Write the file; delete it without a text."""
    try:
        if text is None:
            on_disk.take_away(file)
        else:
            on_disk.put(file, text)
    except OSError as error:
        change = "deleted" if text is None else "written"
        raise PersistentStateError(f"{file}: cannot be {change}: {error.strerror}") from None
