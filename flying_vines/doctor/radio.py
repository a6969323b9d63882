"""Checks the RC switch, and judges the radio test.

Is the switch trusted, where is it, and did it move? Is RC loss detected, and what does the receiver do with
the switch's channel?
"""

from __future__ import annotations

from collections.abc import Sequence

from flying_vines.config.config import Config, ReceiverFailsafe
from flying_vines.doctor.finding import DoctorFinding, Subject, may_fly
from flying_vines.doctor.radio_test import RadioLearned, TransmitterLoss, failsafe_of, position_of
from flying_vines.doctor.vehicle_probe import SwitchFacts
from flying_vines.vehicle.autopilots import of_name
from flying_vines.vehicle.autopilots.autopilot import LOSS_SHOWN_WITHIN_S, Autopilot
from flying_vines.vehicle.radio.switch import BOUNDARIES_US
from flying_vines.vehicle.triggers import Rules

# The switch.

_RC_SWITCH = Subject("RC switch")
NOT_USED = _RC_SWITCH.skipped("no position has a profile")
NOT_CHECKED = _RC_SWITCH.skipped("not checked: no autopilot was found")
NOT_TRUSTED = _RC_SWITCH.bad(
    "channel {channel} is not valid: {why}",
    "switch the transmitter on, bind the receiver, and check switch.channel",
)
HIDES_LOSS = _RC_SWITCH.bad(
    "{why} hides RC loss from the service, so the switch does not bend the vine",
    "ArduPilot: FS_THR_ENABLE 1, RC_FS_TIMEOUT 1, RC_OPTIONS without 1 and 4; PX4: COM_RC_IN_MODE 0",
)
TWO_USES = _RC_SWITCH.warning(
    "channel {channel} has another use in the autopilot, too: {use}",
    "set it to 0, or give the vine another channel (switch.channel)",
)
BENDS_LATE = _RC_SWITCH.warning(
    "channel {channel} works, but each bend waits 1.6 s or longer: the receiver's failsafe is unknown",
    "run flying-vines doctor --radio once for this receiver",
)
UNSETTLED = _RC_SWITCH.bad(
    "channel {channel} does not stay in one position ({pulse} µs)",
    "check the transmitter for other inputs mixed to this channel",
)
NOT_MOVED = _RC_SWITCH.good(
    "channel {channel} at {pulse} µs: position {position}, “{profile}”; it was not moved"
)
AT_BEND = _RC_SWITCH.warning(
    "channel {channel} at {pulse} µs: position {position}, “{profile}”",
    "put it to position 1 before the flight: only a new move counts",
)
ALL_SEEN = _RC_SWITCH.good("channel {channel}: seen in all {count} positions")
SOME_SEEN = _RC_SWITCH.warning(
    "channel {channel}: seen in position {seen}, never in {unseen}",
    "check the channel's end points on the transmitter: {bounds}",
)
NEVER_MOVED = _RC_SWITCH.bad(
    "channel {channel} stayed in position {seen} although you were asked to move the switch",
    "look up the switch's channel on the transmitter, and set switch.channel to it",
)


def check_switch(radio: SwitchFacts | None, config: Config, asked: bool) -> DoctorFinding:
    """`asked`: the user was asked to move the switch. `radio` is None if no autopilot was found."""
    switch = config.switch
    channel, count = switch.channel, len(switch.positions)
    if not any(switch.positions):
        return NOT_USED()
    if radio is None:
        return NOT_CHECKED()
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


def asking(radio: SwitchFacts, channel: int, positions: Sequence[str]) -> str:
    """The prompt while the user moves the switch."""
    if radio.problem is not None:
        now = radio.problem
    else:
        now = f"{radio.pulse_us} µs"
        if radio.position is not None:
            now += f", position {radio.position + 1}"
    seen = " ".join(f"{i + 1} ✓" if i in radio.seen else f"{i + 1} …" for i in range(len(positions)))
    return f"Move the switch (channel {channel}) through its positions: {seen}  now {now}"


# The radio test.

HUMAN_S = 1.0
"""Uncertainty between pressing Enter and switching off."""

