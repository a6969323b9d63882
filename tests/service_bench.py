"""Two stand-ins on real sockets and a serial port, and a service between them."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from ports import free_port

from flying_vines.config import config
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.autopilot_server import AutopilotServer, GroundStation
from flying_vines.simulation.phlosar.phlosar import PtyPhlosar, SimulatedPhlosar


def between(companion_port: int, serial_path: str) -> str:
    """The default configuration's text, for a service between this UDP port and this serial port."""
    return (
        config.default_text()
        .replace("udpin:127.0.0.1:14540", f"udpin:127.0.0.1:{companion_port}")
        .replace("serial:/dev/ttyACM0", f"serial:{serial_path}")
        .replace("port = 8017", "port = 0")
    )


@dataclass
class Bench:
    """Two fakes, and the configuration of a service between them."""

    autopilot: FakeAutopilot
    phlosar: SimulatedPhlosar
    port: PtyPhlosar
    ground: GroundStation
    configuration: str

    def vented(self) -> bool:
        return self.phlosar.cv_kPa < 1.0 and self.phlosar.drive.evp == 0.0 and self.phlosar.drive.solenoid

    def bent(self) -> bool:
        return self.phlosar.cv_kPa > 15.0

    async def bend(self) -> None:
        """Bend by the switch. A move counts only one second after RC is good."""
        for pulse in (1000, 2000) * 5:
            self.autopilot.set_rc(9, pulse)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(2.0):
                    while not self.bent():
                        await asyncio.sleep(0.01)
                    return
        raise AssertionError("the vine never bent")


@contextlib.asynccontextmanager
async def on_bench(autopilot: FakeAutopilot) -> AsyncIterator[Bench]:
    autopilot.set_rc(9, 1000)
    ground = GroundStation()
    ground_port = await ground.listen()
    companion_port = free_port()
    phlosar = SimulatedPhlosar()
    server = AutopilotServer(autopilot, ("127.0.0.1", companion_port), ("127.0.0.1", ground_port))
    with TemporaryDirectory() as folder, PtyPhlosar(phlosar, Path(folder) / "phlosar") as port:
        text = between(companion_port, port.path).replace("bench_mode = false", "bench_mode = true")
        running = [asyncio.create_task(part.run()) for part in (server, port, ground)]
        yield Bench(autopilot, phlosar, port, ground, text)
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)
