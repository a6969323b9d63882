"""Checks the vehicle: who sends on its link, do all needed messages arrive, is its mission understood?"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from flying_vines.config.address import NetworkAddress, parse_address
from flying_vines.config.config import Config
from flying_vines.core.motion_planner import MotionPlanner
from flying_vines.doctor.computer import excused
from flying_vines.doctor.finding import DoctorFinding, Subject
from flying_vines.doctor.processes import Process, all_named, stop
from flying_vines.doctor.vehicle_probe import StreamFacts, VehicleFacts
from flying_vines.vehicle.autopilots import OTHER, of_name
from flying_vines.vehicle.autopilots.autopilot import Autopilot
from flying_vines.vehicle.mavlink.link import BUFFERED_FRAME_BYTES, RECEIVE_BUFFER_BYTES
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.state import ALTITUDE_FRESH_S, HEARTBEAT_FRESH_S
from flying_vines.vehicle.triggers import Rules

MIN_RATE_SHARE = 0.7
"""A stream below this share of its requested rate is slow."""
STALL_S = 3.0
"""A receive buffer should keep the frames of a stall of this computer of so much time."""
SAMPLES_WITHIN_LOSS = 3.0
"""Minimum number of RC_CHANNELS within losses.rc_s: with fewer, one lost message looks like RC loss."""

USES = {
    "RC_CHANNELS": "the switch",
    "SYS_STATUS": "detection of RC loss",
    "GLOBAL_POSITION_INT": "the altitude interlock",
    "MISSION_CURRENT": "mission items",
    "SYSTEM_TIME": "detection of reboots, and the clock check",
    "SCALED_PRESSURE": "ambient pressure",
}
"""The use of each message in the service or the doctor."""

_VEHICLE_LINK = Subject("vehicle link")
NO_LINK = _VEHICLE_LINK.bad("{why}", "check vehicle.link, and the result for its port above")
SERVED = _VEHICLE_LINK.bad(
    "no autopilot is found{why}; {who} runs and may use this link",
    "use flying-vines watch; or stop the service ({stop}) and repeat this check",
)
NOT_ASKED = _VEHICLE_LINK.skipped("not checked, because its port cannot be used: see the result for the port")
SILENT = _VEHICLE_LINK.bad(
    "nothing arrived in {seconds:.0f} s",
    "set the autopilot's port: on ArduPilot SERIALn_PROTOCOL = 2 and its baud rate, on PX4 MAV_1_CONFIG; "
    "check vehicle.link, RX and TX",
)
NOT_THE_PEER = _VEHICLE_LINK.bad(
    "only {other} sends, and this is not the peer in vehicle.link",
    "if that is your autopilot, write ?peer={other} in vehicle.link",
)
NOISE = _VEHICLE_LINK.bad(
    "{bytes} bytes arrived, but no MAVLink message",
    "set the autopilot's baud rate in vehicle.link, and check that no other device uses the line",
)
ECHO = _VEHICLE_LINK.bad(
    "only our own {echoes} frames come back",
    "set the autopilot's port, and check the wires: TX and RX touch, or the adapter returns what we send",
)
SERIAL_ECHO = _VEHICLE_LINK.warning(
    "our own frames come back on the serial line",
    "check the wires: TX and RX touch, or the adapter returns what we send (half-duplex, local echo)",
)
_RECEIVE_BUFFER = Subject("receive buffer")
BUFFER = _RECEIVE_BUFFER.good("keeps {seconds:.0f} s of frames while this computer stalls")
SMALL_BUFFER = _RECEIVE_BUFFER.warning(
    "keeps {seconds:.1f} s of frames: a vent that is sent in a longer stall of this computer is lost",
    "sudo sysctl -w net.core.rmem_max={wanted} (and the same in /etc/sysctl.d/60-vine.conf)",
)
NO_AUTOPILOT = _VEHICLE_LINK.bad(
    "{messages} messages arrived from {others}, but none from an autopilot",
    "check which messages a router forwards, and vehicle.system_id = {system} (0: the first autopilot)",
)
TWO_AUTOPILOTS = _VEHICLE_LINK.bad(
    "autopilots {one} and {other} are on the link: neither is served", "set vehicle.system_id"
)
_AUTOPILOT = Subject("autopilot")
AUTOPILOT = _AUTOPILOT.good("{kind} {version}, system {system}, {mode}")
OTHER_AUTOPILOT = _AUTOPILOT.warning(
    "system {system} is neither ArduPilot nor PX4",
    "try each trigger on the ground first: it is not known how this autopilot reports mission items",
)
ARMED = _AUTOPILOT.warning("it is armed ({mode})", "disarm it before you connect or repair anything")
_HEARTBEAT = Subject("heartbeat")
HEARTBEAT = _HEARTBEAT.good("{rate:.1f} a second; the link was silent for {silence:.1f} s at most")
HEARTBEAT_GAPS = _HEARTBEAT.bad(
    "nothing arrived for {silence:.1f} s; after {limit:g} s (losses.autopilot_s) the autopilot is lost",
    "correct the link: cable, baud rate, load of a router",
)
NO_HEARTBEAT = _HEARTBEAT.bad(
    "none for {limit:g} s, but other messages arrive: the arm state is unknown",
    "check which messages a router forwards",
)
_STREAM = Subject("{name}")
STREAM = _STREAM.good("{rate:.1f} a second")
SLOW = _STREAM.warning("{rate:.1f} a second, not {wanted:g} (for {use})", "{where}")
TOO_SLOW = _STREAM.bad("{rate:.1f} a second; {use} needs {least:.1f}", "{where}")
MISSING = _STREAM.bad("does not arrive; needed for {use}", "{where}")
MISSED = _STREAM.warning("does not arrive; used for {use}", "{where}")
_COMPONENT_ID = Subject("component id")
DUPLICATE_ID = _COMPONENT_ID.bad(
    "{id} is taken by another program on this vehicle",
    "set vehicle.component_id to a free one (BlueOS and Rpanion have 191)",
)
DUPLICATE_ID_OF_SERVICE = _COMPONENT_ID.warning(
    "{id} is in use on this vehicle, probably by {who}, which runs", "stop it ({stop}) and repeat this check"
)
DUPLICATE_ID_ONCE = _COMPONENT_ID.warning(
    "a message came from our own id {id}: another program may use this id",
    "repeat this check; if it comes again, set vehicle.component_id to a free one",
)
FREE = _COMPONENT_ID.good("{id} is free; senders besides the autopilot: {others}")
_SIGNING = Subject("signing")
UNSIGNED = _SIGNING.bad(
    "all messages were refused: {refused}",
    "give both sides the same key (docs/mavlink.md), or remove vehicle.signing_key",
)
DATED_AHEAD = _SIGNING.bad(
    "all messages were refused: their time is too far ahead of this computer's clock",
    "correct the clock that is wrong: this computer's or the sender's (docs/mavlink.md)",
)
SOME_REFUSED = _SIGNING.warning(
    "some messages were refused: {refused}", "check who else sends on this link, and with which key"
)
SIGNED = _SIGNING.good("all messages were signed with our key")
NO_KEY = _SIGNING.warning(
    "the autopilot signs its messages, but the configuration has no key: it may ignore ours",
    "write its key to a file, and set vehicle.signing_key to this file",
)
NO_KEY_NEEDED = _SIGNING.good(
    "the autopilot signs its messages, and also answers our unsigned ones: no key is needed"
)
NOT_SIGNED = _SIGNING.good("off, on both sides")


def check(
    facts: VehicleFacts | None,
    config: Config,
    seconds: float,
    running: Sequence[Process] = (),
    late_s: float = 0.0,
) -> list[DoctorFinding]:
    """The findings about the link.

    Args:
        facts: None if the port could not be opened.
        config: the configuration.
        seconds: listening time.
        running: our own services that run on this computer.
        late_s: lateness of our own loop.
    """
    if facts is None:
        return [NOT_ASKED()]
    if running and not facts.found and not facts.refused.total and not facts.rivals:
        why = f" ({facts.down})" if facts.down else ""
        return [SERVED(why=why, who=all_named(running), stop=stop(running))]
    if not facts.messages:
        if facts.refused.ahead:
            return [DATED_AHEAD()]
        if facts.refused.total:
            return [UNSIGNED(refused=facts.refused)]
        if facts.down:
            return [NO_LINK(why=facts.down)]
        if facts.unread_from and not facts.bytes:
            return [NOT_THE_PEER(other=facts.unread_from)]
        if facts.echoes:
            return [ECHO(echoes=facts.echoes)]
        return [NOISE(bytes=facts.bytes)] if facts.bytes else [SILENT(seconds=seconds)]
    if facts.rivals:
        return [TWO_AUTOPILOTS(one=facts.rivals[0], other=facts.rivals[1])]
    if not facts.found:
        system = config.vehicle.system_id
        return [NO_AUTOPILOT(messages=facts.messages, others=_named(facts.others), system=system)]
    autopilot = of_name(facts.kind)
    return [
        *_autopilot(facts, autopilot),
        excused(_heartbeat(facts, config), late_s),
        *(
            excused(found, late_s) if stream.rate_Hz else found
            for stream in facts.streams
            for found in (_stream(stream, autopilot, config),)
        ),
        _component(facts, config, running),
        _signing(facts, bool(config.vehicle.signing_key)),
        *_line(facts, config, seconds),
    ]


def _line(facts: VehicleFacts, config: Config, seconds: float) -> list[DoctorFinding]:
    if facts.echoes and not isinstance(parse_address(config.vehicle.link), NetworkAddress):
        return [SERIAL_ECHO()]
    if facts.buffered is None:
        return []
    kept_s = facts.buffered * seconds / facts.messages
    too_small = kept_s < STALL_S and facts.buffered * BUFFERED_FRAME_BYTES < RECEIVE_BUFFER_BYTES
    return [(SMALL_BUFFER if too_small else BUFFER)(seconds=kept_s, wanted=RECEIVE_BUFFER_BYTES)]


def _autopilot(facts: VehicleFacts, autopilot: Autopilot) -> list[DoctorFinding]:
    mode = facts.mode or "no mode"
    if autopilot is OTHER:
        return [OTHER_AUTOPILOT(system=facts.system_id)]
    version = facts.version or "of unknown version"
    found = [AUTOPILOT(kind=autopilot.title, version=version, system=facts.system_id, mode=mode)]
    return [*found, ARMED(mode=mode)] if facts.armed else found


def _heartbeat(facts: VehicleFacts, config: Config) -> DoctorFinding:
    if facts.heartbeat_missing:
        return NO_HEARTBEAT(limit=HEARTBEAT_FRESH_S)
    if facts.longest_silence_s > config.losses.autopilot_s:
        return HEARTBEAT_GAPS(silence=facts.longest_silence_s, limit=config.losses.autopilot_s)
    return HEARTBEAT(rate=facts.heartbeat_Hz, silence=facts.longest_silence_s)


def _stream(stream: StreamFacts, autopilot: Autopilot, config: Config) -> DoctorFinding:
    if stream.name in autopilot.own_rates_Hz:
        stream = replace(stream, wanted_Hz=autopilot.own_rates_Hz[stream.name], refused=False)
    use = USES.get(stream.name, "[[triggers]]")
    where = autopilot.how_to_set_stream(stream.name, math.ceil(stream.wanted_Hz))
    needed = stream.essential or (stream.name == "RC_CHANNELS" and uses_switch(config))
    if stream.rate_Hz == 0.0:
        use += "; the autopilot refuses it" if stream.refused else ""
        return (MISSING if needed else MISSED)(name=stream.name, use=use, where=where)
    min_Hz = min_rate_Hz(stream.name, config) if needed else 0.0
    if stream.rate_Hz < min_Hz:
        return TOO_SLOW(name=stream.name, rate=stream.rate_Hz, use=use, least=min_Hz, where=where)
    if stream.rate_Hz < MIN_RATE_SHARE * stream.wanted_Hz:
        return SLOW(name=stream.name, rate=stream.rate_Hz, wanted=stream.wanted_Hz, use=use, where=where)
    return STREAM(name=stream.name, rate=stream.rate_Hz)


def min_rate_Hz(name: str, config: Config) -> float:
    """Below this rate the service would report a loss although messages arrive."""
    if name == "RC_CHANNELS":
        return SAMPLES_WITHIN_LOSS / config.losses.rc_s
    return 1.0 / ALTITUDE_FRESH_S


def uses_switch(config: Config) -> bool:
    return any(config.switch.positions)


def _component(facts: VehicleFacts, config: Config, running: Sequence[Process]) -> DoctorFinding:
    ours = config.vehicle.component_id
    came_once = (facts.system_id, ours) in facts.others
    if running and (facts.duplicate_id or came_once):
        return DUPLICATE_ID_OF_SERVICE(id=ours, who=all_named(running), stop=stop(running))
    if facts.duplicate_id:
        return DUPLICATE_ID(id=ours)
    if came_once:
        return DUPLICATE_ID_ONCE(id=ours)
    return FREE(id=ours, others=_named(facts.others) or "none")


def _signing(facts: VehicleFacts, wanted: bool) -> DoctorFinding:
    if wanted:
        return SOME_REFUSED(refused=facts.refused) if facts.refused.total else SIGNED()
    if not facts.signs:
        return NOT_SIGNED()
    return NO_KEY_NEEDED() if facts.answers else NO_KEY()


def _named(others: tuple[tuple[int, int], ...]) -> str:
    return ", ".join(f"{system}/{component}" for system, component in others)


_MISSION = Subject("mission")
MISSION_NOT_READ = _MISSION.warning(
    "it could not be read, so its items would not move the vine",
    "try again with more --seconds; check whether a ground station is uploading",
)
NO_MISSION_READ = _MISSION.skipped("not read: no autopilot was found")
NO_MISSION = _MISSION.good("the vehicle has no mission")
NO_VINE = _MISSION.good("{items} items, none for the vine")
UNDERSTOOD = _MISSION.good("{items} items; for the vine: {vine}")
NOT_UNDERSTOOD = _MISSION.bad(
    "item {seq}: {why}",
    "correct the item, or add a rule to [[items]]; `flying-vines mission check` shows details",
)


def check_mission(
    mission: Mapping[int, MissionItem] | None, found: bool, config: Config
) -> list[DoctorFinding]:
    """`mission` is None if it was not read; `found` is True if there is an autopilot."""
    if not found:
        return [NO_MISSION_READ()]
    if mission is None:
        return [MISSION_NOT_READ()]
    if not mission:
        return [NO_MISSION()]
    rules, planner = Rules(config), MotionPlanner(config)
    findings, understood = [], []
    for seq, item in sorted(mission.items()):
        if item.command not in rules.commands:
            continue
        intent, problem = rules.for_command(item.command, item.params)
        if intent is not None:
            problem = planner.problem(intent)
        if problem:
            findings.append(NOT_UNDERSTOOD(seq=seq, why=problem))
        else:
            understood.append(f"{seq} ({intent})")
    if understood:
        findings.append(UNDERSTOOD(items=len(mission), vine=", ".join(understood)))
    return findings or [NO_VINE(items=len(mission))]
