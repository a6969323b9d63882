"""Measures the service and its peers: time from a switch move to a setpoint, processor time and memory.

    .venv/bin/python benchmarks/latency.py [--quick] [--flips N] [--json]

The time is from the RC_CHANNELS datagram that settles a switch move to the setpoint frame on the serial line,
with 500 MAVLink messages a second on a UDP link and 100 telemetry frames a second on a pseudo-terminal. Every
program flies in several rounds, in an order that rotates. For the MAVSDK peer install `mavsdk>=4.1,<5` here,
or in an environment of its own (with pyserial) that `--mavsdk-python` names. Linux only: it reads /proc.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import platform
import re
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from time import monotonic

from process_cost import Memory, cpu_s, import_ms, memory
from rich.console import Console
from rich.table import Table
from serial_board import SerialBoard
from switch_flips import Flight, Flipper, NotMeasured

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

from ports import free_port

from flying_vines.config import config as configuration

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
SERVICE = "flying_vines run"
MAVSDK_WANTED = "mavsdk>=4.1,<5"
GOALS = {"p50_ms": 1.0, "p99_ms": 5.0, "cpu_percent": 15.0, "peak_memory_MB": 80.0, "import_ms": 500.0}
IMPORTS = (
    "import flying_vines.cli.main, flying_vines.service.service, "
    "flying_vines.terminal.screen, flying_vines.record.recorder"
)
QUICK_FLIPS = 20
MOST_UNMEASURED = 0.1
"""Maximum share of unmeasured flips. With more, the machine was too busy, or the process did not behave."""


@dataclass(frozen=True)
class Subject:
    """A program under test."""

    name: str
    python: str
    peer: str = ""
    """The program's name in `latency_peers.py`; empty for the service."""
    imports: str = ""


@dataclass
class Result:
    """All flights of one subject together."""

    flights: list[Flight] = field(default_factory=list)
    cpu_s: float = 0.0
    memories: list[Memory] = field(default_factory=list)
    alive_s: list[float] = field(default_factory=list)
    import_ms: float = math.nan

    @property
    def latencies_ms(self) -> list[float]:
        return sorted(ms for flight in self.flights for ms in flight.latencies_ms)

    @property
    def unmeasured(self) -> int:
        return sum(flight.missed + flight.early + flight.void for flight in self.flights)

    def row(self) -> dict[str, float]:
        times_ms = self.latencies_ms
        loaded_s = sum(flight.loaded_s for flight in self.flights)
        late_ms = sorted(ms for flight in self.flights for ms in flight.lateness_ms)
        return {
            "flips": len(times_ms),
            "p50_ms": percentile(times_ms, 0.50),
            "p95_ms": percentile(times_ms, 0.95),
            "p99_ms": percentile(times_ms, 0.99),
            "max_ms": times_ms[-1],
            "cpu_percent": 100.0 * self.cpu_s / loaded_s,
            "peak_memory_MB": max(memory.peak_MB for memory in self.memories),
            "memory_MB": max(memory.now_MB for memory in self.memories),
            "import_ms": self.import_ms,
            "alive_s": statistics.median(self.alive_s),
            "messages_per_s": sum(flight.messages for flight in self.flights) / loaded_s,
            "telemetry_per_s": sum(flight.telemetry_frames for flight in self.flights) / loaded_s,
            "missed": sum(flight.missed for flight in self.flights),
            "early": sum(flight.early for flight in self.flights),
            "void": sum(flight.void for flight in self.flights),
            "bench_late_p50_ms": percentile(late_ms, 0.50),
            "bench_late_p99_ms": percentile(late_ms, 0.99),
            "bench_late_max_ms": late_ms[-1],
        }


def percentile(ordered: Sequence[float], share: float) -> float:
    """The smallest value that has at least this share of all values at or below it."""
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)]


