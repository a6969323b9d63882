"""Checks a port before it is opened: does it exist, may we open it, who else uses it?"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from flying_vines.doctor.checks.service import Process, named
from flying_vines.doctor.finding import DoctorFinding, FindingText

Which = Literal["phloSAR", "vehicle"]
_UART = re.compile(r"serial:/dev/(ttyAMA|ttyS|serial)\d")
_BY_NUMBER = re.compile(r"/dev/tty(ACM|USB)\d+")


@dataclass(frozen=True, slots=True)
class PortFacts:
    """The port of a link of the configuration."""

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


def lines_of(which: Which) -> dict[str, FindingText]:
    """All lines for one of the two ports."""
    check, table = f"{which} port", "firmware" if which == "phloSAR" else "vehicle"
    return {
        "good": FindingText(check, "good", "{path} ({board}): accessible and not in use"),
        "network": FindingText(check, "skipped", "{where} is on the network: no port to check"),
        "free": FindingText(check, "good", "{where} is free"),
        "missing": FindingText(
            check,
            "bad",
            "{why}",
            f"plug it in and switch it on, or correct {table}.link",
        ),
        "no uart": FindingText(
            check,
            "bad",
            "{why}",
            "on a Raspberry Pi: sudo raspi-config, Interface Options, Serial Port: login shell off, hardware "
            "on (enable_uart=1); for ttyAMA0 on a Pi with Bluetooth also dtoverlay=disable-bt; restart; "
            f"or correct {table}.link (docs/wiring.md)",
        ),
        "not allowed": FindingText(
            check,
            "bad",
            "{path} may not be opened by this user",
            "join its group (sudo usermod -aG {group} $USER), then log in again",
        ),
        "log in again": FindingText(
            check,
            "bad",
            "{path} may not be opened yet: group {group} was joined after the login",
            "log out and log in again",
        ),
        "served": FindingText(check, "skipped", "{path} is used by the running service"),
        "held": FindingText(check, "bad", "{path} is used by {who}", "end that program"),
        "console": FindingText(
            check,
            "bad",
            "{path} is the kernel's console: the kernel's messages go to the connected device",
            "sudo raspi-config, Interface Options, Serial Port: login shell off, hardware on; then restart",
        ),
        "modem": FindingText(
            check,
            "warning",
            "ModemManager runs. It may take {path} for a modem and send to it for seconds",
            "exclude the port by a udev rule (flying-vines install-service has one), or purge modemmanager",
        ),
        "kept off": FindingText(check, "good", "ModemManager runs, but a udev rule excludes {path}"),
        "by number": FindingText(
            check,
            "warning",
            "{path} is a numbered name: it may change when the board restarts",
            f'set {table}.link = "{{usb}}"',
        ),
    }


LINES: dict[Which, dict[str, FindingText]] = {"phloSAR": lines_of("phloSAR"), "vehicle": lines_of("vehicle")}


def check(facts: PortFacts) -> list[DoctorFinding]:
    """The findings about a serial port."""
    lines = LINES[facts.which]
    if facts.missing:
        return [lines["no uart" if _UART.match(facts.where) else "missing"](why=facts.missing)]
    found = []
    if facts.console:
        found.append(lines["console"](path=facts.path))
    if not facts.may_open:
        line = lines["log in again" if facts.member_since_login else "not allowed"]
        found.append(line(path=facts.path, group=facts.group or "dialout"))
    if facts.served:
        found.append(lines["served"](path=facts.path))
    elif facts.held_by:
        found.append(lines["held"](path=facts.path, who=named(facts.held_by)))
    if not found:
        found.append(lines["good"](path=facts.path, board=facts.board or "no board on USB"))
    if facts.modem_manager:
        line = lines["kept off" if facts.modem_manager_kept_off else "modem"]
        found.append(line(path=facts.path))
    if facts.usb and _BY_NUMBER.fullmatch(facts.where.removeprefix("serial:").partition(":")[0]):
        found.append(lines["by number"](path=facts.path, usb=facts.usb))
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
    lines = LINES[which]
    if not listens:
        return lines["network"](where=where)
    if held_by is None:
        return lines["free"](where=where)
    if served:
        return lines["served"](path=where)
    return lines["held"](path=where, who=named(held_by) or "a program of another user")
