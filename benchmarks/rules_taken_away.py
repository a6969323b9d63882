"""Checks that a test fails for each rule of safety that is removed.

    python benchmarks/rules_taken_away.py [--only PART] [--list] [--jobs N]

A rule is an `if` of the functions below (also of a `case`), one side of an `and` or `or`, or an entry of
safety's tables. Each rule is removed in turn, in a copy of the sources, and those tests of its module run
there that execute its lines, the shortest first: one of them must fail. A rule without such a test is
printed and makes the exit status 1. So does a rule for which the tests did not end in time.

This file is also the pytest plugin that records which lines a test executes, and that selects tests.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import Queue
from types import FrameType
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
COPIED = ("flying_vines", "firmware_link", "missions")
LINKED = ("tests", "benchmarks", "pyproject.toml", "docs", "README.md")
LONGEST_S = 1200.0
"""Maximum time for the tests of one rule. A timeout proves nothing, because the machine may be busy."""

RECORD_TO, RUN_ONLY = "RULES_RECORD_TO", "RULES_RUN_ONLY"
"""Environment variables of the plugin: the file to write, and the file with the tests to run."""

CORE_TESTS = (
    "tests/core/test_safety.py",
    "tests/core/test_vine_motion.py",
    "tests/core/test_core_board.py",
    "tests/core/test_board_does_not_follow.py",
    "tests/core/test_core_on_bench.py",
    "tests/core/test_core_spoofed.py",
    "tests/core/test_core_arming.py",
    "tests/core/test_core_late.py",
    "tests/core/test_core_link_loss.py",
    "tests/core/test_core_asked.py",
    "tests/core/test_core_board_settings.py",
    "tests/core/test_core.py",
    "tests/core/test_core_limits.py",
    "tests/core/test_invariants.py",
    "tests/supply/test_physics_checks.py",
    "tests/fault_catalogue/test_in_flight.py",
)
RADIO_TESTS = (
    "tests/vehicle/test_rc.py",
    "tests/vehicle/test_autopilots.py",
    "tests/vehicle/test_radio_parameters.py",
    "tests/vehicle/test_vehicle.py",
    "tests/vehicle/test_switch.py",
    "tests/vehicle/test_pilot.py",
    "tests/fault_catalogue/test_radio_truth.py",
    "tests/simulation/test_replay.py",
)


@dataclass(frozen=True)
class Module:
    """A module with rules, and the tests that must fail. Without functions: the rules of all functions."""

    path: str
    tests: tuple[str, ...]
    functions: tuple[str, ...] = ()
    tables: tuple[str, ...] = ()


MODULES = (
    Module("flying_vines/core/safety.py", CORE_TESTS, tables=("_LOSSES", "_LIMITS")),
    Module("flying_vines/core/asked.py", CORE_TESTS),
    Module("flying_vines/core/request_lines.py", ("tests/core/test_request_lines.py",)),
    Module(
        "flying_vines/core/instability.py",
        ("tests/core/test_instability.py", "tests/core/test_known.py", "tests/core/test_core_board.py"),
    ),
    Module("flying_vines/vehicle/component/texts.py", ("tests/vehicle/test_component.py",), ("say", "due")),
    Module(
        "flying_vines/supply/physics_checks/setpoint.py",
        ("tests/supply/test_physics_checks.py", "tests/core/test_board_does_not_follow.py"),
    ),
    Module("flying_vines/core/board_mode.py", CORE_TESTS),
    Module("flying_vines/core/vine_motion.py", CORE_TESTS),
    Module(
        "flying_vines/core/core.py",
        (*CORE_TESTS, "tests/test_extend.py"),
        (
            *("_decide", "_outdated", "_carry_out_without_air", "_hold", "_clear_faults"),
            *("_on_firmware_link", "_note_rc_use", "_conditions", "_enter", "_leave", "_drive"),
            "_check_board_settings",
        ),
    ),
    Module("flying_vines/vehicle/radio/pilot.py", RADIO_TESTS),
    Module("flying_vines/vehicle/autopilots/ardupilot.py", RADIO_TESTS, ("hides_rc_loss",)),
    Module("flying_vines/vehicle/autopilots/px4.py", RADIO_TESTS, ("hides_rc_loss",)),
    Module(
        "flying_vines/vehicle/commands.py",
        ("tests/vehicle/test_commands.py", "tests/vehicle/test_vehicle.py", *CORE_TESTS),
        ("handle", "_only_deflates"),
    ),
    Module(
        "flying_vines/vehicle/component/senders.py",
        (
            "tests/core/test_core_senders.py",
            "tests/core/test_core_limits.py",
            "tests/vehicle/test_component.py",
            "tests/vehicle/test_manners.py",
        ),
        ("refusal", "of", "_is_station"),
    ),
    Module(
        "flying_vines/vehicle/component/parameters.py",
        ("tests/vehicle/test_parameters.py", "tests/core/test_core_senders.py"),
        ("_set", "unbounded_changes"),
    ),
    Module(
        "flying_vines/vehicle/component/requests.py",
        ("tests/vehicle/test_requests.py", "tests/core/test_core_senders.py"),
        ("_set_interval",),
    ),
    Module(
        "flying_vines/vehicle/component/telemetry.py",
        ("tests/vehicle/test_requests.py", "tests/core/test_core_senders.py"),
        ("period_s",),
    ),
    Module(
        "flying_vines/vehicle/state.py",
        ("tests/vehicle/test_arm_state.py", "tests/vehicle/test_state.py", "tests/core/test_core_spoofed.py"),
        ("altitude_m", "_note_altitude", "stamp", "handle", "armed_s", "in_conflict"),
    ),
    Module(
        "flying_vines/config/config.py",
        ("tests/config/test_config.py", "tests/vehicle/test_parameters.py"),
        ("channel_problem", "_taken"),
    ),
    Module("flying_vines/config/address.py", ("tests/config/test_config.py",), ("same_port",)),
    Module(
        "flying_vines/vehicle/clock.py",
        (
            "tests/vehicle/test_clock.py",
            "tests/vehicle/test_requests.py",
            "tests/core/test_core_late.py",
            "tests/fault_catalogue/test_radio_truth.py",
        ),
    ),
)


@dataclass(frozen=True)
class Rule:
    """A piece of source, and its replacement without the rule."""

    module: Module
    function: str
    line: int
    begins: int
    ends: int
    text: str
    instead: str

    def __str__(self) -> str:
        text = " ".join(self.text.split())
        shown = text if len(text) <= 90 else text[:87] + "..."
        return f"{self.module.path}:{self.line} {self.function}: {shown} -> {self.instead}"

    def taken_away(self, source: str) -> str:
        """The source without the rule. Offsets count bytes, as in `ast`."""
        raw = source.encode()
        return (raw[: self.begins] + self.instead.encode() + raw[self.ends :]).decode()


def rules_of(module: Module) -> list[Rule]:
    """The rules, in the order of the source. Raises `LookupError` if the module lacks a function or table."""
    source = (ROOT / module.path).read_text(encoding="utf-8")
    lines = [0]
    for line in source.encode().splitlines(keepends=True):
        lines.append(lines[-1] + len(line))

    def rule(node: ast.expr, function: str, instead: str) -> Rule:
        assert node.end_lineno is not None and node.end_col_offset is not None
        begins = lines[node.lineno - 1] + node.col_offset
        ends = lines[node.end_lineno - 1] + node.end_col_offset
        text = source.encode()[begins:ends].decode()
        return Rule(module, function, node.lineno, begins, ends, text, instead)

    found = []
    missing = {*module.functions, *module.tables}
    tree = ast.parse(source)
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef) and (
            not module.functions or function.name in module.functions
        ):
            missing.discard(function.name)
            found += [rule(node, function.name, instead) for node, instead in _conditions(function)]
    for table in tree.body:
        if isinstance(table, ast.AnnAssign) and isinstance(table.value, ast.Dict):
            name = ast.unparse(table.target)
            if name in module.tables:
                missing.discard(name)
                found += [rule(value, name, "(lambda *_: None)") for value in table.value.values]
    if missing:
        raise LookupError(f"{module.path} has no {', '.join(sorted(missing))}")
    return sorted(set(found), key=lambda rule: (rule.begins, rule.ends))


def _conditions(function: ast.FunctionDef) -> Iterator[tuple[ast.expr, str]]:
    for node in ast.walk(function):
        if isinstance(node, ast.If):
            yield node.test, "False"
        if isinstance(node, ast.match_case) and node.guard is not None:
            yield node.guard, "False"
        if isinstance(node, ast.BoolOp):
            neutral = "True" if isinstance(node.op, ast.And) else "False"
            for value in node.values:
                if not (isinstance(value, ast.Constant) and not value.value):
                    yield value, neutral


@dataclass(frozen=True)
class Executed:
    """What a test executes: of each module with rules, the lines."""

    test: str
    duration_s: float
    lines: dict[str, frozenset[int]]


class _Recorder:
    """Writes a line of JSON a test to a file: its name, its duration and the lines that it executed."""

    def __init__(self, to: Path) -> None:
        self._to = to
        self._lines: dict[str, set[int]] = defaultdict(set)
        paths = {module.path for module in MODULES}
        self._recorded = {str(Path(entry, path)): path for entry in sys.path for path in paths}

    def _call(self, frame: FrameType, _event: str, _arg: object) -> Any:
        path = self._recorded.get(frame.f_code.co_filename)
        if path is None:
            return None
        lines = self._lines[path]

        def line(frame: FrameType, _event: str, _arg: object) -> Any:
            lines.add(frame.f_lineno)
            return line

        return line

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        self._lines.clear()
        began_s = time.perf_counter()
        sys.settrace(self._call)
        yield
        sys.settrace(None)
        lines = {path: sorted(lines) for path, lines in self._lines.items()}
        with self._to.open("a", encoding="utf-8") as out:
            out.write(json.dumps([item.nodeid, time.perf_counter() - began_s, lines]) + "\n")


class _Selection:
    """Runs only the tests of a list, in its order."""

    def __init__(self, tests: list[str]) -> None:
        self._place = {test: place for place, test in enumerate(tests)}

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = sorted(
            (item for item in items if item.nodeid in self._place),
            key=lambda item: self._place[item.nodeid],
        )


def pytest_configure(config: pytest.Config) -> None:
    if to := os.environ.get(RECORD_TO):
        config.pluginmanager.register(_Recorder(Path(to)))
    if tests := os.environ.get(RUN_ONLY):
        config.pluginmanager.register(_Selection(json.loads(Path(tests).read_text(encoding="utf-8"))))


def _run_tests(room: Path, files: list[str], variable: str, value: Path) -> int | None:
    """The exit status of pytest in `room`, with the plugin; None if the tests did not end."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-p", "rules_taken_away"]
    python_path = os.pathsep.join((str(room), str(room / "benchmarks")))
    env = {**os.environ, "PYTHONPATH": python_path, "PYTHONDONTWRITEBYTECODE": "1", variable: str(value)}
    try:
        done = subprocess.run([*command, *files], cwd=room, env=env, capture_output=True, timeout=LONGEST_S)
    except subprocess.TimeoutExpired:
        return None
    if done.returncode not in (0, 1, 2):
        raise SystemExit(f"the tests did not run:\n{done.stdout.decode()[-2000:]}")
    return done.returncode