def main() -> int:
    arguments = _arguments()
    console = Console(stderr=arguments.json)
    python = sys.executable
    subjects = [
        Subject(SERVICE, python, imports=IMPORTS),
        Subject("mavutil loop", python, "mavutil", "from pymavlink import mavutil; import serial"),
        Subject("bare socket", python, "bare", "import serial"),
    ]
    mavsdk = _mavsdk_version(arguments.mavsdk_python)
    if mavsdk:
        imports = "import mavsdk.asyncio, mavsdk.asyncio.plugins.mavlink_direct, serial"
        subjects.insert(2, Subject("mavsdk.asyncio", arguments.mavsdk_python, "mavsdk", imports))
    else:
        console.print(f"Without the MAVSDK peer: pip install '{MAVSDK_WANTED}' (see --help)", soft_wrap=True)
    flips = QUICK_FLIPS if arguments.quick else arguments.flips
    rounds = 1 if arguments.quick else arguments.rounds
    machine = _machine(mavsdk)
    results = {subject.name: Result() for subject in subjects}
    try:
        with tempfile.TemporaryDirectory(prefix="latency-") as scratch:
            for number in range(rounds):
                share = flips // rounds + (number < flips % rounds)
                turn = number % len(subjects)
                for subject in subjects[turn:] + subjects[:turn]:
                    console.print(f"[dim]round {number + 1}/{rounds}: {subject.name}, {share} flips[/dim]")
                    _fly(subject, results[subject.name], share, 1000 + number, Path(scratch))
        for subject in subjects:
            repeats = 3 if arguments.quick else 7
            result = results[subject.name]
            result.import_ms = import_ms(subject.python, subject.imports, environment(), repeats)
            if result.unmeasured > MOST_UNMEASURED * flips:
                raise NotMeasured(f"{subject.name}: {result.unmeasured} of {flips} flips were not measured")
    except (NotMeasured, OSError, subprocess.CalledProcessError) as error:
        print(f"latency: not measured: {error}", file=sys.stderr)
        return 1
    rows = {name: result.row() for name, result in results.items()}
    if arguments.json:
        flights = {name: [asdict(flight) for flight in result.flights] for name, result in results.items()}
        for taken in flights.values():
            for flight in taken:
                del flight["lateness_ms"]
        print(json.dumps({"machine": machine, "goals": GOALS, "rows": rows, "flights": flights}, indent=1))
    else:
        _show(console, machine, rows)
    return 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--flips", type=_count, default=200, help="flips of the switch for each process (200)"
    )
    parser.add_argument(
        "--rounds", type=_count, default=4, help="rounds, among which the flips are divided (4)"
    )
    parser.add_argument(
        "--quick", action="store_true", help=f"{QUICK_FLIPS} flips in one round, to try the benchmark"
    )
    parser.add_argument(
        "--json", action="store_true", help="print JSON with all numbers instead of the table"
    )
    parser.add_argument(
        "--mavsdk-python", default=sys.executable, metavar="PYTHON", help="a Python with MAVSDK"
    )
    return parser.parse_args()


def _count(text: str) -> int:
    count = int(text)
    if count < 1:
        raise argparse.ArgumentTypeError("must be 1 or more")
    return count


