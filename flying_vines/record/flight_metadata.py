"""Versions, machine and firmware of a recorded flight, for the reader of the log."""

from __future__ import annotations

import platform
import time
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from firmware_link import protocol

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
    def of_this_machine(cls, began_s: float, continues: str) -> FlightMetadata:
        """`began_s` is unix time."""
        return cls(
            began=time.strftime("%Y-%m-%d %H:%M:%S %z", time.localtime(began_s)),
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
