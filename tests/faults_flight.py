"""A monitored flight: actions of pilot, mission, ground station and hardware, and the motions that they
allow.

Each method does one thing to the simulated world, and tells the monitor the consequence: a bend was
requested, or the vine must be at rest from some time on. The constants are the times that the service may
take to notice something: the times of `docs/behaviour.md`, plus the period of the message that reports it.
"""

from __future__ import annotations

import dataclasses
import math
import random
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import msgspec
from invariant_monitor import DEAD_MAN_S, LONGEST_HANG_S, InvariantMonitor, MonitoredBoard, Rules, Violation
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config
from flying_vines.config.config import ITEM_COMMANDS, Config
from flying_vines.core.core import Core
from flying_vines.core.events import Action, Decision, Event, LinkChanged
from flying_vines.core.safety import LANDING_MARGIN_M
from flying_vines.physics.plant.effects import Effects
from flying_vines.simulation.autopilot import FakeAutopilot, RcLoss, RcSource
from flying_vines.simulation.autopilot.links import PX4_BUFFER
from flying_vines.simulation.autopilot.rc_input import REPORTS_APART_S
from flying_vines.simulation.phlosar.firmware import SAFE, Board, Firmware
from flying_vines.simulation.phlosar.mishaps import Hanging, Kinked, MishapKind, StuckAt, Unpowered
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.mission.item import AutopilotKind as AutopilotKind
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.notice import Notice
from flying_vines.vine.curve import BendCurve

SWITCH = 9
PULSES_US = (1000, 1500, 2000)
CRUISE_M = 8.0
HELD_AT_MOST_S = 4.0
SCRIPT_MESSAGE, ACTUATOR = ITEM_COMMANDS["script_message"], ITEM_COMMANDS["actuator"]
ALTITUDE = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
COMMAND = mavlink.MAVLINK_MSG_ID_COMMAND_LONG
STEP_S = 0.01
WRITTEN_EVERY_S = 0.5
RESTING_KPA = 0.5
DEBOUNCED_S = 0.5
"""Maximum time from the move of the switch to the move of the vine: 0.15 s of debounce, RC_CHANNELS 20 times
a second, and a tick."""
CONFIRMED_S = 2.2
"""The same time on PX4 with a receiver of its own: RC must stay good for 1.6 s after the move."""
LEFT_S = 0.3
"""After the switch has left a position, this position's bend may still begin within this time."""
SURELY_BENDS_S = 2.7
"""A position that lasts this long, with good RC, must bend the vine."""
RC_SHOWN_S = 1.5
"""Maximum time from PX4's report that its own receiver is lost to a vented vine."""
TOLD_LATE_S = 2.5
"""If PX4 has just reported another change of health, it reports an RC loss late. For this time after the
loss, the receiver's preset may look like a move of the switch."""
REPORTED_S = 2.4
"""Maximum time from the return of RC to PX4's report that it is good."""
RC_LOST_S = 1.4
OVERRIDES_EVERY_S = 0.2
COMMANDED_S = 0.3
FORWARDED_S = 0.05
"""PX4 forwards one command each 10 ms."""
ITEM_S = 1.3
"""An item is executed within about a second, or not at all."""
OLDEST_S = 1.3
"""Any other request, too, is executed within this time, or not at all."""
STRAIGHT_S = 3.0
"""An item that straightens may take longer: if its command was lost, later messages show that it ran."""
STRAIGHTENED_S = 3.0
LIMIT = "limit: "
"""Prefix of the names of triggers that the service cannot distinguish from the pilot's moves."""
FRESH_S = 2.0
"""A fresh move after a request of others is straight for less than this time."""
FLICK_S = 0.3
"""A position that lasts longer has been noticed."""
BOOTS_S = 1.5
"""A rebooted autopilot is silent for a little less than this."""
NEW_CLOCK_S, WAITS_S = 2.5, 0.3
"""Until `NEW_CLOCK_S` after the autopilot's clock has become known, a command waits up to `WAITS_S` for the
messages behind it."""
TICKS_S = 0.05
RC_MESSAGE_S, TWO_RC_MESSAGES_S = 0.06, 0.1
UNCERTAIN_S = 0.3
"""Messages have random times. Within this tolerance both outcomes are right."""
LATE_S = 3.5
"""Additional time to notice something while some of the vehicle's messages are lost."""


