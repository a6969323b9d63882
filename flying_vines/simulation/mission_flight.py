"""Flies a mission in simulation: the core between a simulated autopilot and phloSAR."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter

import msgspec

from flying_vines.config.config import Config
from flying_vines.core.events import Decision
from flying_vines.physics.plant.true_rig import TrueRig
from flying_vines.simulation.autopilot import AutopilotKind, FakeAutopilot
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.supply import nominal_rig
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.triggers import Rules
from missions.home import Home
from missions.report import FlightResult, Report

GROUND_S = 8.0
"""Time before take-off, in which the core finds the autopilot and reads the mission."""
LATE_S = 60.0
"""The simulation ends this long after the planned end of the flight, even if the vehicle still flies."""
TURN_S = 1.0


def fly(
    items: Sequence[MissionItem],
    config: Config,
    kind: AutopilotKind,
    home: Home,
    reservoir_kPa: float,
    planned_s: float,
    rig: TrueRig | None = None,
) -> FlightResult:
    """Fly the items until the vehicle has landed, or until `LATE_S` after `planned_s`.

    Raises `MissionRefused` if the autopilot refuses an item. `rig` is the simulated rig; default: a typical
    one with the configuration's numbers.
    """
    began = perf_counter()
    # Nobody arms the pneumatics in a simulation.
    interlocks = msgspec.structs.replace(config.interlocks, armed_at_start=True)
    config = msgspec.structs.replace(config, interlocks=interlocks)
    autopilot = FakeAutopilot(kind, mission=items, home=home)
    rig = rig or TrueRig(nominal_rig(config.pneumatics), likely=True)
    phlosar = SimulatedPhlosar(rig, reservoir_kPa=reservoir_kPa)
    flight = SimulatedFlight(config, autopilot, phlosar)
    actions = flight.run(GROUND_S)
    begins_kPa = flight.phlosar.reservoir_kPa
    autopilot.start_mission()
    t = GROUND_S
    while t < GROUND_S + planned_s + LATE_S and (t < GROUND_S + TURN_S or autopilot.armed):
        t += TURN_S
        actions += flight.run(t)
    length_s = t - GROUND_S
    landed = not autopilot.armed
    commands = Rules(config).commands
    return FlightResult(
        ran=tuple(item for ran_s, item in autopilot.payload_log if item.command in commands),
        decisions=tuple(a for a in actions if isinstance(a, Decision) and a.trigger == "mission_item"),
        begins_kPa=begins_kPa,
        ends_kPa=flight.phlosar.reservoir_kPa,
        length_s=length_s,
        landed=landed,
        flown_s=t,
        took_s=perf_counter() - began,
    )


def with_flight(report: Report, config: Config, reservoir_kPa: float, rig: TrueRig | None = None) -> Report:
    """The report with a simulated flight of its mission; unchanged if the mission has errors."""
    if any(finding.severity == "error" for finding in report.findings):
        return report
    result = fly(report.items, config, report.kind, report.home, reservoir_kPa, report.timeline.length_s, rig)
    return replace(report, flight_result=result)
