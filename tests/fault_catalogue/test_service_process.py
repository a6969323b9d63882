"""Faults of the companion and its files: the service as a process, with real sockets and a serial port."""

from __future__ import annotations

import asyncio
import os
import resource
import select
import shutil
import signal
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from real_time import real_time
from waiting import MAX_WAIT_S, until

from firmware_link.protocol import Fault
from flying_vines.record.reader import FlightLog

from .black_box import STEP_S
from .catalogue import ROWS
from .served import Served, on_bench

pytestmark = [real_time, pytest.mark.long]

TIME_TO_LIVE_MS = 250
"""Time-to-live of a setpoint. The worst case is a fault directly after a setpoint."""


@pytest.fixture
async def served(tmp_path: Path) -> AsyncIterator[Served]:
    async with on_bench(tmp_path) as served:
        yield served


def assert_ended_by_the_dead_man(served: Served, fault: str) -> None:
    box = served.box
    assert box.unsafe_s is not None
    assert box.setpoint_s is not None
    to_safe_ms = round(1000 * (box.unsafe_s + STEP_S - box.setpoint_s))
    assert to_safe_ms == pytest.approx(TIME_TO_LIVE_MS, abs=10)
    allowed_ms = ROWS[fault].allowed_ms
    assert allowed_ms is not None
    assert to_safe_ms <= allowed_ms
    assert served.phlosar.firmware.faults & Fault.DEAD_MAN


async def assert_latched_until_a_person_clears_it(served: Served, fault: str) -> None:
    """The switch is still at the bend, which triggers nothing. A move to a smaller bend is refused."""
    await served.until_text(ROWS[fault].pilot_text)
    still_s = served.box.unsafe_s
    await asyncio.sleep(0.5)
    served.bend_half()
    await asyncio.sleep(0.5)
    assert served.phlosar.firmware.faults
    served.straighten()
    await until(lambda: not served.phlosar.firmware.faults, "a person has cleared it")
    assert served.box.unsafe_s == still_s
    served.bend_full()
    await served.bent()


async def vent(served: Served) -> None:
    served.straighten()
    await served.vented()
    served.ground.texts.clear()


async def test_the_dead_man_vents_when_the_service_or_its_line_fails(served: Served) -> None:
    await served.serve()
    assert served.process is not None
    assert served.box.unsafe_s is None, "nothing moves before the first trigger"

    served.bend_full()
    await served.bent(8.0)
    served.process.send_signal(signal.SIGSTOP)
    await asyncio.sleep(2.0)
    await served.vented()
    assert_ended_by_the_dead_man(served, "companion_stalled")
    served.process.send_signal(signal.SIGCONT)
    await assert_latched_until_a_person_clears_it(served, "companion_stalled")

    await vent(served)
    served.bend_full()
    await served.bent(8.0)
    await served.unplug()
    served.phlosar.advance(served.phlosar.now_s + 2.0)
    assert_ended_by_the_dead_man(served, "serial_unplugged")
    served.plug_in()
    await served.until_text("phloSAR is back")
    await assert_latched_until_a_person_clears_it(served, "serial_unplugged")

    await vent(served)
    served.bend_full()
    await served.bent(8.0)
    served.process.kill()
    await served.process.communicate()
    await served.vented()
    assert_ended_by_the_dead_man(served, "companion_killed")
    await served.serve()
    served.bend_full()
    await assert_latched_until_a_person_clears_it(served, "companion_killed")


async def test_a_flight_continues_when_files_fail_or_a_second_service_starts(served: Served) -> None:
    """The configuration and the disk fail, and a second copy of the service is started."""
    await served.serve()
    assert served.process is not None
    served.bend_full()
    await served.bent()

    text = served.config_file.read_text()
    served.config_file.write_text("[limits]\nmax_kPa = 'as much as it takes'\n")
    served.bend_half()
    await until(lambda: served.phlosar.cv_kPa < 12.0, "the configuration read at the start is still used")
    served.config_file.unlink()
    served.bend_full()
    await served.bent()
    served.config_file.write_text(text)

    (log,) = (served.folder / "flights").glob("*/flight.mcap")
    size = log.stat().st_size
    resource.prlimit(served.process.pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
    await served.until_text(ROWS["disk_full"].pilot_text)
    resource.prlimit(served.process.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
    await served.until_text("the flight log continues in")
    assert len(list(FlightLog(log).entries())) > 10
    shutil.rmtree(served.folder / "flights")
    await served.until_text(ROWS["log_vanished"].pilot_text)
    await until(lambda: _count(served, "the flight log continues in") == 2, "the log continues again")
    assert _count(served, "the flight log ends here") == 2
    (log,) = (served.folder / "flights").glob("*/flight.mcap")

    shutil.rmtree(served.folder / "state", ignore_errors=True)
    (served.folder / "state").write_text("a file where the folder should be")
    served.set_parameter("VINE_RATE_HZ", 3.0)
    await served.until_text(ROWS["disk_read_only"].pilot_text)

    (served.folder / "state").unlink()
    second = await asyncio.create_subprocess_exec(
        *served.command, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
    )
    assert second.stdout is not None
    async with asyncio.timeout(MAX_WAIT_S):
        while ROWS["second_copy"].pilot_text not in (line := await second.stdout.readline()).decode():
            assert line, "the second copy has ended without its text"
    second.terminate()
    await second.communicate()

    box = served.box
    assert box.unsafe_s is not None
    assert not served.phlosar.firmware.faults
    assert served.phlosar.cv_kPa > 15.0
    served.straighten()
    await served.vented()
    assert "vented" not in "".join(served.ground.texts)
    assert len(list(FlightLog(log).entries())) > 10

    served.bend_full()
    await served.bent()
    began_s = served.phlosar.now_s
    served.process.send_signal(signal.SIGHUP)
    output = await served.output()
    allowed_ms = ROWS["terminal_closed"].allowed_ms
    assert allowed_ms is not None
    assert 1000 * (box.unsafe_s + STEP_S - began_s) <= allowed_ms
    await served.vented()
    assert not served.phlosar.firmware.faults
    assert "Vented. Stopped." in output
    assert "Traceback" not in output
    assert "Exception ignored" not in output


def _count(served: Served, text: str) -> int:
    """How often the ground station received the text."""
    return "".join(served.ground.texts).count(text)


async def test_a_frozen_terminal_delays_nothing(served: Served) -> None:
    """Nobody reads the other end of this terminal."""
    ours, its = os.openpty()
    try:
        await served.serve(terminal=its)
        assert served.process is not None
        served.bend_full()
        await served.bent()
        await asyncio.sleep(1.0)
        assert not served.phlosar.firmware.faults
        assert select.select([], [its], [], 0.0)[1] == [], "the terminal accepts no more output"
        served.straighten()
        await served.vented()
        served.process.terminate()
        async with asyncio.timeout(MAX_WAIT_S):
            assert await served.process.wait() == 0
    finally:
        os.close(ours)
        os.close(its)


async def test_a_service_does_not_start_with_bad_files(served: Served) -> None:
    for fault, fail in (
        ("log_unwritable", served.block_flights),
        ("parameters_damaged", served.damage_state),
    ):
        repair = fail()
        process = await asyncio.create_subprocess_exec(*served.command, stderr=asyncio.subprocess.PIPE)
        _, output = await process.communicate()
        assert process.returncode == 2
        assert ROWS[fault].pilot_text in output.decode()
        assert len(output.decode().splitlines()) == 1
        repair()
    assert served.box.unsafe_s is None
