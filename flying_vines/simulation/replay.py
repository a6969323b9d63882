"""Feeds recordings to the core.

`replay` feeds any recorded MAVLink stream; a simulated phloSAR answers the core. `replay_flight` feeds a
flight log, which contains all input of the core. It compares the core's answers (messages, decisions,
notices, …) with the answers in the log.
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
from flying_vines.core.core import Core
from flying_vines.core.crash_safe_core import CrashSafeCore
from flying_vines.core.events import Action, Decision, StoredState, ToVehicle, VehicleMessage
from flying_vines.record.reader import FlightLog, LogEntry, LogError, event_of, restored, start_of
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
from flying_vines.supply import RigPrior
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage
from flying_vines.vehicle.mavlink.tlog import recorded_times
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.state import is_autopilot

GAP_S = 0.5
"""Maximum time from the last event of a log to the start of the next log. After a longer time, some input is
missing."""


def replay(
    frames: Iterable[tuple[float, bytes]],
    config: Config,
    mission: Sequence[MissionItem] = (),
    pace: float = 0.0,
    sleep: Callable[[float], None] = time.sleep,
    prior: RigPrior | None = None,
    parameters: Mapping[str, float] | None = None,
    say: Callable[[str], None] = lambda sentence: None,
) -> Iterator[Action]:
    """All actions of the core for a recording. `frames`: (unix time in s, frame) in order.

    Times of actions count from the first frame. `pace`: 1 is the recorded speed, 2 twice as fast, 0 as fast
    as possible. Where the recorded times are impossible, the vehicle's clock counts; `say` gets a sentence
    about that. If the core requests a mission item, it gets the latest item with this number so far.
    """
    recorded = list(frames)
    world = SimulatedWorld(config, mission=mission, prior=prior, stored=StoredState(dict(parameters or {})))
    codec = MavlinkCodec(config.vehicle.system_id, config.vehicle.component_id)
    started = time.monotonic()
    items: dict[int, MavlinkMessage] = {}

    def live(actions: Iterable[Action]) -> Iterator[Action]:
        for action in actions:
            yield action
            wanted = action.message if isinstance(action, ToVehicle) else None
            if wanted is not None and wanted.get_type() == "MISSION_REQUEST_INT" and wanted.seq in items:
                yield from live(world.feed(VehicleMessage(world.now, items[wanted.seq])))

    for t, (_, frame) in zip(recorded_times(recorded, say), recorded, strict=True):
        if pace > 0.0:
            ahead_s = t / pace - (time.monotonic() - started)
            if ahead_s > 0.0:
                sleep(ahead_s)
        yield from live(world.advance(t))
        for message in codec.decode(frame, t):
            # A ground station's recording contains our own messages: the core must not receive them.
            if message.get_srcComponent() == config.vehicle.component_id:
                continue
            if message.get_type() in ("MISSION_ITEM_INT", "MISSION_ITEM") and message.mission_type == 0:
                items[message.seq] = message
            yield from live(world.feed(VehicleMessage(t, message)))


def autopilots_in(frames: Iterable[tuple[float, bytes]]) -> dict[int, float]:
    """The system ids of the autopilots in a recording, each with the time of its first HEARTBEAT."""
    codec = MavlinkCodec(0, 0, read=(mavlink.MAVLINK_MSG_ID_HEARTBEAT,))
    found: dict[int, float] = {}
    for t, frame in frames:
        for message in codec.decode(frame, t):
            if message.get_type() == "HEARTBEAT" and is_autopilot(message):
                found.setdefault(message.get_srcSystem(), t)
    return found


@dataclass
class FlightReplay:
    """The result of a replayed flight."""

    decisions: list[Decision] = field(default_factory=list)
    """The replay's decisions."""
    compared: Counter[str] = field(default_factory=Counter)
    """Number of equal answers, by topic."""
    began: float = 0.0
    """Start of the flight on the service's clock."""
    differences: list[str] = field(default_factory=list)
    """The differences, one sentence each."""
    damage: str = ""
    """The reason why the log ends before the end of the flight; empty if the log is complete."""


