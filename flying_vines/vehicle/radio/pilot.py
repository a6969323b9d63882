"""Which moves of the switch the pilot made, and what they request.

A move that straightens the vine counts at once. A move that bends it counts only if the pilot made it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from flying_vines.config.config import Config
from flying_vines.vehicle.autopilots.autopilot import Autopilot
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.notice import Notice, Severity
from flying_vines.vehicle.radio.rc import RadioLink, RadioParameters
from flying_vines.vehicle.radio.switch import MovedUnseen, SwitchMove, SwitchReader
from flying_vines.vehicle.triggers import Rules, Trigger

CONFIRMED_WITHIN_S = 4.0
"""A move is refused if it is not confirmed within this time after the earliest possible confirmation."""
HEALTH_REPORTS_APART_S = 2.0
"""PX4's minimum time between two health reports (min_reporting_interval). So it may report a loss late."""
OVERRIDE_SLACK_S = 0.7
"""Uncertainty of the time at which an override ends."""
MIN_FLICK_S = 1.0
"""A pilot needs up to this time to move the switch down and up. An override that expires so soon looks the
same."""
DEAD_AFTER_S = 5.0
"""A switch that cannot be used for this time after arming is told to the pilot."""
RELEASED_US = 65534
IGNORED_US = (0, 65535)


@dataclass(frozen=True, slots=True)
class Straightened:
    """The pilot straightened the vine while RC was good. This clears the faults latched up to `seen_at`."""

    seen_at: float


PilotOutput = Trigger | Notice | Straightened


@dataclass(slots=True)
class _Waiting:
    """A move that waits for its confirmation: RC must stay good for some time."""

    move: SwitchMove
    before: int
    seen_at: float
    since_s: float | None
    """When the switch came to this position, by the autopilot's clock; None while it is elsewhere."""


