"""What the service reads before it opens a link. `config check` reads the same, so both refuse the same."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path

from flying_vines.config import config as configuration
from flying_vines.config.address import parse_broker
from flying_vines.config.config import Config, ConfigError, MqttConfig
from flying_vines.config.plugins import PluginError
from flying_vines.core.core import Core
from flying_vines.core.events import StoredState
from flying_vines.files.toml_text import key_of, located, read_text
from flying_vines.gateway import page_token
from flying_vines.physics.rig import RigError
from flying_vines.service.persistent_state import PersistentState
from flying_vines.service.service import line_to
from flying_vines.supply.rig_file_prior import RigFilePrior, load_rig_file_prior
from flying_vines.vehicle.component.parameter_file import ParameterFileError, ignored_in
from flying_vines.vehicle.mavlink.signing import Signing, SigningKeyError

RIG, SIGNING_KEY, PARAMETERS = "pneumatics.rig", "vehicle.signing_key", "parameters"
"""Keys of `read_inputs`' problems."""


@dataclass(frozen=True, slots=True)
class StartInputs:
    """The configuration and the files that it names."""

    text: str
    config: Config
    known: RigFilePrior | None
    """The rig file."""
    state: PersistentState
    stored: StoredState
    signing: Signing | None
    ignored: list[str]
    """Settings and parameters of an earlier version, a sentence each."""
    clock_problem: str
    """Why the stored signing clock cannot be used, or empty."""

    @property
    def rig_text(self) -> str:
        return read_text(self.known.path, ConfigError) if self.known else ""

    @property
    def notes(self) -> list[str]:
        """What does not stop the service, a line each."""
        notes = [*self.ignored, *([self.clock_problem] if self.clock_problem else [])]
        folder = self.state.parameters.parent
        above = next(part for part in (folder, *folder.absolute().parents) if part.exists())
        if not os.access(above, os.W_OK):
            notes.append(
                f"{folder}: this user may not write there: the service's user must, to keep its state"
            )
        return notes


def read_inputs(
    path: Path, rig: Path | None = None, broker_files: bool = False, problems: dict[str, str] | None = None
) -> StartInputs:
    """Raises `ConfigError` with file, line and key.

    Args:
        path: the configuration.
        rig: a rig file in place of the configuration's.
        broker_files: also read the files for the broker and the page. The service reads them later, and flies
            without them.
        problems: gets what is wrong with the other files, by key, in place of an error. Plugins are then not
            checked.
    """
    text = configuration.text_of(path)
    config = configuration.parse(text, str(path))
    state = PersistentState.of(path, config)

    @contextmanager
    def named(key: str, *kinds: type[Exception]) -> Iterator[None]:
        caught: tuple[type[Exception], ...] = (OSError, *kinds)
        try:
            yield
        except caught as error:
            reason = f"{error.filename}: {error.strerror}" if isinstance(error, OSError) else str(error)
            if problems is None:
                is_set = "." in key and not (rig and key == RIG)
                reason = located(text, str(path), key_of(f".{key}"), reason) if is_set else reason
                raise ConfigError(reason) from None
            problems[key] = reason

    if problems is None:
        check_plugins(config, path)
    known, signing, clock_problem = None, None, ""
    if file := rig or configuration.rig_named(config, path):
        with named(RIG, RigError):
            known = load_rig_file_prior(file, config.pneumatics)
    with named(SIGNING_KEY, SigningKeyError):
        signing, clock_problem = state.read_signing(config)
    folder = state.parameters.parent
    with named("state.folder"):
        if folder.exists() and not folder.is_dir():
            raise NotADirectoryError(0, "is not a folder", str(folder))
    parameters, disarmed = dict[str, float](), True
    ignored = configuration.ignored(text, str(path), configuration.OLD_SETTINGS)
    ignored += configuration.renamed(text, str(path))
    with named(PARAMETERS, ParameterFileError):
        parameters = state.read_parameters(config)
        ignored += ignored_in(state.parameters)
    with named("disarmed"):
        disarmed = state.disarmed
    stored = StoredState(
        parameters, disarmed, state.read_learned(), state.read_latched(), state.read_board_settings()
    )
    if broker_files:
        _read_broker_files(config.mqtt, named)
        with named("page.token_file", page_token.PageTokenError):
            if config.page.needs_token and state.page_token.exists():
                page_token.read(state.page_token)
    return StartInputs(text, config, known, state, stored, signing, ignored, clock_problem)


def check_plugins(config: Config, config_file: Path | None = None) -> None:
    """Raises `ConfigError`, with the line in `config_file`, if a named plugin cannot be used."""
    try:
        line_to(config.firmware)
        Core(config)
    except PluginError as error:
        key, _, reason = str(error).partition(": ")
        text, source = (
            configuration.text_of(config_file) if config_file else "",
            str(config_file or "built-in"),
        )
        raise ConfigError(located(text, source, key_of(f".{key}"), reason)) from None


def _read_broker_files(mqtt: MqttConfig, named: Callable[..., AbstractContextManager[None]]) -> None:
    if not mqtt.broker:
        return
    from flying_vines.gateway.mqtt.broker import FileError, password, tls

    with named("mqtt.password_file", FileError):
        password(mqtt)
    try:
        tls(mqtt, parse_broker(mqtt.broker))
    except FileError as error:
        files = ("ca_file", "key_file", "certificate_file")
        key = next(name for name in files if str(error).startswith(getattr(mqtt, name) or "\0"))
        with named(f"mqtt.{key}", FileError):
            raise
