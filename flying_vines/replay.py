"""A recorded MAVLink stream, fed through the same core that flies, against a simulated phloSAR."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from flying_vines.config import Config
from flying_vines.events import Action, Decision, VehicleMessage
from flying_vines.reservoir import Belief
from flying_vines.simulated_world import SimulatedWorld
from flying_vines.vehicle.codec import Codec
from flying_vines.vehicle.mission.item import MissionItem


def replay(
    frames: Iterable[tuple[float, bytes]],
    config: Config,
    mission: Sequence[MissionItem] = (),
    pace: float = 0.0,
    sleep: Callable[[float], None] = time.sleep,
    belief: Belief | None = None,
    parameters: Mapping[str, float] | None = None,
) -> Iterator[Action]:
    """Everything that the core does about a recording: (unix time in s, frame) in order.

    The times of the actions count from the first frame. `pace` 1 plays at the recorded speed, 2 twice as
    fast, 0 as fast as it goes. A frame whose time lies before its predecessor's is taken at its
    predecessor's.
    """
    world = SimulatedWorld(config, mission=mission, belief=belief, parameters=parameters)
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
            # A ground station's recording holds what we said then, which is not to be heard as another's.
            if message.get_srcComponent() != config.vehicle.component_id:
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
