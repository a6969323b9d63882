"""The telemetry rate during and after a calibration."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
from real_time import real_time

from firmware_link.protocol import Setting
from flying_vines.calibration.rig import carries_every_step, every_step
from flying_vines.config.address import SerialAddress, parse_address
from flying_vines.physics.plant.effects import Effects
from flying_vines.service import link_settings
from flying_vines.service.link_settings import SettingsError
from flying_vines.simulation.phlosar.phlosar import PtyPhlosar, SimulatedPhlosar

pytestmark = real_time

USUAL_HZ = 50


@asynccontextmanager
async def board() -> AsyncIterator[SerialAddress]:
    firmware = {"telemetry_Hz": USUAL_HZ}
    with PtyPhlosar(SimulatedPhlosar(firmware=firmware, effects=Effects())) as port:
        living = asyncio.create_task(port.run())
        yield SerialAddress(port.path)
        living.cancel()
        await asyncio.wait([living])


async def rate_Hz(address: SerialAddress) -> float:
    return of(await link_settings.exchange_settings(address, {}, asyncio.Event()))


def of(settings: object) -> float:
    assert isinstance(settings, list)
    return next(s.value for s in settings if isinstance(s, Setting) and s.name == "telemetry_Hz")


class Boom(Exception):
    pass


async def test_it_is_set_back_whatever_happens() -> None:
    warnings: list[str] = []
    async with board() as address:
        with pytest.raises(Boom):
            async with every_step(address, asyncio.Event(), warnings.append) as settings:
                assert of(settings) == 1000.0
                assert await rate_Hz(address) == 1000.0
                raise Boom
        assert await rate_Hz(address) == USUAL_HZ
    assert warnings == []


async def test_it_is_set_back_when_it_is_cancelled() -> None:
    inside = asyncio.Event()

    async def calibrate(address: SerialAddress) -> None:
        async with every_step(address, asyncio.Event(), lambda warning: None):
            inside.set()
            await asyncio.Event().wait()

    async with board() as address:
        calibrating = asyncio.create_task(calibrate(address))
        await asyncio.wait_for(inside.wait(), 10.0)
        calibrating.cancel()
        with pytest.raises(asyncio.CancelledError):
            await calibrating
        assert await rate_Hz(address) == USUAL_HZ


async def test_a_board_that_goes_away_gives_a_warning_with_what_to_do(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(link_settings, "ANSWERS_WITHIN_S", 0.5)
    warnings: list[str] = []
    with PtyPhlosar(SimulatedPhlosar(effects=Effects())) as port:
        living = asyncio.create_task(port.run())
        async with every_step(SerialAddress(port.path), asyncio.Event(), warnings.append):
            living.cancel()
            await asyncio.wait([living])
    assert len(warnings) == 1
    assert "--set telemetry_Hz=100" in warnings[0]


async def test_without_an_answer_nothing_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link_settings, "ANSWERS_WITHIN_S", 0.5)
    with PtyPhlosar(SimulatedPhlosar(effects=Effects())) as port, pytest.raises(SettingsError):
        async with every_step(SerialAddress(port.path), asyncio.Event(), lambda warning: None):
            pytest.fail("there is nobody")


@pytest.mark.parametrize(
    ("address", "carries"),
    [
        ("serial:/dev/ttyACM0", True),
        ("usb:16c0:0483", True),
        ("tcp:127.0.0.1:5760", True),
        ("serial:/dev/ttyAMA0:921600", True),
        ("serial:/dev/ttyAMA0:115200", False),
        ("serial:/dev/ttyUSB0", False),
    ],
)
def test_a_slow_line_keeps_its_rate(address: str, carries: bool) -> None:
    assert carries_every_step(parse_address(address)) is carries
