"""A serial line with every kind of error between a host and a firmware."""

from __future__ import annotations

import random
from collections import deque
from dataclasses import dataclass

from firmware_link.framing import FRAME_END
from firmware_link.host import HostEvent, HostSession, Regulate, SessionState
from firmware_link.protocol import Codec, HostMessage, Mode
from flying_vines.simulation.phlosar.firmware import Board, Firmware

TICK_MS = 10
"""Tick of the host, as in `FirmwareLink`."""
READING_KPA = 0.2
"""Tolerance for the firmware's readings, which have the steps of a converter."""


@dataclass(frozen=True)
class Faults:
    """Probability of each fault for a frame, 0…1."""

    lost: float = 0.0
    corrupted: float = 0.0
    duplicated: float = 0.0
    swapped: float = 0.0
    """The frame arrives after the next one."""
    truncated: float = 0.0
    """The end of the frame is missing, also its zero byte, so that the next frame is joined to it."""
    garbage: float = 0.0
    """Random bytes come before the frame."""
    delay_ms: int = 0
    """Maximum delay. A frame has a random part of it, and the following frames wait."""
    bytewise: bool = False


CLEAN = Faults()


class BadLine:
    """One direction. The same seed and frames give the same faults."""

    def __init__(self, faults: Faults, seed: int) -> None:
        self.faults = faults
        self._random = random.Random(seed)
        self._held: bytes | None = None
        self._way: deque[tuple[int, bytes]] = deque()

    def send(self, now_ms: int, frame: bytes) -> None:
        held, self._held = self._held, None
        if held is None and self._happens(self.faults.swapped):
            self._held = frame
            return
        for each in (frame, held):
            if each is not None:
                self._put(now_ms, self._spoilt(each))

    def arrived(self, now_ms: int) -> list[bytes]:
        """The pieces that have arrived."""
        pieces = []
        while self._way and self._way[0][0] <= now_ms:
            data = self._way.popleft()[1]
            pieces += [data[at : at + 1] for at in range(len(data))] if self.faults.bytewise else [data]
        return pieces

    def _put(self, now_ms: int, data: bytes) -> None:
        due_ms = now_ms + 1 + self._random.randint(0, self.faults.delay_ms)
        # A line keeps the order: later data does not arrive earlier.
        self._way.append((max(due_ms, self._way[-1][0] if self._way else 0), data))

    def _spoilt(self, frame: bytes) -> bytes:
        data = bytearray(frame)
        if self._happens(self.faults.lost):
            data.clear()
        if data and self._happens(self.faults.corrupted):
            data[self._random.randrange(len(data))] ^= self._random.randint(1, 255)
        if data and self._happens(self.faults.truncated):
            del data[self._random.randrange(len(data)) :]
        if data and self._happens(self.faults.duplicated):
            data *= 2
        if self._happens(self.faults.garbage):
            data[:0] = self._random.randbytes(self._random.randint(1, 200))
        return bytes(data)

    def _happens(self, probability: float) -> bool:
        return self._random.random() < probability


class Exchange:
    """A host and a firmware on two bad lines, a millisecond at a time, and a vine that follows the valves.

    Nothing may raise, and at every step the firmware may do only what was commanded.
    """

    def __init__(self, faults: Faults, seed: int = 1, board: Board | None = None) -> None:
        self.now_ms = 0
        self.session = HostSession()
        self.codec = Codec()
        self.firmware: Board = board or Firmware()
        self.to_device, self.to_host = BadLine(faults, 2 * seed), BadLine(faults, 2 * seed + 1)
        self.events: list[tuple[int, HostEvent]] = []
        self.frames_sent = 0
        """Number of frames that the firmware sent."""
        self._commanded: dict[int, Regulate] = {}
        self._cv_kPa = 0.0
        self._most_kPa = 0.0
        self.session.opened(0.0)

    @property
    def t(self) -> float:
        return self.now_ms / 1e3

    @property
    def in_step(self) -> bool:
        """The firmware does what the host commands now."""
        return self.session.state is SessionState.READY and self.firmware.number == self.session.number

    def clean(self) -> None:
        """From now on the line is good; frames on their way may still be damaged."""
        self.to_device.faults = self.to_host.faults = CLEAN

    def command(self, target_kPa: float) -> None:
        command = Regulate(target_kPa, 100.0)
        sent = self.session.command(self.t, command)
        if self.session.state is SessionState.READY:
            self._commanded[self.session.number] = command
            self._most_kPa = max(self._most_kPa, target_kPa)
        self.send(sent)

    def send(self, messages: list[HostMessage]) -> None:
        for message in messages:
            self.to_device.send(self.now_ms, FRAME_END + self.codec.encode(message))

    def run(self, for_ms: int) -> None:
        for _ in range(for_ms):
            self._step()

    def run_until_ready(self, at_most_ms: int) -> None:
        for _ in range(at_most_ms):
            if self.session.state is SessionState.READY:
                return
            self._step()
        raise AssertionError(f"not ready after {at_most_ms} ms")

    def _step(self) -> None:
        self.now_ms += 1
        for data in self.to_device.arrived(self.now_ms):
            self.firmware.receive(data)
        drive = self.firmware.step(self.now_ms * 1000, self._cv_kPa, 690.0)
        self._cv_kPa += 0.4 * drive.evp - (0.1 * self._cv_kPa if drive.solenoid else 0.0)
        regulates = self.firmware.mode is Mode.REGULATE
        assert regulates or not drive.evp, "air goes in while nothing is regulated"
        assert not regulates or self.firmware.number in self._commanded, "nobody commanded this"
        output = self.firmware.take_output()
        if output:
            self.frames_sent += output.count(FRAME_END)
            self.to_host.send(self.now_ms, output)
        for data in self.to_host.arrived(self.now_ms):
            for message in self.codec.decode(data):
                self.events += [(self.now_ms, event) for event in self.session.receive(self.t, message)]
        # A regulation begins at the measured pressure.
        self._most_kPa = max(self._most_kPa, self._cv_kPa)
        telemetry = self.session.telemetry
        assert telemetry is None or telemetry.setpoint_kPa <= self._most_kPa + READING_KPA
        if self.now_ms % TICK_MS == 0:
            self.send(self.session.tick(self.t))
