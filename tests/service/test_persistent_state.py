"""State that survives a restart of the service: parameters, disarming, latched faults, the signing clock."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from real_time import real_time
from service_bench import Bench, on_bench
from waiting import until

from flying_vines.config import config
from flying_vines.core.events import Action, Decision
from flying_vines.core.watcher import EachAction
from flying_vines.service import service as service_module
from flying_vines.service.persistent_state import NO_BOARD, UNREADABLE, PersistentState
from flying_vines.service.service import Service
from flying_vines.service.starting import read_inputs
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.vehicle.component import parameter_file
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.mavlink.signing import UNITS_PER_S, UNIX_TIME_OF_ZERO_S, Signing, TimestampFile
from flying_vines.vehicle.notice import Notice

pytestmark = real_time

KEY = bytes(range(32))
STOP, DISARM, ARM = 31013, 2, 3
MORE, CLEAR = 31014, 1


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    async with on_bench(FakeAutopilot("ardupilot")) as bench:
        yield bench


class Served:
    """A service on the bench with its own files, and its texts."""

    def __init__(self, bench: Bench, folder: Path, key: str = "") -> None:
        self.config_file = folder / "vine.toml"
        self.config_file.write_text(bench.configuration.replace('signing_key = ""', f'signing_key = "{key}"'))
        self.config = config.load(self.config_file)
        self.state = PersistentState.of(self.config_file, self.config)
        self.seen: list[Action] = []
        read = read_inputs(self.config_file)
        self.service = Service(
            self.config,
            (EachAction(self.seen.append),),
            stored=read.stored,
            signing=read.signing,
            persistent=self.state,
        )

    @property
    def texts(self) -> list[str]:
        return [action.text for action in self.seen if isinstance(action, Notice)]


@asynccontextmanager
async def serving(bench: Bench, folder: Path, key: str = "") -> AsyncIterator[Served]:
    served = Served(bench, folder, key)
    task = asyncio.create_task(served.service.run())
    yield served
    served.service.stop()
    await task


def set_rate(bench: Bench, kPa_per_s: float) -> None:
    real32 = mavlink.MAV_PARAM_TYPE_REAL32
    bench.ground.send(mavlink.MAVLink_param_set_message(1, 191, b"VINE_MAX_RATE", kPa_per_s, real32))


async def test_a_parameter_survives_a_restart(bench: Bench, tmp_path: Path) -> None:
    async with serving(bench, tmp_path) as served:
        await until(lambda: "RES_KPA" in bench.ground.values, "the service runs")
        for rate in (50.0, 40.0, 30.0):
            set_rate(bench, rate)
        await until(served.state.parameters.exists, "the file is written")
        await until(
            lambda: "VINE_MAX_RATE = 30.0" in served.state.parameters.read_text(),
            "the file has the last value",
        )
    assert Served(bench, tmp_path).service.core.config.limits.max_rate_kPa_per_s == 30.0


async def test_state_that_cannot_be_saved_is_reported_and_active(bench: Bench, tmp_path: Path) -> None:
    async with serving(bench, tmp_path) as served:
        served.state.parameters.mkdir()
        await until(lambda: "RES_KPA" in bench.ground.values, "the service runs")
        set_rate(bench, 30.0)
        await until(lambda: any("parameters not saved" in text for text in served.texts), "the text is shown")
        assert served.service.core.config.limits.max_rate_kPa_per_s == 30.0
        await until(
            lambda: any("parameters not saved" in text for text in bench.ground.texts), "the pilot reads it"
        )


def command(bench: Bench, number: int, param1: float) -> None:
    bench.ground.send(mavlink.MAVLink_command_long_message(1, 191, number, 0, param1, 0, 0, 0, 0, 0, 0))


def doing(served: Served) -> str:
    return served.service.core.snapshot(served.service.now).doing


@pytest.mark.long
async def test_pneumatics_stay_disarmed_over_restarts_until_a_person_arms_them(
    bench: Bench, tmp_path: Path
) -> None:
    async with serving(bench, tmp_path) as served:
        await until(lambda: "RES_KPA" in bench.ground.values, "the service runs")
        command(bench, STOP, DISARM)
        await until(lambda: served.state.disarmed, "the file is written")
    for _ in range(2):
        async with serving(bench, tmp_path) as served:
            await until(lambda: any("disarmed before" in text for text in served.texts), "the text is shown")
            await until(lambda: served.service.core.snapshot(0.0).switch_position == 0, "RC is accepted")
            bench.autopilot.set_rc(9, 2000)
            await until(
                lambda: any("the pneumatics are disarmed" in text for text in served.texts), "refused"
            )
            assert bench.vented() and doing(served) == "pneumatics disarmed"
            bench.autopilot.set_rc(9, 1000)
    async with serving(bench, tmp_path) as served:
        await until(lambda: served.service.core.snapshot(0.0).switch_position == 0, "RC is accepted")
        command(bench, STOP, ARM)
        await until(lambda: not served.state.disarmed, "the file is removed")
        assert doing(served) == "vented"
    async with serving(bench, tmp_path) as served:
        await until(lambda: served.service.core.snapshot(0.0).switch_position == 0, "RC is accepted")
        assert doing(served) == "vented" and not any("disarmed" in text for text in served.texts)


async def test_a_disarm_that_cannot_be_stored_is_reported_takes_effect_and_is_stored_later(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service_module, "WRITE_AGAIN_S", 0.1)
    async with serving(bench, tmp_path) as served:
        in_the_way = tmp_path / "vine.disarmed"
        in_the_way.mkdir()
        await until(lambda: "RES_KPA" in bench.ground.values, "the service runs")
        command(bench, STOP, DISARM)
        await until(lambda: any("disarming not saved" in text for text in served.texts), "the text is shown")
        assert doing(served) == "pneumatics disarmed"
        in_the_way.rmdir()
        await until(in_the_way.is_file, "it is stored when the disk takes it")
        assert len([text for text in served.texts if "not saved" in text]) == 1


async def test_a_disarm_before_a_stop_is_stored_however_slow_the_disk_is(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick, begun = parameter_file.write, threading.Event()

    def slow(*file: Any) -> None:
        begun.set()
        time.sleep(1.0)
        quick(*file)

    monkeypatch.setattr(parameter_file, "write", slow)
    async with serving(bench, tmp_path) as served:
        await until(lambda: "RES_KPA" in bench.ground.values, "the service runs")
        set_rate(bench, 30.0)
        await until(begun.is_set, "the disk is busy")
        command(bench, STOP, DISARM)
        await until(lambda: doing(served) == "pneumatics disarmed", "it takes effect")
        assert not served.state.disarmed
    assert served.state.disarmed


def test_without_a_folder_nothing_is_disarmed_but_an_unreadable_folder_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("a file where the folder should be")
    for folder in ("missing", "file"):
        state = PersistentState.of(tmp_path / folder / "vine.toml", config.default())
        assert not state.disarmed

    def refuse(path: Path, **_: object) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "stat", refuse)
    with pytest.raises(PermissionError):
        _ = state.disarmed


def test_disarmed_is_a_file_that_explains_itself_and_may_be_removed(tmp_path: Path) -> None:
    config_file = tmp_path / "vine.toml"
    config_file.write_text(config.default_text().replace('folder = ""', 'folder = "state/of"'))
    state = PersistentState.of(config_file, config.load(config_file))
    assert not state.disarmed
    state.store_disarmed(False)  # neither the file nor its folder exists
    state.store_disarmed(True)
    (file,) = (tmp_path / "state" / "of").iterdir()
    assert state.disarmed and "disarmed" in file.read_text()
    file.write_bytes(b"")  # a file with any content disarms
    assert state.disarmed
    state.store_disarmed(False)
    assert not state.disarmed and list(file.parent.iterdir()) == []


async def test_a_latched_fault_survives_a_restart_until_a_person_clears_it(
    bench: Bench, tmp_path: Path
) -> None:
    async with serving(bench, tmp_path) as served:
        await until(lambda: "RES_KPA" in bench.ground.values, "the service runs")
        bench.phlosar.reset_firmware()
        await until(lambda: set(served.state.read_latched()) == {"firmware_reset"}, "the file is written")
    async with serving(bench, tmp_path) as served:
        await until(
            lambda: any("latched before restart" in text for text in served.texts), "the text is shown"
        )
        assert "firmware_reset" in served.service.core.snapshot(0.0).safe_state
        await until(lambda: served.service.core.snapshot(0.0).switch_position == 0, "RC is accepted")
        command(bench, MORE, CLEAR)
        await until(lambda: not served.state.latched.exists(), "the file is removed")
        assert served.service.core.snapshot(0.0).safe_state == {}


def test_a_damaged_file_of_latched_faults_is_a_latched_fault(tmp_path: Path) -> None:
    config_file = tmp_path / "vine.toml"
    config_file.write_text(config.default_text())
    state = PersistentState.of(config_file, config.load(config_file))
    assert state.read_latched() == {}
    state.store_latched({"filling": "not filling: …"})
    assert state.read_latched() == {"filling": "not filling: …"}
    state.store_latched({"bottle_loss": "as earlier versions named it"})
    assert state.read_latched() == {"reservoir_loss": "as earlier versions named it"}
    for damaged in (b"", b"[1]", b"\xff{", b'{"filling": "' + b"x" * 300_000 + b'"}'):
        state.latched.write_bytes(damaged)
        assert state.read_latched() == UNREADABLE
    state.store_latched({})
    assert not state.latched.exists()


async def test_the_boards_settings_are_remembered_over_a_restart(bench: Bench, tmp_path: Path) -> None:
    async with serving(bench, tmp_path) as served:
        await until(lambda: served.state.board_settings.exists(), "the file is written")
        known = served.state.read_board_settings()
    served.state.store_board_settings(0x1234)
    async with serving(bench, tmp_path) as served:
        await until(lambda: set(served.state.read_latched()) == {"board_settings"}, "the fault is stored")
        assert served.state.read_board_settings() == 0x1234
        await until(lambda: served.service.core.snapshot(0.0).switch_position == 0, "RC is accepted")
        command(bench, MORE, CLEAR)
        await until(lambda: served.state.read_board_settings() == known, "a person has confirmed them")
        await until(lambda: not served.state.latched.exists(), "the file is removed")


def test_a_damaged_file_of_the_boards_settings_fits_no_board(tmp_path: Path) -> None:
    config_file = tmp_path / "vine.toml"
    config_file.write_text(config.default_text())
    state = PersistentState.of(config_file, config.load(config_file))
    assert state.read_board_settings() is None
    state.store_board_settings(0x0000CAFE)
    assert state.read_board_settings() == 0xCAFE
    for damaged in (b"", b"wrong", b"\xff", b"-1", b"1234567890ab", b"00ca"):
        state.board_settings.write_bytes(damaged)
        assert state.read_board_settings() == NO_BOARD


def private_key(folder: Path, key: bytes) -> str:
    path = folder / "key"
    path.write_text(key.hex())
    path.chmod(0o600)
    return path.name


async def test_a_signed_vehicle_bends_the_vine_and_the_timestamp_is_saved(tmp_path: Path) -> None:
    autopilot = FakeAutopilot("ardupilot", signing_key=KEY, unix_s=time.time())
    async with on_bench(autopilot) as bench, serving(bench, tmp_path, private_key(tmp_path, KEY)) as served:
        await until(lambda: served.service.core.snapshot(0.0).switch_position == 0, "RC is accepted")
        bench.autopilot.set_rc(9, 2000)
        await until(bench.bent, "the vine bends")
        await until(served.state.signing_timestamp.exists, "the timestamp is saved")
        again, problem = served.state.read_signing(served.config)
        assert problem == ""
        assert isinstance(again, Signing) and again.timestamp > int(
            served.state.signing_timestamp.read_text().split()[0]
        )


@pytest.mark.parametrize("theirs", [None, bytes(32 * [7])], ids=["unsigned", "another key"])
async def test_senders_without_the_key_are_refused_and_reported(tmp_path: Path, theirs: bytes | None) -> None:
    autopilot = FakeAutopilot("ardupilot", signing_key=theirs, unix_s=time.time())
    async with on_bench(autopilot) as bench, serving(bench, tmp_path, private_key(tmp_path, KEY)) as served:
        await until(lambda: any("refused messages" in text for text in served.texts), "the text is shown")
        assert served.service.core.snapshot(0.0).vehicle == "not found"
        assert bench.vented()


async def test_a_saved_timestamp_of_2040_is_corrected_and_reported(tmp_path: Path) -> None:
    autopilot = FakeAutopilot("ardupilot", signing_key=KEY, unix_s=time.time())
    (tmp_path / "vine.signing-timestamp").write_text("078890880000000 191\n255 001 001 078890880000000\n")
    async with on_bench(autopilot) as bench, serving(bench, tmp_path, private_key(tmp_path, KEY)) as served:
        await until(lambda: served.service.core.snapshot(0.0).switch_position == 0, "RC is accepted")
        await until(lambda: any("ahead: corrected" in text for text in served.texts), "the text is shown")
    memory, _ = TimestampFile(served.state.signing_timestamp).load()
    assert memory.link_id == 192
    assert memory.timestamp < (time.time() + 120 - UNIX_TIME_OF_ZERO_S) * UNITS_PER_S


@pytest.mark.long
async def test_frames_from_before_a_stop_are_refused_after_it(tmp_path: Path) -> None:
    pilot, key = Signing(KEY), private_key(tmp_path, KEY)
    pilot.advance(time.time())
    station = MavlinkCodec(255, 190, pilot)
    bend = mavlink.MAVLink_command_long_message(1, 191, mavlink.MAV_CMD_USER_2, 0, 60, 0, 0, 0, 0, 0, 0)
    recorded = station.encode(bend, 255)
    async with on_bench(FakeAutopilot("ardupilot", signing_key=KEY, unix_s=time.time())) as bench:
        for expected in (1, 0):
            async with serving(bench, tmp_path, key) as served:
                await until(lambda: served.service.core.snapshot(0.0).switch_position == 0, "RC is accepted")
                # The recorder sends it to the same port, the second time after the restart.
                served.service._vehicle_bytes(recorded)
                await until(
                    bench.bent if expected else bench.vented, "the first run bends, the second does not"
                )
                asked = [a for a in served.seen if isinstance(a, Decision) and a.trigger == "command"]
                assert len(asked) == expected, (asked, served.texts)
            await until(bench.vented, "vented by the stop")
        assert served.service._signing is not None and served.service._signing.refused.replayed == 1
