"""The files to install, and their contents from templates."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import Template

from firmware_link.find import UsbBoard
from flying_vines.config import config as configuration
from flying_vines.config.toml_edit import value_text, with_value
from flying_vines.install.program import InstallError

USER = "flying-vines"
SERVICE = "flying-vines.service"
UNIT = Path("/etc/systemd/system") / SERVICE
RULE = Path("/etc/udev/rules.d/60-phlosar.rules")
USERS = Path("/etc/sysusers.d/flying-vines.conf")
CONFIGURATION = Path("/etc/flying-vines/vine.toml")
STATE = Path("/var/lib/flying-vines")
FLIGHTS = STATE / "flights"

HEAD = "# Written by `flying-vines install-service`; `flying-vines install-service --remove` deletes it.\n"
"""The first line of each file from a template."""

PORT = "serial:/dev/phlosar"
TEENSY = UsbBoard(0x16C0, 0x0483)
_HOMES = tuple(map(Path, ("/home", "/root", "/run/user")))
_USER_NAME = re.compile(r"[a-z_][a-z0-9_-]*", re.ASCII)
_PLAIN_SERIAL_NUMBER = re.compile(r"[\w.-]+", re.ASCII)


@dataclass(frozen=True, slots=True)
class File:
    """A file to install. `keep_existing`: an existing file is not changed."""

    path: Path
    text: str
    keep_existing: bool = False


def unit(command: Iterable[str], user: str, config_file: Path, read: Iterable[Path], write: Path) -> File:
    """The systemd unit. The service needs access to `read` (paths) and `write` (folder)."""
    if not _USER_NAME.fullmatch(user):
        raise InstallError(f"{user!r} is not a valid user name: use a-z, 0-9, _ and -")
    words = [*command, "run", "--config", str(config_file), "--out", str(FLIGHTS)]
    at_home = any(path.is_relative_to(home) for path in (*read, config_file, write) for home in _HOMES)
    return _filled(
        UNIT,
        command=" ".join(map(_word, words)),
        user=user,
        home="read-only" if at_home else "yes",
        write="" if write.is_relative_to(STATE) else f"ReadWritePaths={_word(str(write))}\n",
    )


def rule(board: UsbBoard) -> File:
    """The udev rule for the board."""
    which = f'ATTRS{{idVendor}}=="{board.vendor_id:04x}", ATTRS{{idProduct}}=="{board.product_id:04x}"'
    if board.serial_number is not None:
        if not _PLAIN_SERIAL_NUMBER.fullmatch(board.serial_number):
            raise InstallError(f"{board}: udev cannot match this serial number; remove it from the id")
        which += f', ATTRS{{serial}}=="{board.serial_number}"'
    return _filled(RULE, board=which)


def users() -> File:
    """The service's user, without a login."""
    return _filled(USERS, user=USER, state=str(STATE))


def built_in_configuration() -> File:
    """The built-in configuration, with the udev rule's port and the state folder."""
    text = with_value(configuration.default_text(), "firmware", "link", value_text(PORT))
    return File(
        CONFIGURATION, with_value(text, "state", "folder", value_text(str(STATE))), keep_existing=True
    )


def _filled(path: Path, **values: str) -> File:
    template = resources.files("flying_vines.install").joinpath("templates", path.name)
    return File(path, HEAD + Template(template.read_text(encoding="utf-8")).substitute(values))


def _word(text: str) -> str:
    """One word of a command line in a unit, quoted for systemd."""
    if not text.isprintable():
        raise InstallError(f"{text!r} cannot be written into a unit")
    text = text.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    return f'"{text}"' if re.search(r"[\s'\"\\]", text) else text
