"""Processor time and memory that each part of the service needs on the companion.

    .venv/bin/python benchmarks/everything_on.py [--rounds N] [--flips N]

The flight is that of `latency.py` (500 MAVLink messages a second, 100 telemetry frames a second, a flip of
the switch every 0.6 s). The first row has only the recorder. Each further row adds one part: a page with two
viewers, MQTT to a mosquitto at 2 Hz with discovery, signing, and `flying-vines watch`. The numbers are
processor time and memory (PSS) of the service, of its gateway, and of both. Viewers, broker and `watch` are
not counted, because they run on other computers. The rounds of the rows alternate; the table has their
medians.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
from dataclasses import replace

from latency import percentile
from mqtt_fleet import serving
from rich.console import Console
from rich.table import Table
from switch_flips import NotMeasured
from whole_service import Flown, Switched, mosquitto, running

GOALS = {"cpu_percent": 25.0, "memory_MB": 120.0}
ROUNDS, FLIPS = 5, 25
VIEWERS = 2


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--flips", type=int, default=FLIPS, help="flips of each round")
    arguments = parser.parse_args()
    console = Console(width=110)
    console.print(f"{os.cpu_count()} cores, load before {os.getloadavg()[0]:.1f}", highlight=False)
    try:
        with serving(mosquitto()) as (broker_port, _):
            switched = _one_after_another(broker_port)
            flown: dict[str, list[Flown]] = {name: [] for name in switched}
            for number in range(arguments.rounds):
                for name, on in switched.items():
                    console.print(f"[dim]round {number + 1}: {name}[/dim]")
                    with running(on, arguments.flips, 3000 + number) as (whole, flipper):
                        flown[name].append(whole.fly(flipper))
    except (NotMeasured, OSError) as error:
        print(f"everything_on: not measured: {error}", file=sys.stderr)
        return 1
    return _show(console, flown)


def _one_after_another(broker_port: int) -> dict[str, Switched]:
    recorder = Switched()
    page = replace(recorder, page=True, viewers=VIEWERS)
    mqtt = replace(page, broker_port=broker_port)
    signing = replace(mqtt, signing=True)
    return {
        "recorder": recorder,
        f"+ page, {VIEWERS} viewers": page,
        "+ MQTT": mqtt,
        "+ signing": signing,
        "+ watch": replace(signing, watch=True),
    }


def _show(console: Console, flown: dict[str, list[Flown]]) -> int:
    """Print the table. Returns 1 if all parts together exceed the goals."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    headings = (
        "",
        "service %",
        "gateway %",
        "both %",
        "service MB",
        "gateway MB",
        "both MB",
        "p50 ms",
        "p99 ms",
    )
    for heading in headings:
        table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    cpu_percent = memory_MB = 0.0
    for name, flights in flown.items():
        service = statistics.median(100 * each.service_share for each in flights)
        gateway = statistics.median(100 * each.gateway_share for each in flights)
        cpu_percent = statistics.median(100 * (each.service_share + each.gateway_share) for each in flights)
        memory_MB = statistics.median(each.service_MB + each.gateway_MB for each in flights)
        times_ms = sorted(ms for each in flights for ms in each.flight.latencies_ms)
        table.add_row(
            name,
            *(f"{share:.1f}" for share in (service, gateway, cpu_percent)),
            f"{statistics.median(each.service_MB for each in flights):.0f}",
            f"{statistics.median(each.gateway_MB for each in flights):.0f}",
            f"{memory_MB:.0f}",
            f"{percentile(times_ms, 0.5):.2f}",
            f"{percentile(times_ms, 0.99):.2f}",
        )
    met = cpu_percent < GOALS["cpu_percent"] and memory_MB < GOALS["memory_MB"]
    table.add_row()
    table.add_row("goal", "", "", f"< {GOALS['cpu_percent']:g}", "", "", f"< {GOALS['memory_MB']:g}")
    table.add_row("met", "", "", "yes" if met else "NO")
    console.print(table)
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
