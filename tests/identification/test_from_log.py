"""Flight logs as cases: their content, and whether a diagnosis finds a hidden cause in them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from command_line import refused
from command_line import run as run_command
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from recorded_flight import BEGAN, CONFIG, HIGH, LOW, MIDDLE, fly

from firmware_link.protocol import Fault, Mode, Telemetry
from flying_vines.config import config
from flying_vines.core.events import FirmwareMessage, VehicleMessage
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.from_log import LEAD_MS, MAX_MS, PAUSE_MS, READING_MS, TAIL_MS, read_flight
from flying_vines.identification.recording import CaseError
from flying_vines.identification.simulate import GAP
from flying_vines.physics.plant.true_rig import TrueRig
from flying_vines.physics.rig import Rig
from flying_vines.record.folders import MCAP
from flying_vines.record.mcap_file import McapFile
from flying_vines.record.reader import FlightLog, LogEntry
from flying_vines.record.recorder import Recorder
from flying_vines.record.topics import NUMBERS, TOPICS
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.mavlink.codec import MavlinkCodec

LEAK = 8000.0
ONCE = ((3.0, LOW), (5.0, MIDDLE), (7.0, HIGH), (13.5, LOW))
TWICE = (*ONCE, (15.5, HIGH), (16.0, LOW))
REST = Telemetry(0, Mode.VENT, Fault.NONE, 1, 0.0, 0.0, 600.0, 0.0, 0.0, True)


def flown(parent: Path, causes: dict[str, dict[str, float]], moves: Sequence[tuple[float, int]]) -> Path:
    """The log of switch moves (end time, position) with the fakes and these causes in the rig."""
    phlosar = SimulatedPhlosar(TrueRig(Rig(), causes), {"telemetry_Hz": 1000})
    recorder = Recorder(parent, BEGAN, t=0.0)
    fly(SimulatedFlight(CONFIG, FakeAutopilot("ardupilot"), phlosar), recorder, moves)
    recorder.close()
    return recorder.folder / MCAP


@pytest.fixture(scope="module")
def leaky(tmp_path_factory: pytest.TempPathFactory) -> Path:
    leak = {"cv_leak": {"flow_resistance_kPa_s_per_SL": LEAK}}
    return flown(tmp_path_factory.mktemp("leaky"), leak, TWICE)


def messages(*stretches: tuple[int, int, Mode], period_ms: int = 5) -> Iterator[Telemetry]:
    """(begin, end in ms of the firmware's clock, mode); the inflation valve opens while it regulates."""
    for first, last, mode in stretches:
        for ms in range(first, last, period_ms):
            busy = mode is Mode.REGULATE
            yield replace(
                REST,
                device_time_ms=ms % (1 << 32),
                mode=mode,
                setpoint_kPa=10.0 if busy else 0.0,
                cv_kPa=(ms % 7) * 0.01,
                evp_opening=0.5 if busy else 0.0,
                solenoid=not busy,
            )


def written(parent: Path, telemetry: Iterator[Telemetry], air_kPa: float | None = None) -> Path:
    """A log with these rows; the host received everything 20 ms late."""
    recorder = Recorder(parent, BEGAN, t=0.0)
    snapshot = SimulatedFlight(config.default()).core.snapshot(0.0)
    for count, message in enumerate(telemetry):
        recorder.event(FirmwareMessage(count * 0.005 + 0.02, message))
        if air_kPa is not None and count % 50 == 0:
            recorder.snapshot(replace(snapshot, t=count * 0.005, ambient_kPa=air_kPa - count * 5e-4))
    recorder.close()
    return recorder.folder / MCAP


def rewritten(path: Path, to: Path, change: Callable[[LogEntry], bytes | None]) -> Path:
    """A log in which some messages are changed or missing."""
    to.parent.mkdir(exist_ok=True)
    with to.open("wb") as file:
        log = McapFile(file, TOPICS, "test")
        for entry in FlightLog(path).entries():
            data = change(entry)
            if data is not None:
                log.add(NUMBERS[entry.topic], entry.unix_ns, data)
        log.finish()
    return to


ONE_BEND = ((0, 3000, Mode.VENT), (3000, 5000, Mode.REGULATE), (5000, 12_000, Mode.VENT))


@pytest.mark.long
def test_a_hidden_leak_is_named_and_measured(leaky: Path) -> None:
    verdict = diagnose(read_flight(leaky))
    assert verdict.cause == "cv_leak" and not verdict.also
    estimate = verdict.parameters["flow_resistance_kPa_s_per_SL"]
    assert estimate.estimate == pytest.approx(LEAK, rel=0.01)


@pytest.mark.long
def test_an_ideal_rig_has_no_false_cause(tmp_path: Path) -> None:
    case = read_flight(flown(tmp_path, {}, ONCE))
    assert not case.remarks
    assert diagnose(case).cause == "none"


def test_valve_movements_keep_their_milliseconds(leaky: Path) -> None:
    telemetry = [entry.fields for entry in FlightLog(leaky).entries(("phlosar/telemetry",))]
    first_ms = next(entry["device_time_ms"] for entry in telemetry if entry["mode"] == Mode.REGULATE)
    began_ms = first_ms - LEAD_MS
    (run, *_) = read_flight(leaky).runs
    held = {entry["device_time_ms"] - began_ms: entry["evp_opening"] for entry in telemetry}
    at_ms = np.round(run.time_s * 1000.0).astype(int)
    every_ms = np.arange(at_ms[0], at_ms[-1])
    ours = run.evp_opening[np.searchsorted(at_ms, every_ms, side="right") - 1]
    assert ours.tolist() == [held[ms] for ms in every_ms.tolist()]
    assert len(at_ms) < 0.8 * len(every_ms)
    # Readings have fixed times: valve movements do not select them.
    assert np.isfinite(run.cv_kPa).tolist() == (at_ms % READING_MS == 0).tolist()
    # There is no gap for the fit.
    assert np.diff(run.time_s).max() < GAP * np.median(np.diff(run.time_s))


def test_runs_go_from_rest_to_rest(leaky: Path) -> None:
    runs = read_flight(leaky).runs
    assert len(runs) == 2
    tails_s = []
    for run in runs:
        assert run.command_kPa is not None
        wanted = np.isfinite(run.command_kPa)
        assert not wanted[run.time_s < LEAD_MS / 1000.0 - 0.001].any() and wanted.any()
        assert (run.solenoid[~wanted] == 1.0).all() and (run.evp_opening[~wanted] == 0.0).all()
        tails_s.append(run.time_s[-1] - run.time_s[wanted][-1])
    assert tails_s[0] == pytest.approx(TAIL_MS / 1000.0, abs=0.01) and tails_s[1] < tails_s[0]


def test_time_is_the_firmwares_and_its_wrap_is_none(tmp_path: Path) -> None:
    wrap = 1 << 32
    bend = tuple((first + wrap - 4000, last + wrap - 4000, mode) for first, last, mode in ONE_BEND)
    (run,) = read_flight(written(tmp_path, messages(*bend))).runs
    assert run.time_s[0] == 0.0 and run.time_s[-1] == pytest.approx(8.0, abs=0.01)
    assert run.ambient_kPa is None


@pytest.mark.parametrize("why", ("pause", "restart"))
def test_a_run_ends_where_the_record_does(tmp_path: Path, why: str) -> None:
    later = 4000 + PAUSE_MS + 10 if why == "pause" else 100
    broken = (*ONE_BEND[:1], (3000, 4000, Mode.REGULATE), (later, later + 1000, Mode.REGULATE))
    rest_ms = later + 1000 + TAIL_MS
    rest = (later + 1000, rest_ms, Mode.VENT)
    again = (rest, *((first + rest_ms, last + rest_ms, mode) for first, last, mode in ONE_BEND))
    first, second = read_flight(written(tmp_path, messages(*broken, *again))).runs
    # The start of a movement across the break is unknown.
    assert first.time_s[-1] == pytest.approx(2.0, abs=0.01)
    assert second.time_s[-1] == pytest.approx(8.0, abs=0.01)


def test_a_reading_that_is_not_one_is_left_out(tmp_path: Path) -> None:
    faulty = (
        replace(m, faults=Fault.RESERVOIR_SENSOR if m.device_time_ms > 6000 else Fault.NONE)
        for m in messages(*ONE_BEND)
    )
    (run,) = read_flight(written(tmp_path, faulty)).runs
    old = run.time_s > 6.0 - 3.0 + LEAD_MS / 1000.0 + READING_MS / 1000.0
    assert np.isnan(run.reservoir_kPa[old]).all() and np.isfinite(run.cv_kPa[old]).any()
    assert np.isfinite(run.reservoir_kPa[~old]).any()


def test_the_air_around_is_the_autopilots(tmp_path: Path) -> None:
    (run,) = read_flight(written(tmp_path, messages(*ONE_BEND), air_kPa=95.0)).runs
    assert run.ambient_kPa is not None
    assert run.ambient_kPa == pytest.approx(95.0 - (run.time_s + 2.02) * 0.1, abs=0.005)


def test_the_ambient_pressure_is_known_as_long_as_the_autopilot_reports_it() -> None:
    flight = SimulatedFlight(config.default())
    flight.run(1.5)
    said = mavlink.MAVLink_scaled_pressure_message(0, 950.0, 0.0, 2000)
    autopilot = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    (message,) = MavlinkCodec(0, 191).decode(said.pack(autopilot))
    assert math.isnan(flight.core.snapshot(1.5).ambient_kPa)
    flight.feed(VehicleMessage(1.5, message))
    assert flight.core.snapshot(2.0).ambient_kPa == 95.0
    assert math.isnan(flight.core.snapshot(5.0).ambient_kPa)


def test_a_fake_sends_no_more_often_than_it_regulates(capsys: pytest.CaptureFixture[str]) -> None:
    for rate in ("9", "1001"):
        status, _, error = run_command(capsys, "fake", "phlosar", "--telemetry-Hz", rate)
        assert status == 2 and "--telemetry-Hz must be from 10 to 1000" in error


def test_slow_telemetry_is_reported(tmp_path: Path) -> None:
    case = read_flight(written(tmp_path, messages(*ONE_BEND, period_ms=10)))
    (remark,) = case.remarks
    assert "every 10 ms" in remark and "telemetry_Hz = 1000" in remark
    assert np.isfinite(case.runs[0].cv_kPa).all()


def test_lost_telemetry_is_reported(tmp_path: Path) -> None:
    kept = (m for m in messages(*ONE_BEND, period_ms=1) if m.device_time_ms % 20)
    (remark,) = read_flight(written(tmp_path, kept)).remarks
    assert "5%" in remark and "lost" in remark


def test_a_long_flight_is_sampled_from_beginning_to_end(tmp_path: Path) -> None:
    bends = 60
    plan = [(i * 12_000 + a, i * 12_000 + b, mode) for i in range(bends) for a, b, mode in ONE_BEND]
    case = read_flight(written(tmp_path, messages(*plan, period_ms=50)))
    assert sum(run.time_s[-1] for run in case.runs) * 1000.0 < MAX_MS * 1.1
    assert len(case.runs) >= 20 and any(f"of {bends} runs" in remark for remark in case.remarks)


def test_a_log_may_be_cut_off_and_damaged(leaky: Path, tmp_path: Path) -> None:
    data = leaky.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(0.95 * len(data))])
    case = read_flight(cut)
    assert len(case.runs) == 2
    assert any("is incomplete" in remark for remark in case.remarks)

    readings = iter(range(100_000))

    def one_without_pressure(entry: LogEntry) -> bytes:
        if entry.topic == "phlosar/telemetry" and next(readings) == 3000:
            return b'{"t":1.0}'
        return entry.data

    incomplete = rewritten(leaky, tmp_path / MCAP, one_without_pressure)
    assert any("1 of" in remark and "incomplete" in remark for remark in read_flight(incomplete).remarks)