@dataclass(frozen=True)
class Setup:
    """The vehicle and its settings. The rest of the configuration is the default."""

    autopilot: AutopilotKind = "ardupilot"
    has_rc: bool = True
    holds: bool = False
    """True: the vine holds after RC loss."""
    receiver: RcSource | None = None
    rc_failsafe_mode: str | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    """Parameters of the autopilot."""
    armed_at_start: bool = True
    max_bent_s: float = 120.0
    mission: tuple[MissionItem, ...] = ()
    likely_rig: bool = False
    seed: int = 1

    @property
    def has_real_receiver(self) -> bool:
        """True for PX4 with a receiver, which reports losses late."""
        return self.receiver in ("sbus", "crsf")

    @property
    def shows_rc(self) -> bool:
        """False for a joystick: the service cannot see its RC."""
        return self.has_rc and self.receiver != "joystick"

    @property
    def hides_rc_losses(self) -> bool:
        """True if ArduPilot's parameters, which the service reads, hide losses."""
        told = {"FS_THR_ENABLE": 1.0, "RC_FS_TIMEOUT": 1.0} | dict(self.parameters)
        ignores = int(self.parameters.get("RC_OPTIONS", 0)) & 4
        return self.autopilot == "ardupilot" and (
            not told["FS_THR_ENABLE"] or told["RC_FS_TIMEOUT"] > 1.0 or bool(ignores)
        )

    @property
    def config(self) -> Config:
        base = config.default()
        replace = msgspec.structs.replace
        return replace(
            base,
            interlocks=replace(base.interlocks, armed_at_start=self.armed_at_start),
            limits=replace(base.limits, max_bent_s=self.max_bent_s),
            losses=replace(
                base.losses,
                on_rc_loss="hold" if self.holds else "vent",
                hold_at_most_s=HELD_AT_MOST_S,
            ),
        )


class Nobody(Core):
    """Replaces the core while the companion's process is dead."""

    def handle(self, event: Event) -> list[Action]:
        return []


@dataclass
class Wire:
    """One direction of a line. The line may be cut, or a share of the pieces that were sent may be
    damaged."""

    seed: str
    cut: bool = False
    spoiled: float = 0.0
    without: set[int] = field(default_factory=set)
    """Types of the autopilot's own MAVLink messages that are lost."""
    _random: random.Random = field(init=False)

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)

    def __call__(self, data: bytes) -> bytes:
        if self.cut or (
            self.without and data[6] == 1 and int.from_bytes(data[7:10], "little") in self.without
        ):
            return b""
        if self.spoiled == 0.0 or not data or self._random.random() >= self.spoiled:
            return data
        at = self._random.randrange(len(data))
        match self._random.randrange(3):
            case 0:
                return b""
            case 1:
                return data[:at]
            case _:
                return data[:at] + bytes([data[at] ^ self._random.randrange(1, 256)]) + data[at + 1 :]


