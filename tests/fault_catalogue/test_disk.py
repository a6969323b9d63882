"""During a flight every access to the disk fails."""

from __future__ import annotations

import asyncio
import errno
import os
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from real_time import real_time
from service_bench import on_bench
from waiting import until

from flying_vines.config import config
from flying_vines.service.persistent_state import PersistentState
from flying_vines.service.service import Service
from flying_vines.simulation.autopilot import FakeAutopilot

from .catalogue import ROWS

pytestmark = real_time


async def test_disk_gone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    status = os.stat

    def gone(path: Any, **options: Any) -> os.stat_result:
        if str(path).startswith(str(tmp_path)):
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return status(path, **options)

    async with on_bench(FakeAutopilot("ardupilot")) as bench:
        config_file = tmp_path / "vine.toml"
        config_file.write_text(bench.configuration.replace("settle_s = 1.0", "settle_s = 0.2"))
        parsed = config.load(config_file)
        service = Service(parsed, persistent=PersistentState.of(config_file, parsed))
        serving = asyncio.create_task(service.run())
        await until(lambda: service.core.snapshot(service.now).switch_position == 0, "RC is accepted")
        bench.autopilot.set_rc(9, 2000)
        await until(bench.bent, "the vine bends")
        monkeypatch.setattr(os, "stat", gone)
        bench.ground.send(
            mavlink.MAVLink_param_set_message(1, 191, b"VINE_RATE_HZ", 3.0, mavlink.MAV_PARAM_TYPE_REAL32)
        )
        await until(lambda: ROWS["disk_gone"].pilot_text in "".join(bench.ground.texts), "the pilot reads it")
        assert bench.bent()
        bench.autopilot.set_rc(9, 1000)
        await until(bench.vented, "the switch still acts")
        service.stop()
        await serving