def _fly(subject: Subject, result: Result, flips: int, seed: int, scratch: Path) -> None:
    """Fly one flight with a new process."""
    folder = Path(tempfile.mkdtemp(dir=scratch))
    udp_port = free_port()
    with SerialBoard(monotonic()) as board, (folder / "output").open("w+", encoding="utf-8") as output:
        started_s = monotonic()
        process = subprocess.Popen(
            _command(subject, udp_port, board.path, folder),
            cwd=folder,
            env=environment(),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        used_s = 0.0

        def loaded() -> None:
            nonlocal used_s
            used_s = cpu_s(process.pid)

        try:
            with ended(process):
                flipper = Flipper(udp_port, board, flips, seed)
                flight = flipper.fly(lambda: process.poll() is None, loaded)
                if process.poll() is not None:
                    raise NotMeasured("the process ended during the flight")
                result.cpu_s += cpu_s(process.pid) - used_s
                result.memories.append(memory(process.pid))
                result.alive_s.append(flipper.alive_at_s - started_s)
                result.flights.append(flight)
                if not flight.latencies_ms:
                    raise NotMeasured("no flip was followed by a setpoint")
        except NotMeasured as problem:
            output.seek(0)
            said = output.read()[-2000:].strip()
            raise NotMeasured(f"{subject.name}: {problem}; its output ends:\n{said}") from None


@contextlib.contextmanager
def ended(process: subprocess.Popen[bytes]) -> Iterator[None]:
    """End the process when the context ends."""
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _command(subject: Subject, udp_port: int, tty: str, folder: Path) -> list[str]:
    if subject.peer:
        return [subject.python, str(HERE / "latency_peers.py"), subject.peer, str(udp_port), tty]
    config_file = folder / "vine.toml"
    config_file.write_text(configuration_text(udp_port, tty), encoding="utf-8")
    run = ["run", "--config", str(config_file), "--plain", "--out", str(folder / "flights")]
    return [subject.python, "-m", "flying_vines", *run]


def configuration_text(udp_port: int, tty: str) -> str:
    """The default configuration with other links."""
    links = {"vehicle": f"udpin:127.0.0.1:{udp_port}", "firmware": f"serial:{tty}"}
    text = configuration.default_text()
    for table, link in links.items():
        text, found = re.subn(rf'(\[{table}\]\nlink = )"[^"]*"', rf'\g<1>"{link}"', text)
        if found != 1:
            raise NotMeasured(f"the built-in configuration has no [{table}] link where it is expected")
    return text


def environment() -> dict[str, str]:
    """Environment in which any peer can import the checkout. Python writes bytecode, as on a user's machine;
    otherwise compiling takes a third of each start."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return {**kept, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}


def _mavsdk_version(python: str) -> str:
    """Version of the MAVSDK that `python` can import; empty if there is none."""
    code = "import importlib.metadata as m, mavsdk.asyncio, serial; print(m.version('mavsdk'))"
    try:
        ran = subprocess.run([python, "-c", code], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    return ran.stdout.strip()


def _machine(mavsdk: str) -> dict[str, str]:
    from importlib.metadata import version

    model = platform.processor() or platform.machine()
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith(("model name", "Model")):
            model = line.partition(":")[2].strip()
            break
    return {
        "processor": f"{os.cpu_count()} x {model}",
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "pymavlink": version("pymavlink"),
        "mavsdk": mavsdk or "none",
        "load_before": f"{os.getloadavg()[0]:.2f}",
    }


_COLUMNS = (
    ("p50_ms", "p50", "{:.2f}"),
    ("p95_ms", "p95", "{:.2f}"),
    ("p99_ms", "p99", "{:.2f}"),
    ("max_ms", "max", "{:.2f}"),
    ("cpu_percent", "CPU", "{:.1f}"),
    ("peak_memory_MB", "mem", "{:.0f}"),
    ("import_ms", "import", "{:.0f}"),
)
_UNITS = ("ms", "ms", "ms", "ms", "%", "MB", "ms")


def _show(console: Console, machine: dict[str, str], rows: dict[str, dict[str, float]]) -> None:
    service = rows[SERVICE]
    flips = service["flips"]
    console.print(f"\nFrom the settling RC_CHANNELS to the setpoint on the serial line, {flips:.0f} flips")
    console.print(", ".join(f"{key} {value}" for key, value in machine.items()), highlight=False, style="dim")
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("")
    for _, heading, _ in _COLUMNS:
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_row("", *_UNITS, style="dim")
    for name, row in rows.items():
        table.add_row(name, *(form.format(row[key]) for key, _, form in _COLUMNS))
    table.add_row()
    goals = [f"< {GOALS[key]:g}" if key in GOALS else "" for key, _, _ in _COLUMNS]
    met = [("yes" if service[key] < GOALS[key] else "NO") if key in GOALS else "" for key, _, _ in _COLUMNS]
    table.add_row("goal of the service", *goals)
    table.add_row("met", *met)
    table.add_row()
    for name, row in rows.items():
        if name != SERVICE:
            table.add_row(f"service / {name}", *(f"{service[key] / row[key]:.2f}" for key, _, _ in _COLUMNS))
    console.print(table)
    for name, row in rows.items():
        console.print(
            f"{name}: {row['messages_per_s']:.0f} messages/s, {row['telemetry_per_s']:.0f} telemetry/s; "
            f"flips missed {row['missed']:.0f}, early {row['early']:.0f}, void {row['void']:.0f}; "
            f"memory at the end {row['memory_MB']:.0f} MB; first frame after {row['alive_s']:.2f} s; "
            f"the benchmark's own lateness p50 {row['bench_late_p50_ms']:.2f}, "
            f"p99 {row['bench_late_p99_ms']:.2f}, max {row['bench_late_max_ms']:.1f} ms",
            highlight=False,
            style="dim",
        )
    console.print(
        "CPU: user and system time in % of one core while loaded. mem: the peak, start included. The "
        "peers only write one frame a move: no safety, ramps, repeats, telemetry, estimate or log. The "
        "bare socket decodes nothing: it shows the cost of this machine and this measurement.",
        highlight=False,
        style="dim",
    )


if __name__ == "__main__":
    sys.exit(main())
