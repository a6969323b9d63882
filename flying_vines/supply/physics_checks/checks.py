"""All checks over one stream of telemetry."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

from firmware_link.protocol import Fault, Telemetry
from flying_vines.config.config import Checks
from flying_vines.supply import Belief
from flying_vines.supply.physics_checks.expected import Expected, expected
from flying_vines.supply.physics_checks.filling import Filling, StuckVineSensor
from flying_vines.supply.physics_checks.leak import VineLeak
from flying_vines.supply.physics_checks.moment import Moment, Reader
from flying_vines.supply.physics_checks.reservoir import BottleSensor, Hot, Loss
from flying_vines.supply.physics_checks.venting import Venting
from flying_vines.supply.physics_checks.vine_sensor import SuddenFall, Unsteady, Zero

LONGEST_GAP_S = 0.11
"""Longer without telemetry, and nobody knows what the valves did: nearly everything is watched anew. At 10 Hz
telemetry comes each 0.1 s, give or take a step of the board's loop."""
LONGEST_BRIDGED_S = 0.5
"""Longer, and nothing at all is known."""
BRIDGING = ("filling",)
"""What counts only air that has gone in for sure goes on over a gap. Where a fifth of telemetry of 10 Hz is
lost, everything else is watched anew twice a second."""
UNBELIEVABLE = Fault.CV_SENSOR | Fault.RESERVOIR_SENSOR
"""While the firmware has one of these its telemetry repeats the last reading that it believed."""
_CLOCK_MS = 1 << 32

Level = Literal["fault", "warn"]


@dataclass(frozen=True, slots=True)
class Finding:
    """Something is physically wrong, from now on."""

    name: str
    """As in `[checks]`."""
    sentence: str
    level: Level


class _Check(Protocol):
    def look(self, now: Moment) -> str | None: ...


CHECKS: dict[str, Callable[[Expected], _Check]] = {
    "filling": Filling,
    "venting": Venting,
    "sudden_fall": lambda _: SuddenFall(),
    "vine_sensor": lambda _: StuckVineSensor(),
    "vine_zero": Zero,
    "bottle_loss": Loss,
    "bottle_sensor": BottleSensor,
    "bottle_hot": Hot,
    "vine_leak": VineLeak,
    "unsteady": lambda _: Unsteady(),
}
"""By their keys in `[checks]`."""


class PhysicsChecks:
    """Feed it every telemetry message with `take`; what is wrong just now is in `present`."""

    def __init__(self, belief: Belief, checks: Checks) -> None:
        self._rig = expected(belief, checks)
        self._levels: dict[str, Level] = {name: getattr(checks, name) for name in CHECKS}
        self.present: dict[str, Finding] = {}
        self.counts: Counter[str] = Counter()
        """How often each one has begun."""
        self._device_time_ms: int | None = None
        self.restart()

    def restart(self) -> None:
        """Watch anew: nobody knows what happened meanwhile."""
        self._reader = Reader(self._rig)
        self._checks = {name: made_of(self._rig) for name, made_of in CHECKS.items()}
        self.present = {}

    def take(self, telemetry: Telemetry) -> list[Finding]:
        """What has just become wrong."""
        before_ms, self._device_time_ms = self._device_time_ms, telemetry.device_time_ms
        if before_ms is None:
            return []
        # The device's clock: messages come in bursts, readings do not.
        dt_s = (telemetry.device_time_ms - before_ms) % _CLOCK_MS / 1000.0
        if dt_s > LONGEST_BRIDGED_S or telemetry.faults & UNBELIEVABLE:
            self.restart()
            return []
        if dt_s == 0.0:
            return []
        gap = dt_s > LONGEST_GAP_S
        now = self._reader.read(dt_s, telemetry, gap)
        begun: list[Finding] = []
        for name, check in self._checks.items():
            if gap and name not in BRIDGING:
                self._checks[name] = CHECKS[name](self._rig)
                self.present.pop(name, None)
                continue
            sentence = check.look(now)
            if sentence is None:
                self.present.pop(name, None)
            elif name not in self.present:
                finding = Finding(name, sentence, self._levels[name])
                self.present[name] = finding
                self.counts[name] += 1
                begun.append(finding)
        return begun

    @property
    def faults(self) -> dict[str, str]:
        """Of what is wrong just now, what the vine must not move with: name and sentence."""
        return {name: found.sentence for name, found in self.present.items() if found.level == "fault"}
