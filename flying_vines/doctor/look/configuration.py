"""Reads everything that the service reads at its start: the configuration and its persistent state."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from flying_vines.config import config as configuration
from flying_vines.config.config import Config
from flying_vines.doctor.checks.configuration import ConfigurationFacts
from flying_vines.physics.rig import RigError
from flying_vines.service.persistent_state import PersistentState
from flying_vines.supply import RigPrior, nominal
from flying_vines.supply.cycles_left import Learned
from flying_vines.supply.learned_file import learned_from
from flying_vines.supply.rig_file_prior import load_rig_file_prior
from flying_vines.vehicle.component.parameter_file import ParameterFileError, ignored_in
from flying_vines.vehicle.component.parameters import Parameters
from flying_vines.vehicle.mavlink.signing import Signing
from flying_vines.vehicle.mavlink.signing_key import SigningKeyError


@dataclass(frozen=True, slots=True)
class ServiceConfiguration:
    """The configuration and state with which the service would start."""

    facts: ConfigurationFacts
    prior: RigPrior
    signing: Signing | None
    state: Path | None
    """The folder of the persistent state; None for a configuration without a file."""
    signing_timestamp: Path | None
    learned: Learned | None = None
    """The air that earlier flights learned."""
    board_settings: int | None = None
    """The digest of the board's settings in the last flight; None before the first board."""

    @property
    def config(self) -> Config:
        return self.facts.config


def read(path: Path) -> ServiceConfiguration:
    """Raises `ConfigError` with one line if the configuration itself cannot be read."""
    config = configuration.load(path)
    state = PersistentState.of(path, config)
    parameters, parameters_problem = {}, ""
    ignored = configuration.ignored(configuration.text_of(path), str(path), configuration.OLD_SETTINGS)
    try:
        parameters = state.read_parameters(config)
        ignored += ignored_in(state.parameters)
    except ParameterFileError as error:
        parameters_problem = str(error)
    signing, signing_clock_problem, signing_problem = None, "", ""
    try:
        signing, signing_clock_problem = state.read_signing(config)
    except SigningKeyError as error:
        signing_problem = str(error)
    prior, rig_summary, rig_problem = nominal(config.pneumatics), "", ""
    rig = configuration.rig_named(config, path)
    if rig is not None:
        try:
            known = load_rig_file_prior(rig, config.pneumatics)
            prior, rig_summary = known.prior, known.summary
        except RigError as error:
            rig_problem = str(error)
        except OSError as error:
            rig_problem = f"{rig}: {error.strerror}"
    key = config.vehicle.signing_key
    facts = ConfigurationFacts(
        path=str(path),
        config=Parameters(config, parameters).config,
        rig=str(rig or ""),
        rig_summary=rig_summary,
        rig_problem=rig_problem,
        signing_key=str(path.parent / key) if key else "",
        signing_problem=signing_problem,
        signing_clock_problem=signing_clock_problem,
        parameters=parameters,
        parameters_problem=parameters_problem,
        ignored=ignored,
        disarming=str(state.disarming) if _exists(state.disarming) else "",
        latched=state.read_latched(),
    )
    learned, _ = learned_from(state.read_learned(), prior)
    folder, timestamp = state.parameters.parent, state.signing_timestamp
    board_settings = state.read_board_settings()
    return ServiceConfiguration(facts, prior, signing, folder, timestamp, learned, board_settings)


def given(config: Config, name: str) -> ServiceConfiguration:
    """A configuration without a file."""
    return ServiceConfiguration(
        ConfigurationFacts(name, config), nominal(config.pneumatics), None, None, None
    )


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:
        # The folder is unreadable: the service would not start. Assume that the pneumatics are disarmed.
        return True
