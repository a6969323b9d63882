"""The real service with real sockets and a serial port, between the stand-ins."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import tty
from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path

import pytest
from pseudo_terminal import Terminal
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from real_time import real_time
from service_bench import Bench, on_bench
from waiting import until

from firmware_link import answer_check
from firmware_link.protocol import Fault, Vent
from firmware_link.serial_port import SerialPort
from flying_vines.config import config
from flying_vines.core.events import Action, Decision, Event, ToFirmware
from flying_vines.core.watcher import EachAction, Watcher
from flying_vines.record.reader import FlightLog
from flying_vines.service.service import Service
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.replay import replay_flight
from flying_vines.vehicle.component.telemetry import VALUE_NAMES
from flying_vines.vehicle.notice import Notice, Severity

pytestmark = real_time


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    async with on_bench(FakeAutopilot("ardupilot")) as bench:
        yield bench


async def test_a_switch_bends_the_vine_and_the_ground_station_sees_it(bench: Bench) -> None:
    seen: list[Action] = []
    service = Service(config.parse(bench.configuration, "test"), (EachAction(seen.append),))
    serving = asyncio.create_task(service.run())
    await until(lambda: service.core.snapshot(service.now).switch_position == 0, "RC is accepted")
    bench.autopilot.set_rc(9, 2000)
    await until(bench.bent, "the vine bends")
    await until(lambda: bench.ground.values.get("CV_KPA", 0.0) > 15.0, "the ground station sees it")
    assert bench.ground.values.keys() <= set(VALUE_NAMES)
    assert bench.ground.values.keys() >= {"RES_KPA", "CYC_LEFT", "CV_KPA", "CMD_KPA", "BEND_DEG"}
    assert [a.safety for a in seen if isinstance(a, Decision)] == ["accepted"]
    service.stop()
    await serving
    await until(bench.vented, "a stopped service has vented")
    assert not bench.phlosar.firmware.faults


async def test_messages_to_the_board_are_sent_before_the_watchers_get_a_text(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    service = Service(
        config.parse(bench.configuration, "test"),
        (EachAction(lambda action: done.append(type(action).__name__)),),
    )
    notice = Notice(0.0, Severity.INFO, "Vine: telemetry")
    handled = [notice, ToFirmware(Vent(1)), notice, ToFirmware(Vent(2))]
    monkeypatch.setattr(service.core, "handle", lambda event: handled)
    monkeypatch.setattr(SerialPort, "write", lambda port, data: done.append("written"))
    service.say(Severity.INFO, "whatever")
    assert done == ["written", "written"]
    service.notify_watchers()
    assert done[2:] == ["Notice", "ToFirmware", "Notice", "ToFirmware"]


async def test_a_serial_line_that_returns_our_frames_is_told_once(bench: Bench, tmp_path: Path) -> None:
    seen: list[Action] = []
    line = Terminal(tmp_path / "uart")
    link = config.parse(bench.configuration, "test").vehicle.link
    text = bench.configuration.replace(link, f"serial:{tmp_path / 'uart'}:57600")
    service = Service(config.parse(text, "test"), (EachAction(seen.append),))
    serving = asyncio.create_task(service.run())
    for _ in range(80):
        with suppress(BlockingIOError):
            os.write(line.device, os.read(line.device, 4096))
        await asyncio.sleep(0.1)
    serving.cancel()
    told = [action.text for action in seen if isinstance(action, Notice) and "come back" in action.text]
    assert told == ["Vine: our own frames come back on vehicle.link: check its TX and RX"]


async def test_an_unknown_sender_on_the_network_bends_nothing(bench: Bench) -> None:
    # A whole autopilot in the air, from another address than the configured one, and a command.
    seen: list[Action] = []
    link = config.parse(bench.configuration, "test").vehicle.link
    port = int(link.rpartition(":")[2])
    text = bench.configuration.replace(link, f"udpin:0.0.0.0:{port}?peer=127.0.0.1")
    service = Service(config.parse(text, "test"), (EachAction(seen.append),))
    serving = asyncio.create_task(service.run())
    await until(lambda: service.core.snapshot(service.now).switch_position == 0, "RC is accepted")
    stranger, station = (mavlink.MAVLink(None, srcSystem=system, srcComponent=1) for system in (1, 255))
    loop = asyncio.get_running_loop()
    transport, _ = await loop.create_datagram_endpoint(
        asyncio.DatagramProtocol, local_addr=("127.0.0.9", 0), remote_addr=("127.0.0.1", port)
    )
    bend = mavlink.MAVLink_command_long_message(1, 191, mavlink.MAV_CMD_USER_2, 0, 40, 0, 0, 0, 0, 0, 0)
    channels = mavlink.MAVLink_rc_channels_message(0, 16, *[1500] * 8, 2000, *[1500] * 9, 255)
    for _ in range(40):
        transport.sendto(bend.pack(station))
        transport.sendto(mavlink.MAVLink_heartbeat_message(2, 3, 128, 5, 4, 3).pack(stranger))
        transport.sendto(channels.pack(stranger))
        await asyncio.sleep(0.02)
    assert bench.vented()
    assert not [action for action in seen if isinstance(action, Decision)]
    told = [action.text for action in seen if isinstance(action, Notice) and "ignored" in action.text]
    assert told == ["Vine: ignored 127.0.0.9: it is not vehicle.link's peer"]
    bench.autopilot.set_rc(9, 2000)
    await until(bench.bent, "the real pilot bends")
    transport.close()
    service.stop()
    await serving


class FailingWatcher(Watcher):
    def __init__(self) -> None:
        self.seen = 0

    def event(self, event: Event) -> None:
        self.seen += 1
        raise RuntimeError("I cannot draw that")


async def test_a_failing_watcher_is_switched_off_and_the_others_continue(bench: Bench) -> None:
    clumsy, seen = FailingWatcher(), list[Action]()
    service = Service(config.parse(bench.configuration, "test"), (clumsy, EachAction(seen.append)))

    def texts() -> list[str]:
        return [action.text for action in seen if isinstance(action, Notice)]

    for text in ("one", "two"):
        service.say(Severity.INFO, text)
        service.notify_watchers()
        await asyncio.sleep(0)
    service.notify_watchers()
    assert clumsy.seen == 1
    assert texts() == ["Vine: one", "Vine: FailingWatcher failed, flight goes on", "Vine: two"]


async def test_a_silent_port_is_reported_to_the_pilot_once_and_on_the_screen(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(answer_check, "ANSWER_WITHIN_S", 0.3)
    silent, hosts = os.openpty()
    tty.setraw(hosts)
    seen: list[Action] = []
    text = bench.configuration.replace(bench.port.path, os.ttyname(hosts))
    service = Service(config.parse(text, "test"), (EachAction(seen.append),))
    serving = asyncio.create_task(service.run())
    await until(lambda: "silent" in service.link_problems.get("firmware", ""), "the screen shows it")
    service.stop()
    await serving
    assert len([a for a in seen if isinstance(a, Notice) and "open but silent" in a.text]) == 1
    for descriptor in (silent, hosts):
        os.close(descriptor)


async def run(bench: Bench, tmp_path: Path) -> asyncio.subprocess.Process:
    """The service as a process of its own."""
    config_file = tmp_path / "vine.toml"
    config_file.write_text(bench.configuration)
    arguments = ["run", "--config", str(config_file), "--plain", "--out", str(tmp_path / "flights")]
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "flying_vines",
        *arguments,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
    )
    await until(lambda: "RES_KPA" in bench.ground.values, "the service runs")
    return process


async def start(bench: Bench, tmp_path: Path) -> asyncio.subprocess.Process:
    """The same, with the vine bent by the switch."""
    process = await run(bench, tmp_path)
    await bench.bend()
    return process


async def output_of(process: asyncio.subprocess.Process) -> str:
    text, _ = await process.communicate()
    return text.decode()


async def test_sigterm_vents_and_leaves_no_fault(bench: Bench, tmp_path: Path) -> None:
    process = await start(bench, tmp_path)
    process.send_signal(signal.SIGTERM)
    text = await output_of(process)
    assert process.returncode == 0, text
    assert "Vented. Stopped." in text
    assert "Traceback" not in text
    await until(bench.vented, "vented")
    assert not bench.phlosar.firmware.faults
    (log,) = map(FlightLog, (tmp_path / "flights").iterdir())
    assert list(log.entries(("decision",)))
    assert not log.damage
    again = replay_flight(log)
    assert not again.differences
    assert again.compared["decision"] >= 1


async def test_a_service_knows_that_the_pneumatics_were_disarmed_before_its_start(
    bench: Bench, tmp_path: Path
) -> None:
    (tmp_path / "vine.disarmed").touch()
    process = await run(bench, tmp_path)
    process.send_signal(signal.SIGTERM)
    assert "pneumatics disarmed before restart: arm them" in await output_of(process)
    (log,) = map(FlightLog, (tmp_path / "flights").iterdir())
    assert "pneumatics disarmed" in {entry.fields["doing"] for entry in log.entries(("snapshot",))}


async def test_after_the_service_is_killed_the_dead_man_vents(bench: Bench, tmp_path: Path) -> None:
    process = await start(bench, tmp_path)
    process.kill()
    await process.wait()
    await until(bench.vented, "the dead-man vents")
    assert bench.phlosar.firmware.faults & Fault.DEAD_MAN


async def test_garbage_on_both_links_changes_nothing(bench: Bench) -> None:
    seen: list[Action] = []
    service = Service(config.parse(bench.configuration, "test"), (EachAction(seen.append),))
    serving = asyncio.create_task(service.run())
    await until(lambda: service.core.snapshot(service.now).switch_position == 0, "RC is accepted")
    for i in range(200):
        service._vehicle_bytes(bytes((i * 7 + k * 31) % 256 for k in range(64)))
        service._firmware_bytes(bytes((i * 11 + k * 17) % 256 for k in range(64)))
    bench.autopilot.set_rc(9, 2000)
    await until(bench.bent, "the vine still bends")
    assert [a.trigger for a in seen if isinstance(a, Decision)] == ["switch"]
    service.stop()
    await serving
