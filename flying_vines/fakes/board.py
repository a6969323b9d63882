"""What runs the firmware: its real core where this machine can build it, else the model of it."""

from __future__ import annotations

from typing import Protocol

from firmware_link.protocol import Fault, Mode
from flying_vines.fakes.compiled_firmware import CompiledFirmware, FirmwareBuildError, load
from flying_vines.fakes.firmware import Firmware
from flying_vines.fakes.firmware_settings import FirmwareSettings
from flying_vines.fakes.regulator import Drive


class Board(Protocol):
    """Firmware, whatever runs it. `step` a thousand times a second; bytes and pressures at any time."""

    @property
    def mode(self) -> Mode: ...

    @property
    def faults(self) -> Fault: ...

    @property
    def number(self) -> int: ...

    def receive(self, data: bytes) -> None: ...

    def take_output(self) -> bytes: ...

    def step(self, now_us: int, cv_kPa: float, reservoir_kPa: float) -> Drive: ...

    def reset(self, *, watchdog: bool = False) -> None: ...


def best_board(settings: FirmwareSettings | None = None) -> Board:
    """One that has just started. ValueError for settings that the real firmware does not take."""
    return Firmware(settings) if why_emulated() else CompiledFirmware(settings)


def why_emulated() -> str | None:
    """A sentence, where the real firmware cannot run here."""
    try:
        load()
    except FirmwareBuildError as error:
        return str(error)
    return None
