"""A port before it is opened: is it there, may it be opened, who else is on it?"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from flying_vines.doctor.checks.service import Process, named
from flying_vines.doctor.finding import DoctorFinding, FindingText

Which = Literal["phloSAR", "vehicle"]
_BY_NUMBER = re.compile(r"/dev/tty(ACM|USB)\d+")


@dataclass(frozen=True, slots=True)
class PortFacts:
    """Where a link of the profile goes."""

    which: Which
    where: str
    """As the profile has it."""
    path: str = ""
    """The device that it is now; empty where there is none."""
    missing: str = ""
    """Why there is none: a sentence."""
    board: str = ""
    """What it says of itself on USB; empty for another port."""
    usb: str = ""
    """How the profile would name this very board."""
    may_open: bool = True
    group: str = ""
    """Whose members may open it."""
    member_since_login: bool = False
    """This user is in that group by now, but was not when he logged in."""
    held_by: tuple[Process, ...] = ()
    served: bool = False
    """Our own service holds it."""
    console: bool = False
    """The kernel writes its own messages there."""
    modem_manager: bool = False
    """It runs, and would look for a modem on this port."""
    modem_manager_kept_off: bool = False


def lines_of(which: Which) -> dict[str, FindingText]:
    """The lines that can be said of one of the two."""
    check, table = f"{which} port", "firmware" if which == "phloSAR" else "vehicle"
    return {
        "good": FindingText(check, "good", "{path} ({board}): may be opened, and nobody else holds it"),
        "network": FindingText(
            check, "skipped", "{where} is on the network: there is nothing to look at beforehand"
        ),
        "free": FindingText(check, "good", "{where} is free"),
        "missing": FindingText(
            check,
            "bad",
            "{why}",
            f"plug it in and switch it on, or name the right port in {table}.link",
        ),
        "not allowed": FindingText(
            check,
            "bad",
            "{path} may not be opened by this user",
            "add yourself to its group (sudo usermod -aG {group} $USER), then log in again",
        ),
        "log in again": FindingText(
            check,
            "bad",
            "{path} may not be opened yet: group {group} was joined after logging in",
            "log out and in again",
        ),
        "served": FindingText(check, "skipped", "{path} is the running service's"),
        "held": FindingText(check, "bad", "{path} is held by {who}", "end that program"),
        "console": FindingText(
            check,
            "bad",
            "{path} is the kernel's console: its messages go to whoever is there",
            "sudo raspi-config, Interface Options, Serial Port: no login shell, but the hardware; restart",
        ),
        "modem": FindingText(
            check,
            "warning",
            "ModemManager runs, and may take {path} for a modem: it then talks to it for seconds",
            "keep it off by a udev rule (flying-vines install-service has one), or purge modemmanager",
        ),
        "kept off": FindingText(check, "good", "ModemManager runs, and is kept off {path} by a udev rule"),
        "by number": FindingText(
            check,
            "warning",
            "{path} is a name by number: the board has another one when it restarts at a bad moment",
            f'set {table}.link = "{{usb}}"',
        ),
    }


LINES: dict[Which, dict[str, FindingText]] = {"phloSAR": lines_of("phloSAR"), "vehicle": lines_of("vehicle")}


def check(facts: PortFacts) -> list[DoctorFinding]:
    """Of a serial port."""
    lines = LINES[facts.which]
    if facts.missing:
        return [lines["missing"](why=facts.missing)]
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
    """Of a link over the network.

    Args:
        which: of the two links.
        where: it goes, as the profile has it.
        listens: whether we wait on a port of this computer for the other end.
        held_by: None where that port is free.
        served: whether our own service holds it.
    """
    lines = LINES[which]
    if not listens:
        return lines["network"](where=where)
    if held_by is None:
        return lines["free"](where=where)
    if served:
        return lines["served"](path=where)
    return lines["held"](path=where, who=named(held_by) or "another user's program")
