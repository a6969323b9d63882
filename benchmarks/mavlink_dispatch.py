"""CPU time to read an autopilot's messages: our codec and core, against pymavlink's parsing of the same
bytes.

The bytes are the recordings of real autopilots in tests/data, cut as a socket gives them (a frame per
datagram) and as a serial port or TCP does (1 kB at a time). pymavlink, our codec, and our codec with the core
alternate within one run. The ratios to pymavlink are of CPU time on one core, so that other work on the
machine has little influence; each repeat gives one ratio. With signing, every frame is signed anew with one
key, and all three check it. Linux only: it reads /proc.

    python benchmarks/mavlink_dispatch.py [--repeats N] [--json]    # a minute
    python benchmarks/mavlink_dispatch.py --check                   # exit status 1 if a goal is missed
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

from process_cost import memory
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from rich.console import Console
from rich.table import Table

from flying_vines.config import config
from flying_vines.core.core import Core
from flying_vines.core.events import VehicleMessage
from flying_vines.vehicle.mavlink import handled_messages
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.mavlink.frames import Frame, Frames
from flying_vines.vehicle.mavlink.signing import Signing
from flying_vines.vehicle.mavlink.tlog import TlogReader

RECORDINGS = Path(__file__).resolve().parents[1] / "tests" / "data" / "recordings"
CHUNK = 1024
KEY = hashlib.sha256(b"benchmark").digest()
CONFIG = config.default()
"""Read once, as the service does at its start."""
LONG_RUN = 1_000_000
MOST_COST = 1.2
LEAST_MESSAGES_PER_S = 60_000

Feed = list[tuple[float, bytes]]
"""The time and the bytes of each read."""


@dataclass(frozen=True, slots=True)
class Row:
    """The results for one way to cut the bytes: median times for each message, and the ratios of each
    repeat."""

    feed: str
    bare_us: float
    codec_us: float
    whole_us: float
    codec_ratios: list[float]
    whole_ratios: list[float]

    @property
    def messages_per_s(self) -> float:
        return 1e6 / self.whole_us


def frames_of(path: Path) -> Feed:
    return list(TlogReader(path).frames())


def chunked(frames: Feed) -> Feed:
    """The same bytes, one kilobyte at a time, each with the time of its last byte."""
    chunks: Feed = []
    rest = b""
    t = 0.0
    for t, frame in frames:
        rest += frame
        while len(rest) >= CHUNK:
            chunks.append((t, rest[:CHUNK]))
            rest = rest[CHUNK:]
    return [*chunks, (t, rest)]


def signed(frames: Feed) -> Feed:
    """The same messages of the dialect, signed with our key (PX4 signed its own with a key of zeros)."""
    signing, cutter = Signing(KEY), Frames()
    return [(t, _sign(frame, signing)) for t, raw in frames for frame in cutter.take(raw) if frame.known]


def _sign(frame: Frame, signing: Signing) -> bytes:
    header: bytes = mavlink.MAVLink_header(
        frame.message_id, 1, 0, len(frame.payload), frame.sequence, frame.system, frame.component
    ).pack()
    extra = bytes((mavlink.mavlink_map[frame.message_id].crc_extra,))
    crc: int = mavlink.x25crc(header[1:] + frame.payload + extra).crc
    stamp = bytes((signing.link_id,)) + signing.next_timestamp().to_bytes(6, "little")
    body = header + frame.payload + crc.to_bytes(2, "little") + stamp
    return body + hashlib.sha256(KEY + body).digest()[:6]


def bare(feeds: Sequence[Feed], with_key: bool) -> None:
    for feed in feeds:
        parser = mavlink.MAVLink(None)
        parser.robust_parsing = True
        if with_key:
            parser.signing.secret_key = KEY
        for _, data in feed:
            parser.parse_buffer(data)


def service_codec(with_key: bool) -> MavlinkCodec:
    return MavlinkCodec(0, 191, Signing(KEY) if with_key else None, handled_messages.NUMBERS)


def codec_alone(feeds: Sequence[Feed], with_key: bool) -> None:
    for feed in feeds:
        codec = service_codec(with_key)
        for _, data in feed:
            codec.decode(data)


def whole(feeds: Sequence[Feed], with_key: bool) -> None:
    for feed in feeds:
        codec = service_codec(with_key)
        core = Core(CONFIG)
        for t, data in feed:
            for message in codec.decode(data):
                core.handle(VehicleMessage(t, message))


Side = Callable[[Sequence[Feed], bool], None]


def cpu_us(side: Side, feeds: Sequence[Feed], with_key: bool, messages: int) -> float:
    began = time.process_time()
    side(feeds, with_key)
    return 1e6 * (time.process_time() - began) / messages


def measure(name: str, feeds: Sequence[Feed], with_key: bool, messages: int, repeats: int) -> Row:
    sides: list[Side] = [bare, codec_alone, whole]
    costs: dict[Side, list[float]] = {side: [] for side in sides}
    for side in sides:
        side(feeds, with_key)
    for repeat in range(repeats):
        for turn in range(len(sides)):
            side = sides[(repeat + turn) % len(sides)]
            costs[side].append(cpu_us(side, feeds, with_key, messages))
    return Row(
        name,
        bare_us=statistics.median(costs[bare]),
        codec_us=statistics.median(costs[codec_alone]),
        whole_us=statistics.median(costs[whole]),
        codec_ratios=[ours / theirs for ours, theirs in zip(costs[codec_alone], costs[bare], strict=True)],
        whole_ratios=[ours / theirs for ours, theirs in zip(costs[whole], costs[bare], strict=True)],
    )


def growth_MB(feeds: Sequence[Feed]) -> float:
    """Memory growth of a long run after its first tenth."""
    codec, core = service_codec(with_key=False), Core(CONFIG)
    seen, now_s, early_MB = 0, 0.0, 0.0
    while seen < LONG_RUN:
        for feed in feeds:
            began_s, lasts_s = feed[0][0], feed[-1][0] - feed[0][0]
            for t, data in feed:
                for message in codec.decode(data):
                    core.handle(VehicleMessage(now_s + t - began_s, message))
                    seen += 1
            now_s += lasts_s
        if not early_MB and seen >= LONG_RUN / 10:
            early_MB = memory(os.getpid()).now_MB
    return memory(os.getpid()).now_MB - early_MB


def show(rows: Sequence[Row], growth: float) -> None:
    table = Table("fed", "bare pymavlink", "our codec", "to bare", "codec and core", "to bare", "messages/s")
    for row in rows:
        table.add_row(
            row.feed,
            f"{row.bare_us:.2f} µs",
            f"{row.codec_us:.2f} µs",
            _spread(row.codec_ratios),
            f"{row.whole_us:.2f} µs",
            _spread(row.whole_ratios),
            f"{row.messages_per_s:,.0f}",
        )
    console = Console(width=130)
    console.print(table)
    console.print("CPU time per frame; ratios: median (least…most of the repeats)")
    console.print(
        f"{LONG_RUN:,} messages through one codec and core: memory {growth:+.1f} MB since the first tenth"
    )
    console.print(
        f"Python {platform.python_version()}, pymavlink {version('pymavlink')}, {platform.machine()}"
    )


def _spread(ratios: Sequence[float]) -> str:
    return f"{statistics.median(ratios):.2f} ({min(ratios):.2f}…{max(ratios):.2f})"


def misses(rows: Sequence[Row], growth: float) -> list[str]:
    """The missed goals."""
    told = []
    for row in rows:
        ratio = statistics.median(row.whole_ratios)
        if ratio > MOST_COST:
            told.append(f"{row.feed}: {ratio:.2f} times bare parsing, at most {MOST_COST} is wanted")
        if row.messages_per_s < LEAST_MESSAGES_PER_S:
            told.append(f"{row.feed}: {row.messages_per_s:.0f} messages/s, {LEAST_MESSAGES_PER_S} are wanted")
    if growth > 1.0:
        told.append(f"memory grew by {growth:.1f} MB")
    return told


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    parser.add_argument("--check", action="store_true", help="exit status 1 if a goal is missed")
    options = parser.parse_args()
    recorded = [frames_of(path) for path in sorted(RECORDINGS.glob("*.tlog"))]
    with_key = [signed(frames) for frames in recorded]
    rows = []
    for name, flights, key in (("as recorded", recorded, False), ("signed", with_key, True)):
        messages = sum(len(frames) for frames in flights)
        rows.append(measure(f"{name}, datagrams", flights, key, messages, options.repeats))
        chunks = [chunked(frames) for frames in flights]
        rows.append(measure(f"{name}, 1 kB", chunks, key, messages, options.repeats))
    growth = growth_MB(recorded)
    missed = misses(rows, growth)
    if options.json:
        print(json.dumps({"rows": [asdict(row) for row in rows], "growth_MB": growth, "missed": missed}))
    else:
        show(rows, growth)
        for miss in missed:
            print(f"missed: {miss}", file=sys.stderr)
    return 1 if options.check and missed else 0


if __name__ == "__main__":
    sys.exit(main())