def replay_flight(log: FlightLog, config: Config | None = None) -> FlightReplay:
    """Feed a flight's input to a new core, and compare its answers with those of the flight.

    `config` replaces the flight's own configuration, to show its effect. Raises `LogError` if the log does
    not contain the start of the core.
    """
    result = FlightReplay()
    core: CrashSafeCore | None = None
    replayed: list[tuple[str, object]] = []
    recorded: list[tuple[str, object]] = []
    t = 0.0
    for part in _since_the_service_began(log):
        for entry in part.entries():
            if part.lost:
                break
            if entry.topic == START:
                start = restored(Start, entry.fields)
                if core is None:
                    core, result.began = _core(part, start, config), start.t
                elif start.t > t + GAP_S:
                    result.damage = f"nothing was recorded for {start.t - t:.1f} s before {part.folder.name}"
                    return result
            elif entry.topic in EVENT_TOPICS:
                if core is None:
                    raise LogError(f"{part.path}: its beginning is damaged")
                _compare(result, t, replayed, recorded)
                event = event_of(entry)
                t, actions = event.t, core.handle(event)
                result.decisions.extend(action for action in actions if isinstance(action, Decision))
                replayed = [answer for action in actions for answer in _answers(t, action)]
                recorded = []
            elif entry.topic in ANSWER_TOPICS:
                recorded.append(_recorded_answer(entry))
        if part.damage:
            result.damage = part.damage
            return result
    _compare(result, t, replayed, recorded)
    return result


def _since_the_service_began(log: FlightLog) -> list[FlightLog]:
    """This log and all earlier logs of the same service run, because the core's state depends on them."""
    logs = [log]
    while before := start_of(logs[0]).continues:
        earlier = FlightLog(logs[0].folder.parent / before)
        if not earlier.path.exists():
            raise LogError(f"{log.path}: continues {before}, which is not in the same folder")
        logs.insert(0, earlier)
    return logs


def _core(log: FlightLog, start: Start, config: Config | None) -> CrashSafeCore:
    config = config or configuration.parse(
        start.profile, f"{log.path}: the configuration in it", recorded=True
    )
    prior = None
    if start.rig:
        from flying_vines.supply.rig_file_prior import load_rig_file_prior

        with TemporaryDirectory() as folder:
            path = Path(folder) / "rig.toml"
            path.write_text(start.rig, encoding="utf-8")
            prior = load_rig_file_prior(path, config.pneumatics).prior
    # Logs of earlier versions contain no latched faults.
    stored = StoredState(
        start.parameters, start.disarmed, start.learned, start.latched or {}, start.board_settings
    )
    return CrashSafeCore(Core(config, prior=prior, stored=stored))


def _answers(t: float, action: Action) -> list[tuple[str, object]]:
    """The entry that the log would have for an action; empty if the replay does not compare it."""
    if isinstance(action, ToVehicle):
        action.message.pack(mavlink.MAVLink(None, srcSystem=action.system_id))
    entry = entry_of_action(t, action)
    if entry is None:
        return []
    number, _, what = entry
    name = TOPICS[number - 1].name
    if name not in ANSWER_TOPICS:
        return []
    return [(name, _content(what) if name == MAVLINK_OUT else encoded(entry))]


def _recorded_answer(entry: LogEntry) -> tuple[str, object]:
    if entry.topic == MAVLINK_OUT:
        return entry.topic, _content(binascii.a2b_base64(entry.fields["frame"]))
    return entry.topic, entry.data


def _content(raw: bytes) -> tuple[int, int, bytes]:
    """The content of a MAVLink frame, without sequence number and signature: system, message id, payload."""
    frame = frame_of(raw)
    return frame.system, frame.message_id, frame.payload


def _compare(
    result: FlightReplay, t: float, replayed: list[tuple[str, object]], recorded: list[tuple[str, object]]
) -> None:
    if replayed == recorded:
        result.compared.update(topic for topic, _ in replayed)
        return
    for now, before in zip_longest(replayed, recorded):
        if now == before:
            result.compared[now[0]] += 1
            continue
        texts = [f"{what[0]} {_readable(what[1])}" if what else "nothing" for what in (before, now)]
        result.differences.append(f"at {t - result.began:.3f} s: {texts[0]} in the flight, {texts[1]} now")


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