class MonitoredFlight:
    """Starts on the ground, disarmed, at time 0. Every method acts now, and `run` lets time pass."""

    def __init__(
        self, setup: Setup, core: Callable[[Config], Core] = Core, board: Board | None = None
    ) -> None:
        self.setup = setup
        self.config = config = setup.config
        self.timeline: list[tuple[float, str]] = []
        self._new_core = core
        self.autopilot = FakeAutopilot(
            setup.autopilot,
            mission=setup.mission,
            rc_present=setup.has_rc,
            receiver=setup.receiver,
            rc_failsafe_mode=setup.rc_failsafe_mode,
            parameters=setup.parameters,
            seed=setup.seed,
        )
        self.autopilot.add_link("gcs")
        self.autopilot.set_rc(SWITCH, PULSES_US[0])
        self.phlosar = SimulatedPhlosar(
            firmware=board or Firmware(),
            effects=None if setup.likely_rig else Effects(),
            seed=setup.seed,
        )
        limits = config.limits
        self.monitor = InvariantMonitor(Rules(limits.max_kPa, limits.max_rate_kPa_per_s, limits.max_bent_s))
        MonitoredBoard(self.phlosar, self.monitor)
        self.flight = SimulatedFlight(config, self.autopilot, self.phlosar)
        self.flight.world.core = core(config)
        self.to_board, self.from_board, self.from_autopilot = (
            Wire(f"{name} of {setup.seed}") for name in ("to board", "from board", "from autopilot")
        )
        self.flight.world.to_phlosar = self.to_board
        self.flight.world.from_phlosar = self.from_board
        self.flight.from_autopilot = self.from_autopilot
        self.texts: list[tuple[float, str]] = []
        """Texts that the pilot reads."""
        self._station = MavlinkCodec(255, mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self._position = 0
        self._rc_lost: RcLoss | None = None
        self._rc_lost_s = 0.0
        self._rc_shown = False
        """True if a message has shown the present loss."""
        self._override: int | None = None
        self._stood: set[int] = set()
        self._override_sent_s = self._override_ends_s = 0.0
        self._vented = False
        """True if a ground station has certainly vented the vine since the switch moved."""
        self._overruled = False
        """True if anything but the switch may have moved the vine since the last fresh move."""
        self._straight_s = -math.inf
        """When the switch last left a bending position."""
        self._health_reported_s = -math.inf
        self._stalled_until_s = 0.0
        self._mended_unpowered: set[str] | None = None
        """Places that were repaired while the board has no power; None while it has power."""
        self._clock_is_new_until_s = 0.0
        self._clean = True
        """True while nothing but RC has failed."""
        self._expected: tuple[float, str] | None = None
        """Time and name of the pilot's move that must bend the vine."""
        self._curve = BendCurve(config.vine.curve, config.vine.hysteresis_kPa)
        self._rc_good_since_s: float | None = None
        self._rc_in_use = False
        self._muted_until_s = self._boots_until_s = 0.0
        self._unseen: dict[str, float] = {}
        self._unseen_from_s = 0.0
        self._unseen_position = 0
        self._noticed = False
        self._settled_s = self._surely_settled_s = 0.0
        self._moved_s = 0.0
        self._standing: int | None = None
        self._settle()
        self._conditions: dict[str, float] = {}
        self._items_seen = 0
        self._moving = False
        self._written_s = 0.0
        self._held_from_s = 0.0
        self._late = False
        self._plugged = True
        self._arming_s = -math.inf
        self._sent_s: deque[float] = deque(maxlen=PX4_BUFFER + 1)
        """Times of the latest commands of a ground station."""
        self._received_by_s: dict[str, float] = {}
        """For each condition that forbids a bend: the time when the companion has certainly received it."""
        if not setup.armed_at_start:
            self.monitor.forbid("pneumatics disarmed", 0.0)

    @property
    def now_s(self) -> float:
        return self.flight.world.now

    @property
    def violations(self) -> list[Violation]:
        return self.monitor.violations

    @property
    def companion_lives(self) -> bool:
        return not isinstance(self.flight.core, Nobody)

    def run(self, seconds: float) -> None:
        until_s = self.now_s + seconds
        while self.now_s < until_s - 1e-6:
            self._take(self.flight.run(min(until_s, self.now_s + STEP_S)))
            self._look_around()

    def note(self, text: str) -> None:
        self.timeline.append((self.now_s, text))

    # The pilot.

    def take_off(self) -> None:
        self.autopilot.takeoff(CRUISE_M)

    def start_mission(self) -> None:
        self.autopilot.start_mission()

    def land(self) -> None:
        self._disturb()
        self.autopilot.land()

    def disarm(self) -> None:
        self._disturb()
        self.autopilot.disarm()

    def move_switch(self, position: int) -> None:
        """Move the switch. A move requests nothing if the companion cannot see it, or soon after a loss."""
        if position == self._position:
            return
        left, self._position = self._position, position
        self.autopilot.set_rc(SWITCH, PULSES_US[position])
        # A switch that returns before the service noticed the move has not moved.
        lasted = self.now_s > self._moved_s + FLICK_S
        # On PX4 with a receiver, the same holds until RC was good for long enough at the other position.
        if not self.setup.has_real_receiver or self.now_s > self._moved_s + CONFIRMED_S:
            self._stood = set()
        self._stood.add(left)
        came_back = position in self._stood
        self._moved_s = self.now_s
        self._expected = self._standing = None
        if self._unseen or self._override is not None:
            return
        self._vented = False
        if left > 0 and position == 0:
            self._straight_s = self.now_s
        is_fresh = self._is_fresh(left)
        overruled = self._overruled and not (is_fresh and position > 0)
        if self.setup.has_real_receiver:
            self.monitor.withdraw(_switch_to(left), self.now_s + LEFT_S)
        certain = self.now_s >= self._surely_settled_s
        if self.now_s >= self._settled_s:
            self._switch_asks(position, certain=certain and lasted)
            if position > 0 and self.setup.has_real_receiver:
                self._standing = len(self.monitor.begins)
            may_bend = position > 0 and is_fresh and not came_back
            if certain and lasted and may_bend and self._nothing_is_against_it:
                self._expected = self.now_s, _switch_to(position)
        self._overruled = overruled
        if not certain:
            self._settle()

    def _is_fresh(self, left: int) -> bool:
        """True if the service may not take the move for the end of an override."""
        in_time = not self._overruled or self.now_s < self._straight_s + FRESH_S
        return self.setup.autopilot == "px4" or (left == 0 and in_time)

    @property
    def _nothing_is_against_it(self) -> bool:
        enough_kPa = self.config.limits.max_kPa + 2 * self.config.interlocks.reserve_kPa
        return (
            self._clean
            and self.setup.shows_rc
            and not self.setup.hides_rc_losses
            and self._rc_in_use
            and self.monitor.idle
            and self.monitor.pending_until_s < self.now_s + CONFIRMED_S + 0.1
            and self.phlosar.cv_kPa < RESTING_KPA
            and self.phlosar.reservoir_kPa > enough_kPa
            and self.autopilot.flight.height_m > self.config.interlocks.min_altitude_m + 4.0
        )

    def _switch_asks(self, position: int, *, certain: bool, what: str | None = None) -> None:
        if not self.setup.shows_rc and what is None:
            return
        confirmed = position > 0 and self.setup.has_real_receiver
        self._asked(
            what or _switch_to(position),
            CONFIRMED_S if confirmed else DEBOUNCED_S,
            position > 0,
            True,
            certain,
            after_s=self.config.switch.debounce_s,
            kPa=self._kPa(30.0 * position),
            latest_s=math.inf,
        )

    def _kPa(self, angle_deg: float) -> float:
        return self._curve.pressure_kPa(angle_deg)

    def override(self, position: int) -> None:
        """A ground station overrides the switch, and repeats its message."""
        before = self._position if self._override is None else self._override
        self._override, self._override_sent_s = position, -math.inf
        self._override_ends_s = math.inf
        self._expected = None
        # The override is received even if the transmitter is lost.
        if position != before and self._unseen.keys() <= {"rc"} and self.now_s >= self._settled_s:
            self._switch_asks(position, certain=False, what=f"override to {position}")

    def stop_override(self) -> None:
        """The ground station stops. ArduPilot keeps the overriding value for a while."""
        self._override_ends_s = self._override_sent_s + self.autopilot.parameters["RC_OVERRIDE_TIME"]

    def _tell_override(self) -> None:
        if self._override is None:
            return
        if self._override_ends_s == math.inf and self.now_s >= self._override_sent_s + OVERRIDES_EVERY_S:
            self._override_sent_s = self.now_s
            channels_us = [65535] * 8 + [0] * 10
            channels_us[SWITCH - 1] = PULSES_US[self._override]
            message = mavlink.MAVLink_rc_channels_override_message(1, 1, *channels_us)
            self.autopilot.receive(self.now_s, "gcs", self._station.encode(message, 255))
        elif self.now_s >= self._override_ends_s - STEP_S:
            before, self._override = self._override, None
            if self._position != before and not (self._position > 0 and self._vented):
                # The end of the override looks like a move of the pilot. A move to straight clears faults.
                self._switch_asks(self._position, certain=False, what=f"{LIMIT}an override expired")

    def _settle(self) -> None:
        """A switch that was not seen, or that moves before it has settled, must settle again."""
        settle_s = self.config.switch.settle_s
        if self.now_s < self._settled_s:
            self._settled_s = self.now_s + settle_s - UNCERTAIN_S
        reported_s = REPORTED_S if self.setup.has_real_receiver else 0.0
        self._surely_settled_s = self.now_s + reported_s + settle_s + UNCERTAIN_S

    def press(self, code: int, angle_deg: float = 0.0) -> None:
        """A ground station's button, with the codes of mission items."""
        self._command(mavlink.MAV_CMD_USER_1, code, angle_deg)
        self._asked_by_station(f"button {code}", bends=code > 0, kPa=self._code_kPa(code, angle_deg))

    def bend_to(self, angle_deg: float) -> None:
        self._command(mavlink.MAV_CMD_USER_2, angle_deg)
        self._asked_by_station(f"bend {angle_deg:g}°", bends=True, kPa=self._kPa(angle_deg))

    def vent(self) -> None:
        self._command(mavlink.MAV_CMD_USER_4, 0)
        self._asked_by_station("vent", bends=False)

    def hold(self) -> None:
        self._command(mavlink.MAV_CMD_USER_4, 1)
        self.monitor.any_target(self.now_s + COMMANDED_S)

    def _code_kPa(self, code: float, angle_deg: float) -> float | None:
        """Pressure at the end of a button's or an item's bend; None for a profile that continues to move."""
        angles_deg = {1.0: angle_deg, 4.0: 30.0, 5.0: 60.0}
        return self._kPa(angles_deg[code]) if code in angles_deg else None

    def arm_pneumatics(self) -> None:
        self._command(mavlink.MAV_CMD_USER_4, 3)
        if self._station_is_received:
            self.monitor.permit("pneumatics disarmed")
        self._arming_s = self.now_s

    def disarm_pneumatics(self) -> None:
        self._command(mavlink.MAV_CMD_USER_4, 2)
        self._disturb()
        if (
            self._station_is_received
            and not self._stalled_s
            and self._surely_forwarded
            and not self._vehicle_is_spoiled
        ):
            self.monitor.forbid("pneumatics disarmed", self.now_s + COMMANDED_S)
            self._received_by_s["pneumatics disarmed"] = self.now_s + COMMANDED_S

    def clear_faults(self) -> None:
        self._command(mavlink.MAV_CMD_USER_5, 1)
        if self._station_is_received:
            self.monitor.person_clears(self.now_s + self._stalled_s + COMMANDED_S)

    def _command(self, command: int, *params: float) -> None:
        seven = (*params, *(0.0,) * (7 - len(params)))
        self._sent_s.append(self.now_s)
        message = mavlink.MAVLink_command_long_message(1, 191, command, 0, *seven)
        self.autopilot.receive(self.now_s, "gcs", self._station.encode(message, 255))

    @property
    def _station_is_received(self) -> bool:
        return not self._unseen.keys() & {"silence", "link", "companion"}

    @property
    def _surely_forwarded(self) -> bool:
        """False if PX4 may drop the command, because two others still wait."""
        if self.setup.autopilot != "px4" or len(self._sent_s) <= PX4_BUFFER:
            return True
        return self.now_s - self._sent_s[0] > FORWARDED_S

    @property
    def _vehicle_is_spoiled(self) -> bool:
        return self.from_autopilot.spoiled > 0.0

    @property
    def _stalled_s(self) -> float:
        """Time until messages of the vehicle arrive again."""
        return max(0.0, self._stalled_until_s - self.now_s)

    def _asked_by_station(self, what: str, bends: bool, kPa: float | None = None) -> None:
        if self._station_is_received:
            certain = self._surely_forwarded and not self._stalled_s
            self._vented = certain and not bends
            within_s = COMMANDED_S + (WAITS_S if self.now_s < self._clock_is_new_until_s else 0.0)
            self._asked(what, within_s, bends, by_person=True, certain=certain, kPa=kPa)

    def _asked(
        self,
        what: str,
        within_s: float,
        bends: bool,
        by_person: bool,
        certain: bool = True,
        after_s: float = 0.0,
        kPa: float | None = None,
        latest_s: float = OLDEST_S,
        at_s: float | None = None,
    ) -> None:
        """Tell the monitor about a request.

        `certain`: the companion certainly receives it, but not before `after_s`.
        """
        now_s = self.now_s if at_s is None else at_s
        self._expected = None
        self._overruled = True
        within_s += self._stalled_s
        after_s = max(after_s, self._stalled_s)
        if self._vehicle_is_spoiled:
            within_s += LATE_S
        if bends:
            self.monitor.permit("asked to straighten")
            self.monitor.permit(_STILL_BENT)
            within_s = min(within_s, latest_s)
            self.monitor.trigger(now_s, within_s, what, after_s, kPa=kPa, latest_s=latest_s)
            return
        if by_person:
            self.monitor.person_clears(now_s + within_s)
        # Forbid motion only if no earlier request is pending: its bend may still begin after this request.
        last = self.monitor.pending_until_s <= now_s
        if certain and last and not self._vehicle_is_spoiled:
            self.monitor.forbid("asked to straighten", now_s + within_s + 0.2, inflation_only=True)
            self.monitor.forbid(_STILL_BENT, now_s + within_s + STRAIGHTENED_S)
            self._received_by_s["asked to straighten"] = self._received_by_s[_STILL_BENT] = now_s + within_s

    # The vehicle.

    def lose_rc(self, how: RcLoss | None = None, preset: Mapping[int, int] | None = None) -> None:
        """Lose the pilot's transmitter or its link. Values that the receiver makes up are no request."""
        self.autopilot.lose_rc(how, preset)
        self._rc_lost, self._rc_lost_s = self.autopilot.rc.lost, self.now_s
        # PX4 with a receiver of its own reports a loss only later. Frozen values never show a loss if
        # ArduPilot's parameters hide it.
        self._rc_shown = not self.setup.has_real_receiver and (
            how != "frozen" or not self.setup.hides_rc_losses
        )
        if how == "jump" and self.now_s < self._health_reported_s + REPORTS_APART_S:
            self.monitor.trigger(self.now_s, TOLD_LATE_S, f"{LIMIT}PX4 reports the loss very late")
        if how == "jump" and self.setup.has_real_receiver and self.now_s < self._moved_s + RC_MESSAGE_S:
            self.monitor.trigger(self.now_s, CONFIRMED_S, f"{LIMIT}a preset hides the move before it")
        self._unsee("rc")
        self._expected = None
        self._overruled = True
        if self.setup.holds:
            self.monitor.any_target(math.inf)

    def return_rc(self) -> None:
        self.autopilot.return_rc()
        self._rc_lost = None
        if self._held_from_s > self.now_s:
            self.monitor.hold_still(math.inf)
        self._see("rc")
        if self._standing == len(self.monitor.begins):
            # The pilot's own move, delayed by a short loss, if the switch is still there.
            self._switch_asks(self._position, certain=False)

    def hide_rc_losses(self, name: str, value: float) -> None:
        """Set a parameter of the autopilot so that it hides RC losses."""
        self.autopilot.parameters.change(name, value)
        parameters = {**self.setup.parameters, name: value}
        self.setup = dataclasses.replace(self.setup, parameters=parameters)

    def report_health(self) -> None:
        """Let PX4 report its health now for another reason, and then not for 2 s."""
        self.autopilot.rc.report()
        self._health_reported_s = self.now_s

    def stall_vehicle_link(self, seconds: float, both_ways: bool = False) -> None:
        """The vehicle's messages are delayed, and then arrive all at once."""
        self._disturb()
        self.autopilot.stall(seconds, both_ways=both_ways)
        self._stalled_until_s = self.now_s + seconds
        self._unsee("link stalled")

    def replace_mission(self, items: Sequence[MissionItem]) -> None:
        """A ground station uploads another mission."""
        self.autopilot.replace_mission(items)

    def lose_commands(self) -> None:
        """Lose the autopilot's commands; on PX4 these are its mission items."""
        self._late = True
        self.from_autopilot.without.add(COMMAND)

    def find_commands(self) -> None:
        self.from_autopilot.without.discard(COMMAND)

    def mute(self, seconds: float) -> None:
        self._disturb()
        self.autopilot.mute(seconds)
        self._muted_until_s = self.now_s + seconds
        self._unsee("silence")

    def reboot_autopilot(self) -> None:
        self._disturb()
        self.autopilot.reboot()
        self._clock_is_new_until_s = math.inf
        self._boots_until_s = self.now_s + BOOTS_S
        self._unsee("silence")
        self._noticed = True

    def close_vehicle_link(self) -> None:
        self._disturb()
        self.from_autopilot.cut = True
        if self.setup.holds:
            self.monitor.any_target(math.inf)
        self._unsee("link")
        self._noticed = True
        self._feed(LinkChanged(self.now_s, "vehicle", False, "closed"))

    def open_vehicle_link(self) -> None:
        self.from_autopilot.cut = False
        self._see("link")
        self._feed(LinkChanged(self.now_s, "vehicle", True))

    def spoil_vehicle_link(self, share: float) -> None:
        self._late = True
        self._disturb()
        self.from_autopilot.spoiled = share

    def mend_vehicle_link(self) -> None:
        self.from_autopilot.spoiled = 0.0

    def lose_altitude(self) -> None:
        self._disturb()
        self.from_autopilot.without.add(ALTITUDE)

    def find_altitude(self) -> None:
        self.from_autopilot.without.discard(ALTITUDE)

    # The companion.

    def kill_companion(self) -> None:
        """Stop it at once, as kill -9 does; its port closes."""
        self._disturb()
        self.flight.world.core = Nobody(self.config)
        self._rc_in_use = False
        self._rc_good_since_s = None
        self._unsee("companion")
        self._noticed = True

    def start_companion(self) -> None:
        if self.companion_lives:
            return
        self.flight.world.core = self._new_core(self.config)
        self.monitor.companion_replaced()
        if not self.setup.armed_at_start:
            # The board's present setpoint ends by the dead-man.
            self.monitor.forbid("pneumatics disarmed", self.now_s + DEAD_MAN_S)
        else:
            self.monitor.permit("pneumatics disarmed")
        if self._plugged:
            self._feed(LinkChanged(self.now_s, "firmware", True))
        if not self.from_autopilot.cut:
            self._feed(LinkChanged(self.now_s, "vehicle", True))
        self._clock_is_new_until_s = math.inf
        self._see("companion")

    def stall_companion(self, seconds: float, meanwhile: Callable[[], None] | None = None) -> None:
        """Pause the process. Messages of the vehicle and of people (`meanwhile`) wait until it continues."""
        self._disturb()
        self._unsee("stall")
        if meanwhile is not None:
            meanwhile()
        began_s = self.now_s
        self._take(self.flight.stall(began_s + seconds))
        self.monitor.delay(began_s, seconds + STEP_S)
        self._see("stall")
        self._look_around()

    # The serial line.

    def unplug(self) -> None:
        self._plugged = False
        self.cut_commands()
        self.cut_telemetry()
        self._feed(LinkChanged(self.now_s, "firmware", False, "unplugged"))

    def plug_in(self) -> None:
        self._plugged = True
        self.mend_line()
        self._feed(LinkChanged(self.now_s, "firmware", True))

    def cut_commands(self) -> None:
        self._disturb()
        self.to_board.cut = True

    def cut_telemetry(self) -> None:
        self._disturb()
        self.from_board.cut = True

    def spoil_line(self, share: float) -> None:
        self._disturb()
        self.to_board.spoiled = self.from_board.spoiled = share

    def mend_line(self) -> None:
        if self.to_board.cut:
            # A bend that the board did not receive is dropped 0.3 s after its decision, or a tick later.
            self.monitor.delay(self.now_s, TICKS_S)
        for wire in (self.to_board, self.from_board):
            wire.cut, wire.spoiled = not self._plugged, 0.0

    # The hardware.

    def inject(self, place: str, kind: MishapKind) -> None:
        self._disturb()
        match place, kind:
            case ("evp", StuckAt(opening)) if opening > 0.0:
                self.monitor.excuse(place, math.inf, rises=True)
            case ("solenoid", StuckAt(opening)) if opening < 0.5:
                self.monitor.excuse(place, math.inf, rises=True)
            case ("hose", Kinked()):
                # The air in the vine warms up again, and its pressure rises.
                self.monitor.excuse(place, math.inf, rises=True)
            case ("cv_sensor", _):
                self.monitor.excuse(place, math.inf)
            case "board", Unpowered():
                self.monitor.unpowered()
                self._mended_unpowered = set()
            case "board", Hanging():
                self.monitor.excuse(place, self.now_s + LONGEST_HANG_S)
        self.phlosar.inject(place, kind)

    def heal(self, place: str) -> None:
        if self._mended_unpowered is not None and place != "board":
            # The effect remains: without power the springs keep the air in.
            self._mended_unpowered.add(place)
        else:
            for mended in {place, *(self._mended_unpowered or ())}:
                self.monitor.end_excuse(mended, self.now_s)
            self._mended_unpowered = None
        self.phlosar.inject(place, None)

    # Looking.

    def _disturb(self) -> None:
        """From now on a bend may be refused for other reasons."""
        self._clean, self._expected = False, None

    def _unsee(self, what: str) -> None:
        """From now on the companion cannot see the switch."""
        self._expected = None
        if not self._unseen:
            self._unseen_from_s, self._unseen_position, self._noticed = self.now_s, self._position, False
        self._unseen[what] = self.now_s
        for name, received_by_s in self._received_by_s.items():
            if what != "stall" and received_by_s > self.now_s:
                # The request was still on its way, and may be lost.
                self.monitor.permit(name)
        if what in ("silence", "link", "companion", "link stalled"):
            self._late = True
            for name, due_s in self._conditions.items():
                if name in _TOLD_BY_VEHICLE and due_s > self.now_s:
                    self.monitor.permit(name)
                    self._conditions[name] = math.inf

    def _see(self, what: str) -> None:
        if self._unseen.pop(what, None) is None:
            return  # Two losses overlapped, and it has already returned.
        now_s = self.now_s
        if self._station_is_received:
            if self._clock_is_new_until_s == math.inf:
                self._clock_is_new_until_s = now_s + NEW_CLOCK_S
            if now_s - self._arming_s < STEP_S:
                # The arming command was sent at the same moment, and is still on its way.
                self.monitor.permit("pneumatics disarmed")
            for name, due_s in self._conditions.items():
                if due_s == math.inf:
                    held_s = HELD_AT_MOST_S if self.setup.holds and name == "RC lost" else 0.0
                    self._conditions[name] = now_s + _TOLD_BY_VEHICLE[name] + held_s + self._max_wait_s
                    self.monitor.forbid(name, self._conditions[name])
        if self._unseen:
            return
        # Tens of milliseconds decide whether a short loss was noticed, so both outcomes are right.
        # A silence just before RC loss does not count as part of the loss.
        since_s = self._rc_lost_s if what == "rc" else self._unseen_from_s
        lasted_s, certain_s = now_s - since_s, self.config.losses.rc_s + UNCERTAIN_S
        shown = self._rc_shown or self.setup.hides_rc_losses
        noticed = what != "stall" and (self._noticed or (lasted_s > certain_s and (what != "rc" or shown)))
        noticed |= what == "rc" and shown and (self.setup.has_real_receiver or self.setup.hides_rc_losses)
        if noticed:
            self._settled_s = math.inf
        else:
            if what != "stall":
                # A short silence is no loss: when it ends, the service sees a move that came just before it.
                self.monitor.delay(self._unseen_from_s, lasted_s)
            if self._position != self._unseen_position:
                self._switch_asks(self._position, certain=False)
        self._settle()

    @property
    def _max_wait_s(self) -> float:
        return LATE_S if self._vehicle_is_spoiled else 0.0

    def _look_around(self) -> None:
        now_s, autopilot, config = self.now_s, self.autopilot, self.config
        if "silence" in self._unseen and now_s >= max(self._muted_until_s, self._boots_until_s):
            self._see("silence")
        if "link stalled" in self._unseen and now_s >= self._stalled_until_s - 1.5 * STEP_S:
            self._see("link stalled")
        if self._rc_lost == "jump" and not self.setup.has_real_receiver and self._unseen.keys() <= {"rc"}:
            self._noticed |= now_s > self._rc_lost_s + TWO_RC_MESSAGES_S
        self._tell_override()
        self._call_missed()
        rc_good = self.setup.shows_rc and autopilot.armed and not self._unseen
        if not rc_good:
            self._rc_good_since_s = None
        elif self._rc_good_since_s is None:
            self._rc_good_since_s = now_s
        elif now_s - self._rc_good_since_s > 1.0:
            self._rc_in_use = True
        if not autopilot.armed and self._rc_lost:
            self._rc_in_use = False
        lowest_m = config.interlocks.min_altitude_m - LANDING_MARGIN_M
        self._rc_shown |= self._rc_lost is not None and autopilot.rc.reports_loss
        # A ground station's override ends ArduPilot's loss, or prevents its report.
        replaced = self._override is not None and not autopilot.rc.reports_loss
        rc_lost = self._rc_lost is not None and self._rc_in_use and self._rc_shown and not replaced
        rc_lost_s = RC_SHOWN_S if now_s > self._rc_lost_s + 0.5 else RC_LOST_S
        silent = bool(self._unseen.keys() & {"silence", "link", "link stalled"})
        held_s = HELD_AT_MOST_S if self.setup.holds else 0.0
        if rc_lost and held_s and "RC lost" not in self._conditions:
            self._held_from_s = now_s + rc_lost_s + self._max_wait_s
            self.monitor.hold_still(self._held_from_s)
        self._watch("disarmed", not autopilot.armed, _TOLD_BY_VEHICLE["disarmed"])
        told_height = ALTITUDE not in self.from_autopilot.without
        self._watch(
            "landing", told_height and autopilot.flight.height_m < lowest_m, _TOLD_BY_VEHICLE["landing"]
        )
        self._watch("RC lost", rc_lost, rc_lost_s + held_s)
        self._watch("autopilot silent", silent, 1.3 if self._rc_in_use and not held_s else 2.5)
        self._watch("altitude lost", not told_height, 2.5)
        # If the board receives nothing either, only its dead-man can act.
        deaf = self.from_board.cut and not self.to_board.cut
        # A stopped companion notices nothing; then the dead-man vents.
        self._watch("telemetry lost", deaf, config.losses.telemetry_s + 0.1 + DEAD_MAN_S)
        low = self.phlosar.reservoir_kPa < config.interlocks.reserve_kPa
        self._watch("reservoir low", low and self.phlosar.mishaps.reservoir_sensor is None, 3.0)
        self._note_items()
        self._write_down()

    def _call_missed(self) -> None:
        if self._expected is None:
            return
        since_s, what = self._expected
        if not self.monitor.resting:
            self._expected = None
        elif self.now_s >= since_s + SURELY_BENDS_S:
            self.monitor.miss(self.now_s, f"{what} at {since_s:.2f} s, RC good ever since")
            self._expected = None

    def _write_down(self) -> None:
        """Write down the pressures now and then, and when the vine begins or stops to move."""
        drive = self.phlosar.drive
        moving = drive != SAFE
        pressed = moving or self.phlosar.cv_kPa > RESTING_KPA
        due = pressed and self.now_s >= self._written_s + WRITTEN_EVERY_S
        if moving == self._moving and not due:
            return
        self._moving, self._written_s = moving, self.now_s
        valves = f"EVP {drive.evp:.2f}, DVP {drive.dvp:.0f}, outlet {'open' if drive.solenoid else 'shut'}"
        pressures = f"vine {self.phlosar.cv_kPa:5.1f} kPa, reservoir {self.phlosar.reservoir_kPa:3.0f} kPa"
        self.note(f"        {pressures}, {valves}")

    def _watch(self, name: str, holds: bool, within_s: float) -> None:
        if holds == (name in self._conditions):
            return
        if not holds:
            del self._conditions[name]
            self.monitor.permit(name)
            return
        due_s = self.now_s + within_s
        if name in _TOLD_BY_VEHICLE:
            received = self._station_is_received and not self._stalled_s
            due_s = due_s + self._max_wait_s if received else math.inf
        self._conditions[name] = due_s
        self.monitor.forbid(name, due_s)

    def _note_items(self) -> None:
        log = self.autopilot.payload_log
        for ran_s, item in log[self._items_seen :]:
            if item.command in (SCRIPT_MESSAGE, ACTUATOR):
                code, angle_deg = item.params[:2]
                bends = code != 0.0
                within_s = ITEM_S if bends else STRAIGHT_S
                # An item that is not received is repeated, or the mission's progress shows that it ran.
                after_s = 0.0 if self._station_is_received else within_s
                kPa = self._code_kPa(code, angle_deg)
                self._asked(
                    f"item {item.seq}", within_s, bends, by_person=False, after_s=after_s, kPa=kPa, at_s=ran_s
                )
                self.note(f"mission item {item.seq} runs: {code:g}, {angle_deg:g}")
        self._items_seen = len(log)

    def _feed(self, event: Event) -> None:
        self._take(self.flight.feed(event))

    def _take(self, actions: list[Action]) -> None:
        for action in actions:
            if isinstance(action, Notice):
                self.texts.append((action.t, action.text))
                self.timeline.append((action.t, f"    pilot reads: {action.text}"))
            elif isinstance(action, Decision):
                reason = f": {action.reason}" if action.reason else ""
                text = f"    {action.trigger} {action.intent} {action.safety}{reason}"
                self.timeline.append((action.t, text))


_STILL_BENT = "asked to straighten long ago"
_TOLD_BY_VEHICLE = {"disarmed": 1.3, "landing": 0.8, "RC lost": RC_LOST_S}
"""Conditions that only the vehicle's messages show, and the time until they do."""


def _switch_to(position: int) -> str:
    return f"switch to {position}"
