"""Where a link goes, in MAVLink's customary notation."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

from firmware_link.find import FORM as USB_FORM
from firmware_link.find import UsbBoard

FORMS = f"serial:/dev/NAME[:BAUD], {USB_FORM}, udpin:HOST:PORT, udpout:HOST:PORT or tcp:HOST:PORT"
DEFAULT_BAUD = 115200
_BAUD = re.compile(r"[1-9][0-9]{1,7}")
_PORT = re.compile(r"[0-9]{1,5}")


@dataclass(frozen=True, slots=True)
class SerialAddress:
    """A serial port. USB serial devices ignore the baud rate."""

    path: str
    baud: int = DEFAULT_BAUD


@dataclass(frozen=True, slots=True)
class NetworkAddress:
    """A UDP port to listen on (udpin) or to send to (udpout), or a TCP server to connect to."""

    kind: Literal["udpin", "udpout", "tcp"]
    host: str
    port: int


Address = SerialAddress | UsbBoard | NetworkAddress


def parse_address(text: str) -> Address:
    """Raises `ValueError` with a sentence when `text` is none of the forms."""
    kind, _, rest = text.partition(":")
    if kind == "serial" and rest:
        path, _, baud = rest.rpartition(":")
        if path and _BAUD.fullmatch(baud):
            return SerialAddress(path, int(baud))
        return SerialAddress(rest)
    if kind == "usb":
        return UsbBoard.parse(text)
    host, _, port = rest.rpartition(":")
    if host and _PORT.fullmatch(port) and 0 < int(port) < 65536:
        match kind:
            case "udpin" | "udp":
                return NetworkAddress("udpin", host, int(port))
            case "udpout" | "tcp":
                return NetworkAddress(kind, host, int(port))
    raise ValueError(f"'{text}' is no link: give {FORMS}")
