"""Plugins from installed packages, and `examples/our_lab`, which has one of each kind."""

from __future__ import annotations

import asyncio
import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from command_line import run as call
from core.flights import decisions, notices, run_for
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from real_time import real_time
from service_bench import Bench, on_bench
from waiting import until

from firmware_link import protocol
from firmware_link.actuator import Reading
from firmware_link.conformance import broken_promises
from flying_vines.config import config
from flying_vines.config.config import Config, ConfigError, TriggerConfig
from flying_vines.config.plugins import PluginError
from flying_vines.core.core import Core
from flying_vines.core.events import Action, InternalError, VehicleMessage
from flying_vines.doctor import vehicle
from flying_vines.doctor.vehicle_probe import VehicleProbe
from flying_vines.service.service import Service, line_to
from flying_vines.simulation.autopilot import AutopilotKind, FakeAutopilot
from flying_vines.simulation.autopilot.links import COMPANION
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.triggers import own_triggers
from flying_vines.vine.profile import Sine, flatten

ROOT = Path(__file__).parents[1]
LAB = ROOT / "examples" / "our_lab"
DEFAULT_TEXT = config.default_text()
PUMP = DEFAULT_TEXT.replace('kind = "phlosar"', 'kind = "air_pump"')


def install(folder: Path, name: str, points: dict[str, dict[str, str]]) -> None:
    """Write what an installer leaves of a package: its entry points."""
    info = folder / f"{name}-0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0\n", encoding="utf-8")
    text = ""
    for group, entries in points.items():
        text += f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in entries.items())
    (info / "entry_points.txt").write_text(text, encoding="utf-8")


