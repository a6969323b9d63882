"""A day of flights without a pause: no missed trigger, no motion without a request, no growing memory.

    python benchmarks/soak.py [--hours 24] [--seed 1] [--autopilot ardupilot|px4]
    python benchmarks/soak.py --real-time [--hours 1]

One core, one fake autopilot and one phloSAR with the real firmware (its C++ core) repeat flights: arm, take
off, switch moves, buttons of a ground station or mission items at random times, land, refill the reservoir. A
trigger is an action of the script, or a mission item that the autopilot ran. Each must give one accepted
decision and one motion of the plant's pressure. Between motions the pressure must not change. Simulated time
runs as fast as possible. With --real-time the service is a process of its own, as in a flight, between fakes
on real sockets and a pseudo-terminal.

Memory is sampled once an hour (in real time every five minutes), on the ground: the resident set of the
process, and Python's allocated blocks, which count every object. In real time only the resident set of the
service is sampled.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import gc
import os
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic
from typing import NamedTuple

from process_cost import memory

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from ports import free_port
from service_bench import between
from soak_day import LOOK_S, World, flights

from flying_vines.config import config
from flying_vines.core.events import Decision
from flying_vines.physics.plant.effects import Effects
from flying_vines.record.reader import FlightLog, flights_in, restored
from flying_vines.record.topics import DECISION
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.autopilot_server import COMPONENT_ID, SYSTEM_ID, AutopilotServer, GroundStation
from flying_vines.simulation.phlosar.phlosar import PtyPhlosar, SimulatedPhlosar
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage
from flying_vines.vehicle.mission.item import AutopilotKind

HOUR_S = 3600.0
REAL_TIME_SAMPLES_S = 300.0
MOST_NEW_BLOCKS = 5000
MOST_NEW_MB = 5.0
"""Maximum growth since the first sample. Tables still fill, and the missions have different lengths."""
_STEP_S = 0.02


class Sample(NamedTuple):
    """Memory on the ground, after some hours of flying."""

    hours: float
    took_s: float
    rss_MB: float
    blocks: int | None


@dataclass
class Outcome:
    """The result up to now."""

    world: World
    decisions: Counter[str] = field(default_factory=Counter)
    samples: list[Sample] = field(default_factory=list)

    def decided(self, decision: Decision) -> None:
        how = decision.safety
        self.decisions[how] += 1
        if how != "accepted" or decision.trigger == "failsafe":
            self.world.tally.violations.append(
                f"at {decision.t:.1f} s: {decision.trigger} {how}: {decision.reason}"
            )

    def read_decisions(self, flights_folder: Path) -> None:
        """Count the decisions in the service's log."""
        for log in flights_in(flights_folder):
            for entry in FlightLog(log).entries((DECISION,)):
                self.decided(restored(Decision, entry.fields))

    def sample(self, pid: int, took_s: float, blocks: int | None) -> None:
        new = Sample(self.world.now() / HOUR_S, took_s, memory(pid).now_MB, blocks)
        self.samples.append(new)
        tally = self.world.tally
        print(
            f"{new.hours:7.2f} {took_s:7.0f} {tally.flights:8} {tally.triggers.total():9}"
            f" {self.decisions.total() or '':>10} {tally.motions:8} {len(tally.violations):11}"
            f" {new.rss_MB:7.1f} {new.blocks if new.blocks is not None else '':>9}",
            flush=True,
        )

    @property
    def flat(self) -> bool:
        first, last = self.samples[0], self.samples[-1]
        few = first.blocks is None or last.blocks is None or last.blocks - first.blocks <= MOST_NEW_BLOCKS
        return few and last.rss_MB - first.rss_MB <= MOST_NEW_MB

    @property
    def good(self) -> bool:
        tally = self.world.tally
        asked = tally.triggers.total()
        return not tally.violations and asked == tally.motions == self.decisions.total() and self.flat