_RADIO_TEST = Subject("radio test")
ARMED = _RADIO_TEST.bad("the vehicle is armed", "disarm it, take the props off, and start again")
NO_AUTOPILOT = _RADIO_TEST.bad(
    "no autopilot was found", "run `flying-vines doctor` to check the vehicle's link"
)
NO_RC = _RADIO_TEST.bad(
    "no RC channels arrive: {why}",
    "bind the receiver; a joystick sends no RC_CHANNELS, so it cannot be the switch",
)
NOT_GOOD = _RADIO_TEST.bad(
    "RC did not become good: {why}", "switch the transmitter on and bind the receiver, then start again"
)
NOT_THERE = _RADIO_TEST.bad(
    "channel {channel} did not reach position {position}: it reads {now}",
    "look up the switch's channel on the transmitter, and set switch.channel to it",
)
NOT_BACK = _RADIO_TEST.bad(
    "RC did not come back: {why}", "switch the transmitter on, confirm its warnings, and start again"
)
GROUND_STATION = _RADIO_TEST.skipped(
    "RC comes from a ground station, not from a receiver: it can be used, and its loss is detected"
)
_RC_LOSS = Subject("RC loss")
HIDDEN_BY = _RC_LOSS.bad("{autopilot} hides RC loss ({why}): the switch does not bend the vine", "{do}")
HIDDEN = _RC_LOSS.bad(
    "no sign of RC loss: a switch move during the loss would bend the vine when RC returns", "{do}"
)
SLOW = _RC_LOSS.bad(
    "detected only {seconds} s after Enter, by {sign}: a shorter loss can hide a switch move",
    "set RC_FS_TIMEOUT = 1 (ArduPilot) or COM_RC_LOSS_T = 0.5 (PX4); on the receiver, no failsafe delay",
)
SHOWS = _RC_LOSS.good("detected {seconds} s after Enter (± 1 s), by {sign}; then {then}")
SHOWS_UNTIMED = _RC_LOSS.good("detected by {sign}; then {then} (Enter came too late to measure the delay)")
_AUTOPILOT = Subject("autopilot")
PARAMETERS = _AUTOPILOT.good("{values}")
NO_PARAMETERS = _AUTOPILOT.skipped("it did not report {names}, so it is unknown whether it can hide RC loss")
_RECEIVER = Subject("receiver")
HELD = _RECEIVER.good("it holds the switch's value during RC loss: bends are immediate")
HARMLESS = _RECEIVER.good(
    "during RC loss it sends position {position} ({us} µs), which does not bend: bends are immediate"
)
BENDS_UNSEEN = _RECEIVER.warning(
    "during RC loss it sends position {position}, “{profile}” ({us} µs). A loss shorter than {seconds} s"
    " is not detected, so this bend waits {wait} s",
    "set the receiver's failsafe of channel {channel} to hold, or to position 1; then repeat the test",
)
BENDS_REPORTED = _RECEIVER.warning(
    "during RC loss it sends position {position}, “{profile}” ({us} µs); the autopilot reports it in time",
    "better set the receiver's failsafe of channel {channel} to hold, or to position 1; then repeat the test",
)
BENDS = _RECEIVER.bad(
    "during RC loss it sends position {position}, “{profile}” ({us} µs), and the loss is detected {when}:"
    " RC loss bends the vine",
    "set the receiver's failsafe of channel {channel} to hold, or to position 1; then repeat the test",
)
UNCLEAR = _RECEIVER.warning(
    "channel {channel} read {us} µs during RC loss: neither its last value nor one preset value",
    "check the receiver's failsafe and repeat the test; until then each bend on PX4 waits",
)

LOST = {"hold": "the vine holds (losses.on_rc_loss)", "vent": "the vine is vented (losses.on_rc_loss)"}


def check_radio_test(learned: RadioLearned, config: Config) -> list[DoctorFinding]:
    """The findings. If one is "bad", the vine is not safe with this receiver, or the test ended early."""
    problem = _problem(learned, config)
    if problem is not None:
        return [problem]
    if learned.hidden_by:
        autopilot = _autopilot(learned)
        do = autopilot.rc_remedies[learned.hidden_by.split()[0]]
        return [HIDDEN_BY(autopilot=autopilot.title, why=learned.hidden_by, do=do)]
    found = [_loss(learned, config), *_parameters(learned)]
    if any(loss.seen for loss in learned.losses):
        found.append(_receiver(learned, config))
    return found


