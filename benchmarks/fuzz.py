"""Sends a hundred million random and mutated bytes to each end of the line: nothing may crash, hang or grow.

    python benchmarks/fuzz.py [--bytes 100000000] [--seed 1] [--only blind|guided|host|service]

The firmware's core runs with address and undefined-behaviour sanitizers. First it runs under our own driver,
which is fast but does not measure coverage. Then it runs under clang's libFuzzer, which looks for inputs that
reach new code. firmware_link/firmware/fuzz/core.cpp has the checks. The host's decoder and session get
a device's messages: whole frames, flipped, cut, doubled and spliced frames, and noise. The service's core
gets the same, and on its other link MAVLink of every type with absurd numbers from any sender; its vehicle is
disarmed.
"""

from __future__ import annotations

import argparse
import gc
import math
import random
import re
import shutil
import subprocess
import sys
import tempfile
import tracemalloc
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from random_frames import RandomFrames, serving_vehicle_1

from firmware_link.framing import FRAME_END, encode_frame
from firmware_link.host import VENTING, HostSession, Regulate, SessionState
from firmware_link.protocol import (
    PROTOCOL_VERSION,
    Codec,
    Fault,
    Hello,
    Message,
    Mode,
    Pong,
    Refusal,
    RefusalReason,
    Setpoint,
    Setting,
    Telemetry,
    Welcome,
    encode,
)
from flying_vines.core.core import Core
from flying_vines.core.events import (
    Event,
    FirmwareMessage,
    LinkChanged,
    Tick,
    ToFirmware,
    ToVehicle,
    VehicleMessage,
)
from flying_vines.simulation.phlosar import FirmwareBuildError
from flying_vines.simulation.phlosar.core_library import (
    SOURCES,
    WHAT_TO_INSTALL,
    built,
    compiler,
    core_files,
)
from flying_vines.vehicle.mavlink.codec import MavlinkCodec as MavlinkCodec

SANITIZERS = "address,undefined,float-cast-overflow"
FLAGS = ("-std=c++17", "-O1", "-g", "-fno-exceptions", "-fno-rtti", "-fno-sanitize-recover=all")
MOST_INPUT_BYTES = 4096
RUNS_AT_ONCE = 20_000
LONGEST_INPUT_S = 60
MEMORY_LOOKS = 10
STEP_S = 0.005
MOST_NEW_BYTES = 16 * 1024
"""Maximum growth of the host's memory from the first sample to the last. The host reads 90 MB between
them."""
_FUZZ = SOURCES / "fuzz"
MOST_NEW_TABLES_BYTES = 2_000_000
"""Maximum growth of the service's memory. Its tables fill up; the largest one is a mission of 5000 items."""
_ODD_FLOATS = (math.nan, math.inf, -math.inf, -1.0, 0.0, 3.4e38, 1e30, 1e12, -1e20, 690.0, 15.0)


class FuzzError(Exception):
    """A check failed; the text contains the check and the input."""


def driver() -> Path:
    """The core with sanitizers and our own driver. Raises FirmwareBuildError without a compiler."""
    command = compiler()
    if command is None:
        raise FirmwareBuildError(f"the core cannot be fuzzed here without {WHAT_TO_INSTALL}")
    command_line = (command, *FLAGS, f"-fsanitize={SANITIZERS}")
    return built(command_line, (*core_files(), _FUZZ / "core.cpp", _FUZZ / "driver.cpp"), "fuzz")


@dataclass
class Fuzzed:
    """Counts of a run of the firmware's core."""

    received_bytes: int = 0
    steps: int = 0
    steps_regulating: int = 0
    peak_MB: float = 0.0
    edges: int | None = None
    edges_there: int | None = None

    def take(self, output: str) -> None:
        """Add the counts of one process, and libFuzzer's coverage."""
        counts = re.search(r"received (\d+) bytes, made (\d+) steps, (\d+) of them", output)
        if counts is None:
            raise FuzzError(output[-3000:])
        self.received_bytes += int(counts[1])
        self.steps += int(counts[2])
        self.steps_regulating += int(counts[3])
        self.peak_MB = max(self.peak_MB, float(re.findall(r"peak_rss_mb: +(\d+)", output)[-1]))
        if there := re.search(r"(\d+) inline 8-bit counters", output):
            self.edges_there = int(there[1])
            self.edges = max(map(int, re.findall(r"cov: (\d+)", output)), default=0)


