"""How much of a flight is lost if the power fails, or if the log is damaged afterwards.

    python benchmarks/power_cut.py [--kills 200] [--damages 200] [--seed 1] [--at-once 4]

A process flies in real time (core, fakes, recorder) and is killed (SIGKILL) at a random moment. In shared
memory it reports the time of its latest event for the recorder, and the number of bytes that are safely on
the disk. The loss is the time from the end of the readable log to this event. It is measured for the file
after the kill, and for a power cut, which also removes a random part of the bytes that were not yet safe.
Then one log is cut at random bytes, and random bytes are changed.
"""

from __future__ import annotations

import argparse
import contextlib
import mmap
import os
import random
import shutil
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from mcap.reader import make_reader

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from recorded_flight import BEGAN, HIGH, LOW, SWITCH, new_flight, one_bend, watch

from flying_vines.record.reader import FlightLog, LogError
from flying_vines.record.recorder import Recorder

PROGRESS = struct.Struct("<dQ")
"""Time of the latest recorded event, and number of bytes of the log that are safely on the disk."""
EARLIEST_S, LATEST_S = 0.3, 4.0
"""The process is killed this long after the start of the flight."""
STEP_S = 0.01
SNAPSHOT_S = 0.1
START_WITHIN_S = 30.0


class Outcome(NamedTuple):
    """The result of one killed flight."""

    flown_s: float
    lost_s: float
    """Lost by the kill."""
    lost_on_disk_s: float
    """Lost by a power cut."""
    opened: bool


def record(folder: Path, progress: Path) -> None:
    """Fly until this process is killed."""
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
        flight.run(now, STEP_S)
        if now - shown_s >= SNAPSHOT_S:
            shown_s = now
            recorder.snapshot(flight.core.snapshot(now))
        flown_s = now
        PROGRESS.pack_into(told, 0, flown_s, kept)
        time.sleep(STEP_S)


def recorded_until_killed(folder: Path, seed: int) -> Outcome:
    """Fly and kill one flight, in a new folder."""
    folder.mkdir(parents=True)
    chance = random.Random(seed)
    progress = folder / "progress"
    progress.write_bytes(bytes(PROGRESS.size))
    command = [sys.executable, __file__, "--record", str(folder / "flights"), "--progress", str(progress)]
    process = subprocess.Popen(command)
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
    there = log.stat().st_size
    after_cut = folder / "after-cut.mcap"
    after_cut.write_bytes(log.read_bytes()[: chance.randint(kept, there)])
    ends = [_end_s(path) for path in (log, after_cut)]
    known = [end for end in ends if end is not None]
    lost = [flown_s - (end or 0.0) for end in ends]
    return Outcome(flown_s, lost[0], lost[1], len(known) == len(ends))


def _end_s(path: Path) -> float | None:
    """Time of the last readable event; None if the log cannot be opened."""
    end = None
    with contextlib.suppress(LogError):
        for entry in FlightLog(path).entries():
            end = entry.fields["t"]
    return end


class Damage(NamedTuple):
    """The effect of a damage on one log."""

    kind: str
    opened: bool
    lost_s: float
    """Cut off: time from the last readable event to the end of the chunk that is cut. Changed: time from the
    first lost event to the last."""


def damaged(whole: Path, times: int, chance: random.Random) -> Iterator[Damage]:
    """The log cut at random bytes, and with random bytes changed."""
    data = whole.read_bytes()
    entries = list(FlightLog(whole).entries())
    times_s = [entry.fields["t"] for entry in entries]
    with whole.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    first, *chunks = summary.chunk_indexes  # the first chunk is on the disk before the flight
    hurt = whole.with_name("hurt.mcap")
    for _ in range(times):
        size = chance.randrange(first.chunk_start_offset + first.chunk_length, len(data))
        hurt.write_bytes(data[:size])
        end = _end_s(hurt)
        begun = [chunk.message_end_time for chunk in chunks if chunk.chunk_start_offset < size]
        until = (max(begun, default=first.message_end_time) - first.message_start_time) / 1e9
        yield Damage("cut off", end is not None, until - (end or 0.0))
        changed = bytearray(data)
        changed[chance.randrange(len(data))] ^= chance.randrange(1, 256)
        hurt.write_bytes(changed)
        try:
            found = set(FlightLog(hurt).entries())
        except LogError:
            yield Damage("a byte changed", False, times_s[-1])
            continue
        lost = [t for entry, t in zip(entries, times_s, strict=True) if entry not in found]
        yield Damage("a byte changed", True, lost[-1] - lost[0] if lost else 0.0)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--damages", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--at-once", type=int, default=4, help="flights at the same time (4)")
    parser.add_argument("--record", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--progress", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.record:
        record(arguments.record, arguments.progress)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)

        def one(number: int) -> Outcome:
            outcome = recorded_until_killed(folder / str(number), arguments.seed * 100_000 + number)
            shutil.rmtree(folder / str(number))
            return outcome

        with ThreadPoolExecutor(arguments.at_once) as pool:
            outcomes = list(pool.map(one, range(arguments.kills)))
        whole = one_bend(folder / "whole") / "flight.mcap"
        damages = list(damaged(whole, arguments.damages, random.Random(arguments.seed)))
    good = True
    for what, lost in (
        ("killed", [outcome.lost_s for outcome in outcomes]),
        ("power cut", [outcome.lost_on_disk_s for outcome in outcomes]),
        *((kind, [d.lost_s for d in damages if d.kind == kind]) for kind in ("cut off", "a byte changed")),
    ):
        if lost:
            lost.sort()
            median = lost[len(lost) // 2]
            print(f"{what:15} {len(lost):4} times: lost {median:.2f} s (median), {lost[-1]:.2f} s (most)")
            good = good and lost[-1] < 1.0
    unopened = [one.opened for one in outcomes].count(False) + [one.opened for one in damages].count(False)
    print(f"{unopened} logs did not open")
    return 0 if good and not unopened else 1


if __name__ == "__main__":
    sys.exit(main())
