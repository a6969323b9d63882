"""The firmware's telemetry, with every step of its regulator for a while, and set back whatever happens."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

from firmware_link.protocol import Setting
from flying_vines.config.address import Address, SerialAddress
from flying_vines.service.link_settings import SettingsError, talk_about_settings

RATE = "telemetry_Hz"
EVERY_STEP_HZ = 1000.0
LEAST_BAUD = 460_800
"""That carries it."""


@asynccontextmanager
async def every_step(
    address: Address, stopped: asyncio.Event, tell: Callable[[str], None]
) -> AsyncIterator[Sequence[Setting]]:
    """Within it telemetry comes with every step, where the line carries that: what is set in the firmware.

    SettingsError where no firmware answers, or once `stopped`. `tell` is told in a sentence why the rate
    stays as it is, and what to do where it cannot be set back.
    """
    known = await talk_about_settings(address, {}, stopped)
    before_Hz = next(setting.value for setting in known if setting.name == RATE)
    if not carries_every_step(address):
        tell(
            f"a line of less than {LEAST_BAUD} baud does not carry telemetry at {EVERY_STEP_HZ:g} Hz: "
            f"it stays at {before_Hz:g} Hz, which is too slow for a diagnosis"
        )
        yield known
        return
    try:
        yield await talk_about_settings(address, {RATE: EVERY_STEP_HZ}, stopped)
    finally:
        try:
            await talk_about_settings(address, {RATE: before_Hz}, asyncio.Event())
        except SettingsError as error:
            tell(
                f"{RATE} is still {EVERY_STEP_HZ:g}, for it cannot be set back: {error}. Later: "
                f"flying-vines link ADDRESS --set {RATE}={before_Hz:g}"
            )


def carries_every_step(address: Address) -> bool:
    """Whether a port has no baud rate of its own (USB, a pseudo-terminal, a network), or one that will do."""
    if not isinstance(address, SerialAddress) or address.baud >= LEAST_BAUD:
        return True
    port = Path(address.path).resolve()
    return port.name.startswith("ttyACM") or port.parent == Path("/dev/pts")