def drive(seed: int, most_bytes: int, program: Path | None = None) -> Fuzzed:
    """Run the core with our own driver. Raises FuzzError if a check fails."""
    ran = subprocess.run(
        [program or driver(), str(seed), str(most_bytes)],
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )
    fuzzed = Fuzzed()
    if ran.returncode != 0:
        raise FuzzError(f"seed {seed}: {ran.stderr[-3000:]}")
    fuzzed.take(ran.stdout)
    return fuzzed


def explore(clang: str, seed: int, most_bytes: int, folder: Path) -> Iterator[Fuzzed]:
    """Run the core with libFuzzer, whose corpus grows in `folder`. Yields the counts so far.

    Raises FuzzError if a check fails.
    """
    command_line = (clang, *FLAGS, f"-fsanitize=fuzzer,{SANITIZERS}")
    program = built(command_line, (*core_files(), _FUZZ / "core.cpp"), "fuzz")
    fuzzed = Fuzzed()
    corpus = folder / "corpus"
    corpus.mkdir()
    options = (f"-max_len={MOST_INPUT_BYTES}", "-len_control=0", f"-timeout={LONGEST_INPUT_S}")
    while fuzzed.received_bytes < most_bytes:
        ran = subprocess.run(
            [program, *options, f"-seed={seed}", f"-runs={RUNS_AT_ONCE}", "-print_final_stats=1", corpus],
            capture_output=True,
            text=True,
            errors="replace",
            cwd=folder,
            check=False,
        )
        if ran.returncode != 0:
            why = "\n".join(line for line in ran.stderr.splitlines() if not line.startswith(("#", '"')))
            kept = [str(path.resolve()) for path in folder.glob("*-*")]
            raise FuzzError(f"seed {seed}: {why}\nthe input is kept: {', '.join(kept)}")
        fuzzed.take(ran.stderr + ran.stdout)
        seed += 1
        yield fuzzed


def device_message(dice: random.Random, nonce: int, clock_ms: int) -> Message:
    """A random message of a device, healthy or not."""

    def number() -> float:
        return dice.choice((*_ODD_FLOATS, dice.uniform(0.0, 700.0)))

    def u16() -> int:
        return dice.choice((0, 1, 0xFFFF, dice.getrandbits(16)))

    u32 = dice.getrandbits(32)
    match dice.randrange(30):
        case 0 | 1 | 2:
            asked = dice.choice((nonce, nonce, u32))
            version = dice.choice((PROTOCOL_VERSION, PROTOCOL_VERSION, PROTOCOL_VERSION, dice.randrange(256)))
            limits = (30.0, 28.0, 760.0, 200.0) if dice.random() < 0.7 else (number(),) * 4
            return Welcome(
                version,
                asked,
                dice.choice((1, u32)),
                "fuzz",
                1,
                *limits,
                dice.choice((300, u16())),
                dice.choice((100, u16())),
            )
        case 3:
            return Pong(dice.choice((0, dice.getrandbits(64), dice.getrandbits(40))), u32)
        case 4:
            return Refusal(u16(), dice.choice(tuple(RefusalReason)))
        case 5:
            return Setting(dice.randrange(256), 19, "cv_limit_kPa", number(), number(), number(), number())
        case 6:
            return Hello(PROTOCOL_VERSION, u32)
    return Telemetry(
        clock_ms if dice.random() < 0.98 else dice.choice((0, u32)),
        dice.choice(tuple(Mode)),
        Fault(u16()),
        u16(),
        number(),
        number(),
        number(),
        dice.random(),
        dice.random(),
        dice.random() < 0.5,
    )


def mutated(frame: bytes, other: bytes, dice: random.Random) -> bytes:
    at = dice.randrange(len(frame))
    match dice.randrange(8):
        case 0:
            return frame[:at] + bytes((frame[at] ^ 1 << dice.randrange(8),)) + frame[at + 1 :]
        case 1:
            return frame[:at] + frame[at + 1 :]
        case 2:
            return frame[:at] + frame[at : at + 1] * dice.randrange(2, 300) + frame[at:]
        case 3:
            return frame[:at]
        case 4:
            return frame[:at] + other[dice.randrange(len(other)) :]
        case 5:
            return frame + frame
        case 6:
            # A valid frame for the decoder, with any content.
            return encode_frame(frame[: dice.randrange(min(128, len(frame)) + 1)])
        case _:
            return dice.randbytes(dice.randrange(1, 400))


