"""Where a link goes, in MAVLink's customary notation."""

from __future__ import annotations

import contextlib
import re
from dataclasses import dataclass
from typing import Literal
from urllib.parse import urlsplit

from firmware_link.find import FORM as USB_FORM
from firmware_link.find import UsbBoard

FORMS = f"serial:/dev/NAME[:BAUD], {USB_FORM}, udpin:HOST:PORT, udpout:HOST:PORT or tcp:HOST:PORT"
DEFAULT_BAUD = 115200
BROKER_FORMS = "mqtt://HOST[:PORT], or mqtts://HOST[:PORT] for TLS"
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


@dataclass(frozen=True, slots=True)
class BrokerAddress:
    """An MQTT broker."""

    host: str
    port: int
    tls: bool


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


def parse_broker(text: str) -> BrokerAddress:
    """Raises `ValueError` with a sentence when `text` is none of the forms."""
    if "@" in text:
        raise ValueError("user and password do not belong into the address: give username and password_file")
    with contextlib.suppress(ValueError):
        url = urlsplit(text)
        usual_port = {"mqtt": 1883, "mqtts": 8883}.get(url.scheme)
        port = url.port if url.port is not None else usual_port
        if usual_port and port and url.hostname and not (url.path or url.query or url.fragment):
            return BrokerAddress(url.hostname, port, url.scheme == "mqtts")
    raise ValueError(f"'{text}' is no broker: give {BROKER_FORMS}")