def simulated(kind: AutopilotKind, seed: int, until_s: float, sample_every_s: float = HOUR_S) -> Outcome:
    """Fly in simulated time until `until_s`, and land."""
    autopilot = FakeAutopilot(kind)
    autopilot.add_link("gcs")
    phlosar = SimulatedPhlosar(effects=Effects())
    flight = SimulatedFlight(config.default(), autopilot, phlosar)
    ground = MavlinkCodec(SYSTEM_ID, COMPONENT_ID)

    def press(button: MavlinkMessage) -> None:
        autopilot.receive(flight.world.now, "gcs", ground.encode(button, SYSTEM_ID))

    world = World(autopilot, phlosar, press, lambda: flight.world.now)
    outcome = Outcome(world)
    began_s = monotonic()
    sample_s = sample_every_s
    for pause_s in flights(world, seed):
        resume_s = world.now() + pause_s
        while world.now() < resume_s - 1e-6:
            for action in flight.run(min(resume_s, world.now() + LOOK_S), _STEP_S):
                if isinstance(action, Decision):
                    outcome.decided(action)
            world.look()
        if pause_s == 0.0 and world.now() >= sample_s:
            sample_s += sample_every_s
            gc.collect()
            outcome.sample(os.getpid(), monotonic() - began_s, sys.getallocatedblocks())
            if world.now() >= until_s:
                break
    return outcome


async def real(kind: AutopilotKind, seed: int, until_s: float, folder: Path) -> Outcome:
    """Fly in real time until `until_s`, with the service in a process of its own."""
    ground = GroundStation()
    ground_port = await ground.listen()
    companion_port = free_port()
    autopilot = FakeAutopilot(kind)
    phlosar = SimulatedPhlosar(effects=Effects())
    server = AutopilotServer(autopilot, ("127.0.0.1", companion_port), ("127.0.0.1", ground_port))
    began_s = monotonic()
    world = World(autopilot, phlosar, ground.send, lambda: monotonic() - began_s)
    outcome = Outcome(world)
    with PtyPhlosar(phlosar) as port:
        running = [asyncio.create_task(part.run()) for part in (server, port, ground)]
        async with _service(folder, companion_port, port.path) as pid:
            sample_s = REAL_TIME_SAMPLES_S
            for pause_s in flights(world, seed):
                resume_s = world.now() + pause_s
                while world.now() < resume_s:
                    await asyncio.sleep(min(LOOK_S, resume_s - world.now()))
                    world.look()
                if pause_s == 0.0 and world.now() >= sample_s:
                    sample_s += REAL_TIME_SAMPLES_S
                    outcome.sample(pid, world.now(), None)
                    if world.now() >= until_s:
                        break
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)
    return outcome


@contextlib.asynccontextmanager
async def _service(folder: Path, companion_port: int, serial_path: str) -> AsyncIterator[int]:
    """Run the service as a process. Yields its id. Raises SystemExit if it fails."""
    config_file = folder / "vine.toml"
    config_file.write_text(between(companion_port, serial_path), encoding="utf-8")
    arguments = ["run", "--config", str(config_file), "--plain", "--out", str(folder / "flights")]
    with (folder / "service.txt").open("wb") as said:
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "flying_vines", *arguments), stdout=said, stderr=asyncio.subprocess.STDOUT
        )
    try:
        yield process.pid
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.send_signal(signal.SIGTERM)
        status = await process.wait()
    if status != 0:
        raise SystemExit(f"The service ended with {status}: {(folder / 'service.txt').read_text()[-2000:]}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--hours", type=float, help="hours of flying: 24, in real time 1")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--autopilot", choices=("ardupilot", "px4"), default="ardupilot")
    parser.add_argument("--real-time", action="store_true")
    arguments = parser.parse_args()
    kind: AutopilotKind = arguments.autopilot
    hours = arguments.hours or (1.0 if arguments.real_time else 24.0)
    print(
        f"{kind}, seed {arguments.seed}, {hours:g} h of {'real' if arguments.real_time else 'simulated'} time"
    )
    print("  hours  took, s  flights  triggers  decisions  motions  violations  RSS, MB    blocks")
    if arguments.real_time:
        with tempfile.TemporaryDirectory() as folder:
            outcome = asyncio.run(real(kind, arguments.seed, hours * HOUR_S, Path(folder)))
            outcome.read_decisions(Path(folder) / "flights")
    else:
        outcome = simulated(kind, arguments.seed, hours * HOUR_S)
    tally = outcome.world.tally
    print(
        "triggers: " + ", ".join(f"{count} by {trigger}" for trigger, count in tally.triggers.most_common())
    )
    print(f"decisions: {dict(outcome.decisions)} · motions: {tally.motions} · memory flat: {outcome.flat}")
    for violation in tally.violations:
        print(f"VIOLATION {violation}")
    return 0 if outcome.good else 1


if __name__ == "__main__":
    sys.exit(main())
