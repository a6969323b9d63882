"""A referee at the valves of a simulated phloSAR: what must never happen, whatever the cause.

It goes by facts alone: the bytes that reach the board, what its sensors say and its valves are told, the true
pressures, and what whoever directs the flight knows to have happened. What the service or the firmware
thinks of it is never asked. What it calls, and why a few things are excused: docs/campaign.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from wrapped_board import WrappedBoard

from firmware_link.protocol import Codec, Hello, Setpoint, Vent
from flying_vines.physics.baseline import Inputs
from flying_vines.simulation.phlosar.firmware import Firmware
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.simulation.phlosar.regulator import SAFE

DEAD_MAN_S = 0.300
SAFE_WITHIN_STEPS = 10
"""Of the firmware, from the first reading that must not be to valves that are safe: 10 ms."""
RELIEF = Inputs(0.0, 1.0, True)
RELIEF_AFTER_S = 0.005
SURELY_SEEN_STEPS = 5
"""So many such readings in a row, and the fault is latched."""
LONGEST_OVER_S = 0.020
BLIND_S = 1.0
"""Told to inflate for longer than that with the vine over the limit: nobody noticed the wrong sensor."""
LONGEST_HANG_S = 0.260
"""The board's watchdog and a few steps."""
AFTER_EXCUSE_S = 1.0
"""What was excused may take so long to get well: a vine above the limit has to be let out."""
SURELY_BEYOND = 0.11
"""Of a sensor's span, either way: more than any sensor says whose wires are whole."""
OVER_BY_KPA, BOTTLE_OVER_BY_KPA = 0.5, 3.0
"""Converter and rounding: a reading that is so far above a limit is above it for the firmware, too."""
HELD_WITHIN_KPA = 0.01
AT_REST_AFTER_S = 0.1
RISE_AT_REST_KPA = 1.0
STEADY_S = 0.3
"""A setpoint that stays for so long is where a motion was to end."""
SAME_KPA = 0.4
RAMP_S = 1.5
"""From a trigger to where it ends."""
_STEP_S = 0.001


class Foul(NamedTuple):
    """What must never happen, did."""

    t: float
    rule: str
    what: str

    def __str__(self) -> str:
        return f"{self.t:.3f} s: {self.rule}: {self.what}"


@dataclass(frozen=True)
class Rules:
    """What this flight's profile and firmware promise. Gauge kPa."""

    max_kPa: float
    max_rate_kPa_per_s: float
    max_bent_s: float
    firmware: Mapping[str, float] = field(default_factory=lambda: Firmware().settings)


class _Trigger(NamedTuple):
    until_s: float
    from_s: float
    what: str
    latest_s: float = math.inf
    """Not later than that, however long it is held up."""


class _Target(NamedTuple):
    """Where a trigger sends the vine; unknown for a profile, and where it is held."""

    until_s: float
    kPa: float | None


