"""Runs the core in simulated time: as fast as possible and deterministic."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

from firmware_link import protocol
from flying_vines.config.config import Config
from flying_vines.core.core import TICK_S, Core
from flying_vines.core.events import (
    Action,
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
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.autopilot.links import COMPANION
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.supply import RigPrior
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.mission.item import MissionItem

BUFFER_BYTES = 4095
"""Size of a serial port's input buffer on Linux. Bytes that do not fit are lost."""

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
