"""Checks the RC switch: is it trusted, where is it, and did it move?"""

from __future__ import annotations

from flying_vines.config.config import Config
from flying_vines.doctor.finding import DoctorFinding, FindingText
from flying_vines.doctor.vehicle_probe import SwitchFacts
from flying_vines.vehicle.radio.switch import BOUNDARIES_US

NOT_USED = FindingText("RC switch", "skipped", "no position has a profile")
NO_AUTOPILOT = FindingText("RC switch", "skipped", "not checked: no autopilot was found")
NOT_TRUSTED = FindingText(
    "RC switch",
    "bad",
    "channel {channel} is not valid: {why}",
    "switch the transmitter on, bind the receiver, and check switch.channel",
)
HIDES_LOSS = FindingText(
    "RC switch",
    "bad",
    "{why} hides RC loss from the service, so the switch does not bend the vine",
    "ArduPilot: FS_THR_ENABLE 1, RC_FS_TIMEOUT 1, RC_OPTIONS without 1 and 4; PX4: COM_RC_IN_MODE 0",
)
TWO_USES = FindingText(
    "RC switch",
    "warning",
    "channel {channel} has another use in the autopilot, too: {use}",
    "set it to 0, or give the vine another channel (switch.channel)",
)
BENDS_LATE = FindingText(
    "RC switch",
    "warning",
    "channel {channel} works, but each bend waits 1.6 s or longer: the receiver's failsafe is unknown",
    "run flying-vines doctor --radio once for this receiver",
)
UNSETTLED = FindingText(
    "RC switch",
    "bad",
    "channel {channel} does not stay in one position ({pulse} µs)",
    "check the transmitter for other inputs mixed to this channel",
)
NOT_MOVED = FindingText(
    "RC switch", "good", "channel {channel} at {pulse} µs: position {position}, “{profile}”; it was not moved"
)
AT_BEND = FindingText(
    "RC switch",
    "warning",
    "channel {channel} at {pulse} µs: position {position}, “{profile}”",
    "put it to position 1 before the flight: only a new move counts",
)
ALL_SEEN = FindingText("RC switch", "good", "channel {channel}: seen in all {count} positions")
SOME_SEEN = FindingText(
    "RC switch",
    "warning",
    "channel {channel}: seen in position {seen}, never in {unseen}",
    "check the channel's end points on the transmitter: {bounds}",
)
NEVER_MOVED = FindingText(
    "RC switch",
    "bad",
    "channel {channel} stayed in position {seen} although you were asked to move the switch",
    "look up the switch's channel on the transmitter, and set switch.channel to it",
)


def check(radio: SwitchFacts | None, config: Config, asked: bool) -> DoctorFinding:
    """`asked`: the user was asked to move the switch. `radio` is None if no autopilot was found."""
    switch = config.switch
    channel, count = switch.channel, len(switch.positions)
    if not any(switch.positions):
        return NOT_USED()
    if radio is None:
        return NO_AUTOPILOT()
    if radio.problem is not None:
        return NOT_TRUSTED(channel=channel, why=radio.problem)
    if radio.hides_loss:
        return HIDES_LOSS(why=radio.hides_loss)
    if radio.other_use:
        return TWO_USES(channel=channel, use=radio.other_use)
    if radio.position is None:
        return UNSETTLED(channel=channel, pulse=radio.pulse_us)
    if len(radio.seen) == count and radio.bends_late:
        return BENDS_LATE(channel=channel)
    if len(radio.seen) == count:
        return ALL_SEEN(channel=channel, count=count)
    seen = _numbers(radio.seen)
    if asked and len(radio.seen) == 1:
        return NEVER_MOVED(channel=channel, seen=seen)
    if len(radio.seen) > 1:
        unseen = _numbers(frozenset(range(count)) - radio.seen)
        return SOME_SEEN(channel=channel, seen=seen, unseen=unseen, bounds=bounds(count))
    if radio.position == 0 and radio.bends_late:
        return BENDS_LATE(channel=channel)
    line = NOT_MOVED if radio.position == 0 else AT_BEND
    profile = switch.positions[radio.position] or "nothing"
    return line(channel=channel, pulse=radio.pulse_us, position=radio.position + 1, profile=profile)


def _numbers(positions: frozenset[int]) -> str:
    """Position numbers, from 1."""
    return ", ".join(str(position + 1) for position in sorted(positions))


def bounds(count: int) -> str:
    """The boundaries between the positions."""
    return "the boundaries are " + ", ".join(f"{boundary:g}" for boundary in BOUNDARIES_US[count]) + " µs"
