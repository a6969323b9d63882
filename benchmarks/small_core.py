"""Measures if the service keeps its schedule on a share of one core.

    python benchmarks/small_core.py [--share 1/8 ...] [--flips N]

The flight is that of `latency.py` (500 MAVLink messages and 100 telemetry frames a second), with the recorder
and without the page. The kernel limits the service to a share of one core in every 10 ms. A setpoint is due
every 20 ms while the vine is regulated. Linux only, as root, because it uses a control group.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path

from latency import percentile
from rich.console import Console
from rich.table import Table
from switch_flips import NotMeasured
from whole_service import Switched, running

GROUPS = Path("/sys/fs/cgroup")
PERIOD_US = 10_000
SHORTEST_QUOTA_US = 1000
"""The kernel's minimum."""
DUE_EVERY_S = 0.02
LATE_S = 0.05
DEAD_MAN_S = 0.25


@contextlib.contextmanager
def limited(share: Fraction) -> Iterator[Path]:
    """A control group with this share of one core. A process enters it if its id is written to
    `cgroup.procs`."""
    unified = (GROUPS / "cgroup.controllers").exists()
    group = (GROUPS if unified else GROUPS / "cpu") / f"small-core-{os.getpid()}"
    quota_us = max(SHORTEST_QUOTA_US, round(share * PERIOD_US))
    try:
        if unified:
            (GROUPS / "cgroup.subtree_control").write_text("+cpu", encoding="ascii")
        group.mkdir()
        if unified:
            (group / "cpu.max").write_text(f"{quota_us} {PERIOD_US}", encoding="ascii")
        else:
            (group / "cpu.cfs_period_us").write_text(str(PERIOD_US), encoding="ascii")
            (group / "cpu.cfs_quota_us").write_text(str(quota_us), encoding="ascii")
    except OSError as error:
        raise NotMeasured(f"no control group for the processor: {error}") from None
    try:
        yield group
    finally:
        group.rmdir()


def fly(share: Fraction, flips: int) -> list[str]:
    """Fly one flight. Returns a row of the table."""
    with limited(share) as group, running(Switched(), flips, seed=1) as (whole, flipper):

        def confine() -> None:
            (group / "cgroup.procs").write_text(str(whole.pid), encoding="ascii")
            whole.board.setpoint_gaps_s.clear()

        flown = whole.fly(flipper, confine)
    gaps_s = sorted(whole.board.setpoint_gaps_s)
    times_ms = sorted(flown.flight.latencies_ms)
    return [
        str(share),
        f"{100 * flown.service_share:.1f} %",
        str(len(gaps_s)),
        f"{1e3 * percentile(gaps_s, 0.99):.0f} ms",
        f"{1e3 * gaps_s[-1]:.0f} ms",
        str(sum(gap_s > DUE_EVERY_S + LATE_S for gap_s in gaps_s)),
        str(sum(gap_s > DEAD_MAN_S for gap_s in gaps_s)),
        f"{percentile(times_ms, 0.5):.1f} ms",
        f"{percentile(times_ms, 0.99):.1f} ms",
        str(flown.flight.missed),
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--share", type=Fraction, nargs="+", default=[Fraction(1), Fraction(1, 4), Fraction(1, 8)]
    )
    parser.add_argument("--flips", type=int, default=60)
    options = parser.parse_args(arguments)
    table = Table(
        *("share of a core", "taken", "setpoints", "gap p99", "longest"),
        *(f"later than {1e3 * LATE_S:.0f} ms", "beyond the dead-man", "switch p50", "p99", "flips missed"),
    )
    try:
        for share in options.share:
            table.add_row(*fly(share, options.flips))
    except NotMeasured as problem:
        print(f"small_core: not measured: {problem}", file=sys.stderr)
        return 1
    Console(width=130).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
