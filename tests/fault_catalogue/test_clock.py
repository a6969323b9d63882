"""The companion's clock jumps, while its messages are signed with timestamps of that clock."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import pytest
from patience import until
from real_time import real_time
from service_bench import Bench, on_bench

from flying_vines import config
from flying_vines.fakes.autopilot import Autopilot
from flying_vines.kept import Kept
from flying_vines.service import Service

pytestmark = real_time

KEY = bytes(range(32))
HOUR_S = 3600.0


async def test_clock_jumps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock_s, wrong_by = time.time, [0.0]
    monkeypatch.setattr(time, "time", lambda: clock_s() + wrong_by[0])
    autopilot = Autopilot("ardupilot", signing_key=KEY, unix_s=clock_s())
    async with on_bench(autopilot) as bench:
        (tmp_path / "key").write_bytes(KEY.hex().encode())
        (tmp_path / "key").chmod(0o600)
        profile = tmp_path / "profile.toml"
        signed = bench.profile.replace('signing_key = ""', 'signing_key = "key"')
        profile.write_text(signed.replace("settle_s = 1.0", "settle_s = 0.2"))
        for jumps_s in ((1.0 * HOUR_S, -2.0 * HOUR_S), (0.5 * HOUR_S, 0.0)):
            await fly(bench, profile, wrong_by, jumps_s)


async def fly(bench: Bench, profile: Path, wrong_by: list[float], jumps_s: tuple[float, ...]) -> None:
    """Start the service, bend, let the clock jump, and straighten."""
    parsed = config.load(profile)
    kept = Kept.of(profile, parsed)
    signing, _ = kept.read_signing(parsed)
    service = Service(parsed, signing=signing, kept=kept)
    serving = asyncio.create_task(service.run())
    await until(lambda: service.core.snapshot(service.now).switch_position == 0, "RC is believed")
    bench.autopilot.set_rc(9, 2000)
    await until(bench.bent, "the vine bends")
    for jump_s in jumps_s:
        wrong_by[0] = jump_s
        await asyncio.sleep(0.5)
        snapshot = service.core.snapshot(service.now)
        assert (snapshot.rc, snapshot.firmware, snapshot.safe_state) == ("good", "ready", {})
        assert bench.bent()
    bench.autopilot.set_rc(9, 1000)
    await until(bench.vented, "the switch still acts")
    assert not bench.phlosar.firmware.faults
    service.stop()
    await serving
