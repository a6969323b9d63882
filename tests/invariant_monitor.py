"""A monitor at the valves of a simulated phloSAR: it reports what must never happen, whatever the cause.

It uses facts only: the bytes that reach the board, the readings and valve commands, the true pressures, and
the events that the director reports. The director is the code that flies the flight and causes its faults.
The monitor asks neither the service nor the firmware. docs/campaign.md has the rules and the excuses.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from wrapped_board import WrappedBoard

from firmware_link.protocol import Codec, Hello, Setpoint, Vent
from flying_vines.physics.baseline import Inputs
from flying_vines.simulation.phlosar.firmware import SAFE, Firmware
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar

DEAD_MAN_S = 0.300
SAFE_WITHIN_STEPS = 10
"""Maximum time of the firmware from the first bad reading to safe valves: 10 ms."""
RELIEF = Inputs(0.0, 1.0, True)
RELIEF_AFTER_S = 0.005
SURELY_SEEN_STEPS = 5
"""After this number of bad readings in a row the fault is latched."""
LONGEST_OVER_S = 0.020
BLIND_S = 1.0
"""Maximum time of inflation above the limit. A longer one means that nobody has noticed the wrong sensor."""
LONGEST_HANG_S = 0.260
"""The time of the board's watchdog and a few steps."""
AFTER_EXCUSE_S = 1.0
"""Time to recover after an excuse: a vine above the limit must be vented."""
SURELY_BEYOND = 0.11
"""Share of a sensor's span, on both sides: readings beyond it mean a broken wire."""
OVER_BY_KPA, RESERVOIR_OVER_BY_KPA = 0.5, 3.0
"""A reading this far above a limit is above it for the firmware too, in spite of converter and rounding."""
HELD_WITHIN_KPA = 0.01
AT_REST_AFTER_S = 0.1
RISE_AT_REST_KPA = 1.0
STEADY_S = 0.3
"""A setpoint that is constant for this time is the end of a motion."""
SAME_KPA = 0.4
RAMP_S = 1.5
"""Time from a trigger to the end of its motion."""
_STEP_S = 0.001


class Violation(NamedTuple):
    """A broken rule."""

    t: float
    rule: str
    what: str

    def __str__(self) -> str:
        return f"{self.t:.3f} s: {self.rule}: {self.what}"


@dataclass(frozen=True)
class Rules:
    """The limits of the flight's configuration and firmware. Gauge kPa."""

    max_kPa: float
    max_rate_kPa_per_s: float
    max_bent_s: float
    firmware: Mapping[str, float] = field(default_factory=lambda: Firmware().settings)


class _Trigger(NamedTuple):
    until_s: float
    from_s: float
    what: str
    latest_s: float = math.inf
    """Latest start, whatever delays the trigger."""


class _Target(NamedTuple):
    """The target of a trigger; unknown for a profile, and while the vine is held."""

    until_s: float
    kPa: float | None


