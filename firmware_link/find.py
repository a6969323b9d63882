"""Finds a board by its USB ids, independent of the name of its port.

A port's name depends on the order in which boards were plugged in. A board that restarts while a program
still has its old port open gets another name. The ids and the serial number do not change. Equal boards have
the same ids, but different serial numbers.
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
        present = sorted((ports or _ports_of_this_machine)(), key=lambda port: port.device)
        found = [port for port in present if self._is(port)]
        if len(found) == 1:
            return str(found[0].device)
        if found:
            raise BoardNotFoundError(self._too_many(found))
        others = ", ".join(map(_described, present)) or "no serial port"
        raise BoardNotFoundError(
            f"{self} is not there: is the board plugged in, powered and flashed? Present: {others}"
        )

    def _is(self, port: ListPortInfo) -> bool:
        same_kind = (port.vid, port.pid) == (self.vendor_id, self.product_id)
        return same_kind and self.serial_number in (None, port.serial_number)

    def _too_many(self, found: list[ListPortInfo]) -> str:
        which = f"{self} matches {len(found)} ports: {', '.join(map(_described, found))}"
        numbers = {port.serial_number for port in found}
        if len(numbers) == len(found) and None not in numbers:
            return f"{which}; add the serial number of the right one, as in {self}:{found[0].serial_number}"
        return f"{which}; give the right one as serial:/dev/serial/by-path/…"


def _ports_of_this_machine() -> Iterable[ListPortInfo]:
    try:
        return comports()
    except (OSError, TypeError, ValueError):
        # pyserial raises these if a board is unplugged while it reads the board's description.
        return []


def _described(port: ListPortInfo) -> str:
    if port.vid is None:
        return str(port.device)
    words = [f"usb:{port.vid:04x}:{port.pid:04x}"]
    if port.product:
        words.append(port.product)
    if port.serial_number:
        words.append(f"serial number {port.serial_number}")
    return f"{port.device} ({', '.join(words)})"
