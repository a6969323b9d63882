"""The autopilot's clock, and the age of a message at its arrival.

After a stall of the link or of our process, all delayed messages arrive at once. A text or a command has no
time stamp, so its age follows from the `time_boot_ms` of the messages around it. The clock of a simulated
autopilot may be a tenth slow. Then that alone looks like a growing delay, and our TIMESYNC requests tell the
two apart.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vine.intent import ACTS_WITHIN_S

LATE_S = ACTS_WITHIN_S
"""A request over the link that is older than this may only deflate the vine. The page has the same limit."""

WAIT_FOR_STAMP_S = 0.3
"""A message that may be late waits this long for the next time stamp."""
MAX_STAMP_PERIOD_S = 1.0
SILENCE_S = 1.2
"""HEARTBEAT comes at 1 Hz. If the autopilot is silent for longer, the link or our process has stalled, or the
autopilot has rebooted."""
BACKLOG_S = 2.0
"""After a stall, the delayed messages arrive within this time."""

CLOCK_PERIOD_S = 2**32 / 1000
MAX_DRIFT = 0.03
"""If the offset of the two clocks changes faster than this, and no answer to a request proves the contrary,
the link delays messages."""
MAX_DRIFT_STEP_S = 1.0
"""Drift is counted for at most this time between two stamps."""

# If the autopilot's clock lags by more than this limit, the autopilot may have rebooted. The limit is lower
# in the first minute of uptime.
MAX_DELAY_S = 20.0
YOUNG_MAX_DELAY_S = 2.0
YOUNG_S = 60.0
REORDERED_S = 1.0
"""A stamp may be this much older than the one before, because messages were reordered."""
CONTINUOUS_S = 2.0
"""If the clock lags, but the stamp is at most this much newer than the one before, the autopilot has not
rebooted: there was a stall."""
MAX_MARKS = 64
ROUND_TRIPS = 3
"""If all of the latest answers took a second, the link is late. After a stall, one of them took less."""
ANSWERS_FRESH_S = 10.0


@dataclass(slots=True)
class Mark:
    """The arrival of a message, and what is known about its delay."""

    t: float
    suspected_s: float = 0.0
    """Upper estimate of the delay: the last stamp's delay plus the silence since then."""
    continuous: bool = True
    """No frame was lost between the last stamp and the message."""
    first_stamps: bool = False
    """The message arrived soon after the first stamp. The first stamps may be delayed, too."""
    boot_s: float = math.inf
    """Autopilot time of the first stamp after the message. The message was sent no later than that."""


