"""What runs the firmware: its real core where this machine can build it, else the model of it."""

from __future__ import annotations

from functools import cache
from typing import Protocol

from firmware_link.protocol import Fault, Mode
from flying_vines.simulation.phlosar.compiled_firmware import CompiledFirmware, FirmwareBuildError, load
from flying_vines.simulation.phlosar.firmware import Firmware
from flying_vines.simulation.phlosar.firmware_settings import FirmwareSettings
from flying_vines.simulation.phlosar.regulator import Drive


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


@cache
def why_emulated() -> str | None:
    """A sentence, where the real firmware cannot run here."""
    try:
        load()
    except FirmwareBuildError as error:
        return str(error)
    except OSError as error:
        # A full disk, or a cache from which nothing may be executed.
        return f"the firmware cannot be built and loaded here: {error}"
    return None


class Between:
    """A board in the place of another: hands everything on, for whoever wants to see some of it."""

    def __init__(self, board: Board) -> None:
        self._board = board

    def receive(self, data: bytes) -> None:
        self._board.receive(data)

    def take_output(self) -> bytes:
        return self._board.take_output()

    def step(self, now_us: int, cv_kPa: float, reservoir_kPa: float) -> Drive:
        return self._board.step(now_us, cv_kPa, reservoir_kPa)

    def reset(self, *, watchdog: bool = False) -> None:
        self._board.reset(watchdog=watchdog)

    @property
    def mode(self) -> Mode:
        return self._board.mode

    @property
    def faults(self) -> Fault:
        return self._board.faults

    @property
    def number(self) -> int:
        return self._board.number
