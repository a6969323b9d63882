"""mavsdk's own importer reads the same items from the example plans."""

from __future__ import annotations

import asyncio
import contextlib

import pytest
from mission_building import EXAMPLES, KINDS
from waiting import MAX_WAIT_S

from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.autopilot_server import AutopilotServer
from flying_vines.vehicle.mission.item import AutopilotKind, has_place
from missions.files import load_items
from missions.item_for_intent import over_the_wire
from missions.link import vehicle

pytest.importorskip(
    "mavsdk", reason="needs mavsdk: pip install 'flying-vines[missions]' (64-bit systems only)"
)

GLOBAL_INT = {0: 5, 5: 5}
"""Two numbers for one frame: with 7 decimals as in MISSION_ITEM_INT, or without."""


@pytest.mark.parametrize("kind", KINDS)
async def test_mavsdk_reads_the_plans_as_we_do(kind: AutopilotKind) -> None:
    server = AutopilotServer(FakeAutopilot(kind), None, listen=[("127.0.0.1", 0)])
    flying = asyncio.create_task(server.run())
    try:
        async with asyncio.timeout(MAX_WAIT_S):
            await server.ready.wait()
        async with vehicle(f"tcp:127.0.0.1:{server.ports[0]}") as found:
            for name in ("bridge_inspection", "canopy_sampling"):
                path = EXAMPLES / f"{name}-{kind}.plan"
                imported = await asyncio.to_thread(
                    found._mission.import_qgroundcontrol_mission, str(path.resolve())
                )
                ours = load_items(path).items
                assert len(imported.mission_items) == len(ours)
                for theirs, item in zip(imported.mission_items, map(over_the_wire, ours), strict=True):
                    assert (theirs.seq, theirs.command) == (item.seq, item.command)
                    frames = (theirs.frame, item.frame)
                    assert len({GLOBAL_INT.get(frame, frame) for frame in frames}) == 1
                    scale = 1e7 if has_place(item.command, item.frame) else 1.0
                    x, y, z = item.params[4:]
                    assert (theirs.x, theirs.y) == (round(x * scale), round(y * scale))
                    numbers = (theirs.param1, theirs.param2, theirs.param3, theirs.param4, theirs.z)
                    assert numbers == pytest.approx((*item.params[:4], z), nan_ok=True)
    finally:
        flying.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await flying
