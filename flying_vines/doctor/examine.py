"""Runs all checks in order: first those that open no link, then both links at the same time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from flying_vines.config.address import Address, NetworkAddress, parse_address
from flying_vines.config.config import PageConfig
from flying_vines.doctor import computer, configuration, firmware, network, ports, processes, radio, vehicle
from flying_vines.doctor.configuration import ServiceConfiguration
from flying_vines.doctor.finding import DoctorFinding
from flying_vines.doctor.processes import Process
from flying_vines.doctor.vehicle_probe import TICK_S, SwitchFacts, VehicleWatch
from flying_vines.vehicle.mavlink.signing import SigningKeyError, TimestampFile

MOVING_S = 20.0
"""Time for the user to move the switch through all its positions."""

Report = Callable[[Sequence[DoctorFinding]], None]
RadioQuestion = Callable[[SwitchFacts], None]
"""Asks the user to move the switch and shows its state; called repeatedly."""


async def examine(
    examined: ServiceConfiguration,
    logs: Path,
    seconds: float,
    report: Report,
    ask: RadioQuestion | None = None,
) -> list[DoctorFinding]:
    """All findings in order.

    Args:
        examined: the configuration and state with which the service would start.
        logs: folder of the service's flight logs.
        seconds: time to listen to both links.
        report: gets new findings as they come.
        ask: prompts the user to move the switch; None if there is no user.
    """
    found: list[DoctorFinding] = []

    def add(findings: Sequence[DoctorFinding]) -> None:
        found.extend(findings)
        report(findings)

    config, clock = examined.config, computer.Clock()
    add(configuration.check(examined))
    add(computer.check_machine(computer.machine_facts()))
    folders = [computer.disk_facts("flight logs", logs, config.log.least_free_MB)]
    if examined.state is not None:
        folders.append(computer.disk_facts("state", examined.state.parameters.parent))
    add([*map(computer.check_disk, folders)])
    running, holders = processes.services(), list[Process]()
    board_link = link_to("phloSAR", config.firmware.link, add, running, holders)
    vehicle_link = link_to("vehicle", config.vehicle.link, add, running, holders)
    holding = {process.pid for process in holders}
    uses = [each for each in running if each.pid in holding or processes.hides_files(each)]
    add([processes.check_service(running, uses)])
    add([await asyncio.to_thread(_page, config.page, bool(running))])
    add([network.check_broker(await network.broker_facts(config.mqtt))])

    own = config.firmware.is_phlosar  # a device that is no phloSAR gets no bytes from us
    board = None
    if board_link is not None and own:
        board = firmware.FirmwareProbe(board_link, examined.prior, config.limits.max_kPa, examined.learned)
    watch = None if vehicle_link is None else VehicleWatch(vehicle_link, config, examined.signing)
    over, asked = asyncio.Event(), False
    async with asyncio.TaskGroup() as tasks:
        for probe in (board, watch):
            if probe is not None:
                tasks.create_task(probe.run(over.is_set))
        late_s = await computer.lateness_s(seconds) if board or watch else 0.0
        if board or watch:
            add([computer.check_load(late_s, config.losses.telemetry_s)])
        add(firmware.check(board.facts if board else None, config, examined.board_settings, late_s))
        facts = watch.facts if watch else None
        add(vehicle.check(facts, config, seconds, running, late_s))
        autopilot = facts if facts and facts.found else None
        switch = autopilot.radio if autopilot else None
        if watch and ask and switch and switch.problem is None and vehicle.uses_switch(config):
            asked = True
            switch = await _move_switch(watch, len(config.switch.positions), ask)
        over.set()
    add([radio.check_switch(switch, config, asked)])
    add(vehicle.check_mission(autopilot.mission if autopilot else None, autopilot is not None, config))
    times = clock.facts(autopilot.ahead_s if autopilot else None, examined.signing is not None)
    add(computer.check_clock(times))
    if autopilot:
        add([computer.check_clock_against_vehicle(times)])
    keep_signing(examined)
    return found


def _page(page: PageConfig, service_runs: bool) -> DoctorFinding:
    if not page.port:
        return network.check_page("")
    problem, held_by = ports.tcp_port(page.host, page.port)
    return network.check_page(f"{page.host}:{page.port}", problem, held_by, service_runs)


def link_to(
    which: ports.Which, where: str, add: Report, running: Sequence[Process], holders: list[Process]
) -> Address | None:
    """Checks a link's port. Returns its address, or None if it cannot be opened.

    Adds the processes that use the port to `holders`.
    """

    def served(held_by: Sequence[Process]) -> bool:
        pids = {process.pid for process in running}
        return any(process.pid in pids for process in held_by)

    address = parse_address(where)
    if isinstance(address, NetworkAddress):
        listens = address.kind == "udpin"
        held_by = ports.udp_port(address) if listens else None
        add([ports.check_network(which, where, listens, held_by, served(held_by or ()))])
        holders += held_by or ()
        return address if held_by is None else None
    facts = ports.serial_port(which, where, address)
    facts = replace(facts, served=served(facts.held_by))
    add(ports.check(facts))
    holders += facts.held_by
    return address if facts.may_open and not facts.missing and not facts.held_by else None


async def _move_switch(watch: VehicleWatch, positions: int, ask: RadioQuestion) -> SwitchFacts:
    """Ask the user to move the switch, until all positions were seen or `MOVING_S` is over."""
    ends_s = watch.t + MOVING_S
    while True:
        seen = watch.probe.radio(watch.t)
        ask(seen)
        if len(seen.seen) == positions or watch.t >= ends_s:
            return seen
        await asyncio.sleep(TICK_S)


def keep_signing(examined: ServiceConfiguration) -> None:
    """Save the signing timestamps, so that the service does not use them again."""
    if examined.signing is not None and examined.state is not None:
        try:
            TimestampFile(examined.state.signing_timestamp).save(examined.signing.memory)
        except SigningKeyError:
            # An earlier check has already reported the unwritable folder.
            return