def random_bytes(seed: int, session: HostSession) -> Iterator[bytes]:
    """An endless stream of a device's bytes, in pieces of random size; a third of the frames are damaged."""
    dice = random.Random(seed)
    # The device knows the host's nonce only from the host.
    sequence, frame, clock_ms = 0, FRAME_END, 0
    while True:
        line = bytearray()
        for _ in range(dice.randrange(1, 60)):
            other, sequence = frame, (sequence + dice.choice((1, 1, 1, 2, 200))) & 0xFF
            clock_ms = (clock_ms + 10) & 0xFFFFFFFF
            frame = encode(device_message(dice, session._nonce, clock_ms), sequence)
            line += mutated(frame, other, dice) if dice.random() < 0.33 else frame
        at = 0
        while at < len(line):
            size = dice.choice((1, 7, 64, 255, 4096))
            yield bytes(line[at : at + size])
            at += size


class Memory:
    """Samples of Python's memory, one after each tenth of the bytes."""

    def __init__(self, most_bytes: int) -> None:
        self.looks: list[int] = []
        self._every = most_bytes // MEMORY_LOOKS
        # Python caches every combination of fault bits. Create all of them first.
        for mask in range(1 << 16):
            Fault(mask)
        tracemalloc.start()

    def fed(self, so_far_bytes: int) -> None:
        if so_far_bytes >= self._every * (len(self.looks) + 1):
            gc.collect()
            self.looks.append(tracemalloc.get_traced_memory()[0])

    def end(self, who: str, most_new_bytes: int) -> None:
        """Raises FuzzError if the memory has grown by more than `most_new_bytes`."""
        tracemalloc.stop()
        if self.looks[-1] - self.looks[0] > most_new_bytes:
            raise FuzzError(f"{who} grew: {self.looks}")

    def __str__(self) -> str:
        return ", ".join(f"{size / 1e3:.1f}" for size in self.looks) + " kB"


@dataclass
class Decoded:
    """Counts of a run of the host's end."""

    memory: Memory
    fed_bytes: int = 0
    messages: int = 0
    ready: int = 0
    """Number of pieces after which the session was READY."""


def listen(seed: int, most_bytes: int) -> Decoded:
    """Feed a host's end. Raises FuzzError if it cannot read a whole frame in between, or if its memory
    grows."""
    codec, session, decoded = Codec(), HostSession(), Decoded(Memory(most_bytes))
    dice = random.Random(f"host {seed}")
    whole = encode(Pong(1, 2), 0)
    t = 0.0
    session.opened(t)
    for pieces, data in enumerate(random_bytes(seed, session), 1):
        t += 0.001
        decoded.fed_bytes += len(data)
        for message in codec.decode(data):
            decoded.messages += 1
            session.receive(t, message)
        ours = session.tick(t)
        chance = dice.random()
        if chance < 0.02:
            command = VENTING if chance < 0.01 else Regulate(dice.uniform(0.0, 30.0), 20.0)
            ours += session.command(t, command)
        elif chance < 0.021:
            session.closed(t)
            codec.restart()
            session.opened(t)
        for message in ours:
            codec.encode(message)
        decoded.ready += session.state is SessionState.READY
        if pieces % 1000 == 0 and codec.decode(FRAME_END + whole)[-1:] != [Pong(1, 2)]:
            raise FuzzError(f"seed {seed}: after {decoded.fed_bytes} bytes a whole frame was not read")
        decoded.memory.fed(decoded.fed_bytes)
        if decoded.fed_bytes >= most_bytes:
            break
    decoded.memory.end(f"seed {seed}: the host", MOST_NEW_BYTES)
    return decoded


@dataclass
class Served:
    """Counts of a run of the service's core."""

    memory: Memory
    from_phlosar_bytes: int = 0
    from_vehicle_bytes: int = 0
    messages: int = 0
    answers: int = 0
    ready: int = 0


