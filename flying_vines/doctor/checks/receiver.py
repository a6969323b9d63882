"""What the radio test found: does a lost transmitter show, and what does the receiver do to the switch?"""

from __future__ import annotations

from flying_vines.config.config import Config, ReceiverFailsafe
from flying_vines.doctor.finding import DoctorFinding, FindingText, may_fly
from flying_vines.doctor.radio_test import RadioLearned, TransmitterLoss, failsafe_of, position_of
from flying_vines.vehicle.autopilots import of_name
from flying_vines.vehicle.autopilots.autopilot import LOSS_SHOWN_WITHIN_S, Autopilot
from flying_vines.vehicle.triggers import Rules

HUMAN_S = 1.0
"""Between pressing Enter and switching off."""

ARMED = FindingText(
    "radio test", "bad", "the vehicle is armed", "disarm it, take the props off, and start again"
)
NO_AUTOPILOT = FindingText(
    "radio test",
    "bad",
    "no autopilot was heard",
    "see what `flying-vines doctor` says of the vehicle's link",
)
NO_RC = FindingText(
    "radio test",
    "bad",
    "no channels of a receiver come: {why}",
    "bind the receiver; a joystick sends no RC_CHANNELS, and the switch cannot be used with one",
)
NOT_GOOD = FindingText(
    "radio test",
    "bad",
    "RC did not become good: {why}",
    "switch the transmitter on and bind the receiver, then start again",
)
NOT_THERE = FindingText(
    "radio test",
    "bad",
    "channel {channel} did not come to rest in position {position}: it reads {now}",
    "see on the transmitter which channel the switch is on, and give it in switch.channel",
)
NOT_BACK = FindingText(
    "radio test",
    "bad",
    "RC did not come back: {why}",
    "switch the transmitter on, confirm its warnings, and start again",
)
GROUND_STATION = FindingText(
    "radio test",
    "skipped",
    "RC comes from a ground station (no receiver): nothing to learn; it can be used, and its end shows",
)
HIDDEN_BY = FindingText(
    "RC loss",
    "bad",
    "{autopilot} hides a lost transmitter ({why}): the switch will not bend",
    "{do}",
)
HIDDEN = FindingText(
    "RC loss",
    "bad",
    "nothing told that the transmitter was off: a move made meanwhile would bend the vine on its return",
    "{do}",
)
SLOW = FindingText(
    "RC loss",
    "bad",
    "it shows only {seconds} s after Enter, by {sign}: a shorter loss can hide a move of the switch",
    "on ArduPilot RC_FS_TIMEOUT = 1, on PX4 COM_RC_LOSS_T = 0.5; on the receiver no delay of its failsafe",
)
SHOWS = FindingText("RC loss", "good", "it shows {seconds} s after Enter (± 1 s), by {sign}; then {then}")
SHOWS_UNTIMED = FindingText(
    "RC loss", "good", "it shows (Enter came too late to say how soon), by {sign}; then {then}"
)
PARAMETERS = FindingText("autopilot", "good", "{values}")
NO_PARAMETERS = FindingText(
    "autopilot", "skipped", "it did not say {names}: whether it can hide a loss is not known"
)
HELD = FindingText("receiver", "good", "it holds the switch: a bend by the switch is immediate")
HARMLESS = FindingText(
    "receiver",
    "good",
    "it puts the switch to position {position} ({us} µs), which does not bend: bends are immediate",
)
BENDS_UNSEEN = FindingText(
    "receiver",
    "warning",
    "it puts the switch to position {position}, “{profile}” ({us} µs), and a loss shorter than {seconds} s"
    " does not show: the switch waits {wait} s before it bends so",
    "set the receiver's failsafe of channel {channel} to hold, or to position 1; then repeat the test",
)
BENDS_TOLD = FindingText(
    "receiver",
    "warning",
    "it puts the switch to position {position}, “{profile}” ({us} µs); the autopilot tells of it in time",
    "better set the receiver's failsafe of channel {channel} to hold, or to position 1; then repeat the test",
)
BENDS = FindingText(
    "receiver",
    "bad",
    "it puts the switch to position {position}, “{profile}” ({us} µs), and the loss shows {when}:"
    " a lost transmitter bends the vine",
    "set the receiver's failsafe of channel {channel} to hold, or to position 1; then repeat the test",
)
UNCLEAR = FindingText(
    "receiver",
    "warning",
    "channel {channel} read {us} µs when it was lost: neither held nor one preset value",
    "look at the receiver's failsafe and repeat the test; until then each bend on PX4 waits",
)

LOST = {
    "hold": "the vine holds (losses.on_rc_loss)",
    "vent": "the vine is vented (losses.on_rc_loss)",
}


def check(learned: RadioLearned, config: Config) -> list[DoctorFinding]:
    """Every line that holds; all of them good, or skipped, where the vine is safe with this receiver."""
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
    """What belongs into `switch.receiver_failsafe`; None where nothing was learned.

    "hidden" takes the bends from the switch: so it is where a loss shows too late, as where it does not show.
    """
    if learned.problem or not learned.losses:
        return None
    return failsafe_of(learned.losses) if may_fly(check(learned, config)) else "hidden"


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
    return next(sign.said for sign in loss.signs if sign.after_s == loss.shown_after_s and sign.telling)


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
    told = {
        "position": position + 1,
        "profile": switch.positions[position],
        "us": failsafe,
        "channel": switch.channel,
    }
    late_s = [loss.told_after_jump_s for loss in learned.losses if loss.told_after_jump_s is not None]
    after_s = max(late_s, default=0.0)
    unseen = any(loss.seen and loss.shown_after_s is None for loss in learned.losses)
    if _autopilot(learned).needs_rc_status and not unseen and after_s <= learned.shows_within_s:
        return BENDS_UNSEEN(seconds=f"{after_s:.1f}", wait=f"{learned.shows_within_s:g}", **told)
    if not unseen and after_s <= switch.debounce_s:
        return BENDS_TOLD(**told)
    return BENDS(when="nowhere" if unseen else f"only {after_s:.1f} s later", **told)


def _autopilot(learned: RadioLearned) -> Autopilot:
    return of_name(learned.autopilot)
