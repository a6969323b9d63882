"""One vehicle as the vine sees it: messages in; triggers, notices and our own messages out."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace

from flying_vines.config.config import CARRIERS, Config
from flying_vines.vehicle.clock import Mark
from flying_vines.vehicle.commands import Commands
from flying_vines.vehicle.component import Component
from flying_vines.vehicle.component.parameters import Changed
from flying_vines.vehicle.mavlink import handled_messages as heard
from flying_vines.vehicle.mavlink.codec import Message
from flying_vines.vehicle.mission.ardupilot import ArduPilotWatch
from flying_vines.vehicle.mission.book import MissionBook
from flying_vines.vehicle.mission.execution import Execution
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.mission.px4 import Px4Watch
from flying_vines.vehicle.notice import Notice, Severity
from flying_vines.vehicle.radio.pilot import Pilot, Straightened
from flying_vines.vehicle.radio.rc import RadioLink
from flying_vines.vehicle.radio.switch import Switch
from flying_vines.vehicle.state import Ambiguous, Found, Rebooted, VehicleState
from flying_vines.vehicle.streams import Streams
from flying_vines.vehicle.triggers import Rules, Trigger
from flying_vines.vine.intent import Vent

Output = Trigger | Notice | Straightened | Changed | Message
"""What follows from a message or from time: something to decide, to tell, to take over, or to send."""


MOST_HELD = 50
"""Commands that wait until it is clear how old they are: for a third of a second at most."""


class Vehicle:
    """Everything on the MAVLink side of one vehicle. Sans-IO; all times are seconds of one clock.

    `mission` is the vehicle's where it is known beforehand, `parameters` are those that were kept.
    """

    def __init__(
        self,
        profile: Config,
        mission: Sequence[MissionItem] = (),
        parameters: Mapping[str, float] | None = None,
    ) -> None:
        self.component = Component(profile, parameters)
        config = self.component.parameters.config
        self.state = VehicleState(config.vehicle.system_id)
        self._rules = Rules(config)
        self.pilot = Pilot(config, self._rules)
        self._streams = Streams(config.vehicle.rc_rate_Hz)
        self._missing: list[str] = []
        self.link_closed = False
        self._book = MissionBook(mission)
        self._ardupilot = ArduPilotWatch(self._book, self._rules.commands, self.state.clock)
        self._px4 = Px4Watch(self._book, self._rules.commands, self.state.clock)
        self._held: deque[tuple[Mark, Message]] = deque(maxlen=MOST_HELD)
        self._commands = Commands(self._rules, config.vehicle.component_id)

    @property
    def config(self) -> Config:
        """The profile with the parameters that are in force."""
        return self.component.parameters.config

    @property
    def rc(self) -> RadioLink:
        return self.pilot.radio

    @property
    def switch(self) -> Switch:
        return self.pilot.switch

    def configure(self) -> None:
        """A parameter has changed."""
        self.pilot.configure(self.config)

    def handle(self, t: float, message: Message, vented: bool = True) -> list[Output]:
        """Take in a message of anyone on the link.

        `vented` says that the vine is straight and that nothing moves it: then parameters that steer it may
        be changed.
        """
        kind = message.get_type()
        from_autopilot = self.state.is_ours(message)
        if from_autopilot:
            self.state.clock.frame(t, message.get_seq())
        if from_autopilot and kind not in heard.STATE:
            self.state.heard(t)
        if kind not in heard.ALL:
            return [*self._watch(t, message)] if from_autopilot else []
        out: list[Output] = []
        before = (self.state.armed, self.state.mode)
        for event in self.state.handle(t, message) if kind in heard.STATE else ():
            match event:
                case Found(system_id):
                    self._px4.forget(t)
                    out.append(Notice(t, Severity.INFO, f"Vine: serving vehicle {system_id}"))
                case Ambiguous((one, other)):
                    text = f"Vine: autopilots {one} and {other}: set vehicle.system_id"
                    out.append(Notice(t, Severity.ERROR, text))
                case Rebooted():
                    out.extend(self._rebooted(t))
        answers = None
        if kind in heard.QUESTIONS or kind == "HEARTBEAT":
            answers = self.component.handle(t, message, self.state, vented)
            out.extend(answers or ())
            from_autopilot = self.state.is_ours(message)  # it may have been the first
        if answers is None and kind in ("COMMAND_LONG", "COMMAND_INT") and self.state.found:
            self._held.append((self.state.clock.mark(t), message))
        if kind in heard.CLOCK or kind in ("COMMAND_LONG", "COMMAND_INT"):
            out.extend(self._command_triggers(t))
        if from_autopilot:
            self._streams.handle(t, message)
            if kind in heard.RADIO:
                out.extend(self.pilot.handle(t, message, self.state.kind, vented))
            if (self.state.armed, self.state.mode) != before and self.state.armed:
                self._book.refresh(t)
                self.pilot.parameters.refresh()
            if kind in heard.MISSION:
                self._book.handle(t, message)
                self._px4.handle(t, message)
                out.extend(self._book.acknowledgement(self.state.system_id))
            out.extend(self._watch(t, message))
            if self._book.tell_anew():
                out.append(Notice(t, Severity.NOTICE, "Vine: mission read anew"))
        elif kind == "RC_CHANNELS_OVERRIDE":
            self.pilot.override(t, message)
        if any(isinstance(output, Trigger) and output.by_person for output in out):
            self._px4.forget(t)
        return out

    def tick(self, t: float) -> list[Output]:
        """Let time pass: waiting triggers, and what we ask of the autopilot."""
        out: list[Output] = []
        out.extend(self.pilot.tick(t))
        if not self.state.found:
            return out
        out.extend(self._command_triggers(t))
        due = self._px4.due(t) if self.state.kind == "px4" else self._ardupilot.due(t)
        out.extend(self._item_triggers(t, due))
        out.extend(self._asks(t))
        out.extend(self._streams.requests(t, self.state.system_id))
        out.extend(self._book.requests(t, self.state.system_id, self.state.kind == "ardupilot"))
        out.extend(self.pilot.requests(t, self.state.system_id, self.state.kind))
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
        """What was heard of the radio no longer holds: the switch waits for a fresh move."""
        self.pilot.forget()

    def acknowledge(self, trigger: Trigger, accepted: bool) -> list[Message]:
        """What is owed to the sender of the command behind a trigger."""
        return self._commands.acknowledge(trigger, accepted)

    def _rebooted(self, t: float) -> list[Output]:
        self.component.greet()
        self._streams.forget()
        self.pilot.restarted()
        self._ardupilot = ArduPilotWatch(self._book, self._rules.commands, self.state.clock)
        self._book.doubt(t)
        return [
            Notice(t, Severity.WARNING, "Vine: autopilot rebooted, vented"),
            Trigger(t, "link", {"event": "autopilot rebooted"}, Vent()),
        ]

    def _command_triggers(self, t: float) -> list[Output]:
        """Of the commands that came, those of which it is clear how old they are."""
        out: list[Output] = []
        px4 = None if self.state.kind == "ardupilot" else self._px4
        while self._held:
            mark, message = self._held[0]
            age_s = self.state.clock.age_s(mark, t)
            if age_s is None:
                break
            self._held.popleft()
            theirs = self.state.is_ours(message)
            from_station = self.component.is_station(message, self.state)
            system_id = self.state.system_id
            found = self._commands.handle(t, message, system_id, theirs, px4, from_station, age_s)
            out.extend(answer for output in found for answer in self._once(t, output))
        return out

    def _asks(self, t: float) -> list[Message]:
        """What the autopilot is asked for because it has just run it."""
        return [self._book.ask(seq, self.state.system_id) for seq in self._ardupilot.asks(t)]

    def _once(self, t: float, output: Trigger | Message) -> list[Output]:
        """Of an item that a script on ArduPilot hands over and that is told by text as well, only one."""
        if not isinstance(output, Trigger) or output.command is None or self.state.kind != "ardupilot":
            return [output]
        if output.kind != "mission_item" or output.command.command != CARRIERS["user_1"]:
            return [output]
        command = output.command
        params = (command.param1, command.param2, command.param3, command.param4)
        execution = self._ardupilot.handed_over(t, params)
        if execution is None:
            return list(self._commands.acknowledge(output, True))
        execution = replace(execution, age_s=output.age_s)
        return [self._rules.item_trigger(t, execution, command)]

    def _watch(self, t: float, message: Message) -> list[Output]:
        if self.state.kind == "px4":
            return []
        return [*self._item_triggers(t, self._ardupilot.handle(t, message)), *self._asks(t)]

    def _item_triggers(self, t: float, executions: Sequence[Execution]) -> list[Output]:
        out: list[Output] = []
        for execution in executions:
            trigger = self._rules.item_trigger(t, execution)
            if execution.anew:
                self._book.told_anew()
                text = f"Vine: mission read anew, item {execution.seq}: {trigger.intent or trigger.problem}"
                out.append(Notice(t, Severity.NOTICE, text))
            out.append(trigger)
        return out
