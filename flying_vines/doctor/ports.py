"""A port before it is opened: does it exist, may we open it, who else uses it?"""

from __future__ import annotations

import grp
import os
import pwd
import re
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from firmware_link.find import BoardNotFoundError, Ports, UsbBoard, description, listed, present_ports
from flying_vines.config.address import NetworkAddress, SerialAddress
from flying_vines.doctor import processes
from flying_vines.doctor.finding import DoctorFinding, FindingText, Subject
from flying_vines.doctor.processes import Process, all_named, text_of

Which = Literal["phloSAR", "vehicle"]

MODEM_MANAGER = "ModemManager"
KERNEL_ARGUMENTS = Path("/proc/cmdline")
UDEV_DATA = Path("/run/udev/data")

_UART = re.compile(r"serial:/dev/(ttyAMA|ttyS|serial)\d")
_BY_NUMBER = re.compile(r"/dev/tty(ACM|USB)\d+")
_MAY_BE_MODEM = re.compile(r"tty(ACM|USB)\d+")
_CONSOLE = re.compile(r"\bconsole=(\w+)")
_KEPT_OFF = re.compile(
    r"^E:ID_MM_(DEVICE|PORT|TTY)_IGNORE=1$|^E:ID_MM_DEVICE_MANUAL_SCAN_ONLY=1$", re.MULTILINE
)


@dataclass(frozen=True, slots=True)
class PortFacts:
    """The serial port of a link of the configuration."""

    which: Which
    where: str
    """The link as written in the configuration."""
    path: str = ""
    """The present device; empty if there is none."""
    missing: str = ""
    """Why there is no device: a sentence."""
    board: str = ""
    """The device's USB description; empty for other ports."""
    usb: str = ""
    """The link that would name exactly this board."""
    may_open: bool = True
    group: str = ""
    """The group whose members may open the device."""
    member_since_login: bool = False
    """The user has joined the group, but must log in again."""
    held_by: tuple[Process, ...] = ()
    served: bool = False
    """Our own service holds it."""
    console: bool = False
    """The kernel writes its messages to this port."""
    modem_manager: bool = False
    """ModemManager runs and may probe this port."""
    modem_manager_kept_off: bool = False


_PORT = Subject("{which} port")
GOOD = _PORT.good("{path} ({board}): accessible and not in use")
NETWORK = _PORT.skipped("{where} is on the network: no port to check")
FREE = _PORT.good("{where} is free")
MISSING = _PORT.bad("{why}", "plug it in and switch it on, or correct {table}.link")
NO_UART = _PORT.bad(
    "{why}",
    "on a Raspberry Pi: sudo raspi-config, Interface Options, Serial Port: login shell off, hardware on "
    "(enable_uart=1); for ttyAMA0 on a Pi with Bluetooth also dtoverlay=disable-bt; restart; or correct "
    "{table}.link (docs/wiring.md)",
)
NOT_ALLOWED = _PORT.bad(
    "{path} may not be opened by this user",
    "join its group (sudo usermod -aG {group} $USER), then log in again",
)
LOG_IN_AGAIN = _PORT.bad(
    "{path} may not be opened yet: group {group} was joined after the login", "log out and log in again"
)
SERVED = _PORT.skipped("{path} is used by the running service")
HELD = _PORT.bad("{path} is used by {who}", "end that program")
CONSOLE = _PORT.bad(
    "{path} is the kernel's console: the kernel's messages go to the connected device",
    "sudo raspi-config, Interface Options, Serial Port: login shell off, hardware on; then restart",
)
MODEM = _PORT.warning(
    "ModemManager runs. It may take {path} for a modem and send to it for seconds",
    "exclude the port by a udev rule (flying-vines install-service has one), or purge modemmanager",
)
KEPT_OFF = _PORT.good("ModemManager runs, but a udev rule excludes {path}")
BY_NUMBER = _PORT.warning(
    "{path} is a numbered name: it may change when the board restarts", 'set {table}.link = "{usb}"'
)


def _of(which: Which, line: FindingText, **found: object) -> DoctorFinding:
    return line(which=which, table="firmware" if which == "phloSAR" else "vehicle", **found)


