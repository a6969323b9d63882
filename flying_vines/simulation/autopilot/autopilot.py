"""The simulated autopilot: bytes in, frames out, stimuli by methods."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from random import Random
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.simulation.autopilot import commands, files, legs, sensors, telemetry
from flying_vines.simulation.autopilot.ardupilot import ArduPilotMission
from flying_vines.simulation.autopilot.flight import CopterMotion
from flying_vines.simulation.autopilot.forwarding import Forwarder
from flying_vines.simulation.autopilot.mission_protocol import MissionStorage
from flying_vines.simulation.autopilot.modes import FlightMode, mission_mode, mode_named, mode_numbered
from flying_vines.simulation.autopilot.parameters import ParameterServer
from flying_vines.simulation.autopilot.port import COMPANION, GCS, KNOWN, PX4_EXTRA_MESSAGES, Port
from flying_vines.simulation.autopilot.px4 import CommandLong, CommandSender, Px4Mission
from flying_vines.simulation.autopilot.rc_input import ArduPilotRc, RcInput, rc_input
from flying_vines.simulation.autopilot.receiver import RcLoss, RcSource, Receiver
from flying_vines.simulation.autopilot.routing import Routes
from flying_vines.simulation.autopilot.runner import Runner
from flying_vines.simulation.autopilot.scheduler import ScheduledCallback, Scheduler
from flying_vines.simulation.autopilot.snapshot import AutopilotSnapshot
from flying_vines.simulation.autopilot.streams import StreamSender
from flying_vines.simulation.autopilot.transit import Transit
from flying_vines.vehicle.mission import item as mission_item
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.mission.storage import AutopilotKind
from missions.home import SIMULATOR_HOME, Home

_TICK_S = 0.02
_UPTIME_S = 30.0
_REBOOT_SILENCE_S = 1.25
_CALIBRATION_S = 2.0
_READY_S = 1.41
_ORIGIN_S = 19.0
_NO_SPACE_S = 0.5
_DISARM_AFTER_LANDING_S = 2.0
_REACHED_AGAIN_S = 1.0
_REACHED_TIMES = 10
_FASTEST_STREAM_S = 0.0025
_FASTEST_GROUP_HZ = 50
_RUNTIME_EVERY_S = 31.0
_UNIX_AT_START_S = 1_795_211_406.0
_WARNING, _INFO = 4, 6
_GCS = 6
_LINKS = 255
_MAX_LOGGED = 10_000
"""Maximum entries in each log of executed items: more than a mission has. The oldest ones are removed."""
_MAVLINK_CAMERA, _CAMERA_ITEMS = 5, (202, 203)

_MISSION_MESSAGES = frozenset(
    {
        "MISSION_COUNT",
        "MISSION_ITEM",
        "MISSION_ITEM_INT",
        "MISSION_REQUEST",
        "MISSION_REQUEST_INT",
        "MISSION_REQUEST_LIST",
        "MISSION_CLEAR_ALL",
        "MISSION_ACK",
    }
)
_PARAMETER_MESSAGES = frozenset({"PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET"})


class FakeAutopilot:
    """A simulated ArduCopter or PX4 copter, seen from a companion computer and a ground station.

    Sans-IO: pass received bytes to `receive`, call `advance`, and send the frames that it returns. Times are
    seconds of any monotonic clock; the first time is the start. Stimuli (`arm`, `set_rc`, …) act at the
    latest time so far, or at the start.

    At the start the vehicle has been up for 30 s, so its boot is visible only after `reboot`.
    """

    def __init__(
        self,
        kind: AutopilotKind = "ardupilot",
        system_id: int = 1,
        mission: Sequence[MissionItem] = (),
        *,
        links: Sequence[str] = (COMPANION,),
        home: Home | None = None,
        rc_present: bool = True,
        receiver: RcSource | None = None,
        rc_failsafe_mode: str | None = "RTL",
        parameters: Mapping[str, float] | None = None,
        signing_key: bytes | None = None,
        unix_s: float = _UNIX_AT_START_S,
        seed: int = 0,
    ) -> None:
        """A disarmed vehicle on the ground at `home`.

        Args:
            mission: stored like an upload; raises `MissionRefused` if the autopilot would refuse it. On
                ArduPilot item 0 is home.
            links: get heartbeats from the start; other links appear with their first message.
            receiver: the RC input; default on PX4: overrides by a ground station.
            rc_failsafe_mode: mode after RC loss in flight; None: no change. PX4 without a receiver on its
                own driver never changes its mode after RC loss.
            parameters: values that differ from the factory's, e.g. PX4's MIS_COMMAND_TOUT.
            signing_key: 32 bytes. With a key the autopilot signs, and accepts only signed messages, except on
                a link "usb".
            unix_s: the autopilot's clock at the start.
            seed: determines the delay of PX4's loss reports.
        """
        self.kind: AutopilotKind = kind
        self.system_id = system_id
        self.scheduler = Scheduler()
        self.flight = CopterMotion(home or SIMULATOR_HOME[kind])
        self._rc: RcInput = rc_input(
            kind,
            rc_present,
            receiver,
            self.scheduler,
            Random(seed),
            self._parameter,
            self._rc_failsafe_changed,
        )
        self.payload_log: list[tuple[float, MissionItem]] = []
        self.performed: list[tuple[float, int]] = []
        self.armed = False
        self.mode: FlightMode = mode_named(kind, "STABILIZE" if kind == "ardupilot" else "HOLD")
        self._failsafe_mode = mode_named(kind, rc_failsafe_mode) if rc_failsafe_mode is not None else None
        self._mode_before: FlightMode | None = None
        """The mode to which PX4 returns after its failsafe."""
        self._unix_s = unix_s
        self._key = signing_key
        self._epoch_s: float | None = None
        self._transit = Transit(self.scheduler)
        self._texts: list[tuple[str, int]] = []
        self._reached: int | None = None
        self._ports: dict[str, Port] = {}
        self._routes = Routes(kind, system_id)
        self._forwarder = Forwarder(kind, self.scheduler, self._transit.send)
        self._streams = StreamSender(kind, self.scheduler, self._snapshot, self._send)
        own = {"SYSID_THISMAV": system_id, "MAV_SYS_ID": system_id}
        self.parameters = ParameterServer(
            kind, {**(parameters or {}), **own}, self.scheduler, self._send_to, self._tell, self.text
        )
        self._sender = CommandSender(self.scheduler, self._send_command)
        self._storage = MissionStorage(
            kind, self.flight.home, self.scheduler, self._send_to, self._mission_changed
        )
        self._runner: Runner = self._new_runner()
        self._leg: legs.Leg | None = None
        self._reached_again: ScheduledCallback | None = None
        self._grounded_s: float | None = None
        self._running = False
        self._boot_s = -_UPTIME_S
        self._ready_s = -_UPTIME_S
        self._ticks = 0
        self._first_tick_s = 0.0
        self._mission_mode = mission_mode(kind)
        for name in links:
            self.add_link(name)
        if mission:
            self._storage.load(mission)
        self._come_up()

    # State

    @property
    def receiver(self) -> Receiver:
        return self._rc.receiver

    @property
    def reports_rc_loss(self) -> bool:
        """True if RC loss is reported: by ArduPilot's failsafe, or by PX4's health report about a receiver on
        its own driver."""
        rc = self._rc
        return rc.failsafe if isinstance(rc, ArduPilotRc) else rc.has_driver and not rc.reported_good

    @property
    def items(self) -> list[MissionItem]:
        """The mission as stored."""
        return self._storage.items

    @property
    def mode_name(self) -> str:
        return self.mode.name

    @property
    def airborne(self) -> bool:
        return self.flight.airborne

    @property
    def height_m(self) -> float:
        return self.flight.height_m

    @property
    def now_s(self) -> float:
        """The latest time given, on the caller's clock."""
        return (self._epoch_s or 0.0) + self.scheduler.now_s

    # Links

    def add_link(self, name: str) -> None:
        """Add a link, so that it gets heartbeats."""
        if name not in self._ports:
            known = KNOWN if self.kind == "ardupilot" else KNOWN | PX4_EXTRA_MESSAGES
            port = Port(name, self.system_id, len(self._ports) % _LINKS, self._key, known)
            port.forwards = self._forwards(name)
            self._ports[name] = port
            if self._running:
                self._streams.begin(port)

    def receive(self, t: float, link: str, data: bytes) -> None:
        """Bytes that arrived on `link` at `t`. Never raises, for any bytes."""
        self._run_to(t)
        if not self._transit.delays(link, data):
            self._receive(link, data)

    def _receive(self, link: str, data: bytes) -> None:
        if not self._running or self._transit.muted:
            return
        self.add_link(link)
        port = self._ports[link]
        port.set_time(self._unix_now_s)
        for message in port.decode(data):
            self._handle(port, message)
            self.flush()
            if not self._running:
                return

    def advance(self, t: float) -> list[tuple[str, bytes]]:
        """Advance to `t`. Returns the frames sent since the last call as (link, frame), in order."""
        self._run_to(t)
        for link, data in self._transit.end_stalls():
            self._receive(link, data)
        return self._transit.take()

    def _run_to(self, t: float) -> None:
        if self._epoch_s is None:
            self._epoch_s = t
        self.scheduler.run_until(t - self._epoch_s)

    # Stimuli

    def arm(self) -> None:
        if self.armed or not self._running:
            return
        self.armed = True
        self._grounded_s = None
        if self.kind == "ardupilot":
            self._tell_home()
            self.text("Arming motors")
        self.flush()

    def disarm(self) -> None:
        """Motors off; this also ends a flight in the air."""
        if not self.armed:
            return
        self.armed = False
        self.flight.airborne = self.flight.landing = False
        self.flight.height_m = 0.0
        self._leg = None
        if self.kind == "ardupilot":
            self.text("Disarming motors")
        if self.mode == self._mission_mode:
            self._runner.disarmed()
        self.flush()

    def takeoff(self, altitude_m: float) -> None:
        """Guided take-off to a height above home; arms first."""
        self.set_mode("GUIDED" if self.kind == "ardupilot" else "TAKEOFF")
        self.arm()
        self._take_off(altitude_m)

    def land(self) -> None:
        self.set_mode("LAND")

    def set_mode(self, name: str) -> None:
        """Select a mode by name. Raises `ValueError` if it does not exist.

        Without a mission the mission mode is refused with a status text, as on an autopilot.
        """
        self._select(mode_named(self.kind, name))
        self.flush()

    def start_mission(self) -> None:
        """Select the mission mode and arm."""
        self._select(mission_mode(self.kind))
        self.flush()
        self.arm()

    def set_mission(self, items: Sequence[MissionItem]) -> None:
        """Replace the mission at once. Raises `MissionRefused` if an upload would be refused."""
        self._storage.load(items)
        self.flush()

    def replace_mission(self, items: Sequence[MissionItem]) -> None:
        """Simulate an upload by a ground station. Raises `MissionRefused` if it would be refused."""
        self.add_link(GCS)
        self._storage.replace(GCS, items)

    def set_parameter(self, name: str, value: float) -> None:
        """Change a parameter. Raises `ValueError` if it does not exist."""
        self.parameters.change(name, value)

    def set_current(self, seq: int) -> None:
        """Continue at item `seq`; a DO item runs (again). Raises `ValueError` if it does not exist."""
        if not 0 <= seq < len(self.items):
            raise ValueError(f"the mission has no item {seq}, only 0 to {len(self.items) - 1}")
        self._runner.set_current(seq)
        self.flush()

    def set_rc(self, channel: int, us: int) -> None:
        """Move a stick or switch (channels from 1)."""
        self.receiver.move(channel, us)

    def lose_rc(self, how: RcLoss | None = None, preset: Mapping[int, int] | None = None) -> None:
        """Lose the RC link; default: the receiver's most common kind of loss.

        "frozen": RC_CHANNELS continues with the last values. "jump": it continues with usual failsafe values,
        or with the values in `preset` (channel: µs). Channels that are missing in `preset` keep their last
        value. "silent": RC_CHANNELS stops. Raises `ValueError` if this receiver has no such loss.
        """
        self._rc.lose(how, preset)

    def return_rc(self) -> None:
        """The RC link returns, with the present sticks."""
        self._rc.restore()

    def reboot(self) -> None:
        """Restart on the ground: silent for 1.25 s. Mission and parameters survive; learnt state is lost."""
        self.scheduler.clear()
        self._running = False
        for port in self._ports.values():
            port.reboot()
        self._routes = Routes(self.kind, self.system_id)
        self._sender = CommandSender(self.scheduler, self._send_command)
        place = self.flight
        self.flight = CopterMotion(place.home)
        self.flight.north_m, self.flight.east_m = place.north_m, place.east_m
        self._rc.reboot()
        self._forwarder.reboot()
        self._streams.reboot()
        self.parameters.reboot()
        self._storage.reboot()
        self._runner = self._new_runner()
        self._leg = self._reached_again = None
        self.armed = False
        self._mode_before = None
        self._texts, self._reached = [], None
        self.mode = mode_named(self.kind, "STABILIZE" if self.kind == "ardupilot" else "HOLD")
        now_s = self.scheduler.now_s
        self._boot_s, self._ready_s = now_s + 0.2, now_s + _REBOOT_SILENCE_S
        self.scheduler.at(self._ready_s, self._come_up)
        if self.kind == "ardupilot":
            self.scheduler.at(self._ready_s + _READY_S, self._say_ready)
            self.scheduler.at(self._ready_s + _ORIGIN_S, self._tell_home)

    def report_health(self) -> None:
        """PX4 reports its health for a reason other than RC. A report about RC may then be up to 2 s late."""
        if not isinstance(self._rc, ArduPilotRc):
            self._rc.report()

    def mute(self, seconds: float) -> None:
        """Cut all links for this time; the vehicle continues to fly."""
        self._transit.mute(seconds)

    def stall(self, seconds: float, *, both_ways: bool = False) -> None:
        """Delay frames to the companion (`both_ways`: also received bytes); then all arrive together."""
        self._transit.stall(COMPANION, seconds, both_ways)

    # Host of the mission runner

    def text(self, text: str, severity: int = _INFO) -> None:
        self._texts.append((text, severity))

    def reached(self, seq: int) -> None:
        self._reached = seq

    def executed(self, item: MissionItem) -> None:
        self.payload_log.append((self.now_s, item))
        del self.payload_log[:-_MAX_LOGGED]
        hands_on = self.kind == "ardupilot" and self.parameters["CAM1_TYPE"] == _MAVLINK_CAMERA
        if hands_on and item.command in _CAMERA_ITEMS:
            self._tell(mavlink.MAVLink_command_long_message(0, 0, item.command, 0, *item.params))

    def flush(self) -> None:
        if self._reached is not None:
            self._send_reached(self._reached, _REACHED_TIMES)
            self._reached = None
        texts, self._texts = self._texts, []
        for text, severity in texts:
            message = mavlink.MAVLink_statustext_message(severity, text.encode()[:50])
            for port in self._ports.values():
                if port.active if self.kind == "ardupilot" else port.has_gcs:
                    self._send(port, message)

    # Internals

    def _parameter(self, name: str) -> float:
        return self.parameters[name]

    def _new_runner(self) -> Runner:
        if self.kind == "ardupilot":
            return ArduPilotMission(self)
        return Px4Mission(self, self._sender, partial(self._parameter, "MIS_COMMAND_TOUT"))

    def _come_up(self) -> None:
        self._running = True
        for port in self._ports.values():
            port.forwards = self._forwards(port.name)
            self._streams.begin(port)
        if self.kind == "ardupilot":
            runtime_s = self.scheduler.now_s - self._boot_s
            self.scheduler.after(_RUNTIME_EVERY_S - runtime_s % _RUNTIME_EVERY_S, self._count_runtime)
        self._ticks = 0
        self._first_tick_s = self.scheduler.now_s
        self._schedule_tick()

    def _schedule_tick(self) -> None:
        # Computed from a count, so that rounding errors do not add up.
        self._ticks += 1
        self.scheduler.at(self._first_tick_s + self._ticks * _TICK_S, self._tick)

    def _tell_home(self) -> None:
        for port in self._ports.values():
            self._streams.once(port, sensors.GPS_GLOBAL_ORIGIN)
            self._streams.once(port, telemetry.HOME_POSITION)

    def _say_ready(self) -> None:
        self.text("ArduPilot Ready")
        self.flush()

    def _forwards(self, link: str) -> bool:
        """True if a link takes part in forwarding: on PX4 by a parameter read at boot, on ArduPilot
        always."""
        if self.kind == "ardupilot":
            return True
        return bool(self.parameters["MAV_1_FORWARD" if link == COMPANION else "MAV_0_FORWARD"])

    def _count_runtime(self) -> None:
        self.scheduler.after(_RUNTIME_EVERY_S, self._count_runtime)
        self.parameters.change("STAT_RUNTIME", int(self.scheduler.now_s - self._boot_s))

    def _tick(self) -> None:
        self._schedule_tick()
        self.flight.step(_TICK_S)
        if self.mode == self._mission_mode:
            self._runner.update()
        elif self._leg is not None:
            self._leg.update(self.scheduler.now_s, self.armed)
            if self._leg.done:
                self._leg = None
                if self.mode.name == "TAKEOFF":
                    self._select(mode_named(self.kind, "HOLD"))
        self._watch_landing()
        self.flush()

    def _watch_landing(self) -> None:
        if not (self.armed and self.flight.landing and not self.flight.airborne):
            self._grounded_s = None
        elif self._grounded_s is None:
            self._grounded_s = self.scheduler.now_s
        elif self.scheduler.now_s - self._grounded_s >= _DISARM_AFTER_LANDING_S:
            self.disarm()

    def _select(self, mode: FlightMode) -> bool:
        if not self._running:
            return False
        flies_mission = self._mission_mode
        if mode == flies_mission and len(self.items) < (2 if self.kind == "ardupilot" else 1):
            self.text(f"Mode change to {mode.name} failed: no mission", _WARNING)
            return False
        if mode == self.mode:
            return True
        if self.mode == flies_mission:
            self._runner.leave()
        self.mode = mode
        self._leg = None
        if mode == flies_mission:
            self._runner.enter()
        elif mode.name in ("LAND", "RTL"):
            command = mission_item.LAND if mode.name == "LAND" else mission_item.RETURN
            self._leg = legs.Leg(self.flight, MissionItem(0, command, (0.0,) * 7, 3), self.scheduler.now_s)
        else:
            self.flight.hold()
        if self.kind == "ardupilot":
            for port in self._ports.values():
                self._streams.once(port, telemetry.HEARTBEAT)
        return True

    def _take_off(self, height_m: float) -> None:
        item = MissionItem(0, mission_item.TAKEOFF, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, height_m), 3)
        self._leg = legs.Leg(self.flight, item, self.scheduler.now_s)

    def _rc_failsafe_changed(self, on: bool) -> None:
        in_flight = self.armed and self.flight.airborne
        if self.kind == "ardupilot":
            self.text("Radio Failsafe" + self._continuing_text if on else "Radio Failsafe Cleared", _WARNING)
        elif self._mode_before is not None and not on:
            self._select(self._mode_before)
            self._mode_before = None
        if on and self._failsafe_mode is not None and in_flight:
            self._mode_before = self.mode
            self._select(self._failsafe_mode)
        self.flush()

    @property
    def _continuing_text(self) -> str:
        """The end of ArduPilot's failsafe text if ArduPilot stays in its mode; else empty."""
        in_flight = self.armed and self.flight.airborne
        if self._failsafe_mode is not None or not in_flight or self.mode.name not in ("AUTO", "GUIDED"):
            return ""
        return f" - Continuing {self.mode.name.capitalize()} Mode"

    def _override_rc(self, message: Any) -> None:
        if self.kind == "ardupilot" and message.get_srcSystem() != self.parameters["SYSID_MYGCS"]:
            return
        self._rc.override([getattr(message, f"chan{channel}_raw") for channel in range(1, 19)])

    def _mission_changed(self) -> None:
        self._runner.replaced()
        if self.kind == "ardupilot":
            if self.parameters["MIS_TOTAL"] != len(self.items):
                self.parameters.change("MIS_TOTAL", len(self.items))
            return
        for port in self._ports.values():
            self._streams.once(port, telemetry.MISSION_CURRENT)

    # Sending

    @property
    def _unix_now_s(self) -> float:
        return self._unix_s + self.scheduler.now_s

    def _tell(self, message: Any) -> None:
        for port in self._ports.values():
            if port.active:
                self._send(port, message)

    def _send(self, port: Port, message: Any) -> None:
        if not self._running:
            return
        port.set_time(self._unix_now_s)
        self._transit.send(port.name, port.encode(message))

    def _send_to(self, link: str, message: Any) -> None:
        self._send(self._ports[link], message)

    def _send_reached(self, seq: int, times_left: int) -> None:
        self._tell(mavlink.MAVLink_mission_item_reached_message(seq))
        if self._reached_again is not None:
            self._reached_again.cancel()
            self._reached_again = None
        if self.kind == "px4" and times_left:
            again = self.scheduler.after(_REACHED_AGAIN_S, lambda: self._send_reached(seq, times_left - 1))
            self._reached_again = again

    def _send_command(self, command: CommandLong, confirmation: int) -> None:
        target = self.system_id, command.target_component
        self._tell(
            mavlink.MAVLink_command_long_message(*target, command.command, confirmation, *command.params)
        )

    def _snapshot(self) -> AutopilotSnapshot:
        now_s = self.scheduler.now_s
        return AutopilotSnapshot(
            kind=self.kind,
            mode=self.mode,
            armed=self.armed,
            calibrating=now_s - self._ready_s < _CALIBRATION_S,
            rc_failsafe=self._rc.failsafe,
            rc_reported=not isinstance(self._rc, ArduPilotRc) and self._rc.reported_good,
            boot_s=now_s - self._boot_s,
            unix_s=self._unix_now_s,
            flight=self.flight,
            receiver=self.receiver,
            mission=self._runner.status(self.mode == self._mission_mode),
            mission_id=self._storage.mission_id,
        )

    # Receiving

    def _handle(self, port: Port, message: Any) -> None:
        self._streams.activate(port)
        kind, frame = message.get_type(), bytes(message.get_msgbuf())
        if kind not in KNOWN:
            for other in self._ports.values():
                self._forwarder.forward(port, other, frame)
            return
        source = message.get_srcSystem(), message.get_srcComponent()
        self._routes.learn(*source, port.name)
        if kind == "HEARTBEAT":
            port.has_gcs |= message.type == _GCS
            for other in self._ports.values():
                self._forwarder.forward(port, other, frame)
            return
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        decision = self._routes.decide(port.name, system, component)
        for link in decision.forward:
            self._forwarder.forward(port, self._ports[link], frame)
        if decision.local:
            self._handle_local(port, message, kind)

    def _handle_local(self, port: Port, message: Any, kind: str) -> None:
        if kind in ("COMMAND_LONG", "COMMAND_INT"):
            self._command(port, message)
        elif kind == "COMMAND_ACK":
            self._sender.acknowledged(message.command)
        elif kind in _MISSION_MESSAGES:
            has_space = self.scheduler.now_s - self._ready_s >= _NO_SPACE_S
            self._storage.handle(port.name, message, has_space)
        elif kind == "MISSION_SET_CURRENT":
            if message.seq < len(self.items):
                self._runner.set_current(message.seq)
                self._streams.once(port, telemetry.MISSION_CURRENT)
        elif kind in _PARAMETER_MESSAGES:
            self.parameters.handle(port.name, message)
        elif kind == "RC_CHANNELS_OVERRIDE":
            self._override_rc(message)
        elif kind == "NAMED_VALUE_FLOAT" and self.kind == "px4":
            self._streams.take_value(message)
        elif kind == "FILE_TRANSFER_PROTOCOL":
            reply = files.answer(message)
            if reply is not None:
                self._send(port, reply)
        elif kind == "PING" and self.kind == "px4" and not message.target_system:
            to = message.get_srcSystem(), message.get_srcComponent()
            self._send(port, mavlink.MAVLink_ping_message(message.time_usec, message.seq, *to))
        elif kind == "SET_MODE":
            mode = mode_numbered(self.kind, message.custom_mode)
            if mode is not None:
                self._select(mode)
        elif kind == "REQUEST_DATA_STREAM" and self.kind == "ardupilot":
            rate_hz = min(message.req_message_rate, _FASTEST_GROUP_HZ)
            on = bool(message.start_stop and rate_hz)
            for message_id in commands.stream_group(message.req_stream_id):
                self._streams.every(port, message_id, 1.0 / rate_hz if on else 0.0)
        elif kind == "TIMESYNC" and message.tc1 == 0:
            own_ns = int((self.scheduler.now_s - self._boot_s) * 1e9)
            self._send(port, mavlink.MAVLink_timesync_message(own_ns, message.ts1))

    def _command(self, port: Port, message: Any) -> None:
        params = commands.parameters(message)
        result = self._carry_out(port, message.command, params)
        target = message.get_srcSystem(), message.get_srcComponent()
        self._send(port, mavlink.MAVLink_command_ack_message(message.command, result, 0, 0, *target))
        if result == commands.ACCEPTED:
            self._answer(port, message.command, params)
        if message.command == commands.REBOOT and result == commands.ACCEPTED:
            self.reboot()

    def _answer(self, port: Port, command: int, params: tuple[float, ...]) -> None:
        """Send the requested message after the acknowledgement."""
        match command:
            case commands.REQUEST_MESSAGE:
                self._streams.once(port, commands.whole(params[0]))
            case commands.GET_HOME:
                self._streams.once(port, telemetry.HOME_POSITION)
            case commands.REQUEST_CAPABILITIES:
                self._streams.once(port, telemetry.AUTOPILOT_VERSION)
            case commands.GET_MESSAGE_INTERVAL:
                message_id = commands.whole(params[0])
                stream = port.streams.get(message_id)
                interval_us = round(stream.interval_s * 1e6) if stream else -1
                self._send(port, mavlink.MAVLink_message_interval_message(message_id, interval_us))

    def _carry_out(self, port: Port, command: int, params: tuple[float, ...]) -> int:
        match command:
            case commands.SET_MESSAGE_INTERVAL:
                return self._set_interval(port, commands.whole(params[0]), params[1])
            case commands.GET_HOME | commands.REQUEST_CAPABILITIES:
                return commands.ACCEPTED
            case commands.REQUEST_MESSAGE | commands.GET_MESSAGE_INTERVAL:
                known = telemetry.streamable(commands.whole(params[0]))
                return commands.ACCEPTED if known else commands.FAILED
            case commands.ARM:
                if params[0] == 1.0:
                    self.arm()
                else:
                    self.disarm()
                return commands.ACCEPTED
            case commands.SET_MODE:
                mode = commands.requested_mode(self.kind, params)
                return _result(mode is not None and self._select(mode))
            case mission_item.TAKEOFF:
                return _result(self._guided_take_off(params[6]))
            case mission_item.LAND:
                return _result(self._select(mode_named(self.kind, "LAND")))
            case mission_item.RETURN:
                return _result(self._select(mode_named(self.kind, "RTL")))
            case commands.START_MISSION:
                return _result(self._select(mission_mode(self.kind)))
            case commands.SET_CURRENT:
                seq = commands.whole(params[0])
                if not 0 <= seq < len(self.items):
                    return commands.DENIED
                self._runner.set_current(seq)
                return commands.ACCEPTED
            case commands.REBOOT:
                return commands.ACCEPTED if params[0] == 1.0 and not self.armed else commands.DENIED
            case _ if command in commands.PAYLOAD[self.kind]:
                self.performed.append((self.now_s, command))
                del self.performed[:-_MAX_LOGGED]
                return commands.ACCEPTED
            case _:
                return commands.UNSUPPORTED

    def _guided_take_off(self, height_m: float) -> bool:
        if not self.armed or not 0.0 < height_m < 10_000.0:
            return False
        if self.kind == "px4":
            self._select(mode_named(self.kind, "TAKEOFF"))
        elif self.mode.name != "GUIDED":
            return False
        self._take_off(height_m)
        return True

    def _set_interval(self, port: Port, message_id: int, interval_us: float) -> int:
        if not telemetry.streamable(message_id):
            if self.kind == "px4":
                return commands.FAILED
            self.text(f"No ap_message for mavlink id ({message_id})")
            return commands.DENIED
        if not -1.0 <= interval_us < 1e12:
            return commands.DENIED
        default_s = 1.0 if message_id == telemetry.HEARTBEAT else 0.0
        interval_s = max(interval_us / 1e6, _FASTEST_STREAM_S) if interval_us > 0.0 else default_s
        self._streams.every(port, message_id, interval_s if interval_us >= 0.0 else 0.0)
        return commands.ACCEPTED


def _result(done: bool) -> int:
    return commands.ACCEPTED if done else commands.FAILED