def executed_by_tests(file: str, room: Path) -> list[Executed]:
    """What each test of a file executes. Raises `SystemExit` if one fails: then no rule can be judged."""
    record = room / f"{file.replace('/', '-')}.jsonl"
    if _run_tests(room, [file], RECORD_TO, record) != 0:
        raise SystemExit(f"{file} fails although no rule is removed")
    found = []
    for text in record.read_text(encoding="utf-8").splitlines():
        test, duration_s, lines = json.loads(text)
        found.append(Executed(test, duration_s, {path: frozenset(of) for path, of in lines.items()}))
    return found


def tests_of(rule: Rule, executed: dict[str, list[Executed]]) -> list[str]:
    """The tests that execute a rule, the shortest first; all tests of its module for an entry of a table."""
    of_module = [test for file in rule.module.tests for test in executed[file]]
    if rule.function not in rule.module.tables:
        lines = frozenset(range(rule.line, rule.line + rule.text.count("\n") + 1))
        of_module = [test for test in of_module if test.lines.get(rule.module.path, lines - lines) & lines]
    return [test.test for test in sorted(of_module, key=lambda test: test.duration_s)]


def is_caught(rule: Rule, tests: list[str], room: Path) -> bool | None:
    """True if a test fails without the rule; None if the tests did not end.

    `room` holds a copy of the sources that no other run uses now.
    """
    if not tests:
        return False
    place = room / rule.module.path
    source = place.read_text(encoding="utf-8")
    selection = room / "selection.json"
    selection.write_text(json.dumps(tests), encoding="utf-8")
    place.write_text(rule.taken_away(source), encoding="utf-8")
    try:
        status = _run_tests(room, sorted({test.partition("::")[0] for test in tests}), RUN_ONLY, selection)
    finally:
        place.write_text(source, encoding="utf-8")
    return None if status is None else status != 0


