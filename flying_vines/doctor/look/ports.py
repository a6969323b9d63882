"""The ports that the profile names: what is there, whose it is, who holds it."""

from __future__ import annotations

import grp
import os
import pwd
import re
import socket
from pathlib import Path

from serial.tools.list_ports import comports
from serial.tools.list_ports_common import ListPortInfo

from firmware_link.find import BoardNotFoundError, Ports, UsbBoard
from flying_vines.config.address import NetworkAddress, SerialAddress
from flying_vines.doctor.checks.port import PortFacts, Which
from flying_vines.doctor.checks.service import Process
from flying_vines.doctor.look import processes

MODEM_MANAGER = "ModemManager"
KERNEL_ARGUMENTS = Path("/proc/cmdline")
UDEV_DATA = Path("/run/udev/data")

_MAY_BE_MODEM = re.compile(r"tty(ACM|USB)\d+")
_CONSOLE = re.compile(r"\bconsole=(\w+)")
_KEPT_OFF = re.compile(
    r"^E:ID_MM_(DEVICE|PORT|TTY)_IGNORE=1$|^E:ID_MM_DEVICE_MANUAL_SCAN_ONLY=1$", re.MULTILINE
)


def serial_port(
    which: Which, where: str, address: SerialAddress | UsbBoard, ports: Ports = comports
) -> PortFacts:
    """What can be known of a serial port without opening it."""
    try:
        there = sorted(ports(), key=lambda port: str(port.device))
    except (OSError, TypeError, ValueError):
        # pyserial stumbles over a board that is pulled out just now.
        there = []
    try:
        path = address.find(lambda: there) if isinstance(address, UsbBoard) else address.path
    except BoardNotFoundError as error:
        return PortFacts(which, where, missing=str(error))
    if not Path(path).exists():
        others = ", ".join(f"{port.device}{_of(port)}" for port in there) or "no serial port at all"
        return PortFacts(which, where, missing=f"{path} is not there; there is {others}")
    device = os.path.realpath(path)
    board = next((port for port in there if port.device == device and port.vid is not None), None)
    group, member_since_login = _group(path)
    may_be_modem = _MAY_BE_MODEM.fullmatch(Path(device).name) is not None
    return PortFacts(
        which,
        where,
        path=path if path == device else f"{path} → {device}",
        board=_said(board) if board else "",
        usb=str(UsbBoard(board.vid, board.pid, board.serial_number))
        if board and board.vid and board.pid
        else "",
        may_open=os.access(path, os.R_OK | os.W_OK),
        group=group,
        member_since_login=member_since_login,
        held_by=processes.holders(device),
        console=device in _consoles(),
        modem_manager=may_be_modem and processes.named(MODEM_MANAGER),
        modem_manager_kept_off=_kept_off(device),
    )


def udp_port(address: NetworkAddress) -> tuple[Process, ...] | None:
    """Who holds the port that we are to listen on; None where it is free."""
    try:
        with _bound(socket.SOCK_DGRAM, address.host, address.port):
            return None
    except OSError:
        return processes.port_holders("udp", address.port)


def tcp_port(host: str, port: int) -> tuple[str, tuple[Process, ...]]:
    """Why nobody can listen there, empty where one can; and who does."""
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
            # As a server does: what closed lately holds nothing up.
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.bind(where)
    except OSError:
        opened.close()
        raise
    return opened


def _said(port: ListPortInfo) -> str:
    words = [f"usb:{port.vid:04x}:{port.pid:04x}", port.product, port.serial_number]
    return ", ".join(word for word in words if word)


def _of(port: ListPortInfo) -> str:
    return f" ({_said(port)})" if port.vid is not None else ""


def _group(path: str) -> tuple[str, bool]:
    """Whose members may open it, and whether this user has become one since logging in."""
    try:
        group = grp.getgrgid(Path(path).stat().st_gid)
        user = pwd.getpwuid(os.getuid()).pw_name
    except (KeyError, OSError):
        return "", False
    return group.gr_name, user in group.gr_mem and group.gr_gid not in (*os.getgroups(), os.getgid())


def _consoles() -> set[str]:
    """The devices on which the kernel speaks."""
    try:
        said = KERNEL_ARGUMENTS.read_text()
    except OSError:
        return set()
    return {os.path.realpath(f"/dev/{name}") for name in _CONSOLE.findall(said)}


def _kept_off(device: str) -> bool:
    """Whether udev tells ModemManager to leave the device alone."""
    number = Path(device).stat().st_rdev
    try:
        said = (UDEV_DATA / f"c{os.major(number)}:{os.minor(number)}").read_text(errors="replace")
    except OSError:
        return False
    return _KEPT_OFF.search(said) is not None
