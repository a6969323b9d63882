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
from flying_vines.files.toml_text import Key, key_of, located
from flying_vines.gateway import page_token
from flying_vines.physics.rig import RigError
from flying_vines.service.persistent_state import PersistentState
from flying_vines.service.service import line_to
from flying_vines.supply.rig_file_prior import RigFilePrior, load_rig_file_prior
from flying_vines.vehicle.component.parameter_file import ParameterFileError, ignored_in
from flying_vines.vehicle.mavlink.signing import Signing
from flying_vines.vehicle.mavlink.signing_key import SigningKeyError


@dataclass(frozen=True, slots=True)
class RunInputs:
    """The configuration and the files that it names."""

    text: str
    config: Config
    known: RigFilePrior | None
    """The rig file."""
    state: PersistentState
    stored: StoredState
    signing: Signing | None
    notes: list[str]
    """What does not stop the service, a line each."""


def read_inputs(path: Path, rig: Path | None = None, broker_files: bool = False) -> RunInputs:
    """Raises `ConfigError` with file, line and key.

    Args:
        path: the configuration.
        rig: a rig file in place of the configuration's.
        broker_files: also read the files for the broker and the page. The service reads them later, and flies
            without them.
    """
    text = configuration.text_of(path)
    config = configuration.parse(text, str(path))
    state = PersistentState.of(path, config)

    @contextmanager
    def named(key: Key, *kinds: type[Exception]) -> Iterator[None]:
        try:
            yield
        except kinds as error:
            raise ConfigError(located(text, str(path), key, str(error)) if key else str(error)) from None
        except OSError as error:
            reason = f"{error.filename}: {error.strerror}"
            raise ConfigError(located(text, str(path), key, reason)) from None

    check_plugins(config, path)
    known = None
    if file := rig or configuration.rig_named(config, path):
        with named(() if rig else ("pneumatics", "rig"), RigError):
            known = load_rig_file_prior(file, config.pneumatics)
    with named(("vehicle", "signing_key"), SigningKeyError):
        signing, clock_problem = state.read_signing(config)
    folder = state.parameters.parent
    with named(("state", "folder")):
        if folder.exists() and not folder.is_dir():
            raise NotADirectoryError(0, "is not a folder", str(folder))
    try:
        stored = state.read(config)
        notes = [
            *configuration.ignored(text, str(path), configuration.OLD_SETTINGS),
            *ignored_in(state.parameters),
        ]
    except ParameterFileError as error:
        raise ConfigError(str(error)) from None
    except OSError as error:
        raise ConfigError(f"{error.filename}: {error.strerror}") from None
    if broker_files:
        _read_broker_files(config.mqtt, named)
        with named(("page", "token_file"), page_token.PageTokenError):
            if config.page.needs_token and state.page_token.exists():
                page_token.read(state.page_token)
    if clock_problem:
        notes.append(clock_problem)
    above = next(part for part in (folder, *folder.absolute().parents) if part.exists())
    if not os.access(above, os.W_OK):
        notes.append(f"{folder}: this user may not write there: the service's user must, to keep its state")
    return RunInputs(text, config, known, state, stored, signing, notes)


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
    from flying_vines.gateway.mqtt import credentials
    from flying_vines.gateway.mqtt.problems import FileError

    with named(("mqtt", "password_file"), FileError):
        credentials.password(mqtt)
    try:
        credentials.tls(mqtt, parse_broker(mqtt.broker))
    except FileError as error:
        files = ("ca_file", "key_file", "certificate_file")
        key = next(name for name in files if str(error).startswith(getattr(mqtt, name) or "\0"))
        with named(("mqtt", key), FileError):
            raise
