"""`flying-vines doctor --fakes`: a simulated healthy vehicle and phloSAR, to test an installation."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import ExitStack, asynccontextmanager

import msgspec

from flying_vines.config.config import Config
from flying_vines.doctor.radio_test import RadioStep, RadioTest
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.autopilot_server import FIRST_CLIENT, AutopilotServer
from flying_vines.simulation.phlosar.phlosar import PtyPhlosar, SimulatedPhlosar

FAKE_HAND_S = 0.5
"""Delay of the simulated person after each prompt."""


@asynccontextmanager
async def healthy(config: Config) -> AsyncIterator[Config]:
    """The configuration, linked to a simulated vehicle and phloSAR."""
    autopilot = FakeAutopilot("ardupilot", unix_s=time.time())
    autopilot.set_rc(config.switch.channel, 1000)
    phlosar = SimulatedPhlosar(reservoir_kPa=config.pneumatics.full_kPa)
    async with between(config, autopilot, phlosar) as linked:
        yield linked


@asynccontextmanager
async def between(
    config: Config, autopilot: FakeAutopilot, phlosar: SimulatedPhlosar | None
) -> AsyncIterator[Config]:
    """The configuration, linked to the given vehicle and phloSAR, which run until the block ends.

    Without `phlosar` the configuration's firmware link stays.
    """
    server = AutopilotServer(autopilot, FIRST_CLIENT, listen=[("127.0.0.1", 0)])
    await server.open()
    with ExitStack() as stack:
        living = [asyncio.create_task(server.run())]
        firmware = config.firmware.link
        if phlosar is not None:
            port = stack.enter_context(PtyPhlosar(phlosar))
            living.append(asyncio.create_task(port.run()))
            firmware = f"serial:{port.path}"
        try:
            yield linked(config, f"tcp:127.0.0.1:{server.ports[0]}", firmware)
        finally:
            for task in living:
                task.cancel()
            await _ended(living)


def linked(config: Config, vehicle: str, firmware: str) -> Config:
    """The configuration with other links."""
    replace = msgspec.structs.replace
    return replace(
        config,
        vehicle=replace(config.vehicle, link=vehicle),
        firmware=replace(config.firmware, link=firmware),
    )


async def _ended(tasks: Sequence[asyncio.Task[None]]) -> None:
    """Raises the error of a task that failed before it was cancelled."""
    for ended in await asyncio.gather(*tasks, return_exceptions=True):
        if isinstance(ended, BaseException) and not isinstance(ended, asyncio.CancelledError):
            raise ended


class FakeHand:
    """Simulates the person of the radio test: moves the simulated transmitter as the prompts say."""

    def __init__(self, autopilot: FakeAutopilot, config: Config) -> None:
        self._autopilot, self._switch = autopilot, config.switch
        self._done: tuple[int, RadioStep] | None = None
        self._since_s = 0.0
        self._seen: tuple[int, RadioStep] | None = None

    def act(self, test: RadioTest, t: float) -> None:
        now = test.round, test.step
        if now != self._seen:
            self._seen, self._since_s = now, t
        if now == self._done or t - self._since_s < FAKE_HAND_S:
            return
        self._done = now
        match test.step:
            case "ready":
                self._move(test.target)
            case "off":
                test.press(t)
                self._autopilot.lose_rc("frozen")
            case "on":
                self._move(test.target)
                self._autopilot.return_rc()

    def _move(self, position: int) -> None:
        pulse_us = 1000 + round(1000 * position / (len(self._switch.positions) - 1))
        self._autopilot.set_rc(self._switch.channel, pulse_us)
