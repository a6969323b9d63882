"""Checks the vehicle's link: who sends, and do all needed messages arrive often enough?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from flying_vines.config.address import NetworkAddress, parse_address
from flying_vines.config.config import Config
from flying_vines.doctor.checks.machine import excused
from flying_vines.doctor.checks.service import Process, named, stop
from flying_vines.doctor.finding import DoctorFinding, FindingText
from flying_vines.doctor.vehicle_probe import StreamFacts, VehicleFacts
from flying_vines.vehicle.autopilots import OTHER, of_name
from flying_vines.vehicle.autopilots.autopilot import Autopilot
from flying_vines.vehicle.mavlink.link import BUFFERED_FRAME_BYTES, RECEIVE_BUFFER_BYTES
from flying_vines.vehicle.state import ALTITUDE_FRESH_S, HEARTBEAT_FRESH_S

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

NO_LINK = FindingText("vehicle link", "bad", "{why}", "check vehicle.link, and the result for its port above")
SERVED = FindingText(
    "vehicle link",
    "bad",
    "no autopilot is found{why}; {who} runs and may use this link",
    "use flying-vines watch; or stop the service ({stop}) and repeat this check",
)
NOT_ASKED = FindingText(
    "vehicle link", "skipped", "not checked, because its port cannot be used: see the result for the port"
)
SILENT = FindingText(
    "vehicle link",
    "bad",
    "nothing arrived in {seconds:.0f} s",
    "set the autopilot's port: on ArduPilot SERIALn_PROTOCOL = 2 and its baud rate, on PX4 MAV_1_CONFIG; "
    "check vehicle.link, RX and TX",
)
NOT_THE_PEER = FindingText(
    "vehicle link",
    "bad",
    "only {other} sends, and this is not the peer in vehicle.link",
    "if that is your autopilot, write ?peer={other} in vehicle.link",
)
NOISE = FindingText(
    "vehicle link",
    "bad",
    "{bytes} bytes arrived, but no MAVLink message",
    "set the autopilot's baud rate in vehicle.link, and check that no other device uses the line",
)
ECHO = FindingText(
    "vehicle link",
    "bad",
    "only our own {echoes} frames come back",
    "set the autopilot's port, and check the wires: TX and RX touch, or the adapter returns what we send",
)
SERIAL_ECHO = FindingText(
    "vehicle link",
    "warning",
    "our own frames come back on the serial line",
    "check the wires: TX and RX touch, or the adapter returns what we send (half-duplex, local echo)",
)
BUFFER = FindingText("receive buffer", "good", "keeps {seconds:.0f} s of frames while this computer stalls")
SMALL_BUFFER = FindingText(
    "receive buffer",
    "warning",
    "keeps {seconds:.1f} s of frames: a vent that is sent in a longer stall of this computer is lost",
    "sudo sysctl -w net.core.rmem_max={wanted} (and the same in /etc/sysctl.d/60-vine.conf)",
)
NO_AUTOPILOT = FindingText(
    "vehicle link",
    "bad",
    "{messages} messages arrived from {others}, but none from an autopilot",
    "check which messages a router forwards, and vehicle.system_id = {system} (0: the first autopilot)",
)
TWO_AUTOPILOTS = FindingText(
    "vehicle link",
    "bad",
    "autopilots {one} and {other} are on the link: neither is served",
    "set vehicle.system_id",
)
AUTOPILOT = FindingText("autopilot", "good", "{kind} {version}, system {system}, {mode}")
OTHER_AUTOPILOT = FindingText(
    "autopilot",
    "warning",
    "system {system} is neither ArduPilot nor PX4",
    "try each trigger on the ground first: it is not known how this autopilot reports mission items",
)
ARMED = FindingText(
    "autopilot", "warning", "it is armed ({mode})", "disarm it before you connect or repair anything"
)
HEARTBEAT = FindingText(
    "heartbeat", "good", "{rate:.1f} a second; the link was silent for {silence:.1f} s at most"
)
HEARTBEAT_GAPS = FindingText(
    "heartbeat",
    "bad",
    "nothing arrived for {silence:.1f} s; after {limit:g} s (losses.autopilot_s) the autopilot is lost",
    "correct the link: cable, baud rate, load of a router",
)
NO_HEARTBEAT = FindingText(
    "heartbeat",
    "bad",
    "none for {limit:g} s, but other messages arrive: the arm state is unknown",
    "check which messages a router forwards",
)
STREAM = FindingText("{name}", "good", "{rate:.1f} a second")
SLOW = FindingText("{name}", "warning", "{rate:.1f} a second, not {wanted:g} (for {use})", "{where}")
TOO_SLOW = FindingText("{name}", "bad", "{rate:.1f} a second; {use} needs {least:.1f}", "{where}")
MISSING = FindingText("{name}", "bad", "does not arrive; needed for {use}", "{where}")
MISSED = FindingText("{name}", "warning", "does not arrive; used for {use}", "{where}")
DUPLICATE_ID = FindingText(
    "component id",
    "bad",
    "{id} is taken by another program on this vehicle",
    "set vehicle.component_id to a free one (BlueOS and Rpanion have 191)",
)
DUPLICATE_ID_OF_SERVICE = FindingText(
    "component id",
    "warning",
    "{id} is in use on this vehicle, probably by {who}, which runs",
    "stop it ({stop}) and repeat this check",
)
DUPLICATE_ID_ONCE = FindingText(
    "component id",
    "warning",
    "a message came from our own id {id}: another program may use this id",
    "repeat this check; if it comes again, set vehicle.component_id to a free one",
)
FREE = FindingText("component id", "good", "{id} is free; senders besides the autopilot: {others}")
UNSIGNED = FindingText(
    "signing",
    "bad",
    "all messages were refused: {refused}",
    "give both sides the same key (docs/mavlink.md), or remove vehicle.signing_key",
)
DATED_AHEAD = FindingText(
    "signing",
    "bad",
    "all messages were refused: their time is too far ahead of this computer's clock",
    "correct the clock that is wrong: this computer's or the sender's (docs/mavlink.md)",
)
SOME_REFUSED = FindingText(
    "signing",
    "warning",
    "some messages were refused: {refused}",
    "check who else sends on this link, and with which key",
)
SIGNED = FindingText("signing", "good", "all messages were signed with our key")
NO_KEY = FindingText(
    "signing",
    "warning",
    "the autopilot signs its messages, but the configuration has no key: it may ignore ours",
    "write its key to a file, and set vehicle.signing_key to this file",
)
NO_KEY_NEEDED = FindingText(
    "signing",
    "good",
    "the autopilot signs its messages, and also answers our unsigned ones: no key is needed",
)
NOT_SIGNED = FindingText("signing", "good", "off, on both sides")


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
        return [SERVED(why=why, who=named(running), stop=stop(running))]
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
        return DUPLICATE_ID_OF_SERVICE(id=ours, who=named(running), stop=stop(running))
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
