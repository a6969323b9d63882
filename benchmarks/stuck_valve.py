"""Does venting protect a vine whose inflation valve is stuck open?

A likely rig has a full reservoir, and the firmware's regulator holds the vine at 20.7 kPa until the inflation
valve sticks open. Then there are four cases:

- the host notices nothing, and the firmware regulates until it finds a fault
- the host commands a vent
- the host commands a vent, and the Venturi runs as well
- the host commands a vent, and the outlet does not open

Pressures are kPa gauge; the firmware's limit is 30. The table has the maximum rate, the time until the limit,
the highest pressure and its time, the time above the limit, and the reservoir's pressure at the end (after
12 s; after 1 s if no air can leave).

    python benchmarks/stuck_valve.py
"""

from __future__ import annotations

from typing import NamedTuple

from rich.console import Console
from rich.table import Table

from firmware_link.protocol import PROTOCOL_VERSION, Codec, Hello, Setpoint, Vent
from flying_vines.physics.rig import ControlVolume, Rig
from flying_vines.simulation.phlosar.mishaps import StuckAt
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar

HELD_KPA, LIMIT_KPA = 20.7, 30.0
SETTLED_S, WATCHED_S = 6.0, 12.0
OUTLETS: dict[str, dict[str, StuckAt]] = {
    "regulated": {},
    "vented": {},
    "vented with the Venturi": {"dvp": StuckAt(1.0)},
    "outlet stuck shut": {"solenoid": StuckAt(0.0)},
}


class Found(NamedTuple):
    """The results of one case. Times count from the moment when the valve sticks."""

    fastest_kPa_per_s: float
    at_limit_s: float | None
    highest_kPa: float
    highest_s: float
    above_s: float
    bottle_kPa: float
    """At the end of the run."""


def stuck(volume_L: float, outlet: str, watched_s: float) -> Found:
    """Simulate from the moment when the valve sticks."""
    phlosar, host = SimulatedPhlosar(Rig(cv=ControlVolume(volume_L=volume_L))), Codec()
    phlosar.receive(host.encode(Hello(PROTOCOL_VERSION, 1)))
    fastest_kPa_per_s = highest_kPa = highest_s = 0.0
    at_limit_s = None
    above_ms = 0
    settled_ms = round(SETTLED_S * 1000)
    for ms in range(1, settled_ms + round(watched_s * 1000) + 1):
        if ms % 20 == 1 and (ms <= settled_ms or outlet == "regulated"):
            phlosar.receive(host.encode(Setpoint(HELD_KPA, 50.0, 250, 1)))
        if ms == settled_ms + 1:
            for place, mishap in {"evp": StuckAt(1.0), **OUTLETS[outlet]}.items():
                phlosar.inject(place, mishap)
            if outlet != "regulated":
                phlosar.receive(host.encode(Vent(2)))
        before_kPa = phlosar.cv_kPa
        host.decode(phlosar.advance(ms / 1000))
        if ms <= settled_ms:
            continue
        now_s, kPa = ms / 1000 - SETTLED_S, phlosar.cv_kPa
        fastest_kPa_per_s = max(fastest_kPa_per_s, (kPa - before_kPa) * 1000)
        if kPa > highest_kPa:
            highest_kPa, highest_s = kPa, now_s
        if kPa > LIMIT_KPA:
            above_ms += 1
            at_limit_s = at_limit_s or now_s
    return Found(
        fastest_kPa_per_s, at_limit_s, highest_kPa, highest_s, above_ms / 1000, phlosar.reservoir_kPa
    )


def main() -> None:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in (
        "vine L",
        "outlet",
        "kPa/s",
        "at 30 kPa",
        "highest kPa",
        "after",
        "above 30",
        "bottle kPa",
    ):
        table.add_column(heading, justify="left" if heading == "outlet" else "right", no_wrap=True)
    for volume_L in (0.1, 0.5, 1.0):
        for outlet in OUTLETS:
            # If no air can leave, a second is enough.
            found = stuck(volume_L, outlet, 1.0 if "solenoid" in OUTLETS[outlet] else WATCHED_S)
            table.add_row(
                f"{volume_L:g}",
                outlet,
                f"{found.fastest_kPa_per_s:.0f}",
                "never" if found.at_limit_s is None else f"{found.at_limit_s:.2f} s",
                f"{found.highest_kPa:.1f}",
                f"{found.highest_s:.1f} s",
                f"{found.above_s:.1f} s",
                f"{found.bottle_kPa:.0f}",
            )
    Console().print(table)


if __name__ == "__main__":
    main()
