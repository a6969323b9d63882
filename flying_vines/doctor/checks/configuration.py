"""Checks the configuration and the files that it names. (An unreadable one ends the command earlier.)"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from flying_vines.config.address import NetworkAddress, parse_address
from flying_vines.config.config import Config
from flying_vines.doctor.finding import DoctorFinding, FindingText


@dataclass(frozen=True, slots=True)
class ConfigurationFacts:
    """A configuration that was read. Each problem is a sentence, or empty."""

    path: str
    config: Config
    """Includes the pilot's parameters."""
    rig: str = ""
    """The rig file that it names."""
    rig_summary: str = ""
    rig_problem: str = ""
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


GOOD = FindingText(
    "configuration", "good", "{path}: {profiles} profiles, {rules} rules for mission items and commands"
)
RIG = FindingText("configuration", "good", "rig {path}: {said}")
BAD_RIG = FindingText(
    "configuration", "bad", "{why}", "correct the file that pneumatics.rig names, or remove the key"
)
KEY = FindingText("configuration", "good", "signing key {path}: only its owner may read it")
BAD_KEY = FindingText(
    "configuration", "bad", "{why}", "correct the file that vehicle.signing_key names, or remove the key"
)
VEHICLE_LINK = FindingText("configuration", "good", "vehicle link {who}")
OPEN_TO_NETWORK = FindingText(
    "configuration",
    "warning",
    "vehicle link {who}",
    "set vehicle.signing_key, if your autopilot can sign (docs/mavlink.md)",
)
NO_CLOCK = FindingText(
    "configuration",
    "warning",
    "{why}",
    "set this computer's clock before each flight, or correct the file's permissions",
)
PARAMETERS = FindingText(
    "configuration", "good", "set by a pilot, in place of the configuration's: {parameters}"
)
BAD_PARAMETERS = FindingText(
    "configuration", "bad", "{why}", "correct the file, or delete it; then the configuration's values apply"
)
IGNORED = FindingText("configuration", "warning", "{why}", "delete the line")
DISARMED = FindingText(
    "configuration",
    "bad",
    "the pneumatics are disarmed ({path}): the vine does not bend",
    "arm them from a ground station (command USER_4, 3), or delete the file",
)
LATCHED = FindingText(
    "configuration",
    "bad",
    "latched in the last run: {faults}; the vine does not bend",
    "find the cause; start the service; then clear it from a ground station (command USER_5, 1)",
)
BENCH = FindingText(
    "configuration",
    "bad",
    "bench mode: the vine bends with a disarmed vehicle, and at any altitude",
    "set interlocks.bench_mode = false",
)


def check(facts: ConfigurationFacts) -> list[DoctorFinding]:
    config = facts.config
    found = [GOOD(path=facts.path, profiles=len(config.profiles), rules=len(config.items))]
    if facts.rig_problem:
        found.append(BAD_RIG(why=facts.rig_problem))
    elif facts.rig:
        found.append(RIG(path=facts.rig, said=facts.rig_summary))
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
        found.append(PARAMETERS(parameters=values))
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