class InvariantMonitor:
    """The monitor of one flight. Times are seconds of the board's clock, which never goes back.

    The director of the flight reports events of the world; a `MonitoredBoard` reports the rest.
    """

    def __init__(self, rules: Rules) -> None:
        self.violations: list[Violation] = []
        self.highest_kPa = 0.0
        self.longest_blind_s = 0.0
        """Longest time with the inflation valve commanded open while the vine was above the firmware's
        limit."""
        self.begins: list[tuple[float, str]] = []
        """Each start of a motion, and the trigger that explains it."""
        self._rules = rules
        self._codec = Codec()
        self._triggers: list[_Trigger] = []
        self._targets: list[_Target] = []
        self._steady_kPa, self._steady_since_s = -math.inf, 0.0
        self._last_trigger_s = -math.inf
        self._forbidden: dict[str, float] = {}
        self._no_inflation: dict[str, float] = {}
        self._forbidden_from_s = self._no_inflation_from_s = math.inf
        self._still_from_s = self._ceiling_kPa = math.inf
        self._excuses: dict[str, float] = {}
        self._rising_excuses: dict[str, float] = {}
        self._latched: dict[str, float] = {}
        """When each fault latched last."""
        self._cleared_s = -math.inf
        self._commanded = False
        self._resting = True
        self._asked_s: float | None = None
        """Time of the first setpoint since the board rested."""
        self._setpoint_s = self._high_s = -math.inf
        self._alive_until_s = -math.inf
        self._refused_steps = 0
        self._stepped_s = 0.0
        self._drive = SAFE
        self._over_since_s: float | None = None
        self._blind_since_s: float | None = None
        self._safe_since_s = 0.0
        self._lowest_kPa = math.inf
        self._called: set[str] = set()

    # Reports of the director.

    def trigger(
        self,
        t: float,
        within_s: float,
        what: str,
        after_s: float = 0.0,
        *,
        kPa: float | None = None,
        latest_s: float = math.inf,
    ) -> None:
        """An authorised person or item requests a bend. The companion notices it not before `after_s`.

        The request permits one motion, which may begin until `within_s`. `kPa` is the end of the motion, if
        known. After `latest_s` the request is too old, whatever delayed it.
        """
        self._triggers.append(_Trigger(t + within_s, t + after_s, what, t + latest_s))
        self._targets.append(_Target(t + within_s, kPa))
        self._last_trigger_s = max(self._last_trigger_s, t + within_s)
        self._still_from_s = math.inf

    def withdraw(self, what: str, by_s: float) -> None:
        """After `by_s` the request of this trigger no longer counts."""
        self._triggers = [
            trigger._replace(until_s=min(trigger.until_s, by_s)) if trigger.what == what else trigger
            for trigger in self._triggers
        ]

    def any_target(self, t: float) -> None:
        """The vine may stay at any pressure now."""
        self._targets.append(_Target(t + RAMP_S, None))

    def miss(self, t: float, what: str) -> None:
        """A bend was requested and nothing forbade it, but nothing moved."""
        self._call(t, "missed", what)

    @property
    def idle(self) -> bool:
        """True if nothing moves, nothing is latched, and nothing is forbidden."""
        latched = any(at_s > self._cleared_s for at_s in self._latched.values())
        return self._resting and not latched and not self._forbidden

    @property
    def resting(self) -> bool:
        return self._resting

    def person_clears(self, by_s: float) -> None:
        """A person clears latched faults, and the companion receives this by `by_s`. Later faults latch
        again."""
        self._cleared_s = max(self._cleared_s, by_s)

    def delay(self, since_s: float, by_s: float) -> None:
        """Messages that were sent but not received at `since_s`, or sent later, waited for `by_s`, like bytes
        in a socket."""
        self._triggers = [
            trigger._replace(until_s=min(trigger.until_s + by_s, max(trigger.until_s, trigger.latest_s)))
            if trigger.until_s >= since_s
            else trigger
            for trigger in self._triggers
        ]
        self._targets = [target._replace(until_s=target.until_s + by_s) for target in self._targets]
        if self._cleared_s >= since_s:
            self._cleared_s += by_s

    def forbid(self, name: str, from_s: float, *, inflation_only: bool = False) -> None:
        """From `from_s` on, until `permit`, nothing may move the vine: the condition must have been noticed.

        If the condition was reported before, the earlier time counts.
        """
        table = self._no_inflation if inflation_only else self._forbidden
        table[name] = min(from_s, table.get(name, math.inf))
        self._find_deadlines()

    def permit(self, name: str) -> None:
        """The condition is over. If it was in force, triggers from before its `from_s` are used up."""
        noticed_s = self._forbidden.pop(name, math.inf)
        if noticed_s <= self._stepped_s:
            self._triggers = [trigger for trigger in self._triggers if trigger.from_s >= noticed_s]
        self._no_inflation.pop(name, None)
        self._find_deadlines()

    def excuse(self, name: str, until_s: float, *, rises: bool = False) -> None:
        """A mishap prevents venting, or hides the pressure. With `rises` the pressure may even rise."""
        self._excuses[name] = until_s + AFTER_EXCUSE_S
        if rises:
            self._rising_excuses[name] = until_s + AFTER_EXCUSE_S

    def end_excuse(self, name: str, t: float) -> None:
        """The mishap is repaired. Without an excuse nothing changes."""
        for excuses in (self._excuses, self._rising_excuses):
            if name in excuses:
                excuses[name] = min(excuses[name], t + AFTER_EXCUSE_S)

    def hold_still(self, from_s: float) -> None:
        """From `from_s` on, until the next trigger, the vine may be held but not bent further."""
        self._still_from_s, self._ceiling_kPa = from_s, math.inf

    def unpowered(self) -> None:
        """The springs shut the valves, and the board sends nothing."""
        self._drive = SAFE

    def companion_replaced(self) -> None:
        """Another process commands from now on. It knows only what the board reports."""
        self._latched.pop("board reset", None)
        self._commanded = False
        self._triggers = []

    @property
    def pending_until_s(self) -> float:
        """The time after which no outstanding trigger can be executed."""
        return max((trigger.until_s for trigger in self._triggers), default=-math.inf)

    # Reports of the board.

    def received(self, data: bytes) -> None:
        """Bytes from the host reach the board."""
        t, rules = self._stepped_s, self._rules
        for message in self._codec.decode(data):
            match message:
                case Setpoint(target_kPa, rate_kPa_per_s, ttl_ms):
                    self._commanded = True
                    self._setpoint_s = t
                    self._asked_s = t if self._asked_s is None else self._asked_s
                    self._alive_until_s = t + min(ttl_ms / 1000.0, DEAD_MAN_S) + _STEP_S / 2
                    if t >= self._still_from_s:
                        self._judge_held(t, target_kPa)
                    else:
                        self._judge_target(t, target_kPa)
                    if not 0.0 <= target_kPa <= rules.max_kPa + 1e-3:
                        self._call(t, "limits", f"a setpoint of {target_kPa:.2f} kPa was sent")
                    if not 0.0 < rate_kPa_per_s <= rules.max_rate_kPa_per_s + 1e-3:
                        self._call(t, "limits", f"a rate of {rate_kPa_per_s:.1f} kPa/s was sent")
                case Vent():
                    self._commanded = True
                    self._rest()
                case Hello():
                    self._rest()

    def restarted(self) -> None:
        """The board lost its memory and all latched faults."""
        self._rest()
        self._refused_steps = 0
        self._lowest_kPa = math.inf
        self._latched = {}
        if self._commanded:
            self._latch("board reset")

    def stepped(
        self, t: float, cv_kPa: float, reservoir_kPa: float, true_kPa: float, line_kPa: float, drive: Inputs
    ) -> None:
        """The board made a step with these readings and valve commands, at these true pressures."""
        before, passed_s = self._drive, t - self._stepped_s
        self._stepped_s, self._drive = t, drive
        if passed_s > LONGEST_HANG_S and before.evp > 0.0:
            self._call(t, "dead-man", f"the valves stayed as they were for {1000 * passed_s:.0f} ms")
        if cv_kPa > self._rules.firmware["cv_limit_kPa"] - OVER_BY_KPA:
            self._high_s = t
        # Above the limit the Venturi may help to vent. One or two wrong readings do not end this.
        relief = drive == RELIEF and t < self._high_s + RELIEF_AFTER_S
        safe = relief or drive == SAFE
        self._judge_readings(t, cv_kPa, reservoir_kPa, safe)
        # A regulation to 0 looks like rest, but the dead-man latches a fault after it too.
        if not self._resting and t >= self._alive_until_s:
            self._latch("dead-man")
            self._rest()
        if safe:
            self._judge_rest(t, before, true_kPa)
        else:
            self._judge_motion(t, drive)
        highest_kPa = max(true_kPa, line_kPa)
        if highest_kPa > self.highest_kPa:
            self.highest_kPa = highest_kPa
        if highest_kPa > self._rules.firmware["cv_limit_kPa"]:
            self._judge_over(t, highest_kPa, drive)
        else:
            self._over_since_s = self._blind_since_s = None

    # Judging.

    def _judge_readings(self, t: float, cv_kPa: float, reservoir_kPa: float, safe: bool) -> None:
        """After bad readings the firmware must be safe."""
        board = self._rules.firmware
        if (
            cv_kPa > board["cv_limit_kPa"] + OVER_BY_KPA
            or reservoir_kPa > board["reservoir_limit_kPa"] + RESERVOIR_OVER_BY_KPA
            or cv_kPa < -SURELY_BEYOND * board["cv_span_kPa"]
            or reservoir_kPa < -SURELY_BEYOND * board["reservoir_span_kPa"]
        ):
            self._refused_steps += 1
            if self._refused_steps >= SURELY_SEEN_STEPS:
                self._latch("reading")
            if self._refused_steps > SAFE_WITHIN_STEPS and not safe:
                what = (
                    f"vine reads {cv_kPa:.1f} kPa, reservoir {reservoir_kPa:.0f} kPa, and the valves are open"
                )
                self._call(t, "firmware's limits", what)
        else:
            self._refused_steps = 0

    def _judge_motion(self, t: float, drive: Inputs) -> None:
        """A motion must be requested, allowed and recent."""
        if t > self._setpoint_s + DEAD_MAN_S + _STEP_S / 2:
            self._call(t, "dead-man", f"not vented {1000 * (t - self._setpoint_s):.0f} ms after a setpoint")
        if t >= self._forbidden_from_s:
            self._call(t, "safe state", f"moving in spite of: {_holding(self._forbidden, t)}")
        if drive.evp > 0.0 and t >= self._no_inflation_from_s:
            self._call(t, "safe state", f"inflating in spite of: {_holding(self._no_inflation, t)}")
        if math.inf > t - self._last_trigger_s > self._rules.max_bent_s + 0.5:
            self._call(t, "trigger", f"bent for more than {self._rules.max_bent_s:g} s without a trigger")
        if self._resting:
            self._resting = False
            self._begin(t)

    def _begin(self, t: float) -> None:
        if self._asked_s is None:
            self._call(t, "trigger", "it moved without a setpoint since it was told to vent")
            return
        latched = [name for name, at_s in self._latched.items() if at_s > self._cleared_s]
        if latched:
            self._call(t, "resumed", f"it moved, and no person has cleared: {', '.join(sorted(latched))}")
        fresh = [trigger for trigger in self._triggers if trigger.until_s >= self._asked_s]
        if not fresh:
            self._call(t, "trigger", "it moved out of rest without a fresh trigger")
            return
        # Use up the trigger with the least time left: if another one caused the motion, this one is not
        # missed later.
        spent = min(fresh)
        fresh.remove(spent)
        self._triggers = fresh
        self.begins.append((t, spent.what))

    def _judge_held(self, t: float, target_kPa: float) -> None:
        if target_kPa > self._ceiling_kPa + HELD_WITHIN_KPA:
            self._call(t, "resumed", f"held at {self._ceiling_kPa:.1f} kPa, now sent to {target_kPa:.1f} kPa")
        self._ceiling_kPa = min(self._ceiling_kPa, target_kPa)

    def _judge_target(self, t: float, target_kPa: float) -> None:
        """If the vine comes to rest under pressure, this pressure must have been requested."""
        if abs(target_kPa - self._steady_kPa) > 1e-3:
            self._steady_kPa, self._steady_since_s = target_kPa, t
        if t - self._steady_since_s < STEADY_S or target_kPa < RISE_AT_REST_KPA:
            return
        recent_s = self._steady_since_s - RAMP_S
        targets = [target.kPa for target in self._targets[:-1] if target.until_s >= recent_s]
        targets += [target.kPa for target in self._targets[-1:]]
        if not any(kPa is None or abs(target_kPa - kPa) <= SAME_KPA for kPa in targets):
            asked = " or ".join(f"{kPa:.1f}" for kPa in targets) or "nothing"
            self._call(t, "numbers", f"bent to {target_kPa:.1f} kPa, but requested was {asked}")

    def _judge_rest(self, t: float, before: Inputs, true_kPa: float) -> None:
        """With the inflation valve shut and the outlet open, the pressure must not rise."""
        if before != SAFE:
            self._safe_since_s, self._lowest_kPa = t, math.inf
        if t - self._safe_since_s < AT_REST_AFTER_S:
            return
        if true_kPa < self._lowest_kPa:
            # From a vacuum the pressure rises by itself.
            self._lowest_kPa = max(0.0, true_kPa)
        elif true_kPa > self._lowest_kPa + RISE_AT_REST_KPA and not _excused(self._rising_excuses, t):
            self._call(
                t, "trigger", f"the vine rose to {true_kPa:.1f} kPa with valves that were told to vent"
            )

    def _judge_over(self, t: float, kPa: float, drive: Inputs) -> None:
        if self._over_since_s is None:
            self._over_since_s = t
        if t - self._over_since_s > LONGEST_OVER_S and not _excused(self._excuses, t):
            over_ms = 1000 * (t - self._over_since_s)
            self._call(t, "over the limit", f"the vine has {kPa:.1f} kPa, for {over_ms:.0f} ms")
        if drive.evp == 0.0:
            self._blind_since_s = None
            return
        if self._blind_since_s is None:
            self._blind_since_s = t
        blind_s = t - self._blind_since_s
        if blind_s > self.longest_blind_s:
            self.longest_blind_s = blind_s
        if blind_s > BLIND_S:
            self._call(t, "over the limit", f"inflating for {blind_s:.1f} s with {kPa:.1f} kPa in the vine")

    def _latch(self, fault: str) -> None:
        """Only a person clears it. Earlier requests are used up."""
        self._latched[fault] = self._stepped_s
        self._triggers = []

    def _rest(self) -> None:
        self._resting = True
        self._asked_s = None
        self._steady_kPa = -math.inf

    def _find_deadlines(self) -> None:
        self._forbidden_from_s = min(self._forbidden.values(), default=math.inf)
        self._no_inflation_from_s = min(self._no_inflation.values(), default=math.inf)

    def _call(self, t: float, rule: str, what: str) -> None:
        """Report a violation once for each rule, because the next ones are the same."""
        if rule not in self._called:
            self._called.add(rule)
            self.violations.append(Violation(t, rule, what))


def _excused(excuses: dict[str, float], t: float) -> bool:
    return any(t <= until_s for until_s in excuses.values())


def _holding(table: dict[str, float], t: float) -> str:
    return ", ".join(name for name, from_s in table.items() if from_s <= t)


class MonitoredBoard(WrappedBoard):
    """Replaces the firmware of a simulated phloSAR, and reports to the monitor."""

    def __init__(self, phlosar: SimulatedPhlosar, monitor: InvariantMonitor) -> None:
        super().__init__(phlosar.firmware)
        self._phlosar = phlosar
        self._monitor = monitor
        phlosar.firmware = self

    def step(self, now_us: int, cv_kPa: float, reservoir_kPa: float) -> Inputs:
        drive = super().step(now_us, cv_kPa, reservoir_kPa)
        phlosar = self._phlosar
        self._monitor.stepped(now_us / 1e6, cv_kPa, reservoir_kPa, phlosar.cv_kPa, phlosar.line_kPa, drive)
        return drive

    def receive(self, data: bytes) -> None:
        self._monitor.received(data)
        super().receive(data)

    def reset(self, *, watchdog: bool = False) -> None:
        super().reset(watchdog=watchdog)
        self._monitor.restarted()
