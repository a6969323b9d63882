"""`flying-vines install-service`: shows what it would write and run, asks, does it; and undoes it."""

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
from flying_vines.cli.bad_input import bad_input
from flying_vines.config import config as configuration
from flying_vines.install import files
from flying_vines.install.changes import (
    FileChange,
    How,
    below,
    holds_anything,
    installing,
    removing,
    take_away_empty,
)
from flying_vines.install.program import FileReader, InstalledProgram, InstallError, check_reachable

if TYPE_CHECKING:
    from rich.console import Console

    from flying_vines.config.config import Config

NOT_ALL = 1
THIS_MACHINE = Path("/")
SYSTEMD_IS_AT_WORK = Path("/run/systemd/system")
NEW_RULES = ("systemctl daemon-reload", "udevadm control --reload", "udevadm trigger --subsystem-match=tty")
STYLES = {How.NEW: "green", How.CHANGED: "yellow", How.TAKEN_AWAY: "red", How.AS_IT_IS: "dim"}


@dataclass(frozen=True, slots=True)
class InstallPlan:
    """The commands are run before and after the files are changed."""

    question: str
    changes: Sequence[FileChange]
    before: Sequence[str] = ()
    after: Sequence[str] = ()
    remarks: Sequence[str] = ()


def add(commands: Any) -> None:
    """Add `install-service` to the parsers of the command line."""
    parser = commands.add_parser(
        "install-service",
        help="let systemd run it whenever the machine runs: shows what that changes, and asks",
    )
    parser.add_argument("--remove", action="store_true", help="undo it; flights and a changed profile stay")
    parser.add_argument("--yes", action="store_true", help="do not ask")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help=f"the profile, where it is (default: {files.PROFILE})"
    )
    parser.add_argument(
        "--user", default=files.USER, metavar="NAME", help=f"who runs it (default: {files.USER}, made for it)"
    )
    parser.add_argument(
        "--port-id", default=str(files.TEENSY), metavar="BOARD", help=f"the phloSAR: {files.TEENSY}[:SERIAL]"
    )
    parser.add_argument(
        "--root",
        type=Path,
        default=THIS_MACHINE,
        metavar="DIR",
        help="write below DIR, an image; run nothing",
    )
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> int:
    root: Path = arguments.root
    try:
        if root == THIS_MACHINE and os.geteuid() != 0:
            again = shlex.join(("sudo", *InstalledProgram.here().command, "install-service"))
            raise InstallError(f"only root may install a service: {again}")
        plan = _removal(root) if arguments.remove else _installation(arguments)
        return _carry_out(plan, root, arguments.yes)
    except (InstallError, ValueError) as error:
        return bad_input(str(error))
    except OSError as error:
        return bad_input(f"{error.filename or root}: {error.strerror}")


def _installation(arguments: argparse.Namespace) -> InstallPlan:
    from flying_vines.service.persistent_state import PersistentState

    root: Path = arguments.root
    user: str = arguments.user
    program = InstalledProgram.here()
    profile = arguments.config.resolve() if arguments.config else files.PROFILE
    written = arguments.config or below(root, profile)
    fresh = files.profile()
    if arguments.config or written.exists():
        config = configuration.load(written)
    else:
        config = configuration.parse(fresh.text, str(profile))
    read = [*program.places, *_named(config, profile.parent), *([profile] if written.exists() else [])]
    if root == THIS_MACHINE:
        # Of an image neither folders nor users can be seen from here.
        check_reachable(read, _reader(user))
    kept_in = PersistentState.of(profile, config).parameters.parent
    wanted = [
        *([] if arguments.config else [fresh]),
        *([files.users()] if user == files.USER else []),
        files.rule(UsbBoard.parse(arguments.port_id)),
        files.unit(program.command, user, profile, read, kept_in),
    ]
    changes = installing(wanted, root)
    remarks = [
        f"The profile is {profile}. Change it, then: sudo systemctl restart flying-vines (which vents first)"
    ]
    if changes[-1].how is How.CHANGED:
        remarks.append("A service that runs goes on as it was until it is restarted.")
    remarks.append("What it does: systemctl status flying-vines; journalctl -fu flying-vines")
    return InstallPlan(
        "Write these, and run those?",
        changes,
        after=[
            *([f"systemd-sysusers {files.USERS}"] if user == files.USER else []),
            *NEW_RULES,
            f"systemctl enable --now {files.SERVICE}",
        ],
        remarks=remarks,
    )


def _named(config: Config, folder: Path) -> list[Path]:
    """What a profile in `folder` has read besides: files for all, and the folders of files for one alone.

    Those can be given to the service's own user only when there is one; it says itself what it cannot read.
    """
    mqtt = config.mqtt
    for_all = (config.pneumatics.rig, mqtt.ca_file, mqtt.certificate_file)
    for_one = (config.vehicle.signing_key, mqtt.password_file, mqtt.key_file)
    return [folder / name for name in for_all if name] + [(folder / name).parent for name in for_one if name]


def _removal(root: Path) -> InstallPlan:
    changes = removing(root)
    taken = {change.path for change in changes if change.how is How.TAKEN_AWAY}
    own_user = below(root, files.USERS) in taken
    state_stays = holds_anything(below(root, files.STATE))
    remarks = []
    if state_stays:
        remarks.append(
            f"{files.STATE} stays, with flights and parameters. To lose them: sudo rm -r {files.STATE}"
        )
        if own_user:
            remarks.append(f"So does the user {files.USER}, whose they are. Then: sudo userdel {files.USER}")
    return InstallPlan(
        "Take these away, and run those?",
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
        raise InstallError(f"there is no user {user} here") from None
    return FileReader(user, entry.pw_uid, frozenset(os.getgrouplist(user, entry.pw_gid)))


def _carry_out(plan: InstallPlan, root: Path, agreed: bool) -> int:
    from rich.console import Console

    console = Console(highlight=False, soft_wrap=True)
    commands = [*plan.before, *plan.after]
    for change in plan.changes:
        _show(change, console)
    if not commands and all(change.how is How.AS_IT_IS for change in plan.changes):
        _tell(plan.remarks or ["There is nothing to take away."], console)
        return 0
    here = root == THIS_MACHINE and SYSTEMD_IS_AT_WORK.is_dir()
    when = "Then" if here else "Not run from here, for systemd is not at work there"
    console.print(f"\n{when}:", *commands, sep="\n    ", markup=False)
    if not (agreed or _asked(f"\n{plan.question} [y/N] ")):
        console.print("Nothing was changed.")
        return NOT_ALL
    good = _ran(plan.before, console) if here else True
    for change in plan.changes:
        change.make()
    for folder in (files.PROFILE.parent, files.STATE):
        take_away_empty(below(root, folder))
    good &= _ran(plan.after, console) if here else True
    _tell(plan.remarks, console)
    return 0 if good else NOT_ALL


def _show(change: FileChange, console: Console) -> None:
    why = f", for {change.why}" if change.why else ""
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
        raise InstallError("nobody answers; --yes does it without asking") from None


def _ran(commands: Sequence[str], console: Console) -> bool:
    """Each, whatever became of the one before; whether all ended well."""
    good = True
    for command in commands:
        console.print(f"$ {command}", markup=False)
        try:
            status = subprocess.run(shlex.split(command), check=False).returncode
        except FileNotFoundError:
            status = 127
        if status != 0:
            good = False
            print(f"flying-vines: that ended with status {status}: {command}", file=sys.stderr)
    return good
