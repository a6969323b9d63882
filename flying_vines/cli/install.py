"""`flying-vines install-service`: installs or removes the systemd service, after showing the changes."""

from __future__ import annotations

import argparse
import os
import pwd
import shlex
import subprocess
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from firmware_link.find import UsbBoard
from flying_vines.cli.common import add_option, file_errors
from flying_vines.config import config as configuration
from flying_vines.install import files
from flying_vines.install.changes import (
    FileChange,
    How,
    below,
    holds_anything,
    installing,
    remove_empty,
    removing,
)
from flying_vines.install.program import FileReader, InstalledProgram, InstallError, check_reachable

if TYPE_CHECKING:
    from rich.console import Console

    from flying_vines.config.config import Config

INCOMPLETE = 1
THIS_MACHINE = Path("/")
SYSTEMD_RUNS = Path("/run/systemd/system")
NEW_RULES = ("systemctl daemon-reload", "udevadm control --reload", "udevadm trigger --subsystem-match=tty")
STYLES = {How.NEW: "green", How.CHANGED: "yellow", How.REMOVED: "red", How.UNCHANGED: "dim"}


@dataclass(frozen=True, slots=True)
class InstallPlan:
    """File changes, and the commands that run before and after them."""

    question: str
    changes: Sequence[FileChange]
    before: Sequence[str] = ()
    after: Sequence[str] = ()
    remarks: Sequence[str] = ()


def add(commands: Any) -> None:
    """Add `install-service` to the parsers of the command line."""
    parser = commands.add_parser(
        "install-service",
        help="start the service with the computer (systemd); shows all changes and asks first",
    )
    parser.add_argument(
        "--remove", action="store_true", help="uninstall; flights and a changed configuration stay"
    )
    add_option(parser, "--yes", help="do not ask")
    add_option(parser, "--config", help=f"the configuration, used in place (default: {files.CONFIGURATION})")
    parser.add_argument(
        "--user",
        default=files.USER,
        metavar="NAME",
        help=f"the service's user (default: {files.USER}, created)",
    )
    parser.add_argument(
        "--port-id", default=str(files.TEENSY), metavar="BOARD", help=f"the phloSAR: {files.TEENSY}[:SERIAL]"
    )
    parser.add_argument(
        "--root",
        type=Path,
        default=THIS_MACHINE,
        metavar="DIR",
        help="write into the system image at DIR; run no command",
    )
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> int:
    root: Path = arguments.root
    with file_errors(root, InstallError, ValueError):
        if root == THIS_MACHINE and os.geteuid() != 0:
            again = shlex.join(("sudo", *InstalledProgram.here().command, "install-service"))
            raise InstallError(f"only root may install a service: {again}")
        plan = _removal(root) if arguments.remove else _installation(arguments)
        return _carry_out(plan, root, arguments.yes)


def _installation(arguments: argparse.Namespace) -> InstallPlan:
    from flying_vines.service.persistent_state import PersistentState

    root: Path = arguments.root
    user: str = arguments.user
    here = root == THIS_MACHINE
    program = InstalledProgram.here() if here else InstalledProgram.below(root)
    config_file = _in_image(root, arguments.config) if arguments.config else files.CONFIGURATION
    written = below(root, config_file)
    fresh = files.built_in_configuration()
    if arguments.config or written.exists():
        config = configuration.load(written)
    else:
        config = configuration.parse(fresh.text, str(config_file))
    read = [
        *program.places,
        *_named(config, config_file.parent),
        *([config_file] if written.exists() else []),
    ]
    if here:
        # Folders and users of an image cannot be checked from here.
        check_reachable(read, _reader(user))
    state_folder = PersistentState.of(config_file, config).parameters.parent
    wanted = [
        *([] if arguments.config else [fresh]),
        *([files.users()] if user == files.USER else []),
        files.rule(UsbBoard.parse(arguments.port_id)),
        files.unit(program.command, user, config_file, read, state_folder),
    ]
    changes = installing(wanted, root)
    remarks = [
        f"The configuration is {config_file}. "
        "Change it, then: sudo systemctl restart flying-vines (which vents first)"
    ]
    if not here and not os.path.lexists(below(root, Path(program.command[0]))):
        remarks.append(
            f"The image has no flying-vines yet: install it as {program.command[0]} (docs/install.md)."
        )
    if changes[-1].how is How.CHANGED:
        remarks.append("A running service keeps its old settings until it is restarted.")
    remarks.append("State and log of the service: systemctl status flying-vines; journalctl -fu flying-vines")
    return InstallPlan(
        "Write these files and run these commands?",
        changes,
        after=[
            *([f"systemd-sysusers {files.USERS}"] if user == files.USER else []),
            *NEW_RULES,
            f"systemctl enable --now {files.SERVICE}",
        ],
        remarks=remarks,
    )


