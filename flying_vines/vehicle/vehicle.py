"""One vehicle: messages in; triggers, notices and our own messages out."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence

from flying_vines.config.config import Config
from flying_vines.vehicle.clock import Mark, TimesyncRequests
from flying_vines.vehicle.commands import CommandReceiver
from flying_vines.vehicle.component import Component
from flying_vines.vehicle.component.parameters import Changed
from flying_vines.vehicle.mavlink import handled_messages as handled
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.mission.item import Execution, MissionItem
from flying_vines.vehicle.mission.mission_cache import MissionCache
from flying_vines.vehicle.notice import Notice, Severity
from flying_vines.vehicle.radio.pilot import Pilot, Straightened
from flying_vines.vehicle.radio.rc import RadioLink
from flying_vines.vehicle.radio.switch import SwitchReader
from flying_vines.vehicle.state import Ambiguous, AutopilotFound, OtherComponent, OtherHeard, VehicleState
from flying_vines.vehicle.streams import Streams
from flying_vines.vehicle.triggers import Rules, Trigger, messages_of, own_triggers
from flying_vines.vine.intent import VentVine

VehicleOutput = Trigger | Notice | Straightened | Changed | MavlinkMessage
"""Outputs to the core: requests to decide on, notices, changed parameters and messages to send."""

MAX_WAITING = 50
"""Queue length for commands of unknown age. A command waits 0.3 s at most. If more come, the oldest
one counts as a minute old: it lets air out, but bends nothing and clears no fault that began meanwhile."""
OVERFLOW_AGE_S = 60.0


class Vehicle:
    """The MAVLink side of one vehicle. Sans-IO; all times are seconds of one clock.

    `mission` is the vehicle's mission if it is already known. `parameters` are the saved parameters.
    """

    def __init__(
        self,
        base: Config,
        mission: Sequence[MissionItem] = (),
        parameters: Mapping[str, float] | None = None,
    ) -> None:
        self.component = Component(base, parameters)
        config = self.component.parameters.config
        self.state = VehicleState(config.vehicle.system_id)
        self._rules = Rules(config)
        self.pilot = Pilot(config, self._rules)
        self.own_triggers = own_triggers(config.triggers)
        self._streams = Streams(config.vehicle.rc_rate_Hz, messages_of(self.own_triggers))
        self._timesync = TimesyncRequests()
        self._missing: list[str] = []
        self.link_closed = False
        self._mission_cache = MissionCache(mission)
        self._take_autopilot(0.0)
        self._waiting: deque[tuple[Mark, MavlinkMessage]] = deque()
        self._commands = CommandReceiver(self._rules, config.vehicle.component_id)

    def _take_autopilot(self, t: float) -> None:
        self._autopilot = self.state.autopilot
        self._watch = self._autopilot.mission_watch(
            self._mission_cache, self._rules.commands, self.state.clock
        )
        self._watch.forget(t)

    @property
    def config(self) -> Config:
        """The configuration with the parameters that are in force."""
        return self.component.parameters.config

    @property
    def rc(self) -> RadioLink:
        return self.pilot.radio

    @property
    def switch(self) -> SwitchReader:
        return self.pilot.switch

    def configure(self) -> None:
        self.pilot.configure(self.config)

    def handle(self, t: float, message: MavlinkMessage, vented: bool = True) -> list[VehicleOutput]:
        """Take in a message of any sender on the link.

        `vented`: the vine is vented and no motion runs. Parameters that affect motion may change only then.
        """
        kind = message.get_type()
        state = self.state
        from_autopilot = state.is_ours(message)
        out: list[VehicleOutput] = []
        if from_autopilot:
            state.clock.frame(t, message.get_seq())
            state.note_frame(t)
        elif self.component.is_duplicate(message, state):
            out.extend(self.component.note_duplicate(t))
            if kind not in handled.COMMANDS:
                return out
        # A later part of a long text may begin like a text of its own.
        if kind not in handled.ALL or (kind == "STATUSTEXT" and message.chunk_seq):
            return self._items(t) if from_autopilot and not self._watch.idle else out
        if kind == "HEARTBEAT":
            out.extend(self._on_heartbeat(t, message))
        elif from_autopilot and kind in handled.STATE and state.handle(t, message):
            out.extend(self._rebooted(t))
        elif from_autopilot and kind == "TIMESYNC":
            requested_at = self._timesync.answered(message)
            if requested_at is not None:
                state.clock.answered(t, requested_at)
        answers = None
        if kind == "HEARTBEAT" or kind in handled.QUESTIONS:
            answers = self.component.handle(t, message, state, vented)
            out.extend(answers or ())
            from_autopilot = state.is_ours(message)  # this HEARTBEAT may have made its sender our autopilot
        if kind in handled.COMMANDS and answers is None and state.found:
            self._waiting.append((state.clock.mark(t), message))
        if self._waiting and (kind in handled.CLOCK or kind in handled.COMMANDS):
            out.extend(self._command_triggers(t))
        if from_autopilot:
            self._streams.handle(t, message)
            if kind in handled.RADIO:
                out.extend(self.pilot.handle(t, message, self._autopilot, vented))
                self.component.parameters.mode_channel = self.pilot.mode_channel
        elif kind == "RC_CHANNELS_OVERRIDE" and message.target_system in (0, state.system_id):
            self.pilot.override(t, message)
        if out and any(isinstance(output, Trigger) and output.by_person for output in out):
            self._watch.forget(t)
        if from_autopilot and kind in handled.MISSION:
            out.extend(self._on_mission(t, message))
        elif from_autopilot and not self._watch.idle:
            out.extend(self._items(t))
        return out

    def _on_mission(self, t: float, message: MavlinkMessage) -> list[VehicleOutput]:
        self._mission_cache.handle(t, message)
        self._watch.handle(t, message)
        out = [*self._mission_cache.acknowledgement(self.state.system_id), *self._items(t)]
        if self._mission_cache.take_change():
            out.append(Notice(t, Severity.NOTICE, "Vine: mission changed, read again"))
        return out

    def _on_heartbeat(self, t: float, message: MavlinkMessage) -> list[VehicleOutput]:
        out: list[VehicleOutput] = []
        before = (self.state.armed, self.state.mode)
        for event in self.state.handle(t, message):
            match event:
                case AutopilotFound(system_id):
                    out.append(Notice(t, Severity.INFO, f"Vine: serving vehicle {system_id}"))
                    changes = self.component.parameters.unbounded_changes()
                    out.extend(Notice(t, Severity.WARNING, f"Vine: {change}") for change in changes)
                case Ambiguous((one, other)):
                    text = f"Vine: autopilots {one} and {other}: set vehicle.system_id"
                    out.append(Notice(t, Severity.ERROR, text))
                case OtherHeard(expected, heard):
                    text = f"Vine: autopilot {expected} expected, {heard} heard: set vehicle.system_id"
                    out.append(Notice(t, Severity.WARNING, text))
                case OtherComponent(system_id, component_id):
                    text = f"Vine: autopilot {system_id} has component id {component_id}: set it to 1"
                    out.append(Notice(t, Severity.WARNING, text))
        if self.state.autopilot is not self._autopilot:
            self._take_autopilot(t)
        if self.state.armed and (self.state.armed, self.state.mode) != before:
            self._mission_cache.refresh(t)
            self.pilot.parameters.refresh()
        return out

    def tick(self, t: float) -> list[VehicleOutput]:
        """The outputs that are due at `t`: triggers, notices, and requests to the autopilot."""
        out: list[VehicleOutput] = []
        out.extend(self.pilot.tick(t))
        if not self.state.found:
            return out
        out.extend(self.pilot.dead_switch(t, self.state.armed))
        out.extend(self._command_triggers(t))
        out.extend(self._items(t))
        out.extend(self._timesync.due(t, self.state.system_id))
        out.extend(self._streams.requests(t, self.state.system_id))
        in_any_order = self._autopilot.gives_items_in_any_order
        out.extend(self._mission_cache.requests(t, self.state.system_id, in_any_order))
        out.extend(self.pilot.requests(t, self.state.system_id, self._autopilot))
        missing = self._streams.missing(t)
        if missing and missing != self._missing:
            text = f"Vine: the autopilot does not send {', '.join(missing)}"
            out.append(Notice(t, Severity.WARNING, text))
        self._missing = missing
        return out

    def link_changed(self, up: bool) -> None:
        """The link to the vehicle came up or went down."""
        self.link_closed = not up
        if up:
            self._streams.forget()
        else:
            self.forget_radio()

    def forget_radio(self) -> None:
        """Forget the state of the radio. The switch acts only after a new move."""
        self.pilot.forget()

    def acknowledge(self, trigger: Trigger, accepted: bool) -> list[MavlinkMessage]:
        """The acknowledgement of the command behind a trigger, if there is one."""
        return self._commands.acknowledge(trigger, accepted)

    def _rebooted(self, t: float) -> list[VehicleOutput]:
        self.component.greet()
        self._streams.forget()
        self.pilot.restarted()
        self._watch.restarted()
        self._mission_cache.mark_outdated(t)
        # If two autopilots send, each return to the other one's clock looks like a reboot.
        severity = Severity.DEBUG if self.state.conflict(t) else Severity.WARNING
        return [
            Notice(t, severity, "Vine: autopilot rebooted, vented"),
            Trigger(t, "link", {"event": "autopilot rebooted"}, VentVine()),
        ]

    def _command_triggers(self, t: float) -> list[VehicleOutput]:
        """The outputs of the waiting commands whose age is known."""
        out: list[VehicleOutput] = []
        state = self.state
        while self._waiting:
            mark, message = self._waiting[0]
            age_s = state.clock.age_s(mark, t)
            if age_s is None and len(self._waiting) <= MAX_WAITING:
                break
            if age_s is None:
                age_s = OVERFLOW_AGE_S
            self._waiting.popleft()
            sender = self.component.sender(message, state)
            out.extend(self._commands.handle(t, message, state.system_id, sender, self._watch, age_s))
        return out

    def _items(self, t: float) -> list[VehicleOutput]:
        """The triggers of mission items that ran, and requests for items whose params may be outdated."""
        watch = self._watch
        out = self._item_triggers(t, watch.due(t))
        out.extend(self._mission_cache.ask(seq, self.state.system_id) for seq in watch.asks(t))
        return out

    def _item_triggers(self, t: float, executions: Sequence[Execution]) -> list[VehicleOutput]:
        out: list[VehicleOutput] = []
        for execution in executions:
            trigger = self._rules.item_trigger(t, execution)
            if execution.changed:
                self._mission_cache.note_change_reported()
                text = f"Vine: mission changed, item {execution.seq}: {trigger.intent or trigger.problem}"
                out.append(Notice(t, Severity.NOTICE, text))
            out.append(trigger)
        return out
