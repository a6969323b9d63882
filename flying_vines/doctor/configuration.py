"""Everything that the service reads at its start: the configuration, the files that it names, and its state.

An unreadable configuration ends the command earlier.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from flying_vines.config import config as configuration
from flying_vines.config.address import NetworkAddress, parse_address
from flying_vines.config.config import Config
from flying_vines.doctor.finding import DoctorFinding, Subject
from flying_vines.service.persistent_state import PersistentState
from flying_vines.service.starting import PARAMETERS, RIG, SIGNING_KEY, read_inputs
from flying_vines.supply import RigPrior, nominal
from flying_vines.supply.cycles_left import Learned
from flying_vines.supply.learned_file import learned_from
from flying_vines.vehicle.component.parameters import Parameters
from flying_vines.vehicle.mavlink.signing import Signing


@dataclass(frozen=True, slots=True)
class ServiceConfiguration:
    """The configuration and state with which the service would start. A problem is a sentence, or empty."""

    path: str
    config: Config
    """Includes the pilot's parameters."""
    prior: RigPrior
    rig: str = ""
    """The rig file that it names."""
    rig_summary: str = ""
    rig_problem: str = ""
    signing: Signing | None = None
    signing_key: str = ""
    signing_problem: str = ""
    signing_clock_problem: str = ""
    parameters: Mapping[str, float] = field(default_factory=dict)
    """Set by a pilot."""
    parameters_problem: str = ""
    ignored: Sequence[str] = ()
    """Settings and parameters of an earlier version, a sentence each."""
    disarming: str = ""
    """The file that marks the pneumatics as disarmed; empty if it does not exist."""
    latched: Mapping[str, str] = field(default_factory=dict)
    """The latched faults that nobody has cleared, by name: a sentence each."""
    state: PersistentState | None = None
    """None for a configuration without a file."""
    learned: Learned | None = None
    """The air that earlier flights learned."""
    board_settings: int | None = None
    """The digest of the board's settings in the last flight; None before the first board."""


def read(path: Path) -> ServiceConfiguration:
    """Raises `ConfigError` with one line if the configuration itself cannot be read."""
    problems: dict[str, str] = {}
    found = read_inputs(path, problems=problems)
    config, stored, known = found.config, found.stored, found.known
    prior = known.prior if known else nominal(config.pneumatics)
    key = config.vehicle.signing_key
    learned, _ = learned_from(stored.learned, prior)
    return ServiceConfiguration(
        str(path),
        Parameters(config, stored.parameters).config,
        prior,
        rig=str(configuration.rig_named(config, path) or ""),
        rig_summary=known.summary if known else "",
        rig_problem=problems.get(RIG, ""),
        signing=found.signing,
        signing_key=str(path.parent / key) if key else "",
        signing_problem=problems.get(SIGNING_KEY, ""),
        signing_clock_problem=found.clock_problem,
        parameters=stored.parameters,
        parameters_problem=problems.get(PARAMETERS, ""),
        ignored=found.ignored,
        disarming=str(found.state.disarming) if stored.disarmed else "",
        latched=stored.latched,
        state=found.state,
        learned=learned,
        board_settings=stored.board_settings,
    )


def given(config: Config, name: str) -> ServiceConfiguration:
    """A configuration without a file."""
    return ServiceConfiguration(name, config, nominal(config.pneumatics))


_CONFIGURATION = Subject("configuration")
GOOD = _CONFIGURATION.good("{path}: {profiles} profiles, {rules} rules for mission items and commands")
RIG_READ = _CONFIGURATION.good("rig {path}: {said}")
BAD_RIG = _CONFIGURATION.bad("{why}", "correct the file that pneumatics.rig names, or remove the key")
KEY = _CONFIGURATION.good("signing key {path}: only its owner may read it")
BAD_KEY = _CONFIGURATION.bad("{why}", "correct the file that vehicle.signing_key names, or remove the key")
VEHICLE_LINK = _CONFIGURATION.good("vehicle link {who}")
OPEN_TO_NETWORK = _CONFIGURATION.warning(
    "vehicle link {who}", "set vehicle.signing_key, if your autopilot can sign (docs/mavlink.md)"
)
NO_CLOCK = _CONFIGURATION.warning(
    "{why}", "set this computer's clock before each flight, or correct the file's permissions"
)
SET_BY_PILOT = _CONFIGURATION.good("set by a pilot, in place of the configuration's: {parameters}")
BAD_PARAMETERS = _CONFIGURATION.bad(
    "{why}", "correct the file, or delete it; then the configuration's values apply"
)
IGNORED = _CONFIGURATION.warning("{why}", "delete the line")
DISARMED = _CONFIGURATION.bad(
    "the pneumatics are disarmed ({path}): the vine does not bend",
    "arm them from a ground station (command USER_4, 3), or delete the file",
)
LATCHED = _CONFIGURATION.bad(
    "latched in the last run: {faults}; the vine does not bend",
    "find the cause; start the service; then clear it from a ground station (command USER_5, 1)",
)
BENCH = _CONFIGURATION.bad(
    "bench mode: the vine bends with a disarmed vehicle, and at any altitude",
    "set interlocks.bench_mode = false",
)


def check(facts: ServiceConfiguration) -> list[DoctorFinding]:
    config = facts.config
    found = [GOOD(path=facts.path, profiles=len(config.profiles), rules=len(config.items))]
    if facts.rig_problem:
        found.append(BAD_RIG(why=facts.rig_problem))
    elif facts.rig:
        found.append(RIG_READ(path=facts.rig, said=facts.rig_summary))
    if facts.signing_problem:
        found.append(BAD_KEY(why=facts.signing_problem))
    elif facts.signing_key:
        found.append(KEY(path=facts.signing_key))
    found.append(_vehicle_link(config))
    if facts.signing_clock_problem:
        found.append(NO_CLOCK(why=facts.signing_clock_problem))
    if facts.parameters_problem:
        found.append(BAD_PARAMETERS(why=facts.parameters_problem))
    elif facts.parameters:
        values = ", ".join(f"{name} = {value:g}" for name, value in facts.parameters.items())
        found.append(SET_BY_PILOT(parameters=values))
    found += [IGNORED(why=why) for why in facts.ignored]
    if facts.disarming:
        found.append(DISARMED(path=facts.disarming))
    if facts.latched:
        found.append(LATCHED(faults="; ".join(facts.latched.values())))
    if config.interlocks.bench_mode:
        found.append(BENCH())
    return found


def _vehicle_link(config: Config) -> DoctorFinding:
    address = parse_address(config.vehicle.link)
    unsigned = not config.vehicle.signing_key
    afar = isinstance(address, NetworkAddress) and not address.on_loopback and unsigned
    return (OPEN_TO_NETWORK if afar else VEHICLE_LINK)(who=config.vehicle.who_can_command)
