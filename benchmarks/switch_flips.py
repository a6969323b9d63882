"""Flies one flight with one process: flips the switch under load and times the setpoints that follow.

One thread sends the messages, reads the serial line, and takes both times from one monotonic clock. So a
measured time includes the thread's own sending and reading.
"""

from __future__ import annotations

import gc
import math
import os
import random
import select
import socket
from collections.abc import Callable
from dataclasses import dataclass, field
from time import monotonic

from flight_load import RC_RATE_HZ, SYSTEM_ID, FlightLoad, mission_count, rc_channels
from serial_board import TELEMETRY_HZ, SerialBoard

from flying_vines.vehicle.mavlink.codec import MavlinkCodec

PULSES_US = (1100, 1500, 1900)
DEBOUNCE_S = 0.14
"""0.15 s minus the jitter that the service's switch tolerates."""
LEFT_OUT, SETTLING = 7, 8
"""RC samples after a move. The one at 140 ms is on the edge of the debounce, where a microsecond decides, so
it is not sent. So the one at 120 ms cannot settle the move, and the one at 160 ms must."""
MARGIN_S = 0.005
SAMPLES_A_FLIP = 30
"""0.6 s: the longest ramp at the default rate limit takes 0.345 s and must be over before the next move."""
ALIVE_WITHIN_S = 30.0
SETTLE_S = 4.5
"""The first heartbeat may be 1.8 s away. One second later the service accepts the switch."""
_RC_PERIOD_S = 1.0 / RC_RATE_HZ
_TELEMETRY_PERIOD_S = 1.0 / TELEMETRY_HZ


class NotMeasured(Exception):
    """The process under test could not be measured; the text says why."""


@dataclass
class Flight:
    """The results of one flight."""

    latencies_ms: list[float] = field(default_factory=list)
    missed: int = 0
    """Moves without a setpoint."""
    early: int = 0
    """Moves with a setpoint change before the sample that settles them: not measured."""
    void: int = 0
    """Moves whose samples this process could not send in time: not measured."""
    loaded_s: float = 0.0
    messages: int = 0
    telemetry_frames: int = 0
    lateness_ms: list[float] = field(default_factory=list)
    """Delay of this process's own sending, which shows how busy the machine is."""