def _in_image(root: Path, path: Path) -> Path:
    """The path that a file has on the machine whose system is at `root`."""
    absolute, image = path.resolve(), root.resolve()
    if not absolute.is_relative_to(image):
        raise InstallError(f"{path} is not in the image {root}: copy it there, and give this path")
    return THIS_MACHINE / absolute.relative_to(image)


def _named(config: Config, folder: Path) -> list[Path]:
    """Public files that a configuration in `folder` names, and the folders of its secret files.

    Secret files cannot be checked before the service's user exists, because this user must own them. The
    service reports a file that it cannot read.
    """
    mqtt = config.mqtt
    public = (config.pneumatics.rig, mqtt.ca_file, mqtt.certificate_file)
    secret = (config.vehicle.signing_key, mqtt.password_file, mqtt.key_file)
    return [folder / name for name in public if name] + [(folder / name).parent for name in secret if name]


def _removal(root: Path) -> InstallPlan:
    changes = removing(root)
    taken = {change.path for change in changes if change.how is How.REMOVED}
    own_user = below(root, files.USERS) in taken
    state_stays = holds_anything(below(root, files.STATE))
    remarks = []
    if state_stays:
        remarks.append(
            f"{files.STATE} stays, with flights and parameters. To delete them: sudo rm -r {files.STATE}"
        )
        if own_user:
            remarks.append(f"Their owner {files.USER} also stays. To delete it: sudo userdel {files.USER}")
    return InstallPlan(
        "Remove these files and run these commands?",
        changes,
        before=[f"systemctl disable --now {files.SERVICE}"] if below(root, files.UNIT) in taken else [],
        after=[
            *(NEW_RULES if taken else ()),
            *([f"userdel {files.USER}"] if own_user and not state_stays else []),
        ],
        remarks=remarks,
    )


def _reader(user: str) -> FileReader:
    try:
        entry = pwd.getpwnam(user)
    except KeyError:
        if user == files.USER:
            return FileReader(user)
        raise InstallError(f"there is no user {user} on this computer") from None
    return FileReader(user, entry.pw_uid, frozenset(os.getgrouplist(user, entry.pw_gid)))


def _carry_out(plan: InstallPlan, root: Path, agreed: bool) -> int:
    from rich.console import Console

    console = Console(markup=False, highlight=False, soft_wrap=True)
    commands = [*plan.before, *plan.after]
    for change in plan.changes:
        _show(change, console)
    if not commands and all(change.how is How.UNCHANGED for change in plan.changes):
        _tell(plan.remarks or ["There is nothing to remove."], console)
        return 0
    here = root == THIS_MACHINE and SYSTEMD_RUNS.is_dir()
    when = "Then" if here else "Not run now, because systemd does not run there"
    console.print(f"\n{when}:", *commands, sep="\n    ", markup=False)
    if not (agreed or _asked(f"\n{plan.question} [y/N] ")):
        console.print("Nothing was changed.")
        return INCOMPLETE
    good = _ran(plan.before, console) if here else True
    for change in plan.changes:
        change.make()
    for folder in (files.CONFIGURATION.parent, files.STATE):
        remove_empty(below(root, folder))
    good &= _ran(plan.after, console) if here else True
    _tell(plan.remarks, console)
    return 0 if good else INCOMPLETE


def _show(change: FileChange, console: Console) -> None:
    why = f" ({change.why})" if change.why else ""
    console.print(
        f"\n{change.path}: {change.how.value}{why}", style=f"bold {STYLES[change.how]}", markup=False
    )
    for line in change.lines():
        console.print(f"    {line}", markup=False)


def _tell(remarks: Iterable[str], console: Console) -> None:
    console.print("", *remarks, sep="\n", markup=False)


def _asked(question: str) -> bool:
    try:
        return input(question).strip().lower() in ("y", "yes")
    except EOFError:
        raise InstallError("no answer on standard input; --yes runs it without a question") from None


def _ran(commands: Sequence[str], console: Console) -> bool:
    """Run all commands, also after a failed one. Returns True if all succeeded."""
    good = True
    for command in commands:
        console.print(f"$ {command}", markup=False)
        try:
            status = subprocess.run(shlex.split(command), check=False).returncode
        except FileNotFoundError:
            status = 127
        if status != 0:
            good = False
            print(f"flying-vines: command failed with status {status}: {command}", file=sys.stderr)
    return good
