"""The core gives the answers of a recorded flight again, and differences are reported."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import command_line
import msgspec
import pytest
from recorded_flight import BEGAN, CONFIG, HIGH, LOW, fly, new_flight, one_bend

from flying_vines.config import config
from flying_vines.core.core import Core
from flying_vines.core.crash_safe_core import CrashSafeCore
from flying_vines.core.events import Asked, Decision, InternalError, StoredState
from flying_vines.physics.plant.true_rig import TrueRig, true_rig_text
from flying_vines.physics.rig import Rig
from flying_vines.record.folders import MCAP
from flying_vines.record.mcap_file import McapFile
from flying_vines.record.reader import FlightLog, LogEntry, LogError, start_of
from flying_vines.record.recorder import Recorder
from flying_vines.record.topics import NUMBERS, TOPICS, topic_of
from flying_vines.simulation.replay import replay_flight
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.supply import Features, ReservoirEstimate
from flying_vines.supply.rig_file_prior import load_rig_file_prior
from flying_vines.vine.intent import BendTo


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return one_bend(tmp_path_factory.mktemp("flown"))


def rewritten(log: Path, folder: Path, change: Callable[[LogEntry], bytes]) -> Path:
    folder.mkdir()
    with (folder / MCAP).open("wb") as file:
        mcap = McapFile(file, TOPICS, "test")
        for entry in FlightLog(log).entries():
            mcap.add(NUMBERS[entry.topic], entry.unix_ns, change(entry))
        mcap.finish()
    return folder


def test_a_flight_comes_out_the_same_again(flown: Path) -> None:
    again = replay_flight(FlightLog(flown))
    assert not again.differences and not again.damage
    assert [(d.intent, d.safety) for d in again.decisions] == [
        ("bend-full", "accepted"),
        ("straight", "accepted"),
    ]
    recorded = [entry for entry in FlightLog(flown).entries() if entry.topic in again.compared]
    assert again.compared.total() == len(recorded)
    assert {"decision", "notice", "mavlink/out", "phlosar/setpoint", "phlosar/vent"} <= again.compared.keys()


@pytest.mark.parametrize(
    ("kept", "reason", "written", "forgotten"),
    [
        ({"disarmed": True}, "the pneumatics are disarmed", b'"disarmed":true', b'"disarmed":false'),
        ({"latched": {"filling": "not filling"}}, "not filling", b'{"filling":"not filling"}', b"{}"),
    ],
    ids=["disarmed", "latched"],
)
def test_all_that_the_core_began_with_counts(
    tmp_path: Path, kept: dict[str, Any], reason: str, written: bytes, forgotten: bytes
) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(true_rig_text(TrueRig(Rig(), {"cv_leak": {"flow_resistance_kPa_s_per_SL": 8000.0}})))
    prior = load_rig_file_prior(rig, CONFIG.pneumatics).prior
    stored = StoredState({"VINE_RATE_HZ": 5.0}, **kept)
    began = replace(BEGAN, pneumatics=prior.pneumatics, rig=rig.read_text(), stored=stored)
    flight = new_flight()
    flight.world.core = Core(CONFIG, (), prior, stored)
    recorder = Recorder(tmp_path / "flights", began, t=0.0)
    fly(flight, recorder, ((3.0, LOW), (5.0, HIGH), (6.0, LOW)))
    recorder.close()
    again = replay_flight(FlightLog(recorder.folder))
    assert not again.differences and again.compared.total() > 300
    assert {d.reason for d in again.decisions if d.safety == "refused"} == {reason}

    def without(entry: LogEntry) -> bytes:
        return entry.data.replace(written, forgotten)

    forgot = replay_flight(FlightLog(rewritten(recorder.folder, tmp_path / "forgot", without)))
    assert forgot.differences


def test_a_log_from_before_faults_were_stored_comes_out_the_same(flown: Path, tmp_path: Path) -> None:
    def without(entry: LogEntry) -> bytes:
        return entry.data.replace(b',"latched":{}', b"")

    old = FlightLog(rewritten(flown, tmp_path / "old", without))
    assert start_of(old).latched is None
    assert not replay_flight(old).differences


def test_requests_of_a_page_are_replayed(tmp_path: Path) -> None:
    flight, recorder = new_flight(), Recorder(tmp_path, BEGAN, t=0.0)
    fly(flight, recorder, ((3.0, LOW),))
    actions = flight.core.handle(Asked(3.0, "page", BendTo(33.3)))
    fly_on(flight, recorder, 5.0)
    recorder.close()
    (asked,) = (action for action in actions if isinstance(action, Decision))
    again = replay_flight(FlightLog(recorder.folder))
    assert again.decisions == [asked] and asked.intent == "bend 33.3°" and not again.differences


def test_a_shutdown_is_in_the_log_and_comes_out_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    update = ReservoirEstimate.update

    def failing(estimate: ReservoirEstimate, features: Features) -> None:
        if features.t > 4.0:
            raise RuntimeError("unexpected")
        update(estimate, features)

    monkeypatch.setattr(ReservoirEstimate, "update", failing)
    flight, recorder = new_flight(), Recorder(tmp_path, BEGAN, t=0.0)
    flight.world.core = CrashSafeCore(flight.core)  # type: ignore[assignment]
    fly(flight, recorder, ((3.0, LOW), (5.0, HIGH)))
    recorder.close()
    log = FlightLog(recorder.folder)
    (error,) = log.entries((topic_of(InternalError),))
    assert error.fields["part"] == "reservoir estimate" and "failing" in error.fields["trace"]
    again = replay_flight(log)
    assert not again.differences and again.decisions[-1].what == {"loss": "internal_error"}


def fly_on(flight: SimulatedFlight, recorder: Recorder, until_s: float) -> None:
    """Continue a flight that is already recorded."""
    flight.run(until_s)
    recorder.snapshot(flight.core.snapshot(until_s))


def test_the_second_flight_of_a_service_is_replayed_from_the_first(tmp_path: Path) -> None:
    flight, recorder = new_flight(), Recorder(tmp_path / "flights", BEGAN, t=0.0)
    fly(flight, recorder, ((3.0, LOW), (4.0, HIGH)))
    for until_s, arm in ((5.0, True), (6.0, False), (7.0, True), (8.0, False)):
        if arm:
            flight.autopilot.takeoff(10.0)
        else:
            flight.autopilot.disarm()
        for tenth in range(10):
            fly_on(flight, recorder, until_s - 1.0 + (tenth + 1) / 10)
    recorder.close()
    first, second = sorted((tmp_path / "flights").iterdir())
    again = replay_flight(FlightLog(second))
    assert not again.differences and len(again.decisions) >= 1
    first.rename(tmp_path / "elsewhere")
    with pytest.raises(LogError, match=f"continues {first.name}, which is not in the same folder"):
        replay_flight(FlightLog(second))


def test_another_answer_is_found_and_reported(flown: Path, tmp_path: Path) -> None:
    def other_setpoint(entry: LogEntry) -> bytes:
        if entry.topic != "decision":
            return entry.data
        return msgspec.json.encode({**entry.fields, "setpoint_kPa": 19.0})

    again = replay_flight(FlightLog(rewritten(flown, tmp_path / "other", other_setpoint)))
    assert len(again.differences) == 2
    assert '"setpoint_kPa":19.0' in again.differences[0] and '"setpoint_kPa":20.7' in again.differences[0]


def test_another_configuration_shows_what_would_have_been(flown: Path) -> None:
    grounded = config.parse(BEGAN.configuration.replace("bench_mode = true", "bench_mode = false"), "other")
    again = replay_flight(FlightLog(flown), grounded)
    assert again.differences
    assert (again.decisions[0].safety, again.decisions[0].reason) == ("refused", "not armed")


def test_a_damaged_log_is_compared_up_to_there(flown: Path, tmp_path: Path) -> None:
    data = (flown / MCAP).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) // 2])
    again = replay_flight(FlightLog(cut))
    assert not again.differences and "is incomplete" in again.damage
    assert 100 < again.compared.total() < replay_flight(FlightLog(flown)).compared.total()
    hurt = bytearray(data)
    hurt[len(data) // 2] ^= 0xFF
    cut.write_bytes(hurt)
    again = replay_flight(FlightLog(cut))
    assert not again.differences and "damaged" in again.damage


def test_the_command_reports_whether_it_is_the_same(
    flown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config_file = tmp_path / "grounded.toml"
    config_file.write_text(BEGAN.configuration.replace("bench_mode = true", "bench_mode = false"))
    for arguments, status, said in (
        ([str(flown)], 0, "Identical to the flight"),
        ([str(flown / MCAP)], 0, "Identical to the flight"),
        ([str(flown), "--json"], 0, '"differences": []'),
        ([str(flown), "--config", str(config_file)], 1, "answers differ from the flight's"),
        ([str(flown / "flight.tlog")], 0, "bend-full"),
        ([str(tmp_path)], 2, ""),
        ([str(flown), "--pace", "1"], 2, ""),
    ):
        ended, out, err = command_line.run(capsys, "replay", *arguments)
        assert ended == status
        assert said in " ".join(out.split())
        assert (err.count("\n") == 1) == (status == 2)