class Pilot:
    """Turns moves of the pilot's switch into requests. Sans-IO; all times are seconds of one clock.

    PX4's RC status reports a loss more than a second late, and never reports a short one. During a loss the
    switch's channel may have any value. So a bend waits for the maximum delay of the report, and is carried
    out if the RC status is still good then.
    """

    def __init__(self, config: Config, rules: Rules) -> None:
        self._rules = rules
        self._config = config
        self.radio = RadioLink(config.switch, config.losses.rc_s)
        self.switch = SwitchReader.of(config.switch)
        self.parameters = RadioParameters(config.switch.channel)
        self._waiting: _Waiting | None = None
        self._positions: set[int] = set()
        """Positions since the last confirmed move. A return to one of them does not bend the vine."""
        self._hides_loss = self._other_use = ""
        self._by_station = False
        self._override_ends_at = -math.inf
        self._vented_by: Literal["", "safety", "other"] = ""
        """Who vented the vine, if it was not the switch and nothing has bent it since."""
        self._seen_bent_s = -math.inf
        """When the switch was last seen in a bending position, by the autopilot's clock."""
        self._dead_at: float | None = None
        """When to say that the switch does nothing; infinite if it was usable in this flight, or was said."""
        self._left_bend_s: float | None = None
        """The same, before the switch last went to a straight position since that vent. A stalled link or a
        loss of RC delays what we see, so an override may have begun soon after this time."""

    @property
    def channel(self) -> int:
        return self._config.switch.channel

    def configure(self, config: Config) -> None:
        """One of our parameters has changed."""
        self.radio.configure(config.switch, config.losses.rc_s)
        if config.switch != self._config.switch:
            self.switch = SwitchReader.of(config.switch)
            self._waiting = None
        self.parameters.channel = config.switch.channel
        self._config = config

    def forget(self) -> None:
        """Forget the state of the radio. The switch acts only after a new move."""
        self.radio.forget()
        self._lose()

    def restarted(self) -> None:
        self.forget()
        self.parameters.forget()
        self._seen_bent_s, self._left_bend_s = -math.inf, None

    def drop_waiting(self) -> None:
        """Drop a waiting move, because something newer has happened."""
        if self._waiting is not None:
            self._positions.add(self._waiting.move.position)
        self._waiting = None

    def vented(self, by: Literal["safety", "other"]) -> None:
        """Safety or another person, mission or package vented the vine.

        When an RC override ends, the switch seems to move, and nothing distinguishes this from a move of the
        pilot. So the switch must then go from a bending position to a straight one and back. If it was no
        loss or fault that vented, a ground station may use overrides to keep the vine straight: then the
        switch must come back faster than an override expires.
        """
        self.drop_waiting()
        self._vented_by = "other" if self._vented_by == "other" else by
        self._left_bend_s = None

    def bent_by_other(self) -> None:
        """Another person, mission or package bent the vine."""
        self.drop_waiting()
        self._vented_by = ""

    def handle(
        self, t: float, message: MavlinkMessage, autopilot: Autopilot, vented: bool = False
    ) -> list[PilotOutput]:
        """Take in a message of our autopilot.

        `vented`: the vine is vented and no motion runs.
        """
        self.radio.autopilot = autopilot
        kind = message.get_type()
        if kind == "PARAM_VALUE":
            return self._report_parameters(t) if self.parameters.handle(autopilot, message) else []
        if kind == "RC_CHANNELS" and self.radio.is_outdated(message):
            return []
        self.radio.handle(t, message)
        if kind == "RC_CHANNELS":
            return self._sample(t, vented)
        return [*self._report_source(t), *self._confirm(t)] if kind == "SYS_STATUS" else []

    def override(self, t: float, message: MavlinkMessage) -> None:
        """A ground station's RC_CHANNELS_OVERRIDE, if the autopilot forwards it to us."""
        pulse_us = getattr(message, f"chan{self.channel}_raw")
        released = pulse_us == RELEASED_US or (pulse_us == 0 and self.channel <= 8)
        if released:
            self._override_ends_at = t
        elif pulse_us not in IGNORED_US:
            self._override_ends_at = t + self._override_lasts_s

    def tick(self, t: float) -> list[PilotOutput]:
        if self.radio.problem(t) is not None:
            self._lose()
        waiting = self._waiting
        if waiting is None or t - waiting.seen_at < self._confirmed_after_s + CONFIRMED_WITHIN_S:
            return []
        self._waiting = None
        if not self._waits_to_bend(waiting):
            return []
        return [self._refused(t, waiting.move, "the autopilot does not confirm RC, move it again")]

    def dead_switch(self, t: float, armed: bool) -> list[PilotOutput]:
        """Say once after arming why the switch does nothing. If it was usable before, RC was lost."""
        problem = self.radio.problem(t)
        if not armed or not any(self._config.switch.positions):
            self._dead_at = None
        elif self._dead_at is None:
            self._dead_at = t + DEAD_AFTER_S
        elif problem is None:
            self._dead_at = math.inf
        elif t >= self._dead_at:
            self._dead_at = math.inf
            return [Notice(t, Severity.WARNING, f"Vine: switch ch{self.channel} does nothing: {problem}")]
        return []

    @property
    def fresh_move(self) -> str:
        """The moves after which the switch bends the vine again, such as "switch down, then up".

        Empty if the switch is not in a bending position, or if its move there waits for a confirmation.
        """
        position = self.switch.last_position
        confirming = self._waiting is not None and self._waits_to_bend(self._waiting)
        if position is None or confirming or not self._rules.bends(position):
            return ""
        others = [other for other in range(len(self._config.switch.positions)) if other != position]
        if self._vented_by == "other" and not self._can_flick:
            return f"RC_OVERRIDE_TIME of {MIN_FLICK_S + OVERRIDE_SLACK_S:.1f} s or more"
        straight = [other for other in others if not self._rules.bends(other)] or others
        nearest = min(straight, key=lambda other: abs(other - position))
        away, back = ("down", "up") if nearest < position else ("up", "down")
        return f"switch {away}{self._held(position, nearest)}, then {back}{self._in_time}"

    def requests(self, t: float, system_id: int, autopilot: Autopilot) -> list[MavlinkMessage]:
        return self.parameters.requests(t, system_id, autopilot)

    @property
    def hides_loss(self) -> str:
        """The setting that makes a loss of RC undetectable; empty if there is none."""
        if self._config.switch.receiver_failsafe == "hidden":
            return "switch.receiver_failsafe"
        if self.radio.autopilot.needs_rc_status and not self.radio.by_receiver:
            return ""
        return self.radio.autopilot.hides_rc_loss(self.parameters.values)

    @property
    def other_use(self) -> str:
        """The autopilot's parameter that gives the switch's channel another use; empty if there is none."""
        return self.radio.autopilot.other_use(self.channel, self.parameters.values)

    @property
    def mode_channel(self) -> int:
        """The RC channel of the autopilot's flight mode; 0 if it is not known."""
        return int(self.parameters.values.get(self.radio.autopilot.mode_channel_parameter, 0.0))

    @property
    def _override_lasts_s(self) -> float:
        return self.radio.autopilot.override_lasts_s(self.parameters.values)

    @property
    def _loss_shows_within_s(self) -> float:
        return self.radio.autopilot.rc_loss_shows_within_s(self.parameters.values)

    @property
    def _flick_s(self) -> float:
        """Maximum time that the switch may be straight in a fresh move after somebody vented."""
        return self._override_lasts_s - OVERRIDE_SLACK_S

    @property
    def _can_flick(self) -> bool:
        """False if a pilot cannot move the switch down and up before an override expires."""
        return self._override_lasts_s == 0.0 or self._flick_s >= MIN_FLICK_S

    @property
    def _in_time(self) -> str:
        limited = self._vented_by == "other" and 0.0 < self._override_lasts_s < math.inf
        return f" within {math.floor(self._flick_s)} s" if limited else ""

    def _held(self, position: int, straight: int) -> str:
        """The time that the switch must be straight, so that its return to `position` bends the vine."""
        if position not in self._positions or not self._must_wait(straight):
            return ""
        longest_s = self._loss_shows_within_s + HEALTH_REPORTS_APART_S + self._config.switch.debounce_s
        return f" for {math.ceil(longest_s)} s"

    def _lose(self) -> None:
        self.switch.lose()
        self._waiting = None

    def _report_parameters(self, t: float) -> list[PilotOutput]:
        out: list[PilotOutput] = []
        use, before = self.other_use, self._other_use
        self._other_use = use
        if use and use != before:
            out.append(Notice(t, Severity.WARNING, f"Vine: switch ch{self.channel} has two uses: {use}"))
        hides, before = self.hides_loss, self._hides_loss
        self._hides_loss = hides
        if hides and hides != before:
            out.append(Notice(t, Severity.WARNING, f"Vine: {hides} hides RC loss: switch cannot bend"))
        elif before and not hides:
            out.append(Notice(t, Severity.NOTICE, "Vine: RC loss is detectable again: switch can bend"))
        return out

    def _report_source(self, t: float) -> list[PilotOutput]:
        by_station, before = self.radio.by_station, self._by_station
        self._by_station = by_station
        if not by_station or before:
            return []
        return [Notice(t, Severity.NOTICE, "Vine: RC comes from a ground station")]

    def _sample(self, t: float, vented: bool) -> list[PilotOutput]:
        radio = self.radio
        interrupted, problem = radio.take_interruption(), radio.problem(t)
        if interrupted or problem is not None:
            self._lose()
        if problem is not None:
            return []
        if self._waiting is not None:
            self._keep_waiting(self._waiting)
        if self._rules.bends(self.switch.reads(radio.switch_us)):
            self._seen_bent_s = radio.stamp_s
        event = self.switch.sample(t, radio.switch_us, radio.jumped)
        if isinstance(event, SwitchMove):
            return self._moved(t, event, vented)
        if event is not None:
            self._positions = {event.position}
        if not isinstance(event, MovedUnseen):
            return []
        self._note_straight(event)
        return [self._move_again(t, "moved while RC was lost")]

    def _note_straight(self, move: SwitchMove | MovedUnseen) -> None:
        if self._rules.bends(move.before) and not self._rules.bends(move.position):
            self._left_bend_s = self._seen_bent_s

    def _keep_waiting(self, waiting: _Waiting) -> None:
        if self.switch.reads(self.radio.switch_us) != waiting.move.position:
            waiting.since_s = None
        elif waiting.since_s is None:
            waiting.since_s = self.radio.stamp_s

    def _moved(self, t: float, move: SwitchMove, vented: bool) -> list[PilotOutput]:
        waiting, self._waiting = self._waiting, None
        unconfirmed = waiting if waiting is not None and self._waits_to_bend(waiting) else None
        origin = unconfirmed.before if unconfirmed else move.before
        bends = self._rules.bends(move.position)
        if move.position == origin and (bends or vented):
            hold_s = self._loss_shows_within_s
            text = f"Vine: hold switch ch{self.channel} for {hold_s:.1f} s to bend"
            return [Notice(t, Severity.INFO, text)]
        self._note_straight(move)
        must_wait = self._must_wait(move.position)
        if bends and (why := self._why_not_the_pilots(t, move)):
            return [self._move_again(t, why)]
        if bends and self.channel == self.mode_channel:
            return [self._refused(t, move, f"channel {self.channel} is the flight mode's")]
        if bends and (hides := self.hides_loss):
            return [self._refused(t, move, f"{hides} hides a lost transmitter")]
        if must_wait:
            self._waiting = _Waiting(move, origin, t, self.radio.stamp_s)
        if bends:
            self._vented_by = ""
            return [] if must_wait else self._bend(t, move)
        if not must_wait:
            self._positions = {move.position}
        return self._request(t, move, by_person=not (must_wait or move.jumped))

    def _bend(self, t: float, move: SwitchMove) -> list[PilotOutput]:
        """Act on a bending move that is confirmed or needs no confirmation."""
        was_there = move.position in self._positions
        self._positions = {move.position}
        if was_there:
            return [self._notice(t, "is back where it was", self.fresh_move)]
        return self._request(t, move, by_person=True)

    def _why_not_the_pilots(self, t: float, move: SwitchMove) -> str:
        """Why this move may not be the pilot's; empty if it is."""
        if move.jumped:
            return "moved with other channels"
        if self._override_lasts_s and abs(t - self._override_ends_at) < OVERRIDE_SLACK_S:
            return "moved as an override ended"
        return "was overruled" if self._vented_by and not self._is_fresh(move) else ""

    def _is_fresh(self, move: SwitchMove) -> bool:
        """True if the switch comes from a straight position.

        If overrides expire, it must also have gone there from a bending position since the vent, after a vent
        by others sooner than an override expires.
        """
        if self._rules.bends(move.before):
            return False
        if self._override_lasts_s == 0.0:
            return True
        left_s = self._left_bend_s
        if left_s is None:
            return False
        straight_s = self.radio.stamp_s - left_s - self._config.switch.debounce_s
        return self._vented_by != "other" or (self._can_flick and straight_s <= self._flick_s)

    def _waits_to_bend(self, waiting: _Waiting) -> bool:
        return self._rules.bends(waiting.move.position)

    def _must_wait(self, position: int) -> bool:
        if self._loss_shows_within_s == 0.0 or not self.radio.by_receiver:
            return False
        failsafe = self._config.switch.receiver_failsafe
        if isinstance(failsafe, int):
            return self.switch.reads(failsafe) == position
        return failsafe == "unknown"

    @property
    def _confirmed_after_s(self) -> float:
        """Time from the debounced move to the earliest confirmation."""
        return self._loss_shows_within_s - self._config.switch.debounce_s

    def _confirm(self, t: float) -> list[PilotOutput]:
        waiting = self._waiting
        if waiting is None or waiting.since_s is None:
            return []
        wait_s = self._confirmed_after_s
        # After a health report PX4 may delay the next report by `HEALTH_REPORTS_APART_S`, so wait longer. If
        # the next report shows a loss, the wait is longer again, but the loss drops the move.
        if self.radio.health_changed_since(waiting.since_s - HEALTH_REPORTS_APART_S):
            wait_s += HEALTH_REPORTS_APART_S
        if self.radio.stamp_s - waiting.since_s < wait_s:
            return []
        self._waiting = None
        if self._waits_to_bend(waiting):
            return self._bend(t, waiting.move)
        was_there = waiting.move.position in self._positions
        self._positions = {waiting.move.position}
        return [] if was_there else [Straightened(waiting.seen_at)]

    def _request(self, t: float, move: SwitchMove, *, by_person: bool) -> list[PilotOutput]:
        intent = self._rules.for_position(move.position)
        if intent is None:
            return []
        return [Trigger(t, "switch", self._what(move), intent, by_person=by_person)]

    def _refused(self, t: float, move: SwitchMove, why: str) -> Trigger:
        return Trigger(t, "switch", self._what(move), None, why, by_person=True)

    def _what(self, move: SwitchMove) -> dict[str, object]:
        return {"channel": self.channel, "position": move.position, "from": move.before}

    def _move_again(self, t: float, what: str) -> Notice:
        return self._notice(t, what, self.fresh_move if self._vented_by else "")

    def _notice(self, t: float, what: str, fresh_move: str) -> Notice:
        how = f"to bend: {fresh_move}" if fresh_move else "move it again"
        return Notice(t, Severity.NOTICE, f"Vine: switch ch{self.channel} {what}, {how}")
