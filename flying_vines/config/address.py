"""Addresses of links, in MAVLink's usual notation."""

from __future__ import annotations

import contextlib
import ipaddress
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeVar
from urllib.parse import urlsplit

from firmware_link.find import FORM as USB_FORM
from firmware_link.find import UsbBoard

FORMS = (
    f"serial:/dev/NAME[:BAUD], {USB_FORM}, udpin:HOST:PORT[?peer=ADDRESS], udpout:HOST:PORT or tcp:HOST:PORT"
)
T = TypeVar("T")
DEFAULT_BAUD = 115200
BROKER_FORMS = "mqtt://HOST[:PORT], or mqtts://HOST[:PORT] for TLS; an IPv6 address in brackets"
_HOST_NAME = re.compile(r"[^\s:\[\]]+")
_BAUD = re.compile(r"[1-9][0-9]{1,7}")
_BAUDS = range(1200, 12_000_001)
_WITH_COLONS = ("/dev/serial/by-path/", "/dev/serial/by-id/")
"""Folders of devices whose names have colons of their own."""
_NO_DEVICE = re.compile(r"\s.*|.*\s|~.*|.*[,$].*|(tty|serial\d).*")
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
    peer: str = ""
    """`udpin` reads only datagrams from this address; empty: from all addresses."""

    def __str__(self) -> str:
        return f"{self.kind}:{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"

    @property
    def on_loopback(self) -> bool:
        """True if only programs on this computer can be at the other end."""
        try:
            return self.host == "localhost" or _plain(self.host).is_loopback
        except ValueError:
            return False

    @property
    def is_open(self) -> bool:
        """True if anybody on the network can send to us."""
        return self.kind == "udpin" and not self.peer and not self.on_loopback

    def reads(self, sender: str) -> bool:
        """True if datagrams from this IP address are read."""
        return not self.peer or same_address(sender, self.peer)


@dataclass(frozen=True, slots=True)
class BrokerAddress:
    """An MQTT broker."""

    host: str
    port: int
    tls: bool


Address = SerialAddress | UsbBoard | NetworkAddress


def same_port(one: Address, other: Address) -> bool:
    """True if both addresses are one port, of which each frame would reach only one reader."""
    if isinstance(one, SerialAddress) and isinstance(other, SerialAddress):
        return one.path == other.path
    if isinstance(one, NetworkAddress) and isinstance(other, NetworkAddress):
        if one.kind != other.kind or one.port != other.port:
            return False
        return one.kind == "udpin" or one.host == other.host
    return one == other


def same_address(one: str, other: str) -> bool:
    """True if both texts are the same IP address; IPv6 sockets write IPv4 addresses as ::ffff:192.0.2.1."""
    return _plain(one) == _plain(other)


def _plain(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    address = ipaddress.ip_address(text.partition("%")[0])
    return getattr(address, "ipv4_mapped", None) or address


def who_can_command(address: Address, signed: bool) -> str:
    """One line on who can command the vine over the vehicle link."""
    if signed:
        return "signed: only those who have the key can command the vine"
    if not isinstance(address, NetworkAddress):
        return "unsigned: every sender on this port can command the vine"
    if address.on_loopback:
        return "unsigned: every program on this computer can command the vine"
    if address.is_open:
        return "unsigned: anybody on the network can command the vine"
    peer = address.peer or address.host
    return f"unsigned: everybody who sends from {peer} or forges this address can command the vine"


def parse_address(text: str) -> Address:
    """Raises `ValueError` with a sentence if `text` has none of the valid forms."""
    return _parsed(text, _address)


def _parsed(text: str, parse: Callable[[str], T]) -> T:
    """A text that is valid without its spaces gets the error that says so."""
    try:
        return parse(text)
    except ValueError:
        bare = ":".join(part.strip() for part in text.split(":"))
        if bare == text:
            raise
        parse(bare)
        raise ValueError(f"'{text}' has spaces: write {bare}") from None


def _address(text: str) -> Address:
    kind, _, rest = text.partition(":")
    if kind == "serial" and rest:
        return _serial(text, rest)
    if kind == "usb":
        return UsbBoard.parse(text)
    rest, asks, query = rest.partition("?")
    host, _, port = rest.rpartition(":")
    host = _host(host)
    if host and _PORT.fullmatch(port) and 0 < int(port) < 65536:
        match kind:
            case "udpin" | "udp":
                return NetworkAddress("udpin", host, int(port), _peer(query) if asks else "")
            case "udpout" | "tcp" if not asks:
                return NetworkAddress(kind, host, int(port))
    raise ValueError(f"'{text}' is not a link: give {FORMS}")


def _serial(text: str, rest: str) -> SerialAddress:
    path, colon, baud = rest.rpartition(":")
    if not colon or (path.startswith(_WITH_COLONS) and not _BAUD.fullmatch(baud)):
        path, baud = rest, str(DEFAULT_BAUD)
    if not (_BAUD.fullmatch(baud) and int(baud) in _BAUDS):
        raise ValueError(f"'{text}': '{baud}' is no baud rate: write serial:{path}:57600")
    if _NO_DEVICE.fullmatch(path):
        raise ValueError(
            f"'{text}': '{path}' is no device: write its whole path, as in serial:/dev/ttyAMA0:57600"
        )
    return SerialAddress(path, int(baud))


def _host(text: str) -> str:
    """The host name or IP address, an IPv6 address without brackets; empty if it is neither."""
    bare = text[1:-1] if text[:1] == "[" and text[-1:] == "]" else text
    with contextlib.suppress(ValueError):
        ipaddress.IPv6Address(bare)
        return bare
    return text if _HOST_NAME.fullmatch(text) else ""


def _peer(query: str) -> str:
    key, _, peer = query.partition("=")
    peer = _host(peer)
    try:
        address = _plain(peer)
    except ValueError:
        address = None
    if key != "peer" or address is None or address.is_unspecified or address.is_multicast:
        raise ValueError(f"'?{query}' is not a peer: give its IP address, as in ?peer=192.168.4.1")
    return peer


def parse_broker(text: str) -> BrokerAddress:
    """Raises `ValueError` with a sentence if `text` has none of the valid forms."""
    return _parsed(text, _broker)


def _broker(text: str) -> BrokerAddress:
    if "@" in text:
        raise ValueError("remove user and password from the address: set username and password_file")
    with contextlib.suppress(ValueError):
        url = urlsplit(text)
        usual_port = {"mqtt": 1883, "mqtts": 8883}.get(url.scheme)
        port = url.port if url.port is not None else usual_port
        if usual_port and port and url.hostname and not (url.path or url.query or url.fragment):
            return BrokerAddress(url.hostname, port, url.scheme == "mqtts")
    raise ValueError(f"'{text}' is not a broker: give {BROKER_FORMS}")