class Flipper:
    """Flies one flight to a UDP port of this machine and to the serial board."""

    def __init__(self, port: int, board: SerialBoard, flips: int, seed: int) -> None:
        self.alive_at_s = math.nan
        """Time of the host's first frame."""
        self._to = ("127.0.0.1", port)
        self._board = board
        self._flips = flips
        self._random = random.Random(seed)
        self._load = FlightLoad(monotonic(), seed)
        self._answers = MavlinkCodec(255, 0)
        self._flight = Flight()
        self._position = 0
        self._sample = -1
        """RC samples since the present move; below 0 before the first."""
        self._moved_at_s = self._before_s = self._settled_at_s = math.nan
        self._early = self._measured = False
        self._flips_begun = 0

    def fly(self, running: Callable[[], bool], loaded: Callable[[], None]) -> Flight:
        """Return when all flips are done. `loaded` is called when the loaded time begins."""
        gc.collect()
        gc.disable()
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
                vehicle.bind(("127.0.0.1", 0))
                vehicle.setblocking(False)
                return self._fly(vehicle, running, loaded)
        finally:
            gc.enable()

    def _fly(self, vehicle: socket.socket, running: Callable[[], bool], loaded: Callable[[], None]) -> Flight:
        flight, board, load = self._flight, self._board, self._load
        began_s = rc_due_s = telemetry_due_s = monotonic()
        settle_until_s = math.inf
        loaded_from_s = math.inf
        while True:
            now_s = monotonic()
            due_s = min(rc_due_s, telemetry_due_s, load.next_due_s)
            if now_s < due_s:
                readable, _, _ = select.select([board.fd, vehicle.fileno()], [], [], due_s - now_s)
                if board.fd in readable:
                    self._receive_from_board()
                if vehicle.fileno() in readable:
                    self._receive_from_host(vehicle)
                continue
            if loaded_from_s < math.inf:
                flight.messages += due_s != telemetry_due_s
                flight.lateness_ms.append(1e3 * (now_s - due_s))
            if due_s == load.next_due_s:
                vehicle.sendto(load.take(now_s), self._to)
            elif due_s == telemetry_due_s:
                board.report(now_s)
                telemetry_due_s += _TELEMETRY_PERIOD_S
            else:
                self._send_rc(vehicle, now_s)
                rc_due_s += _RC_PERIOD_S
                if self._sample >= 0:
                    self._sample += 1
                if self._sample == SAMPLES_A_FLIP or (self._sample < 0 and now_s >= settle_until_s):
                    self._end_flip()
                    if self._flips_begun == self._flips:
                        break
                    if loaded_from_s == math.inf:
                        loaded_from_s = now_s
                        flight.telemetry_frames = -board.telemetry_frames
                        loaded()
                    self._begin_flip()
                    # Otherwise every flip would meet the host's 50 Hz tick in the same phase.
                    rc_due_s += self._random.random() * _RC_PERIOD_S
                if settle_until_s == math.inf:
                    if board.received:
                        self.alive_at_s = now_s
                        settle_until_s = now_s + SETTLE_S
                    elif not running():
                        raise NotMeasured("the process ended before its first frame")
                    elif now_s - began_s > ALIVE_WITHIN_S:
                        raise NotMeasured(f"nothing on the serial line within {ALIVE_WITHIN_S:g} s")
        flight.loaded_s = monotonic() - loaded_from_s
        flight.telemetry_frames += board.telemetry_frames
        return flight

    def _begin_flip(self) -> None:
        self._flips_begun += 1
        others = [position for position in range(len(PULSES_US)) if position != self._position]
        self._position = self._random.choice(others)
        self._sample = 0
        self._moved_at_s = self._before_s = self._settled_at_s = math.nan
        self._early = self._measured = False

    def _end_flip(self) -> None:
        """Count a flip that was not measured, by its reason."""
        if self._sample < 0 or self._measured:
            return
        if self._early:
            self._flight.early += 1
        elif not self._in_time():
            self._flight.void += 1
        else:
            self._flight.missed += 1

    def _in_time(self) -> bool:
        """True if only the settling sample could settle the move."""
        too_soon_s = self._before_s - self._moved_at_s
        enough_s = self._settled_at_s - self._moved_at_s
        return too_soon_s < DEBOUNCE_S - MARGIN_S and enough_s > DEBOUNCE_S + MARGIN_S

    def _send_rc(self, vehicle: socket.socket, now_s: float) -> None:
        if self._sample == LEFT_OUT:
            self._flight.messages -= 1
            return
        message = rc_channels(self._load.boot_s(now_s), PULSES_US[self._position])
        frame = self._load.autopilot.encode(message, SYSTEM_ID)
        sent_s = monotonic()
        vehicle.sendto(frame, self._to)
        if self._sample == 0:
            self._moved_at_s = sent_s
        elif self._sample == SETTLING:
            self._settled_at_s = sent_s
        elif 0 < self._sample < LEFT_OUT:
            self._before_s = sent_s

    def _receive_from_board(self) -> None:
        data = os.read(self._board.fd, 4096)
        read_s = monotonic()
        if not self._board.receive(read_s, data) or self._sample < 0:
            return
        if math.isnan(self._settled_at_s):
            self._early = True
        elif not self._early and not self._measured and self._in_time():
            self._measured = True
            self._flight.latencies_ms.append(1e3 * (read_s - self._settled_at_s))

    def _receive_from_host(self, vehicle: socket.socket) -> None:
        for message in self._answers.decode(vehicle.recv(4096)):
            if message.get_type() == "MISSION_REQUEST_LIST":
                answer = mission_count(message.get_srcSystem(), message.get_srcComponent())
                vehicle.sendto(self._load.autopilot.encode(answer, SYSTEM_ID), self._to)