def _without(path: Path, topic: str, to: Path) -> Path:
    return rewritten(path, to, lambda entry: None if entry.topic == topic else entry.data)


def test_an_unusable_log_gives_one_line_and_status_2(
    leaky: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "noise.mcap").write_bytes(bytes(range(256)) * 8)
    still = written(tmp_path, messages((0, 3000, Mode.VENT)))
    cases: dict[Path, str] = {
        tmp_path / "nothing.mcap": "No such file",
        tmp_path / "empty.mcap": "is empty",
        tmp_path / "noise.mcap": "is not a flight log",
        _without(leaky, "phlosar/telemetry", tmp_path / "silent.mcap"): "holds no telemetry",
        _without(leaky, "start", tmp_path / "rigless.mcap"): "--rig RIG.toml",
        still: "no setpoint was held",
    }
    for path, why in cases.items():
        line = refused(capsys, "diagnose", "--from-log", path)
        assert str(path) in line and why in line


def test_a_rig_file_stands_in_for_what_the_log_lacks(leaky: Path, tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text("[cv]\nvolume_L = 0.2\n")
    assert read_flight(leaky).rig.cv == Rig().cv
    believed = read_flight(_without(leaky, "start", tmp_path / MCAP), rig).rig
    assert believed.cv is not None and believed.cv.volume_L == 0.2
    for text, why in (("[cv]\nvolume_L = -1\n", "volume_L"), ("", r"add \[cv\]")):
        rig.write_text(text)
        with pytest.raises(CaseError, match=rf"rig\.toml.*{why}"):
            read_flight(leaky, rig)


def test_an_invalid_rig_in_the_log_is_refused(leaky: Path, tmp_path: Path) -> None:
    start = msgspec.json.encode({"t": 0.0, "believed": {"tank": {}}})
    rewritten(leaky, tmp_path / MCAP, lambda entry: start if entry.topic == "start" else entry.data)
    with pytest.raises(CaseError, match="unknown table 'tank'"):
        read_flight(tmp_path)
