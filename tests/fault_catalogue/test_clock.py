"""The companion's clock jumps while its messages are signed with its timestamps."""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest
from real_time import real_time
from required_programs import need

from flying_vines.simulation.autopilot import FakeAutopilot

from .served import Served, on_bench

pytestmark = [real_time, pytest.mark.long]

KEY = bytes(range(32))
FAKETIME = "sudo apt install faketime"
JUMPS = ("+1h", "-2h", "+14y")
SEEN_WITHIN_S = 1.2
"""libfaketime looks at its file once a second."""
LONGER_THAN_RC_LOSS_S = SEEN_WITHIN_S + 1.3
TRIES = 8
"""A busy machine may delay the service in some tries; the clock would vent the vine in every try."""
BENDS_WITHIN_S = 10.0
"""If the service was delayed during the move of the switch, it vented and waits for the next move."""


@pytest.fixture
async def served(tmp_path: Path) -> AsyncIterator[Served]:
    library = next(Path(need("faketime", FAKETIME)).parents[1].glob("lib/*/faketime/libfaketimeMT.so.1"))
    jump = tmp_path / "jump"
    jump.write_text("+0")
    env = {
        "LD_PRELOAD": str(library),
        "FAKETIME_TIMESTAMP_FILE": str(jump),
        "FAKETIME_CACHE_DURATION": "1",
        "FAKETIME_DISABLE_SHM": "1",
        "FAKETIME_DONT_FAKE_MONOTONIC": "1",  # no program can set the monotonic clock
    }
    autopilot = FakeAutopilot("ardupilot", signing_key=KEY, unix_s=time.time())
    async with on_bench(tmp_path, autopilot) as served:
        served.environment = {**os.environ, **env}
        key = tmp_path / "key"
        key.write_text(KEY.hex())
        key.chmod(0o600)
        text = served.config_file.read_text()
        assert 'signing_key = ""' in text
        served.config_file.write_text(text.replace('signing_key = ""', 'signing_key = "key"'))
        yield served


async def stays_bent(served: Served, jumps: Callable[[str], object], jump: str) -> bool:
    """True if the vine bends and stays bent while the clock jumps and returns. Afterwards it is straight."""
    served.bend_full()
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(BENDS_WITHIN_S):
            await served.bent()
    jumps(jump)
    await asyncio.sleep(LONGER_THAN_RC_LOSS_S)
    bent = served.phlosar.cv_kPa > 15.0
    served.straighten()
    await served.vented()
    jumps("+0")
    await asyncio.sleep(SEEN_WITHIN_S)
    return bent


async def test_clock_jumps(served: Served, tmp_path: Path) -> None:
    jumps = (tmp_path / "jump").write_text
    await served.serve()
    was_delayed = False
    for jump in JUMPS:
        tries = [await stays_bent(served, jumps, jump)]
        while not tries[-1] and len(tries) < TRIES:
            tries.append(await stays_bent(served, jumps, jump))
        assert tries[-1], jump
        was_delayed |= len(tries) > 1
    assert served.process is not None
    served.process.terminate()
    output = await served.output()
    assert "own clock jumped" in output, "by years, which signing does not follow"
    losses = () if was_delayed else ("RC lost", "silent")
    assert not [word for word in (*losses, "refused messages") if word in output], output
