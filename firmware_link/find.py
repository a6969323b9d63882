"""Finds a board by its USB ids, independent of the name of its port.

A port's name depends on the order in which boards were plugged in. If a board restarts while a program still
has its old port open, the new port has another name. The ids and the serial number do not change. Equal
boards have the same ids, but different serial numbers.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Self

from serial.tools.list_ports import comports
from serial.tools.list_ports_common import ListPortInfo

from firmware_link.protocol import LinkError

Ports = Callable[[], Iterable[ListPortInfo]]

FORM = "usb:VENDOR:PRODUCT[:SERIAL]"
_TEXT = re.compile(r"usb:([0-9a-f]{4}):([0-9a-f]{4})(?::([^\s:]+))?", re.IGNORECASE)


class BoardNotFoundError(LinkError):
    """No board matches, or several do. The text lists the ports."""


@dataclass(frozen=True, slots=True)
class UsbBoard:
    """A board on USB. Without a serial number it must be the only one with these ids."""

    vendor_id: int
    product_id: int
    serial_number: str | None = None

    @classmethod
    def parse(cls, text: str) -> Self:
        """`usb:16c0:0483` or `usb:16c0:0483:1234560`. Raises ValueError with a sentence for anything else."""
        found = _TEXT.fullmatch(text)
        if found is None:
            raise ValueError(
                f"'{text}' is not a USB board: give {FORM}, with ids of four hexadecimal digits as in lsusb"
            )
        return cls(int(found[1], 16), int(found[2], 16), found[3])

    def __str__(self) -> str:
        kind = f"usb:{self.vendor_id:04x}:{self.product_id:04x}"
        return kind if self.serial_number is None else f"{kind}:{self.serial_number}"

    def find(self, ports: Ports | None = None) -> str:
        """The board's present port among `ports` (default: this machine's). Raises BoardNotFoundError."""
        present = present_ports(ports)
        found = [port for port in present if self._is(port)]
        if len(found) == 1:
            return str(found[0].device)
        if found:
            raise BoardNotFoundError(self._too_many(found))
        raise BoardNotFoundError(
            f"{self} is not there: is the board plugged in, powered and flashed? Present: {listed(present)}"
        )

    def _is(self, port: ListPortInfo) -> bool:
        same_kind = (port.vid, port.pid) == (self.vendor_id, self.product_id)
        return same_kind and self.serial_number in (None, port.serial_number)

    def _too_many(self, found: list[ListPortInfo]) -> str:
        which = f"{self} matches {len(found)} ports: {listed(found)}"
        numbers = {port.serial_number for port in found}
        if len(numbers) == len(found) and None not in numbers:
            return f"{which}; add the serial number of the right one, as in {self}:{found[0].serial_number}"
        return f"{which}; give the right one as serial:/dev/serial/by-path/…"


def present_ports(ports: Ports | None = None) -> list[ListPortInfo]:
    """The ports that `ports` finds (default: this machine's), sorted by name; none if they cannot be read."""
    try:
        return sorted((ports or comports)(), key=lambda port: str(port.device))
    except (OSError, TypeError, ValueError):
        # pyserial raises these if a board is unplugged while it reads the board's description.
        return []


def description(port: ListPortInfo) -> str:
    """USB ids, product and serial number of the board on a port; empty if the port is not on USB."""
    if port.vid is None:
        return ""
    number = f"serial number {port.serial_number}" if port.serial_number else ""
    return ", ".join(filter(None, (f"usb:{port.vid:04x}:{port.pid:04x}", port.product, number)))


def listed(ports: Iterable[ListPortInfo]) -> str:
    """The names of the ports, with the boards on them."""
    named = ((port.device, description(port)) for port in ports)
    return ", ".join(f"{name} ({board})" if board else name for name, board in named) or "no serial port"
