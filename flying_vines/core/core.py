"""The core: time-stamped events in, actions out. It reads no clock, opens no port and awaits nothing.

One bend, from end to end: a MAVLink message -> vehicle state -> trigger -> intent -> safety -> motion ->
setpoint -> firmware. Back: telemetry -> reservoir estimate -> named values. `run`, `replay` and `demo`
use the same core, so the same events always give the same decisions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from firmware_link import host as fw
from firmware_link import protocol
from flying_vines.config.config import Config
from flying_vines.core.asked import trigger_of
from flying_vines.core.events import (
    UNREQUESTED,
    Action,
    Asked,
    Decision,
    Event,
    Failed,
    FirmwareMessage,
    InternalError,
    KeepBoardSettings,
    KeepDisarmed,
    KeepLatched,
    KeepParameters,
    LinkChanged,
    Measured,
    Said,
    Stop,
    StoredState,
    Tick,
    ToFirmware,
    ToVehicle,
    VehicleMessage,
)
from flying_vines.core.instability import STABLE_AFTER_S, Lateness, OwnLines, Restarts
from flying_vines.core.isolated_parts import IsolatedParts
from flying_vines.core.link_loss import LinkLoss
from flying_vines.core.pending_bend import PendingBend, PendingBendTracker, source
from flying_vines.core.request_lines import RequestLines
from flying_vines.core.safety import BOARD_SETTINGS, LossEnded, ResponseNeeded, Ruling, Safety, SafetyInputs
from flying_vines.core.snapshot import Snapshot
from flying_vines.core.supply_monitor import SupplyMonitor
from flying_vines.core.vine_motion import VineMotion
from flying_vines.supply import Features, RigPrior, nominal
from flying_vines.vehicle.clock import LATE_S
from flying_vines.vehicle.component.parameters import Changed
from flying_vines.vehicle.component.telemetry import VALUE_NAMES
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.notice import Notice, Severity
from flying_vines.vehicle.radio.pilot import Straightened
from flying_vines.vehicle.triggers import Trigger, only_deflates
from flying_vines.vehicle.vehicle import Vehicle, VehicleOutput
from flying_vines.vine.intent import (
    ArmPneumatics,
    BendTo,
    ClearLatchedFaults,
    DisarmPneumatics,
    Hold,
    Intent,
    SetPressure,
    StartBench,
    StartProfile,
    StopBench,
    VentVine,
)
from flying_vines.vine.motion import Motion

TICK_S = 0.02
"""Period of `Tick`. Each tick sends the setpoint for the end of its period."""

LISTEN_FIRST_S = 1.5
"""We wait this long for an autopilot before we send anything."""

BENCH_S = 300.0
"""Bench mode ends this long after the last request of a person."""

AT_ONCE_S = 0.05
"""Requests within this time of each other count as simultaneous."""

VENTING = (VentVine, DisarmPneumatics, StopBench)
MOVING = (StartProfile, BendTo, SetPressure)
_BY_PILOT_OR_SAFETY = {"switch", *UNREQUESTED}
"""Triggers of the pilot's own switch and of safety. All others come from another person, the mission or an
installed package."""
_NEVER_FLOODS = (*_BY_PILOT_OR_SAFETY, "mission_item")

_SENSOR_TEXTS = {
    "cv_kPa": "vine sensor reads",
    "reservoir_kPa": "reservoir sensor reads",
    "setpoint_kPa": "{actuator} setpoint is",
}
"""By telemetry field: the start of the text about an impossible value."""

_RESPONSE_TEXTS = {
    "serial": "its dead-man vents",
    "telemetry": "vent commanded",
    "venting": "outlet commanded open",
    "regulates": "vent commanded",
    "setpoint": "vent commanded",
}
"""For these faults the core cannot see whether the vine is vented. So the text says what is done."""

_BUSY_CAUSES = ("serial", "telemetry", "rc", "autopilot", "late")
"""A computer that is too busy may cause these losses itself. Then its text stands for them."""
VEHICLE_LINK = "vehicle link"
COMPUTER = "this computer"
_CONDITION_NAMES = {
    "rc": "RC",
    "late": VEHICLE_LINK,
    "serial": "{actuator}",
    "telemetry": "{actuator} telemetry",
    "firmware_reset": "{actuator}",
}
"""By safety's name for a loss: the name in texts. All others have the same name in both."""


