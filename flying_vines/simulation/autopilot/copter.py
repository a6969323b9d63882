"""The simulated copter: modes, missions, RC failsafe, and what it sends without a request."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from random import Random

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.simulation.autopilot import telemetry
from flying_vines.simulation.autopilot.flight import (
    CopterMotion,
    FlightMode,
    Leg,
    mode_named,
)
from flying_vines.simulation.autopilot.links import COMPANION, GCS, Links, Port
from flying_vines.simulation.autopilot.mission_protocol import MissionStorage
from flying_vines.simulation.autopilot.mission_runners import (
    ArduPilotMission,
    CommandSender,
    Px4Mission,
    Runner,
    SentCommand,
)
from flying_vines.simulation.autopilot.parameters import ParameterServer
from flying_vines.simulation.autopilot.rc_input import (
    ArduPilotRc,
    Px4Rc,
    RcInput,
    RcLoss,
    RcSource,
)
from flying_vines.simulation.autopilot.scheduler import ScheduledCallback, Scheduler
from flying_vines.vehicle.mission import item as mission_item
from flying_vines.vehicle.mission.item import AutopilotKind, MissionItem
from missions.home import SIMULATOR_HOME, Home

_TICK_S = 0.02
_UPTIME_S = 30.0
_REBOOT_SILENCE_S = 1.25
_CALIBRATION_S = 2.0
_READY_S = 1.41
_ORIGIN_S = 19.0
_DISARM_AFTER_LANDING_S = 2.0
_REACHED_AGAIN_S = 1.0
_REACHED_TIMES = 10
_RUNTIME_EVERY_S = 31.0
UNIX_AT_START_S = 1_795_211_406.0
_WARNING, _INFO = 4, 6
MAX_LOGGED = 10_000
"""Maximum entries in each log of executed items: more than a mission has. The oldest ones are removed."""
_MAVLINK_CAMERA, _CAMERA_ITEMS = 5, (202, 203)


class Copter:
    """The vehicle and its links: state, stimuli, and what it sends of its own accord.

    At the start it has been up for 30 s, so its boot is visible only after `reboot`.
    """

    def __init__(
        self,
        kind: AutopilotKind = "ardupilot",
        system_id: int = 1,
        mission: Sequence[MissionItem] = (),
        *,
        home: Home | None = None,
        rc_present: bool = True,
        receiver: RcSource | None = None,
        rc_failsafe_mode: str | None = "RTL",
        parameters: Mapping[str, float] | None = None,
        signing_key: bytes | None = None,
        unix_s: float = UNIX_AT_START_S,
        seed: int = 0,
    ) -> None:
        """A disarmed vehicle on the ground at `home`, with a link to the companion.

        Args:
            mission: stored like an upload; raises `MissionRefused` if the autopilot would refuse it. On
                ArduPilot item 0 is home.
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
        self.scheduler = scheduler = Scheduler()
        self.payload_log: list[tuple[float, MissionItem]] = []
        self.performed: list[tuple[float, int]] = []
        self._epoch_s: float | None = None
        self._links = links = Links(kind, system_id, scheduler, signing_key, unix_s)
        self._streams = telemetry.StreamSender(kind, scheduler, self._snapshot, links.send)
        own = {"SYSID_THISMAV": system_id, "MAV_SYS_ID": system_id}
        self.parameters = ParameterServer(
            kind, {**(parameters or {}), **own}, scheduler, links.send_to, links.tell, self.text
        )
        source = receiver or ("pulses" if kind == "ardupilot" else "overrides")
        if (kind == "ardupilot") != (source == "pulses"):
            raise ValueError(f"the simulated {kind} has no receiver {source!r}")
        rc = source, rc_present, scheduler, self._rc_failsafe_changed
        self.rc: RcInput = (
            ArduPilotRc(*rc, self.parameters.__getitem__) if kind == "ardupilot" else Px4Rc(*rc, Random(seed))
        )
        self._failsafe_mode = mode_named(kind, rc_failsafe_mode) if rc_failsafe_mode is not None else None
        self._mission_mode = mode_named(kind, "AUTO")
        home = home or SIMULATOR_HOME[kind]
        self._storage = MissionStorage(kind, home, scheduler, links.send_to, self._mission_changed)
        self._boot_s = self._ready_s = -_UPTIME_S
        self._reset(CopterMotion(home))
        self.add_link(COMPANION)
        if mission:
            self._storage.load(mission)
        self._come_up()

    def _reset(self, flight: CopterMotion) -> None:
        """The vehicle's state after a boot."""
        self.flight = flight
        self.armed = False
        self.mode: FlightMode = mode_named(self.kind, "STABILIZE" if self.kind == "ardupilot" else "HOLD")
        self._mode_before: FlightMode | None = None
        """The mode to which PX4 returns after its failsafe."""
        self._leg: Leg | None = None
        self._grounded_s: float | None = None
        self._texts: list[tuple[str, int]] = []
        self._reached: int | None = None
        self._reached_again: ScheduledCallback | None = None
        self._sender = CommandSender(self.scheduler, self._send_command)
        self._runner: Runner = (
            ArduPilotMission(self)
            if self.kind == "ardupilot"
            else Px4Mission(self, self._sender, partial(self.parameters.__getitem__, "MIS_COMMAND_TOUT"))
        )

    # State

    @property
    def items(self) -> list[MissionItem]:
        """The mission as stored."""
        return self._storage.items

    @property
    def now_s(self) -> float:
        """The latest time given, on the caller's clock."""
        return (self._epoch_s or 0.0) + self.scheduler.now_s

    # Links

    def add_link(self, name: str) -> Port:
        """Add a link, so that it gets heartbeats from now on. Other links appear with their first message."""
        port = self._links.ports.get(name)
        if port is None:
            port = self._links.add(name)
            port.forwards = self._forwards(name)
            if self._links.up:
                self._streams.begin(port)
        return port

    # Stimuli

    def arm(self) -> None:
        if self.armed or not self._links.up:
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
        self._fly_item(mission_item.TAKEOFF, altitude_m)

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
        self.set_mode("AUTO")
        self.arm()

    def set_mission(self, items: Sequence[MissionItem]) -> None:
        """Replace the mission at once. Raises `MissionRefused` if an upload would be refused."""
        self._storage.load(items)
        self.flush()

    def replace_mission(self, items: Sequence[MissionItem]) -> None:
        """Simulate an upload by a ground station. Raises `MissionRefused` if it would be refused."""
        self.add_link(GCS)
        self._storage.replace(GCS, items)

    def set_current(self, seq: int) -> None:
        """Continue at item `seq`; a DO item runs (again). Raises `ValueError` if it does not exist."""
        if not 0 <= seq < len(self.items):
            raise ValueError(f"the mission has no item {seq}, only 0 to {len(self.items) - 1}")
        self._runner.set_current(seq)
        self.flush()

    def set_rc(self, channel: int, us: int) -> None:
        """Move a stick or switch (channels from 1)."""
        self.rc.move(channel, us)

    def lose_rc(self, how: RcLoss | None = None, preset: Mapping[int, int] | None = None) -> None:
        """Lose the RC link; default: the receiver's most common kind of loss.

        "frozen": RC_CHANNELS continues with the last values. "jump": it continues with usual failsafe values,
        or with the values in `preset` (channel: µs). Channels that are missing in `preset` keep their last
        value. "silent": RC_CHANNELS stops. Raises `ValueError` if this receiver has no such loss.
        """
        self.rc.lose(how, preset)

    def return_rc(self) -> None:
        """The RC link returns, with the present sticks."""
        self.rc.restore()

    def reboot(self) -> None:
        """Restart on the ground: silent for 1.25 s. Mission and parameters survive; learnt state is lost."""
        self.scheduler.clear()
        self._links.reboot()
        place = self.flight
        flight = CopterMotion(place.home)
        flight.north_m, flight.east_m = place.north_m, place.east_m
        self.rc.reboot()
        self._streams.reboot()
        self.parameters.reboot()
        self._storage.reboot()
        self._reset(flight)
        now_s = self.scheduler.now_s
        self._boot_s, self._ready_s = now_s + 0.2, now_s + _REBOOT_SILENCE_S
        self.scheduler.at(self._ready_s, self._come_up)
        if self.kind == "ardupilot":
            self.scheduler.at(self._ready_s + _READY_S, self._say_ready)
            self.scheduler.at(self._ready_s + _ORIGIN_S, self._tell_home)

    def mute(self, seconds: float) -> None:
        """Cut all links for this time; the vehicle continues to fly."""
        self._links.mute(seconds)

    def stall(self, seconds: float, *, both_ways: bool = False) -> None:
        """Delay frames to the companion (`both_ways`: also received bytes); then all arrive together."""
        self._links.stall(COMPANION, seconds, both_ways)

    # Host of the mission runner

    def text(self, text: str, severity: int = _INFO) -> None:
        self._texts.append((text, severity))

    def reached(self, seq: int) -> None:
        self._reached = seq

    def executed(self, item: MissionItem) -> None:
        self.payload_log.append((self.now_s, item))
        del self.payload_log[:-MAX_LOGGED]
        hands_on = self.kind == "ardupilot" and self.parameters["CAM1_TYPE"] == _MAVLINK_CAMERA
        if hands_on and item.command in _CAMERA_ITEMS:
            self._links.tell(mavlink.MAVLink_command_long_message(0, 0, item.command, 0, *item.params))

    def flush(self) -> None:
        if self._reached is not None:
            self._send_reached(self._reached, _REACHED_TIMES)
            self._reached = None
        texts, self._texts = self._texts, []
        for text, severity in texts:
            message = mavlink.MAVLink_statustext_message(severity, text.encode()[:50])
            for port in self._links.ports.values():
                if port.active if self.kind == "ardupilot" else port.has_gcs:
                    self._links.send(port, message)

    # The vehicle

    def _come_up(self) -> None:
        self._links.up = True
        for port in self._links.ports.values():
            port.forwards = self._forwards(port.name)
            self._streams.begin(port)
        if self.kind == "ardupilot":
            runtime_s = self.scheduler.now_s - self._boot_s
            self.scheduler.after(_RUNTIME_EVERY_S - runtime_s % _RUNTIME_EVERY_S, self._count_runtime)
        self.scheduler.every(_TICK_S, self._tick)

    def _send_once(self, *message_ids: int) -> None:
        """Send these messages now, to all links."""
        for port in self._links.ports.values():
            for message_id in message_ids:
                self._streams.once(port, message_id)

    def _tell_home(self) -> None:
        self._send_once(telemetry.GPS_GLOBAL_ORIGIN, telemetry.HOME_POSITION)

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
        if not self._links.up:
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
            self._fly_item(command, 0.0)
        else:
            self.flight.hold()
        if self.kind == "ardupilot":
            self._send_once(telemetry.HEARTBEAT)
        return True

    def _fly_item(self, command: int, height_m: float) -> None:
        item = MissionItem(0, command, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, height_m), 3)
        self._leg = Leg(self.flight, item, self.scheduler.now_s)

    def _rc_failsafe_changed(self, on: bool) -> None:
        in_flight = self.armed and self.flight.airborne
        if self.kind == "ardupilot":
            stays = on and in_flight and self._failsafe_mode is None and self.mode.name in ("AUTO", "GUIDED")
            mode = f" - Continuing {self.mode.name.capitalize()} Mode" if stays else ""
            self.text(f"Radio Failsafe{mode}" if on else "Radio Failsafe Cleared", _WARNING)
        elif self._mode_before is not None and not on:
            self._select(self._mode_before)
            self._mode_before = None
        if on and self._failsafe_mode is not None and in_flight:
            self._mode_before = self.mode
            self._select(self._failsafe_mode)
        self.flush()

    def _mission_changed(self) -> None:
        self._runner.replaced()
        if self.kind == "px4":
            self._send_once(telemetry.MISSION_CURRENT)
        elif self.parameters["MIS_TOTAL"] != len(self.items):
            self.parameters.change("MIS_TOTAL", len(self.items))

    def _send_reached(self, seq: int, times_left: int) -> None:
        self._links.tell(mavlink.MAVLink_mission_item_reached_message(seq))
        if self._reached_again is not None:
            self._reached_again.cancel()
            self._reached_again = None
        if self.kind == "px4" and times_left:
            again = partial(self._send_reached, seq, times_left - 1)
            self._reached_again = self.scheduler.after(_REACHED_AGAIN_S, again)

    def _send_command(self, command: SentCommand, confirmation: int) -> None:
        target = self.system_id, command.target_component
        self._links.tell(
            mavlink.MAVLink_command_long_message(*target, command.command, confirmation, *command.params)
        )

    def _snapshot(self) -> telemetry.AutopilotSnapshot:
        now_s = self.scheduler.now_s
        return telemetry.AutopilotSnapshot(
            kind=self.kind,
            mode=self.mode,
            armed=self.armed,
            calibrating=now_s - self._ready_s < _CALIBRATION_S,
            boot_s=now_s - self._boot_s,
            unix_s=self._links.unix_s,
            flight=self.flight,
            rc=self.rc,
            mission=self._runner.status(self.mode == self._mission_mode),
            mission_id=self._storage.mission_id,
        )
