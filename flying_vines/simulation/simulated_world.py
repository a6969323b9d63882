"""Runs the core in simulated time, and flies missions with it: as fast as possible and deterministic."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from time import perf_counter

import msgspec

from firmware_link import protocol
from flying_vines.config.config import Config
from flying_vines.core.core import TICK_S, Core
from flying_vines.core.events import (
    Action,
    Decision,
    Event,
    FirmwareMessage,
    LinkChanged,
    StoredState,
    Tick,
    ToFirmware,
    ToVehicle,
    VehicleMessage,
)
from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.true_rig import TrueRig
from flying_vines.simulation.autopilot import AutopilotKind, FakeAutopilot
from flying_vines.simulation.autopilot.links import COMPANION
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.supply import RigPrior, nominal_rig
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.triggers import Rules
from missions.budget import FlightResult
from missions.home import Home
from missions.report import Report

BUFFER_BYTES = 4095
"""Size of a serial port's input buffer on Linux. Bytes that do not fit are lost."""

_GROUND_S = 8.0
"""Time before take-off, in which the core finds the autopilot and reads the mission."""
_LATE_S = 60.0
"""The simulation ends this long after the planned end of the flight, even if the vehicle still flies."""
_TURN_S = 1.0

Wire = Callable[[bytes], bytes]
"""Takes the sent bytes and returns the received ones."""


def perfect(data: bytes) -> bytes:
    """A wire without errors."""
    return data


class SimulatedWorld:
    """A core whose serial link ends at a simulated phloSAR, in simulated time that starts at 0.

    `to_phlosar` and `from_phlosar` are the wires of this link; replace them to simulate errors.
    """

    def __init__(
        self,
        config: Config,
        phlosar: SimulatedPhlosar | None = None,
        mission: Sequence[MissionItem] = (),
        prior: RigPrior | None = None,
        stored: StoredState | None = None,
    ) -> None:
        self.core = Core(config, mission, prior, stored)
        # The default is the ideal plant, because it is fast.
        self.phlosar = phlosar or SimulatedPhlosar(
            effects=Effects(), reservoir_kPa=config.pneumatics.full_kPa
        )
        self.now = 0.0
        self.to_phlosar: Wire = perfect
        self.from_phlosar: Wire = perfect
        self._codec = protocol.Codec()
        self._next_tick = 0
        self._opened = False

    def advance(self, to_t: float) -> Iterator[Action]:
        """Advance the time tick by tick. Yields the core's actions."""
        if not self._opened:
            self._opened = True
            yield from self.feed(LinkChanged(0.0, "firmware", True))
            yield from self.feed(LinkChanged(0.0, "vehicle", True))
        while (tick_t := self._next_tick * TICK_S) <= to_t:
            self._next_tick += 1
            yield from self._advance_phlosar(tick_t)
            yield from self.feed(Tick(tick_t))
        yield from self._advance_phlosar(to_t)

    def feed(self, event: Event) -> Iterator[Action]:
        """Feed one event. Yields the core's actions."""
        for action in self.core.handle(event):
            if isinstance(action, ToFirmware):
                self.phlosar.receive(self.to_phlosar(self._codec.encode(action.message)))
            yield action

    def stall(self, until_t: float) -> Iterator[Action]:
        """The core's computer pauses until `until_t`; the phloSAR continues."""
        self._next_tick = math.ceil(until_t / TICK_S)
        yield from self._advance_phlosar(until_t, BUFFER_BYTES)

    def _advance_phlosar(self, t: float, max_bytes: int | None = None) -> Iterator[Action]:
        self.now = t
        for message in self._codec.decode(self.from_phlosar(self.phlosar.advance(t))[:max_bytes]):
            yield from self.feed(FirmwareMessage(t, message))


class SimulatedFlight:
    """A core between a simulated autopilot and phloSAR. You may act on both of them between two `run` calls.

    `from_autopilot` is the wire for the autopilot's frames; replace it to simulate errors.
    """

    def __init__(
        self,
        config: Config,
        autopilot: FakeAutopilot | None = None,
        phlosar: SimulatedPhlosar | None = None,
        stored: StoredState | None = None,
    ) -> None:
        self.autopilot = autopilot or FakeAutopilot("ardupilot")
        self.world = SimulatedWorld(config, phlosar, stored=stored)
        self.from_autopilot: Wire = perfect
        self._codec = MavlinkCodec(config.vehicle.system_id, config.vehicle.component_id)

    @property
    def phlosar(self) -> SimulatedPhlosar:
        return self.world.phlosar

    @property
    def core(self) -> Core:
        return self.world.core

    def run(self, until_t: float, step_s: float = 0.01) -> list[Action]:
        """Run until `until_t`. Returns the core's actions in order."""
        done: list[Action] = []
        while self.world.now < until_t - 1e-9:
            t = min(until_t, self.world.now + step_s)
            done.extend(self._exchange(t, self.world.advance(t)))
        return done

    def stall(self, until_t: float) -> list[Action]:
        """The companion computer pauses until `until_t`; then it receives the delayed messages together."""
        return self._exchange(until_t, self.world.stall(until_t))

    def _exchange(self, t: float, core_actions: Iterator[Action]) -> list[Action]:
        """Run core and autopilot until `t`, and pass messages both ways. Returns the core's actions."""
        actions = list(core_actions)
        for link, frame in self.autopilot.advance(t):
            if link == COMPANION:
                for message in self._codec.decode(self.from_autopilot(frame), t):
                    actions.extend(self.world.feed(VehicleMessage(t, message)))
        self._send(t, actions)
        return actions

    def _send(self, t: float, actions: Sequence[Action]) -> None:
        """Send the messages among the actions to the autopilot."""
        for action in actions:
            if isinstance(action, ToVehicle):
                frame = self._codec.encode(action.message, action.system_id)
                self.autopilot.receive(t, COMPANION, frame)

    def feed(self, event: Event) -> list[Action]:
        """Feed one event now. Returns the core's actions."""
        actions = list(self.world.feed(event))
        self._send(self.world.now, actions)
        return actions


def fly(
    items: Sequence[MissionItem],
    config: Config,
    kind: AutopilotKind,
    home: Home,
    reservoir_kPa: float,
    planned_s: float,
    rig: TrueRig | None = None,
) -> FlightResult:
    """Fly the items until the vehicle has landed, or until `_LATE_S` after `planned_s`.

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
    actions = flight.run(_GROUND_S)
    begins_kPa = flight.phlosar.reservoir_kPa
    autopilot.start_mission()
    t = _GROUND_S
    while t < _GROUND_S + planned_s + _LATE_S and (t < _GROUND_S + _TURN_S or autopilot.armed):
        t += _TURN_S
        actions += flight.run(t)
    length_s = t - _GROUND_S
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
