"""The page's processor time and memory on the companion, and how quickly it vents.

    python benchmarks/page_load.py

The real service runs between the fakes, with 0, 1 and 10 viewers, and with a flood of connections. Measured
are processor time and memory of the page's process and of the service, bytes to each viewer, the time from a
viewer's VENT to its confirmation, and the service's round trip to its board, which shows delays of its loop.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import statistics
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from pathlib import Path

from aiohttp import ClientSession, ClientWebSocketResponse
from process_cost import cpu_s, only_child, pss_MB

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from ports import free_port
from service_bench import on_bench

from flying_vines.simulation.autopilot import FakeAutopilot

SECONDS = 20.0
VENTS = 60
FLOOD_PER_S = 500


class Viewer:
    """Receives everything, and counts it."""

    def __init__(self, socket: ClientWebSocketResponse) -> None:
        self.bytes = 0
        self.round_trips_ms: set[float] = set()
        self._socket = socket
        self._answers: dict[int, asyncio.Future[float]] = {}

    async def run(self) -> None:
        async for message in self._socket:
            self.bytes += len(message.data)
            said = json.loads(message.data)
            if said["kind"] == "snapshot" and said["snapshot"]["round_trip_s"] is not None:
                self.round_trips_ms.add(1e3 * said["snapshot"]["round_trip_s"])
            if said["kind"] == "answer":
                self._answers.pop(said["id"]).set_result(time.perf_counter())

    async def vent_ms(self, number: int) -> float:
        answer: asyncio.Future[float] = asyncio.get_running_loop().create_future()
        self._answers[number] = answer
        began = time.perf_counter()
        await self._socket.send_str(json.dumps({"id": number, "command": "vent"}))
        return 1e3 * (await asyncio.wait_for(answer, 5.0) - began)


async def flood(port: int, made: list[int]) -> None:
    """Connections that begin a request and never end it. `made` counts them."""
    held: list[socket.socket] = []
    while True:
        with contextlib.suppress(OSError):
            connection = socket.create_connection(("127.0.0.1", port), timeout=1.0)
            connection.send(b"GET / HTTP/1.1\r\nX: ")
            held.append(connection)
            made[0] += 1
        if len(held) > FLOOD_PER_S:
            held.pop(0).close()
        await asyncio.sleep(1.0 / FLOOD_PER_S)


@contextlib.asynccontextmanager
async def service(folder: Path) -> AsyncIterator[tuple[int, int]]:
    """Run the service between the fakes. Yields the id of its process and the page's port."""
    async with on_bench(FakeAutopilot("ardupilot")) as bench:
        port = free_port()
        config_file = folder / "vine.toml"
        config_file.write_text(bench.configuration.replace("\nport = 0", f"\nport = {port}"))
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            *("-m", "flying_vines", "run", "--plain", "--config", str(config_file), "--out", str(folder)),
            stdout=asyncio.subprocess.DEVNULL,
        )
        await asyncio.sleep(6.0)
        yield process.pid, port
        process.terminate()
        await process.wait()


async def measure(pid: int, port: int, viewers: int, flooded: bool) -> None:
    page = only_child(pid)
    async with ClientSession() as session, contextlib.AsyncExitStack() as stack:
        watching = []
        for _ in range(viewers):
            watching.append(
                Viewer(await stack.enter_async_context(session.ws_connect(f"http://127.0.0.1:{port}/live")))
            )
        tasks = [asyncio.create_task(viewer.run()) for viewer in watching]
        made = [0]
        if flooded:
            tasks.append(asyncio.create_task(flood(port, made)))
        await asyncio.sleep(2.0)
        made[0] = 0
        before = cpu_s(page), cpu_s(pid), time.monotonic(), [viewer.bytes for viewer in watching]
        await asyncio.sleep(SECONDS)
        passed_s = time.monotonic() - before[2]
        line = f"{viewers:2} viewers, {made[0] / passed_s:3.0f} connections/s"
        line += f"  page {100 * (cpu_s(page) - before[0]) / passed_s:4.1f} % {pss_MB(page):4.0f} MB"
        line += f"  service {100 * (cpu_s(pid) - before[1]) / passed_s:4.1f} % {pss_MB(pid):4.0f} MB"
        if watching:
            each = [(viewer.bytes - was) / passed_s for viewer, was in zip(watching, before[3], strict=True)]
            line += f"  {statistics.mean(each) / 1000:4.1f} kB/s each"
            waits = []
            for number in range(VENTS):
                waits.append(await watching[0].vent_ms(number))
                await asyncio.sleep(0.1)
            line += f"  VENT median {statistics.median(waits):.1f} ms, worst of {VENTS} {max(waits):.1f} ms"
            trips = watching[0].round_trips_ms
            line += (
                f"  board median {statistics.median(trips):.1f} ms, worst of {len(trips)} {max(trips):.1f} ms"
            )
        print(line, flush=True)
        for task in tasks:
            task.cancel()


async def main() -> None:
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    with tempfile.TemporaryDirectory() as folder:
        async with service(Path(folder)) as (pid, port):
            for viewers, flooded in ((0, False), (1, False), (10, False), (1, True)):
                await measure(pid, port, viewers, flooded)


if __name__ == "__main__":
    asyncio.run(main())