class AutopilotClock:
    """Sans-IO; all times are seconds of one clock, unless they are `time_boot_ms`."""

    def __init__(self) -> None:
        self._offset_s: float | None = None
        self._received_at: float | None = None
        self._sequence: int | None = None
        self.lost_at = -math.inf
        """When frames of the autopilot were last found missing."""
        self.forget()

    def forget(self) -> None:
        """The autopilot rebooted."""
        self._offset_s = None
        self._known_since = math.inf
        self._newest_s = -math.inf
        self._stamped_at = -math.inf
        self._delay_s = self._silence_s = 0.0
        self._sent_after = -math.inf
        self._round_trips: deque[tuple[float, float]] = deque(maxlen=ROUND_TRIPS)
        self._lost = False
        self._open: deque[Mark] = deque(maxlen=MAX_MARKS)

    def time_boot_ms(self, t: float) -> int:
        """Our time `t` on the autopilot's clock; 0 before that clock is known."""
        if self._offset_s is None:
            return 0
        return max(0, int((t - self._offset_s) * 1000)) & 0xFFFFFFFF

    def frame(self, t: float, sequence: int) -> None:
        """Take in the sequence number of any frame of the autopilot."""
        if self._sequence is not None and (sequence - self._sequence) & 0xFF > 1:
            self._lost, self.lost_at = True, t
        self._sequence = sequence
        if self._received_at is not None and t - self._received_at > SILENCE_S:
            self._silence_s += t - self._received_at
            self._silence_over_at = t
        self._received_at = t

    def answered(self, t: float, requested_at: float) -> None:
        """The autopilot answered a request of ours. The link keeps the order, so all later messages were sent
        after `requested_at`.
        """
        self._sent_after = max(self._sent_after, requested_at)
        self._round_trips.append((t, t - requested_at))

    def delay_s(self, t: float) -> float:
        """How late the latest message with a time stamp came. A link may be late from its first message on:
        only slow answers show that.
        """
        answers = self._round_trips
        if len(answers) < ROUND_TRIPS or t - answers[0][0] > ANSWERS_FRESH_S:
            return self._delay_s
        return max(self._delay_s, min(round_trip_s for _, round_trip_s in answers))

    def stamp(self, t: float, time_boot_ms: int, is_measured: bool = False) -> bool:
        """Take in a message with `time_boot_ms`. Returns True if the autopilot rebooted.

        `is_measured`: the stamp is the time of a measurement. It may freeze, so it does not prove a reboot.
        """
        boot_s = time_boot_ms / 1000.0
        offset_s = t - boot_s
        known = self._offset_s
        if known is None:
            known, self._known_since = offset_s, t
        else:
            # The offset of the smallest delay so far. The two clocks may drift apart.
            known += MAX_DRIFT * min(t - self._stamped_at, MAX_DRIFT_STEP_S)
        if abs(offset_s - known - CLOCK_PERIOD_S) < MAX_DELAY_S:
            known += CLOCK_PERIOD_S
            self._newest_s -= CLOCK_PERIOD_S
        step_s = boot_s - self._newest_s
        lags = offset_s - known > (YOUNG_MAX_DELAY_S if boot_s <= YOUNG_S else MAX_DELAY_S)
        rebooted = lags and not -REORDERED_S <= step_s <= CONTINUOUS_S
        if rebooted and is_measured:
            return False
        if rebooted:
            self.forget()
            known, self._known_since = offset_s, t
        if not is_measured:
            known = max(known, self._sent_after - boot_s)
        self._offset_s = min(known, offset_s)
        self._stamped_at = t
        if boot_s > self._newest_s:
            self._newest_s, self._delay_s = boot_s, offset_s - self._offset_s
            self._silence_s, self._lost = 0.0, False
            while self._open:
                self._open.popleft().boot_s = boot_s
        return rebooted

    def mark(self, t: float) -> Mark:
        """Mark the arrival of a message that must not act late."""
        if t - self._known_since < BACKLOG_S:
            mark = Mark(t, first_stamps=True)
            self._open.append(mark)
            return mark
        # If the stamps have stopped, the last known delay is no longer valid.
        delay_s = self._delay_s if t - self._stamped_at < BACKLOG_S + self._silence_s else 0.0
        if self._silence_s and t - self._silence_over_at > BACKLOG_S:
            self._silence_s = 0.0
        silence_s = self._silence_s
        if self._received_at is not None and t - self._received_at > SILENCE_S:
            silence_s += t - self._received_at  # after the silence, another sender's message came first
        mark = Mark(t, delay_s + silence_s, not self._lost)
        self._open.append(mark)
        return mark

    def age_s(self, mark: Mark, t: float) -> float | None:
        """The minimum age of the marked message; None while it is not known.

        If frames were lost, and no stamp has come after the message, the suspected delay is used.
        """
        waited_s = t - mark.t
        if mark.suspected_s <= LATE_S and not mark.first_stamps:
            return waited_s
        min_delay_s = None
        if self._offset_s is not None and mark.boot_s < math.inf:
            min_delay_s = mark.t - self._offset_s - mark.boot_s
        if waited_s < WAIT_FOR_STAMP_S and (mark.first_stamps or min_delay_s is None):
            return None
        if mark.continuous:
            min_delay_s = max(min_delay_s or 0.0, mark.suspected_s - MAX_STAMP_PERIOD_S)
        elif min_delay_s is None:
            min_delay_s = mark.suspected_s
        return max(0.0, min_delay_s) + waited_s


RATE_HZ = 1.0
BURST = 4
"""Answers at once; on average `RATE_HZ`."""
PERIOD_S = 1.0
"""Of our own requests."""
MAX_OPEN = 32
"""Requests whose answer may still come."""

_TARGET = struct.Struct("<qqBB")
_TARGET_AT = 16
"""Offset of the target fields in the payload. A frame without them is shorter, or has zeros there."""


class Timesync(mavlink.MAVLink_timesync_message):  # type: ignore[misc]
    """TIMESYNC with its MAVLink 2 target fields, which the dialect lacks.

    PX4 forwards messages without them to every link, and sends ten requests a second.
    """

    def __init__(self, tc1: int, ts1: int, target_system: int, target_component: int) -> None:
        super().__init__(tc1, ts1)
        self.target_system, self.target_component = target_system, target_component

    def pack(self, mav: MavlinkMessage, force_mavlink1: bool = False) -> bytes:
        payload = _TARGET.pack(self.tc1, self.ts1, self.target_system, self.target_component)
        frame: bytes = self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1)
        return frame


def target_of(message: MavlinkMessage) -> tuple[int, int]:
    """Target system and component of a received TIMESYNC; zeros if it is a broadcast."""
    system, component = (message.get_payload() or b"")[_TARGET_AT:].ljust(2, b"\0")[:2]
    return system, component


class TimesyncRequests:
    """Our requests. An answer proves that the messages after it are newer than the request."""

    def __init__(self) -> None:
        self._due_at = -math.inf
        self._sent_at: dict[int, float] = {}

    def due(self, t: float, system_id: int) -> list[MavlinkMessage]:
        if t < self._due_at:
            return []
        self._due_at = t + PERIOD_S
        stamp_ns = int(t * 1e9)
        if len(self._sent_at) >= MAX_OPEN:
            del self._sent_at[next(iter(self._sent_at))]
        self._sent_at[stamp_ns] = t
        return [Timesync(0, stamp_ns, system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)]

    def answered(self, message: MavlinkMessage) -> float | None:
        """When we sent the request that this TIMESYNC of the autopilot answers; None if it answers none."""
        return self._sent_at.pop(message.ts1, None) if message.tc1 else None
