"""Flights in simulated time with a recorder, as in the service.

As a program it flies in real time until it is killed; see `recorded_until_killed`.
"""

from __future__ import annotations

import mmap
import os
import random
import struct
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from flying_vines.config import config
from flying_vines.core.core import Core
from flying_vines.core.events import Action, Event, ToVehicle
from flying_vines.record.reader import FlightLog
from flying_vines.record.recorder import FlightStart, Recorder
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.mavlink.codec import MavlinkCodec

SWITCH, LOW, MIDDLE, HIGH = 9, 1000, 1500, 2000
TEXT = config.default_text().replace("bench_mode = false", "bench_mode = true")
CONFIG = config.parse(TEXT, "the test's configuration")
BEGAN = FlightStart(TEXT, CONFIG.pneumatics)
PROGRESS = struct.Struct("<dQ")
"""Time of the latest recorded event, and number of bytes of the log that are safely on the disk."""
EARLIEST_S, LATEST_S = 0.3, 4.0
"""The program is killed this long after the start of the flight."""
START_WITHIN_S = 30.0


def watch(core: Core, recorder: Recorder) -> None:
    """Let the recorder see the core's events and actions."""
    handle, codec = core.handle, MavlinkCodec(0, 191)

    def handled(event: Event) -> list[Action]:
        actions = handle(event)
        for action in actions:
            if isinstance(action, ToVehicle):
                codec.encode(action.message, action.system_id)
        recorder.event(event)
        for action in actions:
            recorder.action(action)
        return actions

    core.handle = handled  # type: ignore[method-assign]


def fly(
    flight: SimulatedFlight, recorder: Recorder, moves: Sequence[tuple[float, int]], step_s: float = 0.1
) -> None:
    """Fly moves of the switch, each with a position and an end time, with snapshots as in the service."""
    watch(flight.core, recorder)
    now = flight.world.now
    for until_s, pulse_us in moves:
        flight.autopilot.set_rc(SWITCH, pulse_us)
        while now < until_s - 1e-9:
            now = min(until_s, now + step_s)
            flight.run(now)
            recorder.snapshot(flight.core.snapshot(now))


def new_flight(telemetry_Hz: int = 100) -> SimulatedFlight:
    phlosar = SimulatedPhlosar(firmware={"telemetry_Hz": telemetry_Hz})
    return SimulatedFlight(CONFIG, FakeAutopilot("ardupilot"), phlosar)


def one_bend(parent: Path) -> Path:
    """The folder of a flight of eight seconds."""
    recorder = Recorder(parent, BEGAN, t=0.0)
    fly(new_flight(), recorder, ((3.0, LOW), (5.5, HIGH), (8.0, LOW)))
    recorder.close()
    assert not recorder.failed
    return recorder.folder


class Lost(NamedTuple):
    """The end of a flight that the log does not have, in seconds."""

    by_kill_s: float
    by_power_cut_s: float
    """A power cut also removes a random part of the bytes that were not yet on the disk."""


def recorded_until_killed(folder: Path, seed: int) -> Lost:
    """Fly in a process that is killed (SIGKILL) at a random moment. LogError if a log cannot be opened."""
    folder.mkdir(parents=True)
    chance = random.Random(seed)
    progress = folder / "progress"
    progress.write_bytes(bytes(PROGRESS.size))
    process = subprocess.Popen([sys.executable, __file__, str(folder / "flights"), str(progress)])
    try:
        deadline = time.monotonic() + START_WITHIN_S
        while PROGRESS.unpack(progress.read_bytes())[0] == 0.0:
            if process.poll() is not None or time.monotonic() > deadline:
                raise RuntimeError("the recording process does not start")
            time.sleep(0.01)
        time.sleep(chance.uniform(EARLIEST_S, LATEST_S))
    finally:
        process.kill()
        process.wait()
    flown_s, kept = PROGRESS.unpack(progress.read_bytes())
    (log,) = (folder / "flights").glob("*/flight.mcap")
    after_cut = folder / "after-cut.mcap"
    after_cut.write_bytes(log.read_bytes()[: chance.randint(kept, log.stat().st_size)])
    return Lost(*(flown_s - _end_s(path) for path in (log, after_cut)))


def _end_s(log: Path) -> float:
    """Time of the last readable event."""
    end_s = 0.0
    for entry in FlightLog(log).entries():
        end_s = entry.fields["t"]
    return end_s


def _record_until_killed(folder: Path, progress: Path) -> None:
    """Fly in real time, and share the progress."""
    with progress.open("r+b") as file:
        told = mmap.mmap(file.fileno(), PROGRESS.size)
    flown_s, kept = 0.0, 0
    sync = os.fsync

    def sync_and_tell(descriptor: int) -> None:
        size = os.fstat(descriptor).st_size
        sync(descriptor)
        nonlocal kept
        if Path(f"/proc/self/fd/{descriptor}").readlink().suffix == ".mcap":
            kept = size
            PROGRESS.pack_into(told, 0, flown_s, kept)

    os.fsync = sync_and_tell  # type: ignore[assignment]
    recorder = Recorder(folder, BEGAN, t=0.0)
    flight = new_flight()
    watch(flight.core, recorder)
    began_s, shown_s = time.monotonic(), 0.0
    while True:
        now = time.monotonic() - began_s
        flight.autopilot.set_rc(SWITCH, HIGH if now % 3.0 > 2.0 else LOW)
        flight.run(now, 0.01)
        if now - shown_s >= 0.1:
            shown_s = now
            recorder.snapshot(flight.core.snapshot(now))
        flown_s = now
        PROGRESS.pack_into(told, 0, flown_s, kept)
        time.sleep(0.01)


if __name__ == "__main__":
    _record_until_killed(Path(sys.argv[1]), Path(sys.argv[2]))