class Core:
    """One vine on one vehicle. `handle` takes every event, in time order, and returns the actions, in order.

    `mission` is the vehicle's mission if it is already known; otherwise it is read from the autopilot.
    `prior` holds the rig's identified numbers; without it, those of the configuration are used.
    """

    def __init__(
        self,
        base: Config,
        mission: Sequence[MissionItem] = (),
        prior: RigPrior | None = None,
        stored: StoredState | None = None,
    ) -> None:
        stored = stored or StoredState()
        self._vehicle = Vehicle(base, mission, stored.parameters)
        self._link_loss = LinkLoss(self._vehicle)
        config = self.config
        self._rc_in_use = False
        self._firmware = fw.HostSession(repeat_s=TICK_S)
        self._vine = VineMotion(config, self._firmware, TICK_S)
        self._firmware_was_ready = False
        self._ready_text = ""
        """The latest text about a handshake. After a restart of the same firmware it is only logged."""
        self._firmware_problem = "not connected"
        self._safety = Safety(config, stored.latched)
        self._kept_latched = set(stored.latched)
        """The latched faults that were stored last."""
        self._board_settings = stored.board_settings
        """The digest of the board's settings that a person knows; None before the first board."""
        self._parts = IsolatedParts(self._on_failed)
        self._supply = SupplyMonitor(config, prior or nominal(config.pneumatics), stored.learned, self._parts)
        self._actuator = config.firmware.name
        self._silent_since: float | None = None
        self._pending_bend = PendingBendTracker()
        self._waiting_reported: PendingBend | None = None
        """The waiting bend in the latest text to the ground station."""
        self._pneumatics_armed = config.interlocks.armed_at_start and not stored.disarmed
        self._bench_until = -math.inf
        self._requested_at = -math.inf
        self._request_lines = RequestLines()
        self._motion_before: Motion | None = None
        """The motion before the latest request."""
        self._restarts = Restarts(self._actuator)
        self._own_lines = OwnLines()
        self._lateness = Lateness(TICK_S)
        self._busy = False
        """The pilot was told that this computer is too busy."""
        self._excused: dict[str, tuple[float, ResponseNeeded, str]] = {}
        """The losses that the text about the computer stands for: since when, and the vine's response."""
        self._restart_noted = False
        """True from a board restart until the board is ready again."""
        self._stopped = False
        self.internal_error = False
        """A needed part has failed: the vine stays vented until a person restarts the service."""
        self._actions: list[Action] = []

    @property
    def config(self) -> Config:
        """The configuration with the parameters that are in force."""
        return self._vehicle.config

    def handle(self, event: Event) -> list[Action]:
        """The actions that follow from `event`."""
        self._actions = []
        self._lateness.note(event.t)
        match event:
            case VehicleMessage():  # the most frequent event; a pattern with fields takes twice as long
                self._handle_outputs(event.t, self._vehicle.handle(event.t, event.message, self._vine.vented))
                if self._vehicle.own_triggers:
                    self._ask_own_triggers(event.t, event.message)
            case FirmwareMessage(t, message):
                self._on_firmware(t, message)
            case LinkChanged(t, "vehicle", up):
                self._vehicle.link_changed(up)
            case LinkChanged(t, "firmware", up):
                self._on_firmware_link(t, up)
            case Tick(t):
                self._on_tick(t)
            case Asked():
                trigger = trigger_of(event, self.config, self._vehicle.state.armed, self._on_bench)
                self._decide(event.t, trigger)
            case Said(t, severity, text):
                self._notice(t, severity, text)
            case Stop(t):
                self._stop_moving(t)
                self._stopped = True
            case Failed():
                self._on_failed(event)
        if leaving := self._vehicle.component.leaving(event.t):
            self._transmit(leaving)
        return self._actions

    @property
    def decided(self) -> list[Action]:
        """The actions of the latest event; after an error, those from before the error."""
        return self._actions

    def report(self, t: float) -> list[Action]:
        """The part of a tick that sends heartbeat, texts and named values."""
        self._actions = []
        self._report(t)
        return self._actions

    # The vehicle.

    def _handle_outputs(self, t: float, outputs: Sequence[VehicleOutput]) -> None:
        for output in outputs:
            if isinstance(output, Trigger):
                decision = self._decide(t, output)
                self._send(*self._vehicle.acknowledge(output, decision.safety != "refused"))
            elif isinstance(output, Notice):
                self._publish(output)
            elif isinstance(output, Changed):
                self._configure(output)
            elif isinstance(output, Straightened):
                self._clear_faults(t, output.seen_at)
            else:
                self._send(output)

    def _ask_own_triggers(self, t: float, message: MavlinkMessage) -> None:
        kind = message.get_type()
        for own in self._vehicle.own_triggers:
            if kind in own.messages and self._vehicle.state.is_ours(message):
                trigger = self._parts.run(t, own.name, partial(own.take, t, message), None)
                if trigger is not None:
                    self._decide(t, trigger)

    def _configure(self, change: Changed) -> None:
        self._safety.configure(change.config)
        self._vine.configure(change.config)
        self._vehicle.configure()
        self._actions.append(KeepParameters(change.t, dict(self._vehicle.component.parameters.values)))

    # The firmware.

    def _on_firmware_link(self, t: float, up: bool) -> None:
        self._vine.restart()
        self._restart_noted = False
        if up:
            self._firmware.opened(t)
            self._firmware_problem = "does not answer"
        else:
            self._firmware.closed(t)
            self._firmware_problem = "disconnected"
        self._check_safety(t)

    def _on_firmware(self, t: float, message: protocol.Message) -> None:
        for event in self._firmware.receive(t, message):
            match event:
                case fw.Ready(welcome):
                    self._firmware_was_ready = True
                    self._restart_noted = False
                    self._vine.firmware_limit_kPa = welcome.setpoint_limit_kPa
                    ready = f"{self._actuator} ready ({welcome.firmware_build})"
                    is_new, self._ready_text = ready != self._ready_text, ready
                    self._notice(t, Severity.INFO if is_new else Severity.DEBUG, ready)
                    self._check_board_settings(t, welcome)
                case fw.TelemetryReceived(telemetry):
                    self._actions.append(Measured(t, telemetry))
                    features = self._supply.read(t, telemetry, self._vehicle.state.armed)
                    made_at = t - self._firmware.telemetry_age(t)
                    self._vine.note(t, made_at, telemetry)
                    if telemetry.faults or features.cv_lower_kPa > self.config.limits.overpressure_kPa:
                        self._check_safety(t)
                    self._estimate(t, features)
                case fw.ImplausibleTelemetry():
                    self._check_safety(t)
                case fw.FirmwareReset(reason):
                    self._restarted(t, reason)
                case fw.Incompatible(reason):
                    self._firmware_problem = reason
                    self._notice(t, Severity.ERROR, reason)
                case fw.CommandRefused(refusal):
                    reason = refusal.reason.name.lower().replace("_", " ")
                    why = f"{self._actuator} refused: {reason}"
                    self._enter(t, ResponseNeeded("refused_by_firmware", why, "vent"))

    def _check_board_settings(self, t: float, welcome: protocol.Welcome) -> None:
        """Latch a fault if the board has not the settings of the last flight.

        With the span of another sensor every pressure is wrong, and nothing else shows it.
        """
        # An actuator has no settings. Logs of earlier versions have None.
        if not welcome.settings_memory or welcome.settings_digest == self._board_settings:
            return
        stored = welcome.settings_memory is protocol.SettingsMemory.STORED
        if self._board_settings is None and stored:
            self._remember_board_settings(t, welcome)
            self._notice(t, Severity.INFO, f"{self._actuator} settings are remembered")
            return
        what = "have changed" if stored else "are lost"
        why = f"{self._actuator} settings {what} (check them, then clear faults)"
        self._enter(t, self._safety.latch(t, BOARD_SETTINGS, why))

    def _remember_board_settings(self, t: float, welcome: protocol.Welcome) -> None:
        self._board_settings = welcome.settings_digest
        self._actions.append(KeepBoardSettings(t, welcome.settings_digest))

    def _restarted(self, t: float, reason: str) -> None:
        if self._restart_noted:
            return  # the board's clock in telemetry has already shown this restart; now comes its new boot id
        self._restart_noted = True
        self._firmware_problem = "restarted"
        self._vine.restart()
        self._restarts.note(t)
        why = f"{self._actuator} restarted: {reason}"
        latched = self._safety.latch(t, "firmware_reset", self._restarts.looping(t) or why)
        self._enter(t, replace(latched, reason=why))

    def _estimate(self, t: float, features: Features) -> None:
        """Update the estimates, and run the physics checks."""
        vine, cv_kPa = self._vine, features.telemetry.cv_kPa
        vine.bent_kPa = self._parts.run(
            t, "bend", lambda: vine.planner.curve.bent_kPa(cv_kPa, vine.bent_kPa), vine.bent_kPa, needed=True
        )
        findings = self._supply.find(t, features)
        for finding in findings:
            if finding.level == "warn":
                self._notice(t, Severity.WARNING, finding.sentence)
        if any(finding.level == "fault" for finding in findings):
            self._check_safety(t)

    def _on_failed(self, failed: Failed) -> None:
        self._actions.append(InternalError(failed.t, failed.part, failed.trace))
        if failed.needed:
            self.internal_error = True
            self._check_safety(failed.t)
        else:
            self._notice(failed.t, Severity.WARNING, f"{failed.part} failed, flight goes on")

    # Deciding.

    def _decide(self, t: float, trigger: Trigger) -> Decision:
        """Let safety judge a trigger. Carry out its intent, or refuse it with a reason."""
        now = self._check_safety(t)
        self._motion_before = self._vine.motion
        intent = trigger.intent
        if trigger.by_person and self._on_bench:
            self._bench_until = t + BENCH_S
        if intent is None or trigger.problem:
            return self._record(t, trigger, Ruling("refused", trigger.problem))
        if self._stopped and not only_deflates(self.config, intent):
            return self._record(t, trigger, Ruling("refused", "the service is stopping"))
        if problem := self._outdated(t, trigger, intent):
            return self._record(t, trigger, Ruling("refused", problem))
        without_air = self._carry_out_without_air(t, intent, trigger)
        if without_air is not None:
            return self._record(t, trigger, without_air)
        if problem := self._vine.planner.problem(intent):
            return self._record(t, trigger, Ruling("refused", problem))
        motion = self._vine.plan(t, intent)
        air = self._supply.air_needed(t, motion.rise_kPa, motion.rate_kPa_per_s)
        if trigger.by_person and motion.only_deflates:
            self._clear_faults(t, trigger.seen_at)
        ruling = self._safety.judge(motion, air, now)
        if ruling.verdict == "refused":
            return self._record(t, trigger, ruling)
        if ruling.rate_scale < 1.0:
            motion = self._vine.plan(t, intent, ruling.rate_scale)
        if motion.only_deflates and self._vine.motion is None:
            self._vent(t, trigger)
        else:
            self._note_trigger(t)
            self._pending_bend.began(trigger.kind)
            if motion.only_deflates:
                self._note_cut_off(t)
            self._vine.motion = motion
            self._drive(t)
        return self._record(t, trigger, ruling)

    def _outdated(self, t: float, trigger: Trigger, intent: Intent) -> str:
        """Why a request is too late; empty if it is not.

        A vent, disarm or end of bench mode is never too late. Another motion that only deflates is too late
        only after a newer request.
        """
        late = trigger.age_s > LATE_S
        overtaken = self._requested_at > t - trigger.age_s + AT_ONCE_S
        if isinstance(intent, VENTING) or not (late or overtaken):
            return ""
        moves = isinstance(intent, MOVING) and not self._vine.planner.problem(intent)
        if moves and not overtaken and self._vine.plan(t, intent).only_deflates:
            return ""
        # Without the autopilot's clock the age is only how long the autopilot has been silent.
        why_late = self._safety.reasons.get("autopilot") or f"came {trigger.age_s:.1f} s late"
        return why_late if late else "a newer request came first"

    def _note_trigger(self, t: float) -> None:
        self._vine.triggered_at = t
        self._safety.triggered()

    def _carry_out_without_air(self, t: float, intent: Intent, trigger: Trigger) -> Ruling | None:
        """Carry out or refuse an intent that takes no air. Returns None for an intent that may take air."""
        match intent:
            case ClearLatchedFaults() | ArmPneumatics() | StartBench() if not trigger.by_person:
                return Ruling("refused", "only a person may do that")
            case ClearLatchedFaults():
                if self._clear_faults(t, trigger.seen_at, on_request=True):
                    return Ruling("accepted")
                return Ruling("accepted", "no fault was latched", has_effect=False)
            case ArmPneumatics():
                self._pneumatics_armed = True
                self._actions.append(KeepDisarmed(t, False))
                return Ruling("accepted")
            case DisarmPneumatics():
                if self._pneumatics_armed:
                    by = trigger.what.get("from") or source(trigger.kind, trigger.what)
                    self._notice(t, Severity.WARNING, f"pneumatics disarmed by {by}", of_decision=True)
                self._pneumatics_armed = False
                self._vent(t, trigger)
                self._actions.append(KeepDisarmed(t, True))
                return Ruling("accepted", self._unconfirmed(t))
            case VentVine():
                if trigger.by_person:
                    self._clear_faults(t, trigger.seen_at)
                self._vent(t, trigger)
                return Ruling("accepted", self._unconfirmed(t))
            case Hold():
                return self._hold(t, trigger)
            case StartBench() if self._vehicle.state.armed:
                return Ruling("refused", "the vehicle is armed")
            case StartBench():
                self._bench_until = t + BENCH_S
                return Ruling("accepted")
            case StopBench():
                if self._on_bench:
                    self._vent(t, trigger)
                self._leave_bench(t, "requested")
                return Ruling("accepted")
        return None

    def _hold(self, t: float, trigger: Trigger) -> Ruling:
        if self._vine.motion is None:
            return Ruling("refused", "the vine is vented")
        if self._safety.reasons:
            return Ruling("refused", "; ".join(self._safety.reasons.values()))
        # A hold is a request of its own: the time limit starts again.
        self._note_trigger(t)
        self._pending_bend.began(trigger.kind)
        self._freeze(t)
        return Ruling("accepted")

    def _freeze(self, t: float) -> None:
        """Stay at the present setpoint. This does not restart the time limit `limits.max_bent_s`."""
        self._vine.freeze(t)
        self._drive(t)

    def _clear_faults(self, t: float, seen_at: float = math.inf, *, on_request: bool = False) -> bool:
        """Clear the faults that a person may clear. Returns True if there was any loss or fault before.

        On the ground this also ends the doubt in the reservoir's sensor. `on_request`: the request is to
        clear faults, not to vent or to straighten the vine.
        """
        had_faults = bool(self._safety.reasons) or self._supply.sensor_in_doubt
        if not self._vehicle.state.armed:
            self._supply.believe_sensor(seen_at)
        now = self._conditions(t)
        cleared = self._safety.clear(now, seen_at, on_request=on_request)
        # Before the first handshake the settings are unknown; the handshake latches the fault again.
        if BOARD_SETTINGS in cleared and self._firmware.welcome is not None:
            self._remember_board_settings(t, self._firmware.welcome)
        if now.faults and self._safety.firmware_faults_seen(seen_at):
            self._to_firmware(self._firmware.clear_faults(t, now.faults))
        for name, reason in cleared.items():
            condition = self._condition(name)
            line = Notice(t, Severity.NOTICE, f"Vine: cleared: {reason}", condition=condition, ended=True)
            self._own_lines.take(line, at_once=True)
            self._show(line)
        return had_faults

    def _record(self, t: float, trigger: Trigger, ruling: Ruling, shown: bool = True) -> Decision:
        motion = self._vine.motion
        # A request without effect must not invalidate a switch move that still waits for its confirmation.
        is_newer = ruling.verdict != "refused" and ruling.has_effect
        if is_newer:
            self._requested_at = max(self._requested_at, t - trigger.age_s)
        if ruling.verdict == "refused" and motion is None:
            self._pending_bend.refused(trigger.kind, ruling.reason)
        line = self._line(t, trigger, ruling)
        changes_nothing = motion is self._motion_before
        decision = Decision(
            t=t,
            trigger=trigger.kind,
            what=trigger.what,
            intent=None if trigger.intent is None else str(trigger.intent),
            safety=ruling.verdict,
            reason=ruling.reason,
            setpoint_kPa=round(motion.aim_kPa, 3) if motion else 0.0,
            shown=shown and (not (changes_nothing and line.source) or self._request_lines.take(line)),
        )
        self._actions.append(decision)
        if is_newer and trigger.kind not in _BY_PILOT_OR_SAFETY:
            self._tell_pilot(trigger.intent)
        if decision.shown and ruling.verdict != "accepted":
            self._show(line)
        return decision

    def _line(self, t: float, trigger: Trigger, ruling: Ruling) -> Notice:
        """A decision as a text. Only requests that others can send in floods have a source."""
        request = str(trigger.intent or trigger.kind.replace("_", " "))
        severity, text = Severity.NOTICE, f"{request} {ruling.verdict} {ruling.reason}".rstrip()
        if ruling.verdict == "refused":
            if (seq := trigger.what.get("seq")) is not None:
                request = f"item {seq}" + (f", {trigger.intent}" if trigger.intent else "")
            severity, text = Severity.WARNING, f"refused {request}: {ruling.reason}"
        sender = "" if trigger.kind in _NEVER_FLOODS else trigger.kind
        if trigger.kind == "command":
            sender = str(trigger.what.get("from", sender))
        return Notice(t, severity, f"Vine: {text}", of_decision=True, source=sender)

    def _tell_pilot(self, intent: Intent | None) -> None:
        """Tell the pilot's switch what somebody else has just carried out."""
        pilot = self._vehicle.pilot
        if not isinstance(intent, (*VENTING, *MOVING)):
            pilot.drop_waiting()
        elif self._vine.only_deflates:
            pilot.vented("other")
        else:
            pilot.bent_by_other()

    # Motions.

    def _drive(self, t: float) -> None:
        """Send the firmware the command for the time until the next tick."""
        if ended := self._vine.ended(t):
            self._pending_bend.ended(ended.name, self._vehicle.switch.position)
            if not self._vine.near_zero:
                left_kPa = self._vine.setpoint_kPa(t)
                self._notice(t, Severity.WARNING, f"still at {left_kPa:.1f} kPa, vent commanded")
        self._to_firmware(self._vine.command(t))

    def _vent(self, t: float, trigger: Trigger) -> None:
        """Vent because of a trigger."""
        moved = self._vine.motion is not None
        if trigger.kind != "link":
            by = f"{trigger.intent} by {source(trigger.kind, trigger.what)}"
            self._pending_bend.withdrawn(by, moved)
        else:
            self._note_unrequested_vent(str(trigger.what["event"]))
        self._stop_moving(t)

    def _note_unrequested_vent(self, why: str) -> None:
        """If a motion runs: it is about to be vented, and nobody asked for that. Its bend stays requested."""
        if self._vine.motion is not None:
            self._pending_bend.stopped(why)
            if not self._vine.motion.only_deflates:
                self._vehicle.pilot.vented("safety")

    def _note_cut_off(self, t: float) -> None:
        """If the present motion still runs: tell the reservoir estimate that it ends early."""
        if self._vine.motion is not None and not self._vine.motion.is_over(t):
            self._supply.reservoir.cut_off()

    def _stop_moving(self, t: float) -> None:
        self._note_cut_off(t)
        self._to_firmware(self._vine.stop(t))

    # Bench mode.

    @property
    def _on_bench(self) -> bool:
        return self._bench_until > -math.inf

    def _leave_bench(self, t: float, why: str) -> None:
        if self._on_bench:
            self._bench_until = -math.inf
            self._note_unrequested_vent(f"bench mode is over: {why}")
            self._stop_moving(t)
            self._notice(t, Severity.NOTICE, f"bench mode over, {why}: vented")

    # Ticks and safety.

    def _on_tick(self, t: float) -> None:
        self._lateness.tick(t)
        self._handle_outputs(t, self._vehicle.tick(t))
        if self._vehicle.state.armed:
            self._leave_bench(t, "the vehicle is armed")
        elif t > self._bench_until:
            self._leave_bench(t, "no more requests")
        self._check_safety(t)
        if not self._stopped:
            self._drive(t)
        self._to_firmware(self._firmware.tick(t))
        if text := self._link_loss.back(t, self._safety.reasons):
            self._say_condition(t, VEHICLE_LINK, text, ended=True)
        if bool(busy := self._lateness.problem(t)) is not self._busy:
            self._busy = not self._busy
            self._say_condition(t, COMPUTER, busy or f"{COMPUTER} keeps up again", ended=not busy)
        for name, (since, change, response) in list(self._excused.items()):
            if not busy or t - since >= STABLE_AFTER_S:
                del self._excused[name]
                if name in self._safety.reasons and (line := self._loss_line(t, change, response)):
                    self._publish(line)
        for counted in (*self._request_lines.due(t), *self._own_lines.due(t)):
            self._show(counted)
        self._report_waiting(t)
        self._watch_supply(t)
        self._keep_latched(t)
        self._report(t)

    @property
    def _waiting(self) -> PendingBend | None:
        """The bend that is requested but not carried out; None while a motion runs, or nothing may bend."""
        if self._vine.motion is not None or not self._pneumatics_armed:
            return None
        return self._pending_bend.waiting(self._vehicle.switch.position, self._vehicle.pilot.fresh_move)

    def _report_waiting(self, t: float) -> None:
        """Send a text, once, that says which request would bend the vine.

        No text is sent while RC or the autopilot is lost or late: the switch may have another position
        afterwards.
        """
        waiting = self._waiting
        if waiting is None:
            self._waiting_reported = None
        may_bend = self._vehicle.state.armed or self._on_bench
        if waiting in (None, self._waiting_reported) or not may_bend:
            return
        lost = not {"rc", "autopilot", "late"}.isdisjoint(self._safety.reasons)
        unread = self._vehicle.switch.position is None and bool(self._vehicle.pilot.fresh_move)
        if not lost and not unread:
            self._waiting_reported = waiting
            self._notice(t, Severity.NOTICE, f"waiting for: {waiting.awaited}")

    def _note_rc_use(self, t: float) -> None:
        """Note whether RC is in use. A loss of RC counts only while RC is in use."""
        armed = self._vehicle.state.armed
        if self._vehicle.rc.problem(t) is None:
            self._rc_in_use |= armed or self._on_bench or self.config.interlocks.bench_mode
        elif not armed and self._vine.motion is None:
            self._rc_in_use = False

    def _conditions(self, t: float) -> SafetyInputs:
        telemetry, supply = self._firmware.telemetry, self._supply
        features = supply.features
        return SafetyInputs(
            pneumatics_armed=self._pneumatics_armed,
            armed=self._vehicle.state.armed,
            armed_s=self._vehicle.state.arm_state.armed_s(t),
            conflict=self._vehicle.state.conflict(t),
            altitude_m=self._vehicle.state.altitude_m(t),
            rc_problem=self._vehicle.rc.problem(t) if self._rc_in_use else None,
            autopilot_age_s=self._vehicle.state.silence_s(t),
            heartbeat_missing=self._vehicle.state.heartbeat_missing,
            link_delay_s=self._vehicle.state.clock.delay_s(t),
            firmware_ready=self._firmware.state is fw.SessionState.READY,
            firmware_was_ready=self._firmware_was_ready,
            firmware_problem=self._firmware_problem,
            telemetry_age_s=self._firmware.telemetry_age(t),
            faults=telemetry.faults if telemetry else protocol.Fault.NONE,
            sensor_problem=self._sensor_problem,
            cv_kPa=features.cv_lower_kPa if features else math.nan,
            reservoir_kPa=supply.reservoir.reservoir_kPa if supply.has_reservoir else math.inf,
            mode_mismatch_s=self._vine.mode_mismatch_s,
            wrong_setpoint_kPa=self._vine.wrong_setpoint_kPa,
            restarting=self._restarts.looping(t),
            bench=self._on_bench,
            moving=self._vine.motion is not None,
            moving_s=t - self._vine.triggered_at if self._vine.motion else 0.0,
            physics=supply.faults,
            internal_error=self.internal_error,
        )

    @property
    def _sensor_problem(self) -> str | None:
        if self._firmware.implausible is None:
            return None
        field, value_kPa = self._firmware.implausible
        # The log cannot hold infinity, and a replayed flight must give the same text.
        value = f"{value_kPa:g} kPa" if math.isfinite(value_kPa) else "not a number"
        return f"{_SENSOR_TEXTS[field].format(actuator=self._actuator)} {value}"

    def _check_safety(self, t: float) -> SafetyInputs:
        """Let safety check the conditions and carry out its response. Returns the conditions after that."""
        self._note_rc_use(t)
        now = self._conditions(t)
        changes = self._safety.watch(t, now)
        for change in changes:
            if isinstance(change, ResponseNeeded):
                self._enter(t, change)
            else:
                self._leave(t, change)
        if changes:
            self._note_rc_use(t)
            now = self._conditions(t)
        return now

    def _enter(self, t: float, change: ResponseNeeded) -> None:
        deflates = self._vine.only_deflates
        hold = change.response == "hold" and not deflates
        moved = self._vine.motion is not None
        response = "holding" if hold else _RESPONSE_TEXTS.get(change.name, "vented")
        is_restart = change.name == "serial" and self._restart_noted  # the restart has a text of its own
        dead = self._link_loss.dead(t, change.name)
        may_be_ours = change.name in _BUSY_CAUSES or bool(dead)
        busy = self._lateness.problem(t)
        line, reason = None, change.reason
        if busy and may_be_ours and not is_restart and not self._link_loss.covers(change.name):
            self._excused[change.name] = (t, change, response)
            reason = f"{busy}; {reason}"
            line = Notice(t, Severity.WARNING, f"Vine: {busy}, {response}", condition=COMPUTER)
            shown = (not self._busy or moved) and self._own_lines.take(line, at_once=moved)
            self._busy = True
        else:
            reason = f"{VEHICLE_LINK} {dead}; {reason}" if dead else reason
            line = None if is_restart else self._loss_line(t, change, response)
            shown = not is_restart and (line is None or self._own_lines.take(line, at_once=moved))
        decides = moved or self._vehicle.state.armed
        self._vehicle.pilot.drop_waiting()
        if hold:
            self._freeze(t)
        else:
            self._note_unrequested_vent(change.reason)
            self._stop_moving(t)
        if change.name == "autopilot" and not self._vehicle.state.heartbeat_missing:
            self._vehicle.forget_radio()
        if decides:
            trigger = Trigger(t, "failsafe", {"loss": change.name}, Hold() if hold else VentVine())
            self._record(t, trigger, Ruling("accepted", reason, has_effect=moved), shown)
        if line is not None:
            severity = line.severity if shown else Severity.DEBUG
            self._show(replace(line, severity=severity, of_decision=decides and shown))

    def _loss_line(self, t: float, change: ResponseNeeded, response: str) -> Notice | None:
        """The text about a loss or fault; None if the text about the dead link stands for it."""
        text = self._link_loss.entered(t, change.name, change.reason, response)
        if text is None:
            return None
        name = VEHICLE_LINK if self._link_loss.covers(change.name) else self._condition(change.name)
        return Notice(t, Severity.WARNING, f"Vine: {text}", condition=name)

    def _condition(self, name: str) -> str:
        return _CONDITION_NAMES.get(name, name.replace("_", " ")).format(actuator=self._actuator)

    def _leave(self, t: float, change: LossEnded) -> None:
        if self._excused.pop(change.name, None) or self._link_loss.covers(change.name):
            return
        name = self._condition(change.name)
        texts = {
            "late": "vehicle link is in time again",
            "conflict": "only one autopilot again",
            "firmware_fault": "firmware fault cleared",
        }
        text = texts.get(change.name, f"{name} is back")
        if change.name == "rc" and self._vehicle.rc.problem(t) is not None:
            text = "RC is off and not in use"
        self._say_condition(t, name, text, ended=True)

    def _say_condition(self, t: float, name: str, text: str, *, ended: bool) -> None:
        severity = Severity.NOTICE if ended else Severity.WARNING
        self._publish(Notice(t, severity, f"Vine: {text}", condition=name, ended=ended))

    def _watch_supply(self, t: float) -> None:
        low_reservoir_cycles = self.config.telemetry.low_reservoir_cycles
        for output in self._supply.tick(t, self._safety.reasons, low_reservoir_cycles):
            if isinstance(output, Notice):
                self._publish(output)
            else:
                self._actions.append(output)

    def _keep_latched(self, t: float) -> None:
        latched = self._safety.latched
        if latched.keys() != self._kept_latched:
            self._kept_latched = set(latched)
            self._actions.append(KeepLatched(t, latched))

    def _report(self, t: float) -> None:
        status = mavlink.MAV_STATE_ACTIVE if self._vine.motion else mavlink.MAV_STATE_STANDBY
        if self._safety.reasons:
            status = mavlink.MAV_STATE_CRITICAL
        values: Mapping[str, float] = {}
        if self._vehicle.state.found:
            if self._vehicle.component.wants_values(t):
                values = self._parts.run(t, "named values", lambda: self._named_values(t), values)
        else:
            if self._silent_since is None:
                self._silent_since = t
            # Some peers, such as a UDP server, send nothing until they have received something.
            if t - self._silent_since < LISTEN_FIRST_S:
                return
        boot_ms = self._vehicle.state.time_boot_ms(t)
        self._transmit(self._vehicle.component.due(t, boot_ms, values, status))

    def _vehicle_state(self, t: float) -> str:
        """The vehicle, for people. Its mode and arm state are old if it is silent."""
        state, silence_s = self._vehicle.state, self._vehicle.state.silence_s(t) or 0.0
        if not state.found:
            return "not found"
        silent = silence_s > self.config.losses.autopilot_s
        return f"{state.kind} {state.system_id}" + (f", silent for {silence_s:.0f} s" if silent else "")

    def _actuator_state(self, t: float) -> str:
        """What is known of the actuator, for people."""
        if self._firmware.state is not fw.SessionState.READY:
            return self._firmware_problem
        if self._fresh_telemetry(t) is not None:
            return "ready"
        age_s = self._firmware.telemetry_age(t)
        return f"silent for {max(1.0, age_s):.0f} s" if math.isfinite(age_s) else "no telemetry yet"

    def _unconfirmed(self, t: float) -> str:
        """Why nobody can know if the vine vents; empty if telemetry shows it."""
        state = self._actuator_state(t)
        return "" if state == "ready" else f"not confirmed: {self._actuator} {state}"

    def _fresh_telemetry(self, t: float) -> protocol.Telemetry | None:
        """The latest telemetry; None if it is too old to be shown."""
        fresh = self._firmware.telemetry_age(t) <= self.config.losses.telemetry_s
        return self._firmware.telemetry if fresh else None

    def _named_values(self, t: float) -> dict[str, float]:
        telemetry = self._fresh_telemetry(t)
        if telemetry is None:
            return {}
        left = self._supply.cycles_left
        values = (
            telemetry.reservoir_kPa if self._supply.has_reservoir else math.nan,
            left.expected if left else math.nan,
            left.minutes if left else math.nan,
            telemetry.cv_kPa,
            self._vine.commanded_kPa(t),
            self._vine.bend_deg,
        )
        return dict(zip(VALUE_NAMES, values, strict=True))

    def snapshot(self, t: float) -> Snapshot:
        """The state at time `t`, for displays and logs."""
        telemetry = self._fresh_telemetry(t)
        altitude_m = self._vehicle.state.altitude_m(t)
        ambient_kPa = self._vehicle.state.ambient_kPa(t)
        return Snapshot(
            t=t,
            vehicle=self._vehicle_state(t),
            mode=self._vehicle.state.mode,
            armed=self._vehicle.state.armed,
            altitude_m=math.nan if altitude_m is None else altitude_m,
            rc=self._vehicle.rc.problem(t) or "good",
            switch_position=self._vehicle.switch.position,
            actuator=self._actuator,
            firmware=self._actuator_state(t),
            round_trip_s=self._firmware.round_trip_s if telemetry else None,
            telemetry_gaps=self._firmware.telemetry_gaps,
            reservoir_kPa=telemetry.reservoir_kPa if telemetry and self._supply.has_reservoir else math.nan,
            cv_kPa=telemetry.cv_kPa if telemetry else math.nan,
            command_kPa=self._vine.commanded_kPa(t),
            bend_deg=self._vine.bend_deg if telemetry else math.nan,
            evp_opening=telemetry.evp_opening if telemetry else math.nan,
            dvp_opening=telemetry.dvp_opening if telemetry else math.nan,
            solenoid=telemetry.solenoid if telemetry else None,
            cycles=self._supply.cycles_left if telemetry else None,
            doing=self._vine.motion.name if self._vine.motion else self._resting(telemetry),
            safe_state=self._safety.reasons,
            unstable=self._unstable(t),
            findings=self._supply.findings,
            ambient_kPa=math.nan if ambient_kPa is None else ambient_kPa,
            pneumatics_armed=self._pneumatics_armed,
            bench=self._on_bench,
            waiting=self._waiting,
        )

    def _resting(self, telemetry: protocol.Telemetry | None) -> str:
        """What a vine without a motion does, as far as it is known. `telemetry`: fresh, or None."""
        if telemetry is None:
            sent = self._firmware.state is fw.SessionState.READY
            if not sent and not self._firmware_was_ready:
                return "not known"
            return "vent sent, not confirmed" if sent else "dead-man vents, not confirmed"
        if not self._vine.near_zero:
            return "venting"
        return "vented" if self._pneumatics_armed else "pneumatics disarmed"

    def _unstable(self, t: float) -> dict[str, str]:
        busy = self._lateness.problem(t)
        return {**self._own_lines.unstable(t), **({COMPUTER: busy} if busy else {})}

    # Sending.

    def _send(self, *messages: MavlinkMessage) -> None:
        for message in messages:
            self._vehicle.component.send(message)

    def _transmit(self, messages: Sequence[MavlinkMessage]) -> None:
        system_id = self._vehicle.state.system_id or self.config.vehicle.system_id or 1
        self._actions.extend(ToVehicle(message, system_id) for message in messages)

    def _to_firmware(self, messages: Sequence[protocol.HostMessage]) -> None:
        self._actions.extend(ToFirmware(message) for message in messages)

    def _notice(self, t: float, severity: Severity, text: str, of_decision: bool = False) -> None:
        self._publish(Notice(t, severity, f"Vine: {text}", of_decision))

    def _publish(self, notice: Notice) -> None:
        lines = self._request_lines if notice.source else self._own_lines
        if notice.severity is Severity.DEBUG or lines.take(notice):
            self._show(notice)
        elif not notice.source:
            self._show(replace(notice, severity=Severity.DEBUG))

    def _show(self, notice: Notice) -> None:
        self._actions.append(notice)
        if notice.severity is not Severity.DEBUG:
            self._vehicle.component.say(notice)
