"""Versions, machine and firmware of a recorded flight, for the reader of the log."""

from __future__ import annotations

import platform
import time
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import msgspec

from firmware_link import protocol
from flying_vines.files.bounded import read_bytes

ABOUT = "about.json"
PACKAGES = ("pymavlink", "pyserial", "pyserial-asyncio-fast", "msgspec", "mcap", "zstandard", "rich")
_BOARD = Path("/proc/device-tree/model")


@dataclass(frozen=True)
class FirmwareIdentity:
    """The firmware's identity, as reported by the board."""

    build: str
    protocol_version: int
    boot_id: int
    """Changes at every reset."""


@dataclass(frozen=True)
class FlightMetadata:
    """The contents of about.json."""

    began: str
    """Local time with its UTC offset."""
    number: int
    """Higher than that of all earlier flights in the folder, whatever the computer's clock says."""
    continues: str
    """The previous folder of this run of the service; empty in its first folder."""
    flying_vines: str
    python: str
    packages: dict[str, str]
    kernel: str
    machine: str
    firmware: FirmwareIdentity | None = None
    """The firmware of the board that answered last."""

    @classmethod
    def of_this_machine(cls, number: int, began_s: float, continues: str) -> FlightMetadata:
        """`began_s` is unix time."""
        return cls(
            began=time.strftime("%Y-%m-%d %H:%M:%S %z", time.localtime(began_s)),
            number=number,
            continues=continues,
            flying_vines=version_of("flying-vines"),
            python=platform.python_version(),
            packages={name: version_of(name) for name in PACKAGES},
            kernel=f"{platform.system()} {platform.release()}",
            machine=_machine(),
        )

    def with_firmware(self, welcome: protocol.Welcome) -> FlightMetadata:
        firmware = FirmwareIdentity(welcome.firmware_build, welcome.protocol_version, welcome.boot_id)
        return replace(self, firmware=firmware)


def number_of(folder: Path) -> int:
    """The number of the flight in a folder; 0 if it is unknown, as in flights of earlier versions."""
    try:
        return max(0, msgspec.json.decode(read_bytes(folder / ABOUT), type=_Numbered).number)
    except (OSError, ValueError, RecursionError):
        return 0


class _Numbered(msgspec.Struct):
    number: int = 0


@cache
def version_of(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


@cache
def _machine() -> str:
    try:
        board = _BOARD.read_text(encoding="utf-8", errors="replace").rstrip("\0\n")
    except OSError:
        return platform.machine()
    return f"{board} ({platform.machine()})"
