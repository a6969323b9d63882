"""The RC switch: can it be believed, where does it stand, and was it seen to move?"""

from __future__ import annotations

from flying_vines.config.config import Config
from flying_vines.doctor.finding import DoctorFinding, FindingText
from flying_vines.doctor.vehicle_probe import Radio
from flying_vines.vehicle.radio.switch import BOUNDARIES_US

NOT_USED = FindingText("RC switch", "skipped", "the profile gives its positions nothing to do")
NOT_HEARD = FindingText("RC switch", "skipped", "not looked at: no autopilot was heard")
NOT_BELIEVED = FindingText(
    "RC switch",
    "bad",
    "channel {channel} cannot be believed: {why}",
    "switch the transmitter on, bind the receiver; give the channel in switch.channel",
)
HIDES_LOSS = FindingText(
    "RC switch",
    "bad",
    "{why} hides a lost transmitter: the switch does not bend the vine",
    "ArduPilot: FS_THR_ENABLE 1, RC_FS_TIMEOUT 1, RC_OPTIONS without 1 and 4; PX4: COM_RC_IN_MODE 0",
)
BENDS_LATE = FindingText(
    "RC switch",
    "warning",
    "channel {channel} works, but a bend waits 1.6 s: what this receiver does in a loss is not known",
    "run flying-vines doctor --radio once for this receiver",
)
UNSETTLED = FindingText(
    "RC switch",
    "bad",
    "channel {channel} does not come to rest ({pulse} µs)",
    "see what else is mixed to that channel on the transmitter",
)
STANDS = FindingText(
    "RC switch", "good", "channel {channel} at {pulse} µs: position {position}, “{profile}”; nobody moved it"
)
STANDS_BENT = FindingText(
    "RC switch",
    "warning",
    "channel {channel} at {pulse} µs: position {position}, “{profile}”",
    "put it to position 1 before the start: only a fresh move counts, and it would be one back",
)
ALL_SEEN = FindingText("RC switch", "good", "channel {channel}: all {count} positions were seen")
SOME_SEEN = FindingText(
    "RC switch",
    "warning",
    "channel {channel}: seen in position {seen}, never in {unseen}",
    "look at the channel's end points on the transmitter: {bounds}",
)
NEVER_MOVED = FindingText(
    "RC switch",
    "bad",
    "channel {channel} stayed in position {seen} when it was to be moved",
    "see on the transmitter which channel the switch is on, and give it in switch.channel",
)


def check(radio: Radio | None, config: Config, asked: bool) -> DoctorFinding:
    """`asked` says whether somebody was asked to move it; `radio` is None where no autopilot was heard."""
    switch = config.switch
    channel, count = switch.channel, len(switch.positions)
    if not any(switch.positions):
        return NOT_USED()
    if radio is None:
        return NOT_HEARD()
    if radio.problem is not None:
        return NOT_BELIEVED(channel=channel, why=radio.problem)
    if radio.hides_loss:
        return HIDES_LOSS(why=radio.hides_loss)
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
    line = STANDS if radio.position == 0 else STANDS_BENT
    profile = switch.positions[radio.position] or "nothing"
    return line(channel=channel, pulse=radio.pulse_us, position=radio.position + 1, profile=profile)


def _numbers(positions: frozenset[int]) -> str:
    """As people count."""
    return ", ".join(str(position + 1) for position in sorted(positions))


def bounds(count: int) -> str:
    """Where one position ends and the next begins."""
    return "positions part at " + ", ".join(f"{boundary:g}" for boundary in BOUNDARIES_US[count]) + " µs"
