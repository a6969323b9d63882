"""`flying-vines doctor --radio`: the guided test, its verdict, and the setting for the configuration."""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Console
from rich.text import Text

from flying_vines.cli.common import bad_input
from flying_vines.cli.doctor_fakes import FakeHand, between
from flying_vines.config import config as configuration
from flying_vines.config import on_disk
from flying_vines.config.address import parse_address
from flying_vines.config.config import ConfigError, ReceiverFailsafe
from flying_vines.config.toml_edit import value_text, with_value
from flying_vines.doctor import processes, radio
from flying_vines.doctor.configuration import ServiceConfiguration, given, read
from flying_vines.doctor.examine import keep_signing, link_to
from flying_vines.doctor.finding import DoctorFinding, last_line, may_fly, show
from flying_vines.doctor.radio_guide import NobodyThereError, guided
from flying_vines.doctor.radio_test import RadioLearned
from flying_vines.simulation.autopilot import FakeAutopilot

FAKE = "The simulated vehicle moves its own transmitter, to show the test."
NOT_SAFE = 1
SAFE = "The vine is safe with this receiver."
UNSAFE = "The vine is not safe with this receiver."
NOT_KNOWN = "The test did not finish: it has no result."
KEY = "receiver_failsafe"


def test_radio(arguments: argparse.Namespace) -> int:
    """Returns 0 if the vine is safe with this receiver, 1 if not or unknown, 2 for bad input."""
    path: Path | None = arguments.config
    examined = read(path) if path else given(configuration.default(), "the built-in configuration")
    # With --json, standard output has only the JSON object.
    console = Console(markup=False, highlight=False, stderr=arguments.json)
    ports: list[DoctorFinding] = []
    try:
        learned = asyncio.run(_test(examined, arguments.fakes, console, ports))
    except NobodyThereError:
        return bad_input(
            "a person must press Enter and switch the transmitter off: run it in a terminal, or use --fakes"
        )
    keep_signing(examined)
    if learned is None:
        findings = [finding for finding in ports if finding.verdict == "bad"]
        learned = RadioLearned(problem="no autopilot")
    else:
        findings = radio.check_radio_test(learned, examined.config)
    console.print(Text())
    show(findings, console)
    console.print(last_line(findings, _summary(findings, learned)))
    try:
        learned_failsafe = radio.to_write(learned, examined.config)
        written = _keep(learned_failsafe, arguments, console)
    except OSError as error:
        return bad_input(f"{path}: {error.strerror}")
    if arguments.json:
        print(json.dumps(as_json(findings, learned, learned_failsafe, written), allow_nan=False))
    return 0 if may_fly(findings) else NOT_SAFE


async def _test(
    examined: ServiceConfiguration, fakes: bool, console: Console, ports: list[DoctorFinding]
) -> RadioLearned | None:
    """The result, or None if the vehicle's link cannot be opened; then `ports` has the reason."""
    config = examined.config
    if fakes:
        autopilot = FakeAutopilot("ardupilot", unix_s=time.time())
        async with between(config, autopilot, None) as linked:
            link, hand = parse_address(linked.vehicle.link), FakeHand(autopilot, linked)
            return await guided(link, linked, None, console, FAKE, hand.act)
    address = link_to("vehicle", config.vehicle.link, ports.extend, processes.services(), [])
    if address is None:
        return None
    return await guided(address, config, examined.signing, console)


def as_json(
    findings: Sequence[DoctorFinding],
    learned: RadioLearned,
    failsafe: ReceiverFailsafe | None,
    written: Path | None,
) -> dict[str, Any]:
    """The test as JSON; `receiver_failsafe` is null without a result."""
    return {
        "safe": may_fly(findings),
        "summary": _summary(findings, learned),
        "receiver_failsafe": failsafe,
        "written_to": None if written is None else str(written),
        "findings": [*map(asdict, findings)],
        "autopilot": learned.autopilot,
        "parameters": learned.parameters,
        "losses": [
            {**asdict(loss), "shown_after_s": loss.shown_after_s, "told_after_jump_s": loss.told_after_jump_s}
            for loss in learned.losses
        ],
    }


def with_learned(text: str, source: str, failsafe: ReceiverFailsafe, day: str) -> str:
    """The configuration's text with the new value; everything else is unchanged.

    Raises `ConfigError` if this line cannot be replaced in the text's layout.
    """
    before = configuration.parse(text, source)
    was = value_text(before.switch.receiver_failsafe)
    edited = with_value(text, "switch", KEY, value_text(failsafe), f"was {was}, measured {day}")
    wanted = msgspec.structs.replace(
        before, switch=msgspec.structs.replace(before.switch, receiver_failsafe=failsafe)
    )
    try:
        if configuration.parse(edited, source) == wanted:
            return edited
    except ConfigError:
        pass
    raise ConfigError(f"{source}: the layout does not allow an automatic edit: set switch.{KEY} by hand")


def _summary(findings: Sequence[DoctorFinding], learned: RadioLearned) -> str:
    if learned.problem:
        return "" if learned.problem == "ground station" else NOT_KNOWN
    return SAFE if may_fly(findings) else UNSAFE


def _keep(failsafe: ReceiverFailsafe | None, arguments: argparse.Namespace, console: Console) -> Path | None:
    """Write the value to the configuration file if the user agrees. Returns the written file, or None."""
    if failsafe is None:
        return None
    line = f"{KEY} = {value_text(failsafe)}"
    path: Path | None = arguments.config
    if arguments.fakes:
        console.print(
            Text(f"With a real receiver, this line would go into the configuration: {line}", style="dim")
        )
        return None
    if path is None:
        console.print(f"Add to your configuration:\n\n[switch]\n{line}", markup=False)
        return None
    text = configuration.text_of(path)
    if configuration.parse(text, str(path)).switch.receiver_failsafe == failsafe:
        console.print(f"{path} already has this line: {line}", markup=False, soft_wrap=True)
        return None
    edited = with_learned(text, str(path), failsafe, time.strftime("%Y-%m-%d"))
    if not arguments.yes and not _agreed(f"Write {line} to {path}? [y/N] ", console):
        console.print(f"Not written. The line for [switch] is: {line}", markup=False, soft_wrap=True)
        return None
    on_disk.put(path, edited)
    console.print(f"Written to {path}: {line}", markup=False, soft_wrap=True)
    return path


def _agreed(question: str, console: Console) -> bool:
    if not sys.stdin.isatty():
        return False
    console.print(Text(question, style="bold magenta"), end="", soft_wrap=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")
