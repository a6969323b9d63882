"""The core in simulated time: as fast as the machine goes, and the same every time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

from firmware_link import protocol
from flying_vines.config.config import Config
from flying_vines.core.core import TICK_S, Core
from flying_vines.core.events import (
    Action,
    Event,
    FirmwareMessage,
    LinkChanged,
    Tick,
    ToFirmware,
    ToVehicle,
    VehicleMessage,
)
from flying_vines.physics.plant.effects import Effects
from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar
from flying_vines.supply import Belief
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.mission.item import MissionItem

COMPANION = "companion"
BUFFER_BYTES = 4095
"""Of a serial port on Linux: what comes in while nobody reads, and does not fit, is lost."""

Wire = Callable[[bytes], bytes]
"""What becomes of bytes on their way."""


def perfect(data: bytes) -> bytes:
    """A wire that loses nothing."""
    return data


class SimulatedWorld:
    """A core whose serial link ends at a simulated phloSAR, in simulated time that starts at 0.

    `to_phlosar` and `from_phlosar` are the two wires of that link; exchange them for worse ones.
    """

    def __init__(
        self,
        config: Config,
        phlosar: SimulatedPhlosar | None = None,
        mission: Sequence[MissionItem] = (),
        belief: Belief | None = None,
        parameters: Mapping[str, float] | None = None,
        disarmed: bool = False,
    ) -> None:
        self.core = Core(config, mission, belief, parameters, disarmed)
        # The ideal plant, for it is quick; whoever wants another hands it over.
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
        """Let time pass, tick by tick; actions come out as they happen."""
        if not self._opened:
            self._opened = True
            yield from self.feed(LinkChanged(0.0, "firmware", True))
            yield from self.feed(LinkChanged(0.0, "vehicle", True))
        while (tick_t := self._next_tick * TICK_S) <= to_t:
            self._next_tick += 1
            yield from self._live_until(tick_t)
            yield from self.feed(Tick(tick_t))
        yield from self._live_until(to_t)

    def feed(self, event: Event) -> Iterator[Action]:
        """One event, and what the core does about it."""
        for action in self.core.handle(event):
            if isinstance(action, ToFirmware):
                self.phlosar.receive(self.to_phlosar(self._codec.encode(action.message)))
            yield action

    def stall(self, until_t: float) -> Iterator[Action]:
        """The core's computer stands still until then, while the phloSAR lives on."""
        self._next_tick = math.ceil(until_t / TICK_S)
        yield from self._live_until(until_t, BUFFER_BYTES)

    def _live_until(self, t: float, most_bytes: int | None = None) -> Iterator[Action]:
        self.now = t
        for message in self._codec.decode(self.from_phlosar(self.phlosar.advance(t))[:most_bytes]):
            yield from self.feed(FirmwareMessage(t, message))


class SimulatedFlight:
    """A core between a fake autopilot and a simulated phloSAR: act on either between two runs.

    `from_autopilot` is the wire on which each frame of the autopilot comes.
    """

    def __init__(
        self,
        config: Config,
        autopilot: FakeAutopilot | None = None,
        phlosar: SimulatedPhlosar | None = None,
        mission: Sequence[MissionItem] = (),
        disarmed: bool = False,
    ) -> None:
        self.autopilot = autopilot or FakeAutopilot("ardupilot")
        self.world = SimulatedWorld(config, phlosar, mission, disarmed=disarmed)
        self.from_autopilot: Wire = perfect
        self._codec = MavlinkCodec(config.vehicle.system_id, config.vehicle.component_id)

    @property
    def phlosar(self) -> SimulatedPhlosar:
        return self.world.phlosar

    @property
    def core(self) -> Core:
        return self.world.core

    def run(self, until_t: float, step_s: float = 0.01) -> list[Action]:
        """Live until `until_t`; every action on the way, in order."""
        done: list[Action] = []
        while self.world.now < until_t - 1e-9:
            t = min(until_t, self.world.now + step_s)
            done.extend(self._exchange(t, self.world.advance(t)))
        return done

    def stall(self, until_t: float) -> list[Action]:
        """The companion's computer stands still until then; what it was sent meanwhile, it hears at once."""
        return self._exchange(until_t, self.world.stall(until_t))

    def _exchange(self, t: float, lived: Iterator[Action]) -> list[Action]:
        """What the core did on its way to `t` and about what the autopilot sent, told to the autopilot."""
        actions = list(lived)
        for link, frame in self.autopilot.advance(t):
            if link == COMPANION:
                for message in self._codec.decode(self.from_autopilot(frame)):
                    actions.extend(self.world.feed(VehicleMessage(t, message)))
        for action in actions:
            if isinstance(action, ToVehicle):
                frame = self._codec.encode(action.message, action.system_id)
                self.autopilot.receive(t, COMPANION, frame)
        return actions

    def feed(self, event: Event) -> list[Action]:
        """One event from outside, now."""
        return list(self.world.feed(event))
