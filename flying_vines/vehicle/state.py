"""The state of the vehicle as the autopilot reports it: identity, arming, mode, altitude, clock."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.autopilots import OTHER, of_heartbeat
from flying_vines.vehicle.clock import SILENCE_S, AutopilotClock
from flying_vines.vehicle.mavlink import handled_messages as handled
from flying_vines.vehicle.mavlink.codec import MavlinkMessage

_AUTOPILOT: int = mavlink.MAV_COMP_ID_AUTOPILOT1
ALTITUDE_FRESH_S = 2.0
ALTITUDE_CONFIRMED_S = 0.9
"""After the start or a reboot the altitude is known when reports have arrived for this time. Also at 1 Hz
this takes two, so one false report is not enough."""
LOWEST_OF_S = 1.1
"""The lowest report of this time counts: two reports at 1 Hz, six at the 5 Hz that we request."""
LOWEST_M, HIGHEST_M = -1_000.0, 100_000.0
"""No vehicle with a vine reports an altitude beyond these."""
HEARTBEAT_FRESH_S = 5.0
"""Only HEARTBEAT, at 1 Hz, carries the arm state. Five HEARTBEATs are hardly ever lost in a row. A disarmed
vehicle must not count as armed for longer than this."""

SILENCE_RECENT_S = 1.0
"""A loss that is found at most this long after a silence comes from it. After a stall of our process, the
first queued frames may be read before any loss is found."""

OTHER_ID_AFTER_S = 5.0
"""If our autopilot is silent for this time, and another system id is heard, it may have a new id."""

CHOOSING_S = 2.0
"""A second autopilot within this time after the first makes the choice ambiguous."""

MAX_BOOT_MS = 15_000
"""If "ArduPilot Ready" arrives at a longer uptime than this, by the old clock, the autopilot has rebooted."""

NO_VEHICLE = {
    mavlink.MAV_TYPE_GCS,
    mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
    mavlink.MAV_TYPE_ANTENNA_TRACKER,
    mavlink.MAV_TYPE_GIMBAL,
    mavlink.MAV_TYPE_CAMERA,
    mavlink.MAV_TYPE_ADSB,
}
"""Types of HEARTBEAT senders that carry no vine. Some of them claim to be an autopilot."""


@dataclass(frozen=True, slots=True)
class Rebooted:
    """The autopilot rebooted. It has lost our stream requests and its route to us."""


@dataclass(frozen=True, slots=True)
class AutopilotFound:
    """The first heartbeat of the autopilot that we serve."""

    system_id: int


@dataclass(frozen=True, slots=True)
class Ambiguous:
    """Two autopilots are on the link and none is configured. Neither is served."""

    system_ids: tuple[int, int]


@dataclass(frozen=True, slots=True)
class OtherHeard:
    """Another system id is heard, and our autopilot is not. It may be another vehicle: not served."""

    expected: int
    heard: int


@dataclass(frozen=True, slots=True)
class OtherComponent:
    """No autopilot is found, and an autopilot with a component id other than 1 is heard: not served."""

    system_id: int
    component_id: int


VehicleEvent = Rebooted | AutopilotFound | Ambiguous | OtherHeard | OtherComponent


class VehicleState:
    """The state of one vehicle, from the messages of its autopilot only.

    With `system_id` 0 it is the vehicle of the first autopilot on the link, unless a second autopilot appears
    within `CHOOSING_S`. Ground stations, gimbals and other companions do not count.
    """

    def __init__(self, system_id: int = 0) -> None:
        self._configured_id = system_id
        self._found_at: float | None = None
        self._ambiguous = False
        self.clock = AutopilotClock()
        self._clocks = Clocks()
        self._others: dict[int, float] = {}
        """When each other autopilot was first heard without ours."""
        self._other_reported = False
        """One is reported. In a swarm the others would fill the pilot's screen and hide a fault."""
        self._altitudes: deque[tuple[float, float]] = deque()
        """Time and altitude of the latest report, and of each earlier one below all later ones."""
        self._altitudes_since = 0.0
        """When the first report after the start or a reboot arrived."""
        self._ambient_kPa = 0.0
        self._ambient_at: float | None = None
        self.system_id = 0
        self.autopilot = OTHER
        self.arm_state = ArmState()
        self.mode = ""
        self.heartbeat_at: float | None = None
        self.received_at: float | None = None
        self._silence = (-math.inf, 0.0)
        """When the latest silence ended, and how long it was."""

    @property
    def kind(self) -> str:
        return self.autopilot.kind

    @property
    def found(self) -> bool:
        return self.system_id != 0

    @property
    def heartbeat_missing(self) -> bool:
        """True if frames of the autopilot arrive, but no HEARTBEAT. Then the arm state is unknown."""
        if self.heartbeat_at is None or self.received_at is None:
            return False
        return self.received_at - self.heartbeat_at > HEARTBEAT_FRESH_S

    @property
    def armed(self) -> bool:
        """The arm state in the autopilot's latest HEARTBEAT."""
        return self.arm_state.armed

    def conflict(self, t: float) -> str:
        """How two senders with the autopilot's ids contradict each other; empty if they do not."""
        if self._clocks.in_conflict(t):
            return f"two autopilots with id {self.system_id}"
        if self.arm_state.in_conflict(t):
            return "armed again within 3 s of a disarm, or a second sender claims to be the autopilot"
        return ""

    def silence_s(self, t: float) -> float | None:
        """Time since the last frame of the autopilot; None before the first one."""
        return None if self.received_at is None else t - self.received_at

    def recent_silence_s(self, t: float) -> float:
        """The present silence, or a longer one that has just ended: its losses may be found afterwards."""
        ended_at, lasted_s = self._silence
        return max(self.silence_s(t) or 0.0, lasted_s if t - ended_at < SILENCE_RECENT_S else 0.0)

    def note_frame(self, t: float) -> None:
        """Note a frame of the autopilot, of any type."""
        silence_s = self.silence_s(t) or 0.0
        if silence_s > SILENCE_S:
            self._silence = (t, silence_s)
        self.received_at = t

    def altitude_m(self, t: float) -> float | None:
        """Height above home: the lowest of the latest reports; None if it is not known.

        One false report among good ones must not allow a bend on the ground, and a landing must show at once.
        So the lowest one counts.
        """
        heights = self._altitudes
        if not heights or heights[-1][0] - self._altitudes_since < ALTITUDE_CONFIRMED_S:
            return None
        return heights[0][1] if t - heights[-1][0] <= ALTITUDE_FRESH_S else None

    def _note_altitude(self, t: float, height_m: float) -> None:
        if not LOWEST_M <= height_m <= HIGHEST_M:
            return
        heights = self._altitudes
        if not heights:
            self._altitudes_since = t
        elif t - heights[-1][0] > ALTITUDE_FRESH_S:
            # After a pause the last report before it counts as if it came now.
            heights.append((t, heights.pop()[1]))
        while heights and t - heights[0][0] > LOWEST_OF_S:
            heights.popleft()
        while heights and heights[-1][1] >= height_m:
            heights.pop()
        heights.append((t, height_m))

    def ambient_kPa(self, t: float) -> float | None:
        """The barometer's pressure (absolute); None if the last report is too old."""
        if self._ambient_at is None or t - self._ambient_at > ALTITUDE_FRESH_S:
            return None
        return self._ambient_kPa

    def time_boot_ms(self, t: float) -> int:
        """Our time `t` on the autopilot's clock; 0 before that clock is known."""
        return self.clock.time_boot_ms(t)

    def is_ours(self, message: MavlinkMessage) -> bool:
        """True if the message comes from the autopilot that we serve."""
        if message.get_srcComponent() != _AUTOPILOT:
            return False
        return self.system_id != 0 and self.system_id == message.get_srcSystem()

    def handle(self, t: float, message: MavlinkMessage) -> list[VehicleEvent]:
        """Take in one message of any sender."""
        kind = message.get_type()
        events: list[VehicleEvent] = []
        if kind == "HEARTBEAT":
            if not is_autopilot(message):
                return self._other_component(t, message)
            events.extend(self._choose(t, message))
        if not self.is_ours(message):
            return events
        self.note_frame(t)
        if kind in handled.CLOCK:
            is_measured = kind == "RC_CHANNELS"
            is_other_clock = not is_measured and self._clocks.stamp(t, message.time_boot_ms / 1000.0)
            if self.clock.stamp(t, message.time_boot_ms, is_measured):
                self._altitudes.clear()
                events += [] if is_other_clock else [Rebooted()]
        if kind == "HEARTBEAT":
            self._others.clear()
            self._other_reported = False
            self.heartbeat_at = t
            self.arm_state.handle(t, bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED))
            self.autopilot = of_heartbeat(message.autopilot)
            self.mode = self.autopilot.mode_name(message.custom_mode)
        elif kind == "GLOBAL_POSITION_INT":
            self._note_altitude(t, message.relative_alt / 1000.0)
        elif kind == "SCALED_PRESSURE":
            self._ambient_kPa = message.press_abs / 10.0
            self._ambient_at = t
        elif kind == "STATUSTEXT" and message.text.startswith("ArduPilot Ready"):
            # After a reboot no stream runs, so this text may arrive long before the next time stamp.
            if self.time_boot_ms(t) > MAX_BOOT_MS:
                self._altitudes.clear()
                events.append(Rebooted())
            self.clock.forget()
        return events

    def _choose(self, t: float, message: MavlinkMessage) -> list[VehicleEvent]:
        system = message.get_srcSystem()
        if self._ambiguous or system in (0, self.system_id):
            return []
        if self._configured_id:
            if system != self._configured_id:
                return self._other(t, self._configured_id, system)
        elif self._found_at is not None:
            if t - self._found_at > CHOOSING_S:
                return self._other(t, self.system_id, system)
            pair = (self.system_id, system)
            self.system_id, self._ambiguous = 0, True
            self.arm_state = ArmState()
            return [Ambiguous(pair)]
        self.system_id, self._found_at = system, t
        return [AutopilotFound(system)]

    def _other(self, t: float, expected: int, heard: int) -> list[VehicleEvent]:
        return [OtherHeard(expected, heard)] if self._reports_other(t, heard) else []

    def _other_component(self, t: float, message: MavlinkMessage) -> list[VehicleEvent]:
        ids = (message.get_srcSystem(), message.get_srcComponent())
        if self.found or ids[1] == _AUTOPILOT or not _claims_to_be_autopilot(message):
            return []
        return [OtherComponent(*ids)] if self._reports_other(t, ids[0]) else []

    def _reports_other(self, t: float, system_id: int) -> bool:
        first_at = self._others.setdefault(system_id, t)
        if self._other_reported or t - first_at < OTHER_ID_AFTER_S:
            return False
        self._other_reported = True
        return True