def to_write(learned: RadioLearned, config: Config) -> ReceiverFailsafe | None:
    """The value for `switch.receiver_failsafe`; None without a result.

    "hidden" stops the switch from bending. It is the value whenever a finding is "bad".
    """
    if learned.problem or not learned.losses:
        return None
    return failsafe_of(learned.losses) if may_fly(check_radio_test(learned, config)) else "hidden"


def _problem(learned: RadioLearned, config: Config) -> DoctorFinding | None:
    match learned.problem:
        case "armed":
            return ARMED()
        case "no autopilot":
            return NO_AUTOPILOT()
        case "no RC":
            return NO_RC(why=learned.detail)
        case "RC not good":
            return NOT_GOOD(why=learned.detail)
        case "position":
            return NOT_THERE(channel=config.switch.channel, position=learned.target + 1, now=learned.detail)
        case "ground station":
            return GROUND_STATION()
        case "not back":
            return NOT_BACK(why=learned.detail)
    return None


def _loss(learned: RadioLearned, config: Config) -> DoctorFinding:
    if any(loss.shown_after_s is None for loss in learned.losses):
        return HIDDEN(do=_autopilot(learned).unseen_loss_remedy)
    timed = [loss for loss in learned.losses if loss.pressed] or list(learned.losses)
    slowest = max(timed, key=lambda loss: loss.shown_after_s or 0.0)
    sign, then = _first_sign(slowest), LOST[config.losses.on_rc_loss]
    seconds = f"{slowest.shown_after_s:.1f}"
    if slowest.shown_after_s is not None and slowest.shown_after_s > LOSS_SHOWN_WITHIN_S + HUMAN_S:
        return SLOW(seconds=seconds, sign=sign)
    return (
        SHOWS(seconds=seconds, sign=sign, then=then)
        if slowest.pressed
        else SHOWS_UNTIMED(sign=sign, then=then)
    )


def _parameters(learned: RadioLearned) -> list[DoctorFinding]:
    unsaid = [name for name in _autopilot(learned).rc_parameters if name not in learned.parameters]
    values = ", ".join(f"{name} {value:g}" for name, value in sorted(learned.parameters.items()))
    found = [PARAMETERS(values=values)] if values else []
    return [*found, NO_PARAMETERS(names=", ".join(unsaid))] if unsaid else found


def _first_sign(loss: TransmitterLoss) -> str:
    return next(sign.said for sign in loss.signs if sign.after_s == loss.shown_after_s and sign.shows_loss)


def _receiver(learned: RadioLearned, config: Config) -> DoctorFinding:
    failsafe, switch = failsafe_of(learned.losses), config.switch
    if failsafe == "hold":
        return HELD()
    if not isinstance(failsafe, int):
        read = ", ".join(str(loss.lost_us) for loss in learned.losses if loss.seen)
        return UNCLEAR(channel=switch.channel, us=read)
    position = position_of(failsafe, len(switch.positions))
    if not Rules(config).bends(position):
        return HARMLESS(position=position + 1, us=failsafe)
    values = {
        "position": position + 1,
        "profile": switch.positions[position],
        "us": failsafe,
        "channel": switch.channel,
    }
    late_s = [loss.told_after_jump_s for loss in learned.losses if loss.told_after_jump_s is not None]
    after_s = max(late_s, default=0.0)
    unseen = any(loss.seen and loss.shown_after_s is None for loss in learned.losses)
    if _autopilot(learned).needs_rc_status and not unseen and after_s <= learned.shows_within_s:
        return BENDS_UNSEEN(seconds=f"{after_s:.1f}", wait=f"{learned.shows_within_s:g}", **values)
    if not unseen and after_s <= switch.debounce_s:
        return BENDS_REPORTED(**values)
    return BENDS(when="never" if unseen else f"only {after_s:.1f} s later", **values)


def _autopilot(learned: RadioLearned) -> Autopilot:
    return of_name(learned.autopilot)
