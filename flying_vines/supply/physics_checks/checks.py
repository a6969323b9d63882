"""All checks over one stream of telemetry."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

from flying_vines.config.config import ChecksConfig
from flying_vines.config.plugins import PluginError, find
from flying_vines.supply import Features, RigPrior
from flying_vines.supply.physics_checks.expected import Expected, expected
from flying_vines.supply.physics_checks.filling import Filling, StuckVineSensor
from flying_vines.supply.physics_checks.leak import VineLeak
from flying_vines.supply.physics_checks.reservoir import Hot, ReservoirLoss
from flying_vines.supply.physics_checks.reservoir_sensor import ReservoirSensor
from flying_vines.supply.physics_checks.setpoint import AboveSetpoint, BelowSetpoint
from flying_vines.supply.physics_checks.venting import VentingCheck
from flying_vines.supply.physics_checks.vine_sensor import SuddenFall, Unsteady, Zero

BRIDGING = ("filling", "below_setpoint")
"""These checks count only air that certainly went in, or could go in, so they continue over a gap. All others
restart at each gap: twice a second if a fifth of 10 Hz telemetry is lost."""

ENDURING = ("reservoir_sensor",)
"""These checks keep an account of the whole flight, also over long gaps. Their findings stay."""

AIR_LOSSES = ("filling", "sudden_fall", "reservoir_loss")
"""After one of these faults no air is left for a bend."""

FindingSeverity = Literal["fault", "warn"]


@dataclass(frozen=True, slots=True)
class PhysicsFinding:
    """A check has begun to find a fault."""

    name: str
    """The key in `[checks]`."""
    sentence: str
    level: FindingSeverity


class Check(Protocol):
    """One physics check. After a gap in the telemetry a new object replaces it, if it is neither in
    `BRIDGING` nor in `ENDURING`."""

    def look(self, now: Features) -> str | None:
        """Take in one telemetry message. Returns the finding while it is present."""


CHECKS: dict[str, Callable[[Expected], Check]] = {
    "filling": Filling,
    "venting": VentingCheck,
    "below_setpoint": BelowSetpoint,
    "above_setpoint": AboveSetpoint,
    "sudden_fall": lambda _: SuddenFall(),
    "vine_sensor": StuckVineSensor,
    "vine_zero": Zero,
    "reservoir_loss": ReservoirLoss,
    "reservoir_sensor": ReservoirSensor,
    "reservoir_hot": Hot,
    "vine_leak": VineLeak,
    "unsteady": lambda _: Unsteady(),
}
"""The checks by their keys in `[checks]`."""


class PhysicsChecks:
    """Pass every telemetry message to `take`. `present` has the present findings."""

    def __init__(
        self,
        prior: RigPrior,
        config: ChecksConfig,
        made_by: Mapping[str, Callable[[Expected], Check]] = CHECKS,
    ) -> None:
        self._rig = expected(prior, config)
        self._made_by = made_by
        self._levels: dict[str, FindingSeverity] = {
            name: config.own[name] if name in config.own else getattr(config, name) for name in made_by
        }
        self.present: dict[str, PhysicsFinding] = {}
        self.counts: Counter[str] = Counter()
        """The number of findings of each check."""
        self._checks = {name: check(self._rig) for name, check in made_by.items()}

    def restart(self) -> None:
        """Start all checks again that do not endure, because the time before is unknown."""
        for name, check in self._made_by.items():
            if name not in ENDURING:
                self._checks[name] = check(self._rig)
                self.present.pop(name, None)

    def take(self, now: Features) -> list[PhysicsFinding]:
        """Take in one telemetry message. Returns the new findings."""
        if now.continuity == "broken":
            self.restart()
        if now.continuity in ("none", "broken"):
            return []
        new: list[PhysicsFinding] = []
        gap = now.continuity == "gap"
        for name, check in self._checks.items():
            if gap and name not in BRIDGING and name not in ENDURING:
                self._checks[name] = self._made_by[name](self._rig)
                self.present.pop(name, None)
                continue
            sentence = check.look(now)
            if sentence is None:
                if self.present:
                    self.present.pop(name, None)
            elif name not in self.present:
                finding = PhysicsFinding(name, str(sentence), self._levels[name])
                self.present[name] = finding
                self.counts[name] += 1
                new.append(finding)
        return new

    @property
    def faults(self) -> dict[str, str]:
        """The sentences of the present findings with which the vine must not bend, by name."""
        return {name: found.sentence for name, found in self.present.items() if found.level == "fault"}


def own_checks(prior: RigPrior, config: ChecksConfig) -> dict[str, PhysicsChecks]:
    """The configured checks of installed packages, each by itself: an error in one stops no other.

    Raises `PluginError`.
    """
    return {name: PhysicsChecks(prior, config, {name: _maker(name)}) for name in config.own}


def _maker(name: str) -> Callable[[Expected], Check]:
    key = f"checks.own.{name}"
    if name in CHECKS:
        raise PluginError(f"{key}: the name {name} is taken")
    return find("checks", name, key, "look")
