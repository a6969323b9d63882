"""The real service with its page, as a process between the stand-ins."""

from __future__ import annotations

import asyncio
import contextlib
import re
import socket
import sys
from collections.abc import AsyncIterator
from pathlib import Path

from gateway_process import gateway_of
from ports import free_port
from service_bench import Bench, on_bench
from waiting import until

from flying_vines.simulation.autopilot import FakeAutopilot


class Served:
    """The service as a process, with a page."""

    def __init__(self, bench: Bench, folder: Path, host: str) -> None:
        self.bench = bench
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}/"
        self.config_file = folder / "vine.toml"
        text = bench.configuration.replace("bench_mode = true", "bench_mode = false")
        text = text.replace('host = "127.0.0.1"', f'host = "{host}"')
        self.config_file.write_text(re.sub(r"^port = 0", f"port = {self.port}", text, flags=re.MULTILINE))
        self.output = folder / "output.txt"
        """The service's standard output."""
        self._process: asyncio.subprocess.Process | None = None

    async def start(self) -> None:
        arguments = (
            "run",
            "--config",
            str(self.config_file),
            "--plain",
            "--out",
            str(self.config_file.parent / "out"),
        )
        with self.output.open("w") as output:
            self._process = await asyncio.create_subprocess_exec(
                sys.executable, "-m", "flying_vines", *arguments, stdout=output
            )
        await until(self.listens, "the page is served")

    def listens(self) -> bool:
        with socket.socket() as probe:
            return bool(probe.connect_ex(("127.0.0.1", self.port)) == 0)

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    @property
    def gateway(self) -> int:
        """Process id of the gateway, which serves the page."""
        return gateway_of(self.pid)

    async def kill(self) -> None:
        assert self._process is not None
        with contextlib.suppress(ProcessLookupError):
            self._process.kill()
        await self._process.wait()


@contextlib.asynccontextmanager
async def serving(folder: Path, host: str = "127.0.0.1") -> AsyncIterator[Served]:
    async with on_bench(FakeAutopilot("ardupilot")) as bench:
        served = Served(bench, folder, host)
        await served.start()
        try:
            yield served
        finally:
            await served.kill()
