"""A million random messages through codec and core: nothing raises, nothing moves, nothing grows.

    python benchmarks/random_messages.py [--messages 1000000] [--seed 1]

Three worlds take a third of the messages each: the phloSAR never answers; the phloSAR is ready and the
vehicle is disarmed; a flood of commands, parameters and mission messages at 2000 a second. The frames are
valid, of every kind that the dialect knows, from random senders (ours and the autopilot among them) to random
targets, with random, extreme and not-a-number fields; every twentieth comes behind random bytes, and now and
then a vehicle says that it is there.
"""

from __future__ import annotations

import argparse
import gc
import resource
import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from babble import FLOOD, KINDS, Babble, largest_tables, serving_vehicle_1

from firmware_link import protocol
from flying_vines.core import Core
from flying_vines.events import Action, LinkChanged, Tick, ToFirmware, ToVehicle, VehicleMessage
from flying_vines.simulated_world import SimulatedWorld
from flying_vines.vehicle.codec import Codec

TICK_S = 0.02
NOISE_EVERY = 20
ALIVE_EVERY = 250
STAGES = 4
"""Memory is looked at this often: the first stage may still fill tables."""
MOST_NEW_OBJECTS = 2000
"""What tables that are not yet full may take up after that: one in a hundred messages, were it a leak."""

Feed = Callable[[float, bytes], list[Action]]


def alone(codec: Codec) -> tuple[Feed, Core]:
    """A core whose phloSAR never answers."""
    core = Core(serving_vehicle_1())
    core.handle(LinkChanged(0.0, "firmware", True))
    ticks = 0

    def feed(t: float, data: bytes) -> list[Action]:
        nonlocal ticks
        actions: list[Action] = []
        for message in codec.decode(data):
            actions.extend(core.handle(VehicleMessage(t, message)))
        while ticks * TICK_S <= t:
            actions.extend(core.handle(Tick(ticks * TICK_S)))
            ticks += 1
        return actions

    return feed, core


def with_phlosar(codec: Codec) -> tuple[Feed, Core]:
    """A core whose phloSAR is ready and full of air."""
    world = SimulatedWorld(serving_vehicle_1())

    def feed(t: float, data: bytes) -> list[Action]:
        actions = list(world.advance(t))
        for message in codec.decode(data):
            actions.extend(world.feed(VehicleMessage(t, message)))
        return actions

    return feed, world.core


def run(name: str, messages: int, seed: int, step_s: float, ready: bool, kinds: tuple[object, ...]) -> bool:
    babble = Babble(seed, disarmed=ready)
    codec, out = Codec(0, 191), Codec(0, 191)
    feed, core = with_phlosar(codec) if ready else alone(codec)
    moved = sent = 0
    objects: list[int] = []
    began_s = perf_counter()
    for i in range(messages):
        data = babble.frame(kinds)
        if i % ALIVE_EVERY == 0:
            data += babble.alive()
        if i % NOISE_EVERY == 0:
            data = babble.noise() + data
        for action in feed(i * step_s, data):
            if isinstance(action, ToVehicle):
                sent += bool(out.encode(action.message, action.system_id))
            elif isinstance(action, ToFirmware) and isinstance(action.message, protocol.Setpoint):
                moved += action.message.target_kPa != 0.0
        if (i + 1) % (messages // STAGES) == 0:
            gc.collect()
            objects.append(len(gc.get_objects()))
    took_s = perf_counter() - began_s
    size, where = max(largest_tables(core)[0], largest_tables(codec)[0])
    ready_now = core.snapshot(messages * step_s).firmware == "ready"
    largest_MB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(f"{name}, seed {seed}")
    print(f"  {messages} frames, {messages * step_s:.0f} s of flight, {took_s:.0f} s of this machine")
    print(f"  phloSAR {'ready' if ready_now else 'not ready'} · setpoints above 0 kPa: {moved}")
    print(f"  frames sent to the vehicle: {sent}, {sent / (messages * step_s):.1f} a second of flight")
    print(
        f"  objects after each quarter: {', '.join(map(str, objects))} · at most {largest_MB:.0f} MB so far"
    )
    print(f"  largest table: {size} in {where}")
    return moved == 0 and ready_now == ready and objects[-1] - objects[0] < MOST_NEW_OBJECTS


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--messages", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    third, seed = arguments.messages // 3, arguments.seed
    good = [
        run("phloSAR not ready", third, seed, 0.004, False, KINDS),
        run("phloSAR ready, vehicle disarmed", third, seed + 1, 0.001, True, KINDS),
        run("flood at 2000 a second", third, seed + 2, 0.0005, False, FLOOD),
    ]
    print("nothing raised, moved or grew" if all(good) else "FAILED")
    return 0 if all(good) else 1


if __name__ == "__main__":
    sys.exit(main())
