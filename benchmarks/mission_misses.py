"""The number of missed mission items at a given loss of frames, for each autopilot and kind of mission.

    python benchmarks/mission_misses.py [--flights 150] [--seed 1]

The fake autopilots fly random missions over a link that loses a share of the frames in each direction. The
executed items are compared with the items that the service's `Vehicle` has seen. "Plain" missions have one
vine item after each stop (a waypoint or a delay). "Wild" missions have several vine items at a place,
conditions and loops, and are disturbed by changes of mode, jumps, other missions, reboots of the autopilot
and of the service, and cut links.
"""

from __future__ import annotations

import argparse
import random
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from mission_on_bad_link import Link, MissionOnBadLink, compare, fly, mission

from flying_vines.simulation.autopilot import AutopilotKind

LOSSES = (0.0, 0.01, 0.05, 0.2)
KINDS: tuple[AutopilotKind, AutopilotKind] = ("ardupilot", "px4")


def misses(kind: AutopilotKind, loss: float, flights: int, seed: int, wild: bool) -> tuple[int, int, int]:
    """Numbers of items that ran, of missed items, and of triggers without an item."""
    ran = missed = extra = 0
    for number in range(flights):
        dice = random.Random(f"{seed} {number} {wild}")
        flight = MissionOnBadLink(
            kind, dice, Link(loss, copies=0.05, late_s=0.05), mission(kind, dice, wild=wild)
        )
        if not wild:
            flight.run(10.0)
        fly(flight, 45.0, happenings=dice.randrange(5) if wild else 0)
        found = compare(flight)
        ran, missed, extra = ran + len(flight.ran), missed + len(found.missed), extra + len(found.extra)
    return ran, missed, extra


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--flights", type=int, default=150)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    print(f"seed {arguments.seed}, {arguments.flights} flights a row")
    print("missions  autopilot   loss    ran  missed         extra")
    for wild in (False, True):
        for kind in KINDS:
            for loss in LOSSES:
                ran, missed, extra = misses(kind, loss, arguments.flights, arguments.seed, wild)
                print(
                    f"{'wild' if wild else 'plain':8}  {kind:9}  {loss:4.0%}  {ran:6}  {missed:4} "
                    f"({missed / ran:6.2%})  {extra:4}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