@pytest.fixture
def our_lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    project = tomllib.loads((LAB / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    install(tmp_path, "our_lab", project["entry-points"])
    for folder in (tmp_path, LAB, LAB / "tests"):
        monkeypatch.syspath_prepend(folder)
    yield
    for name in [name for name in sys.modules if name.partition(".")[0] in ("our_lab", "model_of_board")]:
        del sys.modules[name]


Install = Callable[[str, str], None]


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Install a package of one module with one part, `Part`, as `broken` in a group."""
    monkeypatch.syspath_prepend(tmp_path)

    def install_one(group: str, source: str) -> None:
        (tmp_path / "broken_lab.py").write_text(source, encoding="utf-8")
        install(tmp_path, "broken_lab", {f"flying_vines.{group}": {"broken": "broken_lab:Part"}})

    yield install_one
    sys.modules.pop("broken_lab", None)


class Bridge:
    """The air pump's board with its line, instead of the simulated phloSAR."""

    def __init__(self, conf: Config) -> None:
        from model_of_board import Board

        self.board: Any = Board()
        self.cut = False
        self._line = line_to(conf.firmware)
        self._theirs = protocol.Codec()

    def receive(self, data: bytes) -> None:
        for message in self._theirs.decode(data):
            told = self._line.encode(message)  # type: ignore[arg-type]
            if not self.cut:
                self.board.receive(told)

    def advance(self, t: float) -> bytes:
        messages = self._line.decode(t, self.board.advance(t))
        return b"".join(map(self._theirs.encode, messages))


def flown(text: str) -> tuple[SimulatedFlight, Any]:
    """A flight at 10 m with the air pump, RC good, switch low, after 8 s."""
    conf = config.parse(text, "p.toml")
    autopilot = FakeAutopilot("ardupilot", rc_failsafe_mode=None)
    bridge: Any = Bridge(conf)
    flight = SimulatedFlight(conf, autopilot, bridge)
    autopilot.set_rc(9, 1000)
    flight.run(2.0)
    autopilot.takeoff(10.0)
    flight.run(8.0)
    return flight, bridge


def bent(text: str = PUMP) -> tuple[SimulatedFlight, Any, list[Action]]:
    flight, bridge = flown(text)
    flight.autopilot.set_rc(9, 2000)
    actions = run_for(flight, 3.0)
    assert [decision.safety for decision in decisions(actions)] == ["accepted"]
    assert bridge.board.pressure_kPa == pytest.approx(20.7, abs=1.0)
    return flight, bridge, actions


# The actuator.


def test_an_air_pump_bends_the_vine_and_has_no_air_to_count(our_lab: None) -> None:
    flight, bridge, actions = bent()
    state = flight.core.snapshot(flight.world.now)
    assert (state.firmware, state.cycles, state.safe_state) == ("ready", None, {})
    assert state.reservoir_kPa != state.reservoir_kPa  # NaN
    assert notices(actions) == []
    flight.autopilot.set_rc(9, 1000)
    run_for(flight, 3.0)
    assert bridge.board.pressure_kPa == 0.0


def test_each_loss_vents_an_air_pump(our_lab: None) -> None:
    flight, bridge, _ = bent()
    flight.autopilot.lose_rc("frozen")
    run_for(flight, 3.0)
    assert bridge.board.pressure_kPa == 0.0
    assert "rc" in flight.core.snapshot(flight.world.now).safe_state


def test_a_broken_wire_to_the_air_pump_is_found_by_what_the_pump_reports(our_lab: None) -> None:
    flight, bridge, _ = bent()
    bridge.cut = True
    told = notices(run_for(flight, 2.0))
    assert bridge.board.pressure_kPa == 0.0
    assert "Vine: air_pump gets no commands, vented" in told


def test_an_air_pump_that_does_not_straighten_the_vine_is_vented_and_the_pilot_reads_it(
    our_lab: None,
) -> None:
    flight, bridge, _ = bent()
    received, advance = bridge.board.receive, bridge.board.advance
    bridge.board.receive = lambda data: received(data.replace(b"D", b"H"))
    bridge.board.advance = lambda t: advance(t) and b"\n20.70 A\n"
    flight.autopilot.set_rc(9, 1000)
    told = notices(run_for(flight, 12.0))
    assert bridge.board.pressure_kPa == 0.0
    assert "Vine: still at 20.7 kPa, vent commanded" in told
    assert "Vine: air_pump does not vent, vent commanded" in told


def test_the_example_meets_the_requirements_of_an_actuator(our_lab: None) -> None:
    from model_of_board import Board
    from our_lab.air_pump import AirPump

    assert broken_promises(AirPump, Board) == []


def _forgetful(self: Any, data: bytes) -> Sequence[Reading]:
    return [
        Reading(float(line.split()[0]), b"V" in line) for line in data.split(b"\n") if len(line.split()) == 2
    ]


def _strict(self: Any, data: bytes) -> Sequence[Reading]:
    return [Reading(float(line.split()[0]), b"V" in line) for line in data.strip().split(b"\n")]


@pytest.mark.parametrize(
    ("what", "attributes", "says"),
    [
        ("pump", {"vent": b"H\n"}, "the vent command does not vent it"),
        ("pump", {"vent": b"V\n"}, "after the first 1 bytes of a setpoint"),
        ("pump", {"vent": b""}, "cannot be used: vent is empty"),
        ("pump", {"dead_man_ms": 1000}, "cannot be used: dead_man_ms is 1000"),
        ("pump", {"readings": lambda self, data: [Reading(0.0, True)]}, "does not reach max_kPa"),
        ("pump", {"readings": lambda self, data: []}, "sends no reading within 2 s"),
        ("pump", {"readings": _forgetful}, "readings differ if their bytes come one by one"),
        ("pump", {"readings": _strict}, "readings raises"),
        ("pump", {"setpoint": lambda self, kPa: b"I\n"}, "it reaches"),
        ("board", {"advance": lambda self, t: b"\n0.00 A\n0.00 A\n"}, "is vented after power-up"),
        ("board", {"dead_man_s": 1e9}, "does not vent when no message comes"),
    ],
)
def test_each_violated_requirement_is_found(
    our_lab: None, monkeypatch: pytest.MonkeyPatch, what: str, attributes: dict[str, Any], says: str
) -> None:
    import model_of_board
    from model_of_board import Board
    from our_lab.air_pump import AirPump

    if "dead_man_s" in attributes:
        monkeypatch.setattr(model_of_board, "DEAD_MAN_S", attributes["dead_man_s"])
    pump = type("Changed", (AirPump,), attributes) if what == "pump" else AirPump
    board = type("Changed", (Board,), attributes) if what == "board" else Board
    assert any(says in sentence for sentence in broken_promises(pump, board)), broken_promises(pump, board)


def test_an_actuator_whose_setpoint_fails_vents(our_lab: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """The package's `line` raises. The service then writes `vent`, which needs no code of the package."""
    conf = config.parse(PUMP, "p.toml")
    line = line_to(conf.firmware)
    from our_lab.air_pump import AirPump

    monkeypatch.setattr(AirPump, "setpoint", lambda self, kPa: 5)
    with pytest.raises(TypeError):
        line.encode(protocol.Setpoint(5.0, 1.0, 250, 1))
    assert line.encode(protocol.Vent(2)) == line.vent == b"\nV\n"


@pytest.fixture
async def on_pump(our_lab: None, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Bench]:
    from model_of_board import Board

    class AtPort(Board):
        """The board at the pseudo-terminal of the bench."""

        now_s = 0.0

        def advance(self, t: float) -> bytes:
            self.now_s = t
            sent: bytes = super().advance(t)
            return sent

        @property
        def cv_kPa(self) -> float:
            return float(self.pressure_kPa)

    monkeypatch.setattr("service_bench.SimulatedPhlosar", AtPort)
    async with on_bench(FakeAutopilot("ardupilot")) as bench:
        bench.configuration = bench.configuration.replace('kind = "phlosar"', 'kind = "air_pump"')
        yield bench


@real_time
@pytest.mark.long
async def test_the_service_drives_an_air_pump_on_a_real_port(on_pump: Bench) -> None:
    service = Service(config.parse(on_pump.configuration, "test"))
    serving = asyncio.create_task(service.run())
    await on_pump.bend()
    service.stop()
    await serving
    await until(lambda: on_pump.phlosar.cv_kPa == 0.0, "a stopped service has vented")


@real_time
@pytest.mark.long
async def test_an_error_of_an_actuator_vents_and_the_service_goes_on(
    on_pump: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    service = Service(config.parse(on_pump.configuration, "test"))
    serving = asyncio.create_task(service.run())
    await on_pump.bend()
    from our_lab.air_pump import AirPump

    def broken(self: object, kPa: float) -> bytes:
        raise ZeroDivisionError

    monkeypatch.setattr(AirPump, "setpoint", broken)
    await until(lambda: on_pump.phlosar.cv_kPa == 0.0, "the vine is vented")
    assert service.core.snapshot(service.now).safe_state.keys() == {"internal_error"}
    assert not serving.done()
    service.stop()
    await serving


# Names.


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        (
            ('kind = "phlosar"', 'kind = "pump"'),
            "firmware.kind: no installed package has 'pump' in flying_vines.actuators; installed: air_pump",
        ),
        (("settings = {}", "settings = { volts = 3 }"), "firmware.kind: our_lab.air_pump:AirPump"),
        (("own = {}", 'own = { gone = "warn" }'), "checks.own.gone: no installed package has 'gone'"),
        (("own = {}", 'own = { filling = "warn" }'), "checks.own.filling: the name filling is taken"),
        (
            ("[switch]", '[[triggers]]\nkind = "quake"\nprofile = "straight"\n[switch]'),
            "triggers[0].kind: no",
        ),
        (
            ('{ kind = "ramp", to_deg = 0, over_s = 1.5 }', '{ kind = "chrip" }'),
            "not 'chrip'; installed packages have chirp",
        ),
        (
            ('{ kind = "ramp", to_deg = 0, over_s = 1.5 }', '{ kind = "chirp" }'),
            "segments: our_lab.chirp:chirp",
        ),
    ],
)
def test_a_part_that_cannot_be_used_is_one_line(
    our_lab: None, tmp_path: Path, capsys: pytest.CaptureFixture[str], changed: tuple[str, str], says: str
) -> None:
    text = PUMP if "volts" in changed[1] else DEFAULT_TEXT
    assert changed[0] in text
    (tmp_path / "p.toml").write_text(text.replace(changed[0], changed[1], 1), encoding="utf-8")
    status, _, error = call(capsys, "run", "--config", tmp_path / "p.toml", "--out", tmp_path / "flights")
    assert (status, error.count("\n")) == (2, 1)
    assert says in error
    assert not (tmp_path / "flights").exists()


@pytest.mark.parametrize("command", [["config", "check"], ["doctor", "--config"]])
def test_a_missing_package_is_reported_before_a_flight(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: list[str]
) -> None:
    (tmp_path / "p.toml").write_text(PUMP, encoding="utf-8")
    status, out, error = call(capsys, *command, tmp_path / "p.toml")
    assert (status, out) == (2, "")
    assert "no installed package has 'air_pump' in flying_vines.actuators; installed: none" in error


def test_no_package_is_searched_for_a_configuration_without_own_parts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def search(**_: object) -> None:
        raise AssertionError("searched")

    monkeypatch.setattr("importlib.metadata.entry_points", search)
    conf = config.parse(DEFAULT_TEXT, "p.toml")
    Core(conf)
    line_to(conf.firmware)


def test_calibrate_and_link_send_nothing_to_another_device(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "p.toml").write_text(PUMP, encoding="utf-8")
    for command in (["link"], ["calibrate", "--yes"]):
        status, _, error = call(capsys, *command, "--config", tmp_path / "p.toml")
        assert (status, error) == (
            2,
            f"flying-vines: {command[0]} needs a phloSAR; firmware.kind is 'air_pump'\n",
        )


# The segment.

CHIRP = '{ kind = "chirp", from_kPa = 0, to_kPa = 15, from_Hz = 0.1, to_Hz = 0.4, cycles = 3 }'


def test_a_segment_becomes_built_in_segments(our_lab: None) -> None:
    steps = "{ kind = 'step', to_kPa = 1 }", "{ kind = 'step', to_kPa = 2 }"
    conf = config.parse(
        f"{DEFAULT_TEXT}\n[profiles.chirped]\nsegments = [{steps[0]}, {CHIRP}, {steps[1]}]\n", "p.toml"
    )
    segments = list(flatten(conf.profiles, "chirped"))
    assert [getattr(segment, "to_kPa", None) for segment in segments] == [1, 15, 15, 15, 2]
    assert [segment.frequency_Hz for segment in segments if isinstance(segment, Sine)] == [0.1, 0.2, 0.4]


def test_a_segment_keeps_the_limits_of_the_configuration(our_lab: None) -> None:
    wild = CHIRP.replace("to_kPa = 15", "to_kPa = 99")
    with pytest.raises(ConfigError, match=r"profiles\.chirped: 99 kPa is outside"):
        config.parse(f"{DEFAULT_TEXT}\n[profiles.chirped]\nsegments = [{wild}]\n", "p.toml")


@pytest.mark.parametrize(
    ("returned", "says"),
    [("5", "TypeError"), ("[5]", "does not return segments"), ("[]", "returns 0 segments")],
)
def test_a_segment_must_return_segments(installed: Install, returned: str, says: str) -> None:
    installed("segments", f"def Part():\n    return {returned}\n")
    with pytest.raises(ConfigError, match=says if says != "TypeError" else "not iterable"):
        config.parse(DEFAULT_TEXT + '\n[profiles.x]\nsegments = [{ kind = "broken" }]\n', "p.toml")


# The trigger.

GUST = PUMP.replace("[switch]", '[[triggers]]\nkind = "gust"\nprofile = "bend-half"\n\n[switch]', 1)


def attitude(flight: SimulatedFlight, roll_deg: float, system_id: int = 1) -> list[Action]:
    boot_ms = flight.core._vehicle.state.time_boot_ms(flight.world.now)
    message = mavlink.MAVLink_attitude_message(boot_ms, roll_deg / 57.3, 0.0, 0.0, 0.0, 0.0, 0.0)
    (read,) = MavlinkCodec(1, 191).decode(MavlinkCodec(system_id, 1).encode(message, system_id))
    return flight.feed(VehicleMessage(flight.world.now, read))


def test_a_trigger_starts_its_profile_once_when_its_condition_begins(our_lab: None) -> None:
    flight, bridge = flown(GUST)
    (decision,) = decisions(attitude(flight, 30.0))
    assert (decision.trigger, decision.intent, decision.safety) == ("trigger", "bend-half", "accepted")
    assert decision.what == {"name": "gust", "message": "ATTITUDE"}
    assert decisions(attitude(flight, 40.0)) == []
    run_for(flight, 2.0)
    assert bridge.board.pressure_kPa > 5.0


def test_a_trigger_is_refused_like_every_other(our_lab: None) -> None:
    conf = config.parse(GUST, "p.toml")
    flight = SimulatedFlight(conf, FakeAutopilot("ardupilot"), Bridge(conf))  # type: ignore[arg-type]
    flight.run(4.0)
    attitude(flight, 0.0)
    (decision,) = decisions(attitude(flight, 30.0))
    assert (decision.safety, decision.reason) == ("refused", "not armed")


def test_a_condition_that_holds_already_moves_nothing(our_lab: None) -> None:
    (trigger,) = own_triggers((TriggerConfig("gust", "straight"),))
    calm, gust = (mavlink.MAVLink_attitude_message(0, roll, 0.0, 0.0, 0.0, 0.0, 0.0) for roll in (0.0, 1.0))
    stream = [
        (0.0, gust),
        (0.2, gust),
        (0.4, calm),
        (0.6, gust),
        (0.8, calm),
        (4.0, gust),
        (4.2, calm),
        (4.4, gust),
    ]
    assert [t for t, message in stream if trigger.take(t, message)] == [0.6, 4.4]


def test_a_trigger_sees_only_our_autopilot(our_lab: None) -> None:
    flight, _ = flown(GUST)
    assert decisions(attitude(flight, 30.0, system_id=7)) == []


@pytest.mark.parametrize("fails", ["1 / 0", "exit(1)"])
def test_a_trigger_that_fails_is_switched_off_and_the_flight_continues(
    installed: Install, our_lab: None, fails: str
) -> None:
    part = f"class Part:\n    messages = ('ATTITUDE',)\n    def holds(self, t, m): return {fails}\n"
    installed("triggers", part)
    flight, _, _ = bent(GUST.replace('"gust"', '"broken"'))
    assert not flight.core.internal_error
    assert decisions(attitude(flight, 30.0)) == []


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_the_doctor_requests_the_messages_of_triggers(our_lab: None, kind: AutopilotKind) -> None:
    conf = config.parse(GUST, "p.toml")
    autopilot, probe, codec = FakeAutopilot(kind), VehicleProbe(conf), MavlinkCodec(1, 191)
    for tick in range(160):
        t = 0.05 * tick
        for link, frame in autopilot.advance(t):
            for message in codec.decode(frame) if link == COMPANION else ():
                probe.take(t, t, message)
        for message in probe.due(t):
            autopilot.receive(t, COMPANION, codec.encode(message, 1))
    facts = probe.facts(8.0)
    (stream,) = (stream for stream in facts.streams if stream.name == "ATTITUDE")
    assert stream.rate_Hz > 4.0
    missing = replace(facts, streams=(replace(stream, rate_Hz=0.0),))
    (finding,) = (found for found in vehicle.check(missing, conf, 8.0) if found.check == "ATTITUDE")
    assert (finding.verdict, finding.what) == ("warning", "does not arrive; used for [[triggers]]")
    assert "ATTITUDE" in finding.do


# The check.


@pytest.mark.parametrize(("level", "vents"), [("warn", False), ("fault", True)])
def test_a_check_finds_a_stuck_vine(our_lab: None, level: str, vents: bool) -> None:
    flight, bridge = flown(PUMP.replace("own = {}", f'own = {{ stuck = "{level}" }}'))
    bridge.board.receive = lambda data: type(bridge.board).receive(bridge.board, data.replace(b"I", b"H"))
    flight.autopilot.set_rc(9, 2000)
    actions = run_for(flight, 5.0)
    assert any("vine stays at 0 kPa" in text for text in notices(actions))
    state = flight.core.snapshot(flight.world.now)
    assert ("stuck" in str(state.safe_state) or "stays" in str(state.safe_state)) is vents
    assert state.findings["stuck"] >= 1


def test_a_check_finds_nothing_in_a_good_flight(our_lab: None) -> None:
    flight, _, actions = bent(PUMP.replace("own = {}", 'own = { stuck = "fault" }'))
    assert notices(actions) == []
    assert flight.core.snapshot(flight.world.now).findings == {}


@pytest.mark.parametrize("fails", ["1 / 0", "exit(1)"])
@pytest.mark.parametrize(("level", "needed"), [("warn", False), ("fault", True)])
def test_a_check_that_fails_vents_if_the_vine_needs_it(
    installed: Install, our_lab: None, level: str, needed: bool, fails: str
) -> None:
    part = f"class Part:\n    def __init__(self, rig): pass\n    def look(self, now): return {fails}\n"
    installed("checks", part)
    conf = config.parse(PUMP.replace("own = {}", f'own = {{ broken = "{level}" }}'), "p.toml")
    flight = SimulatedFlight(conf, FakeAutopilot("ardupilot"), Bridge(conf))  # type: ignore[arg-type]
    actions = flight.run(3.0)
    assert [action.part for action in actions if isinstance(action, InternalError)] == ["check broken"]
    assert flight.core.internal_error is needed


def test_a_check_without_look_is_reported_at_the_start(installed: Install) -> None:
    installed("checks", "class Part:\n    def __init__(self, rig): pass\n")
    conf = config.parse(DEFAULT_TEXT.replace("own = {}", 'own = { broken = "warn" }'), "p.toml")
    with pytest.raises(PluginError, match=r"broken_lab:Part of package broken_lab has no look"):
        Core(conf)


# The package.


@pytest.mark.long
def test_the_example_as_an_installed_package(tmp_path: Path) -> None:
    source = shutil.copytree(LAB, tmp_path / "our_lab", ignore=shutil.ignore_patterns("__pycache__"))
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--no-index", "--target", tmp_path / "site", source], check=True, timeout=120)
    path = os.pathsep.join([str(tmp_path / "site"), str(ROOT), str(source / "tests")])
    environment = {**os.environ, "PYTHONPATH": path}
    tests = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests"]
    subprocess.run(tests, cwd=source, env=environment, check=True, timeout=120)
    (tmp_path / "p.toml").write_text(
        f"{DEFAULT_TEXT}\n[profiles.chirped]\nsegments = [{CHIRP}]\n", encoding="utf-8"
    )
    shown = subprocess.run(
        [sys.executable, "-m", "flying_vines", "config", "check", tmp_path / "p.toml"],
        env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert shown.returncode == 0, shown.stderr
