"""Reads everything that the service reads at its start: the configuration and its persistent state."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from flying_vines.config import config as configuration
from flying_vines.config.config import Config
from flying_vines.doctor.checks.configuration import ConfigurationFacts
from flying_vines.service.persistent_state import PersistentState
from flying_vines.service.starting import PARAMETERS, RIG, SIGNING_KEY, read_inputs
from flying_vines.supply import RigPrior, nominal
from flying_vines.supply.cycles_left import Learned
from flying_vines.supply.learned_file import learned_from
from flying_vines.vehicle.component.parameters import Parameters
from flying_vines.vehicle.mavlink.signing import Signing


@dataclass(frozen=True, slots=True)
class ServiceConfiguration:
    """The configuration and state with which the service would start."""

    facts: ConfigurationFacts
    prior: RigPrior
    signing: Signing | None
    state: PersistentState | None
    """None for a configuration without a file."""
    learned: Learned | None = None
    """The air that earlier flights learned."""
    board_settings: int | None = None
    """The digest of the board's settings in the last flight; None before the first board."""

    @property
    def config(self) -> Config:
        return self.facts.config


def read(path: Path) -> ServiceConfiguration:
    """Raises `ConfigError` with one line if the configuration itself cannot be read."""
    problems: dict[str, str] = {}
    found = read_inputs(path, problems=problems)
    config, stored, known = found.config, found.stored, found.known
    prior = known.prior if known else nominal(config.pneumatics)
    key = config.vehicle.signing_key
    facts = ConfigurationFacts(
        path=str(path),
        config=Parameters(config, stored.parameters).config,
        rig=str(configuration.rig_named(config, path) or ""),
        rig_summary=known.summary if known else "",
        rig_problem=problems.get(RIG, ""),
        signing_key=str(path.parent / key) if key else "",
        signing_problem=problems.get(SIGNING_KEY, ""),
        signing_clock_problem=found.clock_problem,
        parameters=stored.parameters,
        parameters_problem=problems.get(PARAMETERS, ""),
        ignored=found.ignored,
        disarming=str(found.state.disarming) if stored.disarmed else "",
        latched=stored.latched,
    )
    learned, _ = learned_from(stored.learned, prior)
    return ServiceConfiguration(facts, prior, found.signing, found.state, learned, stored.board_settings)


def given(config: Config, name: str) -> ServiceConfiguration:
    """A configuration without a file."""
    return ServiceConfiguration(ConfigurationFacts(name, config), nominal(config.pneumatics), None, None)