class Referee:
    """One flight's. Times are seconds of the board's clock, which never goes back.

    Whoever directs the flight says what happens in the world; a `RefereedBoard` says the rest.
    """

    def __init__(self, rules: Rules) -> None:
        self.fouls: list[Foul] = []
        self.highest_kPa = 0.0
        self.longest_blind_s = 0.0
        """For how long at most the inflation valve was told open with the vine over the firmware's limit."""
        self.begins: list[tuple[float, str]] = []
        """Each time that the vine began to move out of rest, and the trigger that it is put down to."""
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
        """When each fault was last seen to latch."""
        self._cleared_s = -math.inf
        self._commanded = False
        self._resting = True
        self._asked_s: float | None = None
        """When the first setpoint came since it rested."""
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

    # What the director knows.

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
        """Somebody who may asked for a bend, which takes `after_s` to be seen.

        Out of rest it has to begin within so long, and only once. `kPa` is where it ends, if that is known.
        `latest_s`: whatever holds it up, it is too old after that.
        """
        self._triggers.append(_Trigger(t + within_s, t + after_s, what, t + latest_s))
        self._targets.append(_Target(t + within_s, kPa))
        self._last_trigger_s = max(self._last_trigger_s, t + within_s)
        self._still_from_s = math.inf

    def withdraw(self, what: str, by_s: float) -> None:
        """Whoever asked for it by this trigger does so no longer."""
        self._triggers = [
            trigger._replace(until_s=min(trigger.until_s, by_s)) if trigger.what == what else trigger
            for trigger in self._triggers
        ]

    def any_target(self, t: float) -> None:
        """The vine may stay wherever it is now."""
        self._targets.append(_Target(t + RAMP_S, None))

    def miss(self, t: float, what: str) -> None:
        """Somebody asked for a bend, nothing was against it, and nothing moved."""
        self._call(t, "missed", what)

    @property
    def idle(self) -> bool:
        """Nothing moves, nothing is latched, and nothing is forbidden."""
        latched = any(at_s > self._cleared_s for at_s in self._latched.values())
        return self._resting and not latched and not self._forbidden

    @property
    def resting(self) -> bool:
        return self._resting

    def person_clears(self, by_s: float) -> None:
        """A person did what clears latched faults, and is heard by then; what comes later latches again."""
        self._cleared_s = max(self._cleared_s, by_s)

    def delay(self, since_s: float, by_s: float) -> None:
        """What was said and not yet heard then waited for so long, as bytes in a socket do."""
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
        """From then on, and until it is permitted, nothing may move the vine: it must have been noticed.

        The earlier time counts when it is forbidden already.
        """
        table = self._no_inflation if inflation_only else self._forbidden
        table[name] = min(from_s, table.get(name, math.inf))
        self._find_deadlines()

    def permit(self, name: str) -> None:
        """It is over. What was heard of before it must have been noticed is spent."""
        noticed_s = self._forbidden.pop(name, math.inf)
        if noticed_s <= self._stepped_s:
            self._triggers = [trigger for trigger in self._triggers if trigger.from_s >= noticed_s]
        self._no_inflation.pop(name, None)
        self._find_deadlines()

    def excuse(self, name: str, until_s: float, *, rises: bool = False) -> None:
        """A mishap that lets no venting hold the pressure, or hides it; it may even rise on its own."""
        self._excuses[name] = until_s + AFTER_EXCUSE_S
        if rises:
            self._rising_excuses[name] = until_s + AFTER_EXCUSE_S

    def end_excuse(self, name: str, t: float) -> None:
        """The mishap is mended; where nothing was excused, nothing is."""
        for excuses in (self._excuses, self._rising_excuses):
            if name in excuses:
                excuses[name] = min(excuses[name], t + AFTER_EXCUSE_S)

    def hold_still(self, from_s: float) -> None:
        """From then on, and until the next trigger, the vine may be held but not bent further."""
        self._still_from_s, self._ceiling_kPa = from_s, math.inf

    def unpowered(self) -> None:
        """The springs shut the valves, and the board says nothing more."""
        self._drive = SAFE

    def companion_replaced(self) -> None:
        """Another process commands from now on, which knows of nothing that the board does not tell."""
        self._latched.pop("board reset", None)
        self._commanded = False
        self._triggers = []

    @property
    def pending_until_s(self) -> float:
        """When no trigger that is not carried out yet can be any more."""
        return max((trigger.until_s for trigger in self._triggers), default=-math.inf)

    # What the board knows.

    def heard(self, data: bytes) -> None:
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
        """The board lost its memory, and everything that it had latched."""
        self._rest()
        self._refused_steps = 0
        self._lowest_kPa = math.inf
        self._latched = {}
        if self._commanded:
            self._latch("board reset")

    def stepped(
        self, t: float, cv_kPa: float, reservoir_kPa: float, true_kPa: float, line_kPa: float, drive: Inputs
    ) -> None:
        """The board read this, and told its valves that; the true pressures are those of now."""
        before, passed_s = self._drive, t - self._stepped_s
        self._stepped_s, self._drive = t, drive
        if passed_s > LONGEST_HANG_S and before.evp > 0.0:
            self._call(t, "dead-man", f"the valves stayed as they were for {1000 * passed_s:.0f} ms")
        if cv_kPa > self._rules.firmware["cv_limit_kPa"] - OVER_BY_KPA:
            self._high_s = t
        # Over the limit the Venturi may help to let it out; a wild reading or two do not end that.
        relief = drive == RELIEF and t < self._high_s + RELIEF_AFTER_S
        safe = relief or drive == SAFE
        self._judge_readings(t, cv_kPa, reservoir_kPa, safe)
        # A regulation to nothing looks like rest, but ends in the same fault.
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
        """The firmware ends what it does over readings that must not be."""
        board = self._rules.firmware
        if (
            cv_kPa > board["cv_limit_kPa"] + OVER_BY_KPA
            or reservoir_kPa > board["reservoir_limit_kPa"] + BOTTLE_OVER_BY_KPA
            or cv_kPa < -SURELY_BEYOND * board["cv_span_kPa"]
            or reservoir_kPa < -SURELY_BEYOND * board["reservoir_span_kPa"]
        ):
            self._refused_steps += 1
            if self._refused_steps >= SURELY_SEEN_STEPS:
                self._latch("reading")
            if self._refused_steps > SAFE_WITHIN_STEPS and not safe:
                what = f"vine reads {cv_kPa:.1f} kPa, bottle {reservoir_kPa:.0f} kPa, and the valves are open"
                self._call(t, "firmware's limits", what)
        else:
            self._refused_steps = 0

    def _judge_motion(self, t: float, drive: Inputs) -> None:
        """Whatever is not safe has to be asked for, allowed and fresh."""
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
        # Whichever has the least time left: if any other did it, this one is not missed later.
        spent = min(fresh)
        fresh.remove(spent)
        self._triggers = fresh
        self.begins.append((t, spent.what))

    def _judge_held(self, t: float, target_kPa: float) -> None:
        if target_kPa > self._ceiling_kPa + HELD_WITHIN_KPA:
            self._call(t, "resumed", f"held at {self._ceiling_kPa:.1f} kPa, now sent to {target_kPa:.1f} kPa")
        self._ceiling_kPa = min(self._ceiling_kPa, target_kPa)

    def _judge_target(self, t: float, target_kPa: float) -> None:
        """Where it comes to rest under pressure, somebody asked for just that."""
        if abs(target_kPa - self._steady_kPa) > 1e-3:
            self._steady_kPa, self._steady_since_s = target_kPa, t
        if t - self._steady_since_s < STEADY_S or target_kPa < RISE_AT_REST_KPA:
            return
        recent_s = self._steady_since_s - RAMP_S
        targets = [target.kPa for target in self._targets[:-1] if target.until_s >= recent_s]
        targets += [target.kPa for target in self._targets[-1:]]
        if not any(kPa is None or abs(target_kPa - kPa) <= SAME_KPA for kPa in targets):
            asked = " or ".join(f"{kPa:.1f}" for kPa in targets) or "nothing"
            self._call(t, "numbers", f"bent to {target_kPa:.1f} kPa, and asked was for {asked}")

    def _judge_rest(self, t: float, before: Inputs, true_kPa: float) -> None:
        """With the inflation valve shut and the outlet open, no pressure comes from nowhere."""
        if before != SAFE:
            self._safe_since_s, self._lowest_kPa = t, math.inf
        if t - self._safe_since_s < AT_REST_AFTER_S:
            return
        if true_kPa < self._lowest_kPa:
            # Out of a vacuum it comes back by itself.
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
        """Only a person ends it, and what was asked for before is spent."""
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
        """Once for each rule: what follows is the same."""
        if rule not in self._called:
            self._called.add(rule)
            self.fouls.append(Foul(t, rule, what))


def _excused(excuses: dict[str, float], t: float) -> bool:
    return any(t <= until_s for until_s in excuses.values())


def _holding(table: dict[str, float], t: float) -> str:
    return ", ".join(name for name, from_s in table.items() if from_s <= t)


class RefereedBoard(WrappedBoard):
    """Takes the place of a simulated phloSAR's firmware, and tells the referee what it sees there."""

    def __init__(self, phlosar: SimulatedPhlosar, referee: Referee) -> None:
        super().__init__(phlosar.firmware)
        self._phlosar = phlosar
        self._referee = referee
        phlosar.firmware = self

    def step(self, now_us: int, cv_kPa: float, reservoir_kPa: float) -> Inputs:
        drive = super().step(now_us, cv_kPa, reservoir_kPa)
        phlosar = self._phlosar
        self._referee.stepped(now_us / 1e6, cv_kPa, reservoir_kPa, phlosar.cv_kPa, phlosar.line_kPa, drive)
        return drive

    def receive(self, data: bytes) -> None:
        self._referee.heard(data)
        super().receive(data)

    def reset(self, *, watchdog: bool = False) -> None:
        super().reset(watchdog=watchdog)
        self._referee.restarted()