def check(facts: PortFacts) -> list[DoctorFinding]:
    """The findings about a serial port."""
    here = partial(_of, facts.which, path=facts.path)
    if facts.missing:
        return [here(NO_UART if _UART.match(facts.where) else MISSING, why=facts.missing)]
    found = []
    if facts.console:
        found.append(here(CONSOLE))
    if not facts.may_open:
        line = LOG_IN_AGAIN if facts.member_since_login else NOT_ALLOWED
        found.append(here(line, group=facts.group or "dialout"))
    if facts.served:
        found.append(here(SERVED))
    elif facts.held_by:
        found.append(here(HELD, who=all_named(facts.held_by)))
    if not found:
        found.append(here(GOOD, board=facts.board or "no board on USB"))
    if facts.modem_manager:
        found.append(here(KEPT_OFF if facts.modem_manager_kept_off else MODEM))
    if facts.usb and _BY_NUMBER.fullmatch(facts.where.removeprefix("serial:").partition(":")[0]):
        found.append(here(BY_NUMBER, usb=facts.usb))
    return found


def check_network(
    which: Which, where: str, listens: bool, held_by: Sequence[Process] | None, served: bool = False
) -> DoctorFinding:
    """The finding about a network link.

    Args:
        which: the link.
        where: the link as written in the configuration.
        listens: True if the link listens on a port of this computer.
        held_by: the processes that use this port; None if it is free.
        served: True if our own service uses it.
    """
    here = partial(_of, which, where=where, path=where)
    if not listens:
        return here(NETWORK)
    if held_by is None:
        return here(FREE)
    return here(SERVED) if served else here(HELD, who=all_named(held_by) or "a program of another user")


def serial_port(
    which: Which, where: str, address: SerialAddress | UsbBoard, ports: Ports | None = None
) -> PortFacts:
    """Facts about a serial port, without opening it."""
    there = present_ports(ports)
    try:
        path = address.find(lambda: there) if isinstance(address, UsbBoard) else address.path
    except BoardNotFoundError as error:
        return PortFacts(which, where, missing=str(error))
    if not Path(path).exists():
        return PortFacts(which, where, missing=f"{path} does not exist; found: {listed(there)}")
    device = os.path.realpath(path)
    board = next((port for port in there if port.device == device and port.vid is not None), None)
    group, member_since_login = _group(path)
    may_be_modem = _MAY_BE_MODEM.fullmatch(Path(device).name) is not None
    return PortFacts(
        which,
        where,
        path=path if path == device else f"{path} → {device}",
        board=description(board) if board else "",
        usb=str(UsbBoard(board.vid, board.pid, board.serial_number))
        if board and board.vid and board.pid
        else "",
        may_open=os.access(path, os.R_OK | os.W_OK),
        group=group,
        member_since_login=member_since_login,
        held_by=processes.holders(device),
        console=device in _consoles(),
        modem_manager=may_be_modem and processes.runs(MODEM_MANAGER),
        modem_manager_kept_off=_kept_off(device),
    )


def udp_port(address: NetworkAddress) -> tuple[Process, ...] | None:
    """The processes that use the port on which we listen; None if it is free."""
    try:
        with _bound(socket.SOCK_DGRAM, address.host, address.port):
            return None
    except OSError:
        return processes.port_holders("udp", address.port)


def tcp_port(host: str, port: int) -> tuple[str, tuple[Process, ...]]:
    """Why the port cannot be opened (empty if it can), and the processes that use it."""
    try:
        with _bound(socket.SOCK_STREAM, host, port):
            return "", ()
    except OSError as error:
        return error.strerror or str(error), processes.port_holders("tcp", port)


def _bound(kind: socket.SocketKind, host: str, port: int) -> socket.socket:
    family, kind, _, _, where = socket.getaddrinfo(host, port, type=kind, flags=socket.AI_PASSIVE)[0]
    opened = socket.socket(family, kind)
    try:
        if kind is socket.SOCK_STREAM:
            # As servers do: a recently closed connection must not block the port.
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.bind(where)
    except OSError:
        opened.close()
        raise
    return opened


def _group(path: str) -> tuple[str, bool]:
    """The device's group, and True if this user has joined it since the login."""
    try:
        group = grp.getgrgid(Path(path).stat().st_gid)
        user = pwd.getpwuid(os.getuid()).pw_name
    except (KeyError, OSError):
        return "", False
    return group.gr_name, user in group.gr_mem and group.gr_gid not in (*os.getgroups(), os.getgid())


def _consoles() -> set[str]:
    """The devices to which the kernel writes messages."""
    return {os.path.realpath(f"/dev/{name}") for name in _CONSOLE.findall(text_of(KERNEL_ARGUMENTS))}


def _kept_off(device: str) -> bool:
    """True if udev excludes the device from ModemManager."""
    number = Path(device).stat().st_rdev
    properties = text_of(UDEV_DATA / f"c{os.major(number)}:{os.minor(number)}")
    return _KEPT_OFF.search(properties) is not None
