"""Checks the port of the status page, and the MQTT broker. Neither is needed to fly."""

from __future__ import annotations

from dataclasses import dataclass

from flying_vines.doctor.checks.service import Process, named
from flying_vines.doctor.finding import DoctorFinding, FindingText


@dataclass(frozen=True, slots=True)
class PageFacts:
    address: str
    """Host and port; empty if the configuration has no page."""
    problem: str = ""
    """Why the port cannot be opened; else empty."""
    held_by: tuple[Process, ...] = ()


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


NO_PAGE = FindingText("page", "skipped", "the configuration has none")
PAGE = FindingText("page", "good", "{address} is free")
PAGE_TAKEN = FindingText(
    "page", "warning", "{address}: {why}", "end that program, or set another address in [page]"
)
PAGE_SERVED = FindingText("page", "skipped", "{address} is used by the running service")
NO_BROKER = FindingText("broker", "skipped", "the configuration has none")
BROKER = FindingText("broker", "good", "{broker} answers within {took:.0f} ms")
NO_PACKAGE = FindingText("broker", "warning", "{why}", "install flying-vines again")
AWAY = FindingText("broker", "warning", "{broker}: {why}", "check the network, and that the broker runs")
REFUSES = FindingText("broker", "warning", "{broker}: {why}", "correct [mqtt], or the broker (docs/mqtt.md)")


def check_page(facts: PageFacts, service_runs: bool) -> DoctorFinding:
    if not facts.address:
        return NO_PAGE()
    if not facts.problem:
        return PAGE(address=facts.address)
    if service_runs:
        return PAGE_SERVED(address=facts.address)
    held = f", held by {named(facts.held_by)}" if facts.held_by else ""
    return PAGE_TAKEN(address=facts.address, why=facts.problem + held)


def check_broker(facts: BrokerFacts) -> DoctorFinding:
    if not facts.broker:
        return NO_BROKER()
    if facts.missing_package:
        return NO_PACKAGE(why=facts.problem)
    if facts.problem:
        return (REFUSES if facts.needs_person else AWAY)(broker=facts.broker, why=facts.problem)
    return BROKER(broker=facts.broker, took=facts.took_s * 1e3)
