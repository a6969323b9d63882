"""Network faults: the real service, its gateway process and a real broker."""

from __future__ import annotations

import os
import signal
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from gateway.mqtt.brokers import Broker, onlooker, running
from gateway_process import gateway_of
from real_time import real_time
from waiting import until

from .catalogue import ROWS
from .served import Served, on_bench

pytestmark = [real_time, pytest.mark.long]


@pytest.fixture
async def served(tmp_path: Path) -> AsyncIterator[Served]:
    async with on_bench(tmp_path) as served:
        yield served


async def test_a_flight_continues_whatever_the_network_does(served: Served, tmp_path: Path) -> None:
    base = "flying-vines/heron"
    async with running(Broker(tmp_path)) as broker:
        text = served.config_file.read_text()
        text = text.replace('broker = ""', f'broker = "{broker.url}"').replace("port = 8017", "port = 0")
        served.config_file.write_text(text.replace('\nname = ""', '\nname = "heron"'))
        async with onlooker(broker) as people:
            await served.serve()
            await people.until(f"{base}/state", rc="good")
            served.bend_full()
            await served.bent()
            await people.until(f"{base}/event", event="decision", intent="bend-full")
            assert served.process is not None
            os.kill(gateway_of(served.process.pid), signal.SIGKILL)
            await people.until(f"{base}/status", status="offline")
            await served.until_text(ROWS["gateway_killed"].pilot_text)
            await people.until(f"{base}/state", doing="bend-full")

        broker.kill()
        await served.until_text(ROWS["broker_gone"].pilot_text)
        assert served.phlosar.cv_kPa > 15.0
        assert not served.phlosar.firmware.faults
        served.straighten()
        await served.vented()
        await broker.start()
        async with onlooker(broker) as people:
            await people.until(f"{base}/status", status="online")
            await until(lambda: not served.phlosar.firmware.faults, "nothing latches")
