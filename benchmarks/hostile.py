"""Measures if attackers of the page and the broker can delay the switch.

    .venv/bin/python benchmarks/hostile.py [--one-core] [--gateway-nice 0 5 19] [--rounds N] [--flips N]

The flight is that of `latency.py`, with the page open to the network, two authorised viewers, MQTT to a real
mosquitto, and signing. It is flown without attackers, and while `strangers.py` attacks page and broker as
fast as it can. Each round flies all cases, in an order that rotates; the latencies of all rounds are pooled.

Attackers and broker would be on other computers. Here they share the processors, so they have the lowest
priority. `--one-core` gives one core to the service and its gateway, and another one to everything else. Then
only the work of the gateway can delay the service. `--gateway-nice` also flies with other priorities of the
gateway: a niceness, or idle.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
from collections import Counter
from dataclasses import dataclass, field

from latency import percentile
from mqtt_fleet import serving
from process_cost import cpu_s
from rich.console import Console
from rich.table import Table
from strangers import Harm, Target, attacking
from switch_flips import NotMeasured
from whole_service import ASKED_OVER_MQTT, VEHICLE, Flown, Switched, mosquitto, running

from flying_vines.gateway import page_token

ROUNDS, FLIPS = 6, 25
VIEWERS = 2
LOWEST = 19
OURS, THEIRS = {0}, {1}
"""Cores."""
STOPPED = "page and broker stopped"


@dataclass(frozen=True)
class Case:
    """With or without attackers; `priority` replaces the gateway's own priority."""

    name: str
    attacked: bool = True
    priority: str = ""


@dataclass
class Result:
    """All flights of one case."""

    flown: list[Flown] = field(default_factory=list)
    harms: list[Harm] = field(default_factory=list)
    broker_shares: list[float] = field(default_factory=list)
    stopped: int = 0
    """Number of gateways that did not survive."""

    @property
    def latencies_ms(self) -> list[float]:
        return sorted(ms for each in self.flown for ms in each.flight.latencies_ms)


def main() -> int:
    arguments = _arguments()
    console = Console(width=110)
    if arguments.one_core:
        os.sched_setaffinity(0, THEIRS)
    prompt = _be_prompt()
    cases = [Case("nobody else", attacked=False), Case("strangers")]
    cases += [Case(f"strangers, gateway {way}", priority=way) for way in arguments.gateway_nice]
    results = {case: Result() for case in cases}
    console.print(
        f"{os.cpu_count()} cores, load before {os.getloadavg()[0]:.1f}; the benchmark's own process runs at "
        f"{'real-time' if prompt else 'normal'} priority",
        highlight=False,
    )
    try:
        with serving(mosquitto()) as (port, pid):
            os.setpriority(os.PRIO_PROCESS, pid, LOWEST)
            for number in range(arguments.rounds):
                turn = number % len(cases)
                for case in cases[turn:] + cases[:turn]:
                    console.print(f"[dim]round {number + 1}: {case.name}[/dim]")
                    _fly(case, results[case], (port, pid), 5000 + number, arguments)
    except (NotMeasured, OSError) as error:
        print(f"hostile: not measured: {error}", file=sys.stderr)
        return 1
    _show(console, results)
    harmed = [case.name for case, result in results.items() if result.stopped or _let_in(result)]
    return 1 if harmed else 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--one-core", action="store_true", help="one core for service and gateway, another for the rest"
    )
    parser.add_argument("--gateway-nice", nargs="*", default=[], metavar="N", help="0 to 19, or idle")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--flips", type=int, default=FLIPS, help="flips of each round")
    return parser.parse_args()


def _be_prompt() -> bool:
    """Give this process real-time priority, so that its own waiting is not measured; needs root."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))
    except PermissionError:
        return False
    return True


def _fly(
    case: Case, result: Result, broker: tuple[int, int], seed: int, arguments: argparse.Namespace
) -> None:
    broker_port, broker_pid = broker
    everything = Switched(page=True, host="0.0.0.0", viewers=VIEWERS, broker_port=broker_port, signing=True)
    cores = OURS if arguments.one_core else None
    with running(everything, arguments.flips, seed, cores) as (whole, flipper):
        gateway = whole.gateway
        if case.priority == "idle":
            os.sched_setscheduler(gateway, os.SCHED_IDLE, os.sched_param(0))
        elif case.priority:
            os.setpriority(os.PRIO_PROCESS, gateway, int(case.priority))
        if not case.attacked:
            result.flown.append(whole.fly(flipper))
            return
        topic = f"flying-vines/{VEHICLE}/ask"
        watching = page_token.watching(whole.token)
        target = Target(whole.port, watching, broker_port, topic, ASKED_OVER_MQTT)
        with attacking(target, LOWEST) as strangers:
            used_s = 0.0

            def loaded() -> None:
                nonlocal used_s
                used_s = cpu_s(broker_pid)
                strangers.count()

            flown = whole.fly(flipper, loaded)
            result.broker_shares.append((cpu_s(broker_pid) - used_s) / flown.flight.loaded_s)
            result.harms.append(strangers.tell())
        result.flown.append(flown)
        result.stopped += STOPPED in whole.output or whole.gateway != gateway


def _let_in(result: Result) -> Counter[str]:
    return sum((harm.let_in for harm in result.harms), Counter())


def _show(console: Console, results: dict[Case, Result]) -> None:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("", "flips", "p50 ms", "p95", "p99", "max", "CPU %", "gateway", "seen/s", "gap s"):
        table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    for case, result in results.items():
        times_ms = result.latencies_ms
        looked = [each.looked for each in result.flown if each.looked]
        table.add_row(
            case.name,
            f"{len(times_ms)}",
            *(f"{percentile(times_ms, share):.2f}" for share in (0.5, 0.95, 0.99, 1.0)),
            f"{statistics.median(100 * each.service_share for each in result.flown):.1f}",
            f"{statistics.median(100 * each.gateway_share for each in result.flown):.1f}",
            f"{statistics.median(each.snapshots_per_s for each in looked):.1f}",
            f"{max(each.longest_gap_s for each in looked):.2f}",
        )
    (_, quiet), *others = results.items()
    for case, result in others:
        ratios = (
            percentile(result.latencies_ms, share) / percentile(quiet.latencies_ms, share)
            for share in (0.5, 0.95, 0.99, 1.0)
        )
        table.add_row(f"{case.name} / nobody", "", *(f"{ratio:.2f}" for ratio in ratios))
    console.print(table)
    for case, result in others:
        done = sum((harm.done for harm in result.harms), Counter())
        seconds = sum(harm.seconds for harm in result.harms)
        theirs = sum(harm.cpu_s for harm in result.harms) / seconds
        console.print(
            f"\n{case.name}: they took {theirs:.0%} of a core, mosquitto "
            f"{statistics.median(result.broker_shares):.0%}; gateways that stopped: {result.stopped}",
            highlight=False,
        )
        let_in = _let_in(result)
        for kind, count in done.items():
            got = f", LET IN {let_in[kind]}" if let_in[kind] else ""
            console.print(f"  {kind}: {count / seconds:.0f}/s{got}", highlight=False, style="dim")
    lost = {case.name: sum(e.flight.missed + e.flight.early for e in r.flown) for case, r in results.items()}
    void = {case.name: sum(e.flight.void for e in r.flown) for case, r in results.items()}
    console.print(f"flips missed or early {lost}; void {void}", highlight=False, style="dim")


if __name__ == "__main__":
    sys.exit(main())
