"""A recorded MAVLink stream, fed through the same core that flies, against a simulated phloSAR."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence

from firmware_link import protocol
from flying_vines.config import Config
from flying_vines.core import (
    TICK_S,
    Action,
    Core,
    Decision,
    Event,
    FirmwareMessage,
    LinkChanged,
    Tick,
    ToFirmware,
    VehicleMessage,
)
from flying_vines.fakes.phlosar import SimulatedPhlosar
from flying_vines.vehicle.codec import Codec
from flying_vines.vehicle.mission_item import MissionItem


class SimulatedWorld:
    """A core whose serial link ends at a simulated phloSAR, in simulated time that starts at 0."""

    def __init__(
        self, config: Config, phlosar: SimulatedPhlosar | None = None, mission: Sequence[MissionItem] = ()
    ) -> None:
        self.core = Core(config, mission)
        self.phlosar = phlosar or SimulatedPhlosar(reservoir_kPa=config.pneumatics.full_kPa)
        self.now = 0.0
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
                self.phlosar.receive(self._codec.encode(action.message))
            yield action

    def _live_until(self, t: float) -> Iterator[Action]:
        self.now = t
        for message in self._codec.decode(self.phlosar.advance(t)):
            yield from self.feed(FirmwareMessage(t, message))


def replay(
    frames: Iterable[tuple[float, bytes]],
    config: Config,
    mission: Sequence[MissionItem] = (),
    pace: float = 0.0,
    sleep: Callable[[float], None] = time.sleep,
) -> Iterator[Action]:
    """Everything that the core does about a recording: (unix time in s, frame) in order.

    The times of the actions count from the first frame. `pace` 1 plays at the recorded speed, 2 twice as
    fast, 0 as fast as it goes. A frame whose time lies before its predecessor's is taken at its
    predecessor's.
    """
    world = SimulatedWorld(config, mission=mission)
    codec = Codec(config.vehicle.system_id, config.vehicle.component_id)
    began: float | None = None
    started = time.monotonic()
    for unix_s, frame in frames:
        began = unix_s if began is None else began
        t = max(world.now, unix_s - began)
        if pace > 0.0:
            ahead_s = t / pace - (time.monotonic() - started)
            if ahead_s > 0.0:
                sleep(ahead_s)
        yield from world.advance(t)
        for message in codec.decode(frame):
            yield from world.feed(VehicleMessage(t, message))


def as_json(decision: Decision) -> dict[str, object]:
    """One decision as `replay --json` prints it."""
    return {
        "t": round(decision.t, 3),
        "trigger": decision.trigger,
        "what": decision.what,
        "intent": decision.intent,
        "safety": decision.safety,
        "reason": decision.reason,
        "setpoint_kPa": decision.setpoint_kPa,
    }