def make_room(parent: Path, number: int) -> Path:
    """A copy of the packages with rules, beside the unchanged tests."""
    room = parent / str(number)
    room.mkdir()
    for name in COPIED:
        shutil.copytree(ROOT / name, room / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in LINKED:
        (room / name).symlink_to(ROOT / name)
    return room


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", default="", help="only rules whose line in the list contains this")
    parser.add_argument("--list", action="store_true", help="list the rules, and run nothing")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    args = parser.parse_args()
    rules = [rule for module in MODULES for rule in rules_of(module) if args.only in str(rule)]
    if args.list:
        print(*rules, sep="\n")
        return 0
    survivors: list[Rule] = []
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory() as parent:
        rooms: Queue[Path] = Queue()
        for number in range(args.jobs):
            rooms.put(make_room(Path(parent), number))

        def record(file: str) -> list[Executed]:
            room = rooms.get()
            try:
                return executed_by_tests(file, room)
            finally:
                rooms.put(room)

        def take_away(rule: Rule) -> None:
            room = rooms.get()
            try:
                caught = is_caught(rule, tests_of(rule, executed), room)
            finally:
                rooms.put(room)
            verdict = "NO END" if caught is None else "caught" if caught else "NOT CAUGHT"
            print(f"{verdict}  {rule}", flush=True)
            if not caught:
                survivors.append(rule)

        with ThreadPoolExecutor(args.jobs) as pool:
            files = sorted({file for rule in rules for file in rule.module.tests})
            executed = dict(zip(files, pool.map(record, files), strict=True))
            list(pool.map(take_away, rules))
    minutes = (time.monotonic() - began_s) / 60.0
    print(f"{len(rules)} rules taken away, {len(rules) - len(survivors)} caught, in {minutes:.0f} min")
    for rule in survivors:
        print(f"not caught: {rule}")
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