def serve(seed: int, most_bytes: int) -> Served:
    """Feed a core on both links. Raises FuzzError if it moves the vine, or if its memory grows."""
    core, vehicle, out, phlosar = (
        Core(serving_vehicle_1()),
        MavlinkCodec(0, 191),
        MavlinkCodec(0, 191),
        Codec(),
    )
    line, air = random_bytes(seed, core._firmware), RandomFrames(seed, disarmed=True)
    served = Served(Memory(most_bytes))
    core.handle(LinkChanged(0.0, "firmware", True))
    fed_bytes = step = 0
    while fed_bytes < most_bytes:
        step += 1
        t = step * STEP_S
        data = next(line)
        said = air.frame() if step % 20 else air.noise() + air.alive() + air.frame()
        served.from_phlosar_bytes += len(data)
        served.from_vehicle_bytes += len(said)
        fed_bytes += len(data) + len(said)
        events: list[Event] = [FirmwareMessage(t, message) for message in phlosar.decode(data)]
        events += [VehicleMessage(t, message) for message in vehicle.decode(said)]
        served.messages += len(events)
        for event in [*events, Tick(t)]:
            for action in core.handle(event):
                if isinstance(action, ToVehicle):
                    served.answers += bool(out.encode(action.message, action.system_id))
                elif isinstance(action, ToFirmware):
                    phlosar.encode(action.message)
                    if isinstance(action.message, Setpoint) and action.message.target_kPa != 0.0:
                        raise FuzzError(f"seed {seed}, step {step}: {action.message}")
        served.ready += core._firmware.state is SessionState.READY
        served.memory.fed(fed_bytes)
    served.memory.end(f"seed {seed}: the service", MOST_NEW_TABLES_BYTES)
    return served


def _blind(seed: int, most_bytes: int) -> None:
    print(f"firmware, blind, seed {seed}")
    began_s = perf_counter()
    _tell(drive(seed, most_bytes), perf_counter() - began_s)


def _guided(seed: int, most_bytes: int) -> None:
    clang = shutil.which("clang++")
    if clang is None:
        print("firmware, guided by coverage: needs clang: sudo apt install clang")
        return
    print(f"firmware, guided by coverage, seeds from {seed} on, {RUNS_AT_ONCE} inputs each")
    began_s = perf_counter()
    folder = Path(tempfile.mkdtemp(prefix="flying-vines-fuzz-"))
    for fuzzed in explore(clang, seed, most_bytes, folder):
        print(
            f"  {fuzzed.received_bytes:10} bytes · {perf_counter() - began_s:5.0f} s"
            f" · edges {fuzzed.edges} of {fuzzed.edges_there}",
            flush=True,
        )
    shutil.rmtree(folder)
    _tell(fuzzed, perf_counter() - began_s)


def _tell(fuzzed: Fuzzed, took_s: float) -> None:
    print(f"  bytes into its decoder: {fuzzed.received_bytes}, in {took_s:.0f} s")
    print(f"  steps: {fuzzed.steps}, regulating in {fuzzed.steps_regulating}")
    print(f"  peak memory: {fuzzed.peak_MB:.0f} MB, the sanitizers' included", flush=True)


def _host(seed: int, most_bytes: int) -> None:
    began_s = perf_counter()
    decoded = listen(seed, most_bytes)
    print(f"host, seed {seed}")
    print(f"  bytes into its decoder: {decoded.fed_bytes}, in {perf_counter() - began_s:.0f} s")
    print(f"  messages: {decoded.messages} · pieces after which the session was ready: {decoded.ready}")
    print(f"  memory after each tenth: {decoded.memory}")


def _service(seed: int, most_bytes: int) -> None:
    began_s = perf_counter()
    served = serve(seed, most_bytes)
    print(f"service, seed {seed}")
    print(f"  bytes: {served.from_phlosar_bytes} on the serial line, {served.from_vehicle_bytes} of MAVLink")
    print(f"  messages: {served.messages} in {perf_counter() - began_s:.0f} s; frames sent: {served.answers}")
    print(f"  steps with the phloSAR ready: {served.ready}")
    print(f"  memory after each tenth: {served.memory}", flush=True)


PARTS = {"blind": _blind, "guided": _guided, "host": _host, "service": _service}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--bytes", type=int, default=100_000_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=tuple(PARTS))
    arguments = parser.parse_args()
    try:
        for name, part in PARTS.items():
            if arguments.only in (None, name):
                part(arguments.seed, arguments.bytes)
    except (FuzzError, FirmwareBuildError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
