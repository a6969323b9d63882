"""The service as a process between a simulated autopilot and a board with recorded valves."""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
from collections.abc import AsyncIterator, Callable
from pathlib import Path

from ports import free_port
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from service_bench import between
from waiting import until

from flying_vines.physics.plant.effects import Effects
from flying_vines.record.reader import FlightLog, LogError
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.autopilot_server import AutopilotServer, GroundStation
from flying_vines.simulation.phlosar.phlosar import PtyPhlosar, SimulatedPhlosar

from .black_box import BlackBox
from .watched import HIGH, LOW, MIDDLE, SWITCH


class Served:
    """One rig on a bench. The service may be started several times."""

    def __init__(
        self, folder: Path, autopilot: FakeAutopilot, ground: GroundStation, companion_port: int
    ) -> None:
        self.folder = folder
        self.autopilot = autopilot
        self.ground = ground
        self.phlosar = SimulatedPhlosar(effects=Effects())
        self.box = BlackBox(self.phlosar)
        self.device = folder / "phlosar"
        self.config_file = folder / "vine.toml"
        text = between(companion_port, str(self.device)).replace("bench_mode = false", "bench_mode = true")
        text = text.replace('folder = ""', 'folder = "state"').replace("settle_s = 1.0", "settle_s = 0.2")
        self.config_file.write_text(text)
        self.environment = {**os.environ}
        self.process: asyncio.subprocess.Process | None = None
        self._port: PtyPhlosar | None = None
        self._port_task: asyncio.Task[None] | None = None

    @property
    def command(self) -> list[str]:
        run = ["run", "--config", str(self.config_file), "--plain", "--out", str(self.folder / "flights")]
        return [sys.executable, "-m", "flying_vines", *run]

    def plug_in(self) -> None:
        self._port = PtyPhlosar(self.phlosar, self.device)
        self._port_task = asyncio.create_task(self._port.run())

    async def unplug(self) -> None:
        """Unplug the line. The board's time stops until a test advances it."""
        assert self._port is not None
        assert self._port_task is not None
        self._port.close()
        self._port_task.cancel()
        await asyncio.wait([self._port_task])

    async def serve(self, terminal: int | None = None) -> None:
        """Start the service, and wait until the switch is accepted. With `terminal` it shows its live view
        there."""
        self.ground.texts.clear()
        flights = len(self._logs)
        self.autopilot.set_rc(SWITCH, LOW)
        self.process = await asyncio.create_subprocess_exec(
            *(part for part in self.command if terminal is None or part != "--plain"),
            stdin=terminal,
            stdout=asyncio.subprocess.PIPE if terminal is None else terminal,
            stderr=asyncio.subprocess.STDOUT,
            env={**self.environment, "TERM": "xterm"},
        )
        await until(lambda: len(self._logs) > flights, "the service runs")
        await until(lambda: self._switch_is_accepted, "the switch is accepted")

    @property
    def _logs(self) -> list[Path]:
        """The logs of all flights, in order."""
        return sorted((self.folder / "flights").glob("*/flight.mcap"))

    @property
    def _switch_is_accepted(self) -> bool:
        try:
            snapshots = [entry.fields for entry in FlightLog(self._logs[-1]).entries(("snapshot",))]
        except LogError:
            return False  # the file is still empty
        return bool(snapshots) and snapshots[-1].get("switch_position") == 0

    def straighten(self) -> None:
        self.autopilot.set_rc(SWITCH, LOW)

    def bend_half(self) -> None:
        self.autopilot.set_rc(SWITCH, MIDDLE)

    def bend_full(self) -> None:
        self.autopilot.set_rc(SWITCH, HIGH)

    def set_parameter(self, name: str, value: float) -> None:
        self.ground.send(
            mavlink.MAVLink_param_set_message(1, 191, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32)
        )

    def block_flights(self) -> Callable[[], None]:
        """Put a file in the place of the flights' folder. The returned function removes it."""
        flights = self.folder / "flights"
        flights.write_text("")
        return flights.unlink

    def damage_state(self) -> Callable[[], None]:
        parameters = self.folder / "state" / "vine.parameters.toml"
        parameters.parent.mkdir()
        parameters.write_text("VINE_RATE_HZ = 3.0.0\n")
        return parameters.unlink

    async def bent(self, above_kPa: float = 15.0) -> None:
        await until(lambda: self.phlosar.cv_kPa > above_kPa, "the vine bends")

    async def vented(self) -> None:
        await until(lambda: self.phlosar.cv_kPa < 1.0 and self.phlosar.drive.solenoid, "the vine vents")

    async def until_text(self, text: str) -> None:
        await until(lambda: text in "".join(self.ground.texts), f"the ground station reads {text!r}")

    async def output(self) -> str:
        """The output of the service, after its end."""
        assert self.process is not None
        text, _ = await self.process.communicate()
        return text.decode()


@contextlib.asynccontextmanager
async def on_bench(folder: Path, autopilot: FakeAutopilot | None = None) -> AsyncIterator[Served]:
    autopilot = autopilot or FakeAutopilot("ardupilot")
    ground = GroundStation()
    ground_port = await ground.listen()
    companion_port = free_port()
    server = AutopilotServer(autopilot, ("127.0.0.1", companion_port), ("127.0.0.1", ground_port))
    served = Served(folder, autopilot, ground, companion_port)
    running = [asyncio.create_task(part.run()) for part in (server, ground)]
    served.plug_in()
    try:
        yield served
    finally:
        if served.process is not None and served.process.returncode is None:
            served.process.kill()
            print(await served.output())  # pytest shows it if the test fails
        await served.unplug()
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)
