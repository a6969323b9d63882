"""What was recorded, fed through the same core that flies.

`replay` takes a recorded MAVLink stream, of anyone, and a simulated phloSAR answers. `replay_flight` takes a
flight's own log, with all that the core was told, and compares every answer with the one of the flight.
"""

from __future__ import annotations

import binascii
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from tempfile import TemporaryDirectory

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config as configuration
from flying_vines.config.config import Config
from flying_vines.core.contained import CrashSafeCore
from flying_vines.core.core import Core
from flying_vines.core.events import Action, Decision, ToVehicle, VehicleMessage
from flying_vines.record.reader import FlightLog, LogEntry, LogError
from flying_vines.record.restore import event_of, restored, start_of
from flying_vines.record.topics import (
    ANSWER_TOPICS,
    EVENT_TOPICS,
    MAVLINK_OUT,
    START,
    TOPICS,
    Start,
    encoded,
    entry_of_action,
    frame_of,
)
from flying_vines.simulation.simulated_world import SimulatedWorld
from flying_vines.supply import Belief
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage
from flying_vines.vehicle.mission.item import MissionItem

GAP_S = 0.5
"""A log goes on in the next folder at once, unless its disk failed in between."""


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
    predecessor's. Where the core asks for a mission item, it gets the one that the recording showed last.
    """
    world = SimulatedWorld(config, mission=mission, belief=belief, parameters=parameters)
    codec = MavlinkCodec(config.vehicle.system_id, config.vehicle.component_id)
    began: float | None = None
    started = time.monotonic()
    items: dict[int, MavlinkMessage] = {}

    def live(actions: Iterable[Action]) -> Iterator[Action]:
        for action in actions:
            yield action
            wanted = action.message if isinstance(action, ToVehicle) else None
            if wanted is not None and wanted.get_type() == "MISSION_REQUEST_INT" and wanted.seq in items:
                yield from live(world.feed(VehicleMessage(world.now, items[wanted.seq])))

    for unix_s, frame in frames:
        began = unix_s if began is None else began
        t = max(world.now, unix_s - began)
        if pace > 0.0:
            ahead_s = t / pace - (time.monotonic() - started)
            if ahead_s > 0.0:
                sleep(ahead_s)
        yield from live(world.advance(t))
        for message in codec.decode(frame):
            # A ground station's recording holds what we said then, which is not to be heard as another's.
            if message.get_srcComponent() == config.vehicle.component_id:
                continue
            if message.get_type() in ("MISSION_ITEM_INT", "MISSION_ITEM") and message.mission_type == 0:
                items[message.seq] = message
            yield from live(world.feed(VehicleMessage(t, message)))


@dataclass
class Again:
    """A flight whose core was asked again."""

    decisions: list[Decision] = field(default_factory=list)
    """As they come out now."""
    compared: Counter[str] = field(default_factory=Counter)
    """How many answers of each topic were the same."""
    began: float = 0.0
    """Of the service's clock."""
    differences: list[str] = field(default_factory=list)
    """A sentence each."""
    damage: str = ""
    """Where the log ends before the flight did."""


def replay_flight(log: FlightLog, config: Config | None = None) -> Again:
    """Ask a new core all that the flight's was asked, and compare its answers.

    `config` instead of the flight's own profile shows what would have been different. Raises `LogError` when
    the log does not say how the core began.
    """
    again = Again()
    core: CrashSafeCore | None = None
    ours: list[tuple[str, object]] = []
    theirs: list[tuple[str, object]] = []
    t = 0.0
    for part in _since_the_service_began(log):
        for entry in part.entries():
            if part.lost:
                break
            if entry.topic == START:
                start = restored(Start, entry.fields)
                if core is None:
                    core, again.began = _core(part, start, config), start.t
                elif start.t > t + GAP_S:
                    again.damage = f"nothing was recorded for {start.t - t:.1f} s before {part.folder.name}"
                    return again
            elif entry.topic in EVENT_TOPICS:
                if core is None:
                    raise LogError(f"{part.path}: its beginning is damaged")
                _compare(again, t, ours, theirs)
                event = event_of(entry)
                t, actions = event.t, core.handle(event)
                again.decisions.extend(action for action in actions if isinstance(action, Decision))
                ours = [answer for action in actions for answer in _ours(t, action)]
                theirs = []
            elif entry.topic in ANSWER_TOPICS:
                theirs.append(_theirs(entry))
        if part.damage:
            again.damage = part.damage
            return again
    _compare(again, t, ours, theirs)
    return again


def _since_the_service_began(log: FlightLog) -> list[FlightLog]:
    """The logs of one service up to this one: what came before it is how the core came to where it was."""
    logs = [log]
    while before := start_of(logs[0]).continues:
        earlier = FlightLog(logs[0].folder.parent / before)
        if not earlier.path.exists():
            raise LogError(f"{log.path}: continues {before}, which is not beside it")
        logs.insert(0, earlier)
    return logs


def _core(log: FlightLog, start: Start, config: Config | None) -> CrashSafeCore:
    config = config or configuration.parse(start.profile, f"{log.path}: the profile in it", recorded=True)
    belief = None
    if start.rig:
        from flying_vines.supply.known_rig import load_calibration

        with TemporaryDirectory() as folder:
            path = Path(folder) / "rig.toml"
            path.write_text(start.rig, encoding="utf-8")
            belief = load_calibration(path, config.pneumatics).belief
    return CrashSafeCore(Core(config, belief=belief, parameters=start.parameters, disarmed=start.disarmed))


def _ours(t: float, action: Action) -> list[tuple[str, object]]:
    """What the log says of an action, where it says anything."""
    if isinstance(action, ToVehicle):
        action.message.pack(mavlink.MAVLink(None, srcSystem=action.system_id))
    entry = entry_of_action(t, action)
    if entry is None:
        return []
    number, _, what = entry
    name = TOPICS[number - 1].name
    if name not in ANSWER_TOPICS:
        return []
    return [(name, _spoken(what) if name == MAVLINK_OUT else encoded(entry))]


def _theirs(entry: LogEntry) -> tuple[str, object]:
    if entry.topic == MAVLINK_OUT:
        return entry.topic, _spoken(binascii.a2b_base64(entry.fields["frame"]))
    return entry.topic, entry.data


def _spoken(raw: bytes) -> tuple[int, int, bytes]:
    """What a MAVLink frame says, apart from its running number and signature: system, kind, payload."""
    frame = frame_of(raw)
    return frame.system, frame.message_id, frame.payload


def _compare(
    again: Again, t: float, ours: list[tuple[str, object]], theirs: list[tuple[str, object]]
) -> None:
    if ours == theirs:
        again.compared.update(topic for topic, _ in ours)
        return
    for mine, his in zip_longest(ours, theirs):
        if mine == his:
            again.compared[mine[0]] += 1
            continue
        said = [f"{what[0]} {_readable(what[1])}" if what else "nothing" for what in (his, mine)]
        again.differences.append(f"at {t - again.began:.3f} s: {said[0]} in the flight, {said[1]} now")


def _readable(what: object) -> str:
    return what.decode() if isinstance(what, bytes) else str(what)


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
