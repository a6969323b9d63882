"""The port of the status page, and the MQTT broker. Neither is needed to fly."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from flying_vines.config.config import MqttConfig
from flying_vines.doctor.finding import DoctorFinding, Subject
from flying_vines.doctor.processes import Process, all_named

TIMEOUT_S = 5.0


@dataclass(frozen=True, slots=True)
class BrokerFacts:
    broker: str
    """The broker's address; empty if the configuration has none."""
    problem: str = ""
    """Why the broker cannot be used; else empty."""
    needs_person: bool = False
    """True if waiting does not help."""
    missing_package: bool = False
    took_s: float = 0.0


_PAGE = Subject("page")
NO_PAGE = _PAGE.skipped("the configuration has none")
PAGE = _PAGE.good("{address} is free")
PAGE_TAKEN = _PAGE.warning("{address}: {why}", "end that program, or set another address in [page]")
PAGE_SERVED = _PAGE.skipped("{address} is used by the running service")
_BROKER = Subject("broker")
NO_BROKER = _BROKER.skipped("the configuration has none")
BROKER = _BROKER.good("{broker} answers within {took:.0f} ms")
NO_PACKAGE = _BROKER.warning("{why}", "install flying-vines again")
AWAY = _BROKER.warning("{broker}: {why}", "check the network, and that the broker runs")
REFUSES = _BROKER.warning("{broker}: {why}", "correct [mqtt], or the broker (docs/mqtt.md)")


def check_page(
    address: str, problem: str = "", held_by: Sequence[Process] = (), service_runs: bool = False
) -> DoctorFinding:
    """The finding about the page's port.

    Args:
        address: host and port; empty if the configuration has no page.
        problem: why the port cannot be opened; empty if it can.
        held_by: the processes that use it.
        service_runs: our own service runs.
    """
    if not address:
        return NO_PAGE()
    if not problem:
        return PAGE(address=address)
    if service_runs:
        return PAGE_SERVED(address=address)
    held = f", held by {all_named(held_by)}" if held_by else ""
    return PAGE_TAKEN(address=address, why=problem + held)


async def broker_facts(mqtt: MqttConfig) -> BrokerFacts:
    """Connects as the service does, and disconnects.

    A new client id is used, so that a running service stays connected.
    """
    if not mqtt.broker:
        return BrokerFacts("")
    try:
        import aiomqtt

        from flying_vines.gateway.mqtt.broker import FileError, login, may_want_other_version, problem_of
    except ModuleNotFoundError as error:
        return BrokerFacts(mqtt.broker, f"{error.name} is missing", missing_package=True)

    async def greet(version: aiomqtt.ProtocolVersion) -> None:
        async with aiomqtt.Client(**await login(mqtt, version, TIMEOUT_S)):
            pass

    began_s = time.monotonic()
    try:
        try:
            await greet(aiomqtt.ProtocolVersion.V5)
        except aiomqtt.MqttError as error:
            if not may_want_other_version(error):
                raise
            await greet(aiomqtt.ProtocolVersion.V311)
    except (aiomqtt.MqttError, FileError, OSError) as error:
        problem = problem_of(error, mqtt, connected=False)
        return BrokerFacts(mqtt.broker, problem.text, needs_person=problem.needs_person)
    return BrokerFacts(mqtt.broker, took_s=time.monotonic() - began_s)


def check_broker(facts: BrokerFacts) -> DoctorFinding:
    if not facts.broker:
        return NO_BROKER()
    if facts.missing_package:
        return NO_PACKAGE(why=facts.problem)
    if facts.problem:
        return (REFUSES if facts.needs_person else AWAY)(broker=facts.broker, why=facts.problem)
    return BROKER(broker=facts.broker, took=facts.took_s * 1e3)
