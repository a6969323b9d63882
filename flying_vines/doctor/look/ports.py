"""The configured ports: device, permissions, and the processes that use them."""

from __future__ import annotations

import grp
import os
import pwd
import re
import socket
from pathlib import Path

from firmware_link.find import BoardNotFoundError, Ports, UsbBoard, description, listed, present_ports
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
        modem_manager=may_be_modem and processes.named(MODEM_MANAGER),
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
    try:
        arguments = KERNEL_ARGUMENTS.read_text()
    except OSError:
        return set()
    return {os.path.realpath(f"/dev/{name}") for name in _CONSOLE.findall(arguments)}


def _kept_off(device: str) -> bool:
    """True if udev excludes the device from ModemManager."""
    number = Path(device).stat().st_rdev
    try:
        properties = (UDEV_DATA / f"c{os.major(number)}:{os.minor(number)}").read_text(errors="replace")
    except OSError:
        return False
    return _KEPT_OFF.search(properties) is not None