def is_autopilot(message: MavlinkMessage) -> bool:
    return _claims_to_be_autopilot(message) and message.get_srcComponent() == _AUTOPILOT


def _claims_to_be_autopilot(message: MavlinkMessage) -> bool:
    return message.autopilot != mavlink.MAV_AUTOPILOT_INVALID and message.type not in NO_VEHICLE


REARMED_S = 3.0
"""No pilot arms a vehicle again so soon after it was disarmed."""
CONFLICT_S = 5.0
"""A conflict ends this long after the last contradiction."""

BACK_S = 3.0
"""Two paths from one autopilot do not differ by so much delay."""
SAME_CLOCK_S = 0.5
"""Stamps of one clock agree within this time. A stamp that stands still differs before `TWO_CLOCKS_S`."""
TWO_CLOCKS_S = 1.0
"""A clock that has returned for this time belongs to a second autopilot."""


class Clocks:
    """Finds two clocks in the time stamps of one sender. All times are seconds of one clock.

    Two autopilots with the same system id have booted at different times. So the time stamps go back, forward
    and back again. After a reboot they go back once. Two that booted within `BACK_S` cannot be told by their
    clocks.
    """

    def __init__(self) -> None:
        self._latest_s = -math.inf
        self._began_at = self._back_at = self._conflict_at = -math.inf
        self._offset_s = math.inf
        """Our time minus the stamp's, when the stamps began to go back to this clock."""

    def stamp(self, t: float, boot_s: float) -> bool:
        """Take in a time stamp that runs. Returns True if it goes back to a clock that was seen before."""
        is_back, self._latest_s = boot_s < self._latest_s - BACK_S, boot_s
        if not is_back:
            return False
        is_known = t - self._back_at < CONFLICT_S and abs(t - boot_s - self._offset_s) < SAME_CLOCK_S
        self._back_at = t
        if not is_known:
            self._began_at, self._offset_s = t, t - boot_s
        elif t - self._began_at >= TWO_CLOCKS_S:
            self._conflict_at = t
        return is_known or self.in_conflict(t)

    def in_conflict(self, t: float) -> bool:
        """True if two autopilots send."""
        return t - self._conflict_at < CONFLICT_S


class ArmState:
    """Whether a second sender has the autopilot's ids: then two arm states contradict each other.

    Without signing, anybody on the link can send a HEARTBEAT with the autopilot's ids. The autopilot sends
    its own once a second, and both arrive. So a forged "armed" lasts at most a second, and the state flips.
    All times are seconds of one clock.
    """

    def __init__(self) -> None:
        self.armed = False
        self._armed_at = self._disarmed_at = self._contradicted_at = -math.inf

    def handle(self, t: float, armed: bool) -> None:
        """Take in the arm state of a HEARTBEAT."""
        if armed == self.armed:
            return
        self.armed = armed
        if not armed:
            self._disarmed_at = t
            return
        self._armed_at = t
        if t - self._disarmed_at < REARMED_S:
            self._contradicted_at = t

    def armed_s(self, t: float) -> float:
        """Time since the first of the HEARTBEATs that all said "armed"; 0 if the last one did not."""
        return t - self._armed_at if self.armed else 0.0

    def in_conflict(self, t: float) -> bool:
        """True if two senders disagree about the arm state."""
        return t - self._contradicted_at < CONFLICT_S
