"""Commands: their addressee, repeats, intents, and acknowledgements."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import count, pairwise

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config
from flying_vines.vehicle.autopilots import AUTOPILOTS
from flying_vines.vehicle.autopilots.autopilot import MissionWatch
from flying_vines.vehicle.clock import AutopilotClock
from flying_vines.vehicle.commands import CommandReceiver
from flying_vines.vehicle.component.senders import Sender
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.mission.item import AutopilotKind, MissionItem
from flying_vines.vehicle.mission.mission_cache import MissionCache
from flying_vines.vehicle.repeats import MAX_COMMANDS, MAX_DELAY_DIFFERENCE_S, PX4_REPEAT_S
from flying_vines.vehicle.triggers import Rules, Trigger
from flying_vines.vine.intent import (
    ArmPneumatics,
    BendTo,
    ClearLatchedFaults,
    DisarmPneumatics,
    Hold,
    Intent,
    SetPressure,
    StartProfile,
    VentVine,
)

ACCEPTED, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS = 0, 2, 3, 4, 5
US, AUTOPILOT, STATION = 191, (1, 1), (255, 190)
PERSON = Sender(*STATION, is_station=True)
ACTUATOR, GRIPPER, SET_SERVO = 187, 211, 183
USER_1, USER_2, USER_3, USER_4, USER_5 = 31010, 31011, 31012, 31013, 31014
NAN = math.nan


SEQUENCE = count()


def sent(message: MavlinkMessage, sender: tuple[int, int]) -> MavlinkMessage:
    side = mavlink.MAVLink(None, *sender)
    side.seq = next(SEQUENCE) & 0xFF
    return mavlink.MAVLink(None).parse_char(message.pack(side))


def command(
    number: int,
    params: Sequence[float] = (),
    confirmation: int = 0,
    sender: tuple[int, int] = STATION,
    target: tuple[int, int] = (1, US),
) -> MavlinkMessage:
    numbers = [*params, *(7 * [0.0])][:7]
    return sent(mavlink.MAVLink_command_long_message(*target, number, confirmation, *numbers), sender)


def broadcast(
    number: int = ACTUATOR,
    params: Sequence[float] = (0.5,),
    confirmation: int = 0,
    target: tuple[int, int] = (1, 0),
) -> MavlinkMessage:
    """A mission item as PX4 sends it, to component 0."""
    return command(number, params, confirmation, AUTOPILOT, target)


class Bench:
    """A receiver whose triggers are decided at once. It stores triggers and answers."""

    def __init__(
        self, items: Sequence[MissionItem] = (), kind: AutopilotKind = "px4", accepts: bool = True
    ) -> None:
        rules = Rules(config.default())
        self.commands = CommandReceiver(rules, US)
        cache = MissionCache(items)
        self.watch = AUTOPILOTS[kind].mission_watch(cache, rules.commands, AutopilotClock())
        self.accepts = accepts
        self.triggers: list[Trigger] = []
        self.answers: list[MavlinkMessage] = []

    def take(self, t: float, message: MavlinkMessage) -> None:
        ids = (message.get_srcSystem(), message.get_srcComponent())
        sender = Sender(*ids, is_autopilot=ids == AUTOPILOT, is_station=ids[0] > 1)
        for output in self.commands.handle(t, message, 1, sender, self.watch):
            if isinstance(output, Trigger):
                self.triggers.append(output)
                self.answers += self.commands.acknowledge(output, self.accepts and output.intent is not None)
            else:
                self.answers.append(output)

    def results(self) -> list[int]:
        return [answer.result for answer in self.answers]


def repeats(
    confirmations: Sequence[int], every_s: float = 0.5, params: Sequence[float] = (0.5,)
) -> list[tuple[float, MavlinkMessage]]:
    """The repeats of a mission item by PX4."""
    return [(10.0 + every_s * one, broadcast(params=params, confirmation=one)) for one in confirmations]


@pytest.mark.parametrize(
    ("received", "intents"),
    [
        # Repeats count once, at any pace, and also if the first ones are lost.
        (repeats(range(4)), [BendTo(30.0)]),
        (repeats(range(4), every_s=0.001), [BendTo(30.0)]),
        (repeats(range(1, 4)), [BendTo(30.0)]),
        (repeats(range(2, 4)), [BendTo(30.0)]),
        (repeats((3,)), [BendTo(30.0)]),
        (repeats(range(4), params=(0.0,)), [BendTo(0.0)]),
        # Params that are NaN do not hide a repeat.
        (repeats(range(4), params=(0.5, NAN, NAN, NAN)), [BendTo(30.0)]),
        # Confirmation 0 that arrives after confirmation 1 is the same command.
        (
            [
                (10.0, broadcast(confirmation=1)),
                (10.0 + MAX_DELAY_DIFFERENCE_S / 2, broadcast()),
                (10.9, broadcast(confirmation=2)),
            ],
            [BendTo(30.0)],
        ),
        # A new execution with the same params counts, also if its first message was lost.
        (
            [
                (t + 0.1 * repeat, broadcast(confirmation=repeat))
                for t in (10.0, 10.4, 14.0, 200.0)
                for repeat in range(2)
            ],
            [BendTo(30.0)] * 4,
        ),
        (
            [(10.0, broadcast(confirmation=1)), (10.4 + MAX_DELAY_DIFFERENCE_S, broadcast())],
            [BendTo(30.0)] * 2,
        ),
        # Other params are another command.
        (
            [(10.0, broadcast(params=(0.5,))), (10.6, broadcast(params=(0.25,), confirmation=1))],
            [BendTo(30.0), BendTo(15.0)],
        ),
        # A ground station repeats after 3 s. A new press of the button has confirmation 0 and counts.
        ([(10.0 + 3.0 * i, command(USER_2, (20.0,), i)) for i in range(3)], [BendTo(20.0)]),
        ([(t, command(USER_1, (2.0,))) for t in (10.0, 10.8, 12.0)], [StartProfile("reach")] * 3),
        # Commands of two stations are not repeats of each other.
        (
            [(10.0, command(USER_2, (20.0,))), (10.1, command(USER_2, (20.0,), 1, sender=(254, 190)))],
            [BendTo(20.0)] * 2,
        ),
        # A repeat that is much too late is a new command.
        (
            [(10.0, broadcast()), (10.1 + PX4_REPEAT_S + MAX_DELAY_DIFFERENCE_S, broadcast(confirmation=1))],
            [BendTo(30.0)] * 2,
        ),
    ],
)
def test_repeats_trigger_once_and_each_is_acknowledged(
    received: list[tuple[float, MavlinkMessage]], intents: list[object]
) -> None:
    bench = Bench()
    for t, message in received:
        bench.take(t, message)
    assert [trigger.intent for trigger in bench.triggers] == intents
    assert bench.results() == [ACCEPTED] * len(received)
    assert [(a.command, a.target_system, a.target_component) for a in bench.answers] == [
        (m.command, m.get_srcSystem(), m.get_srcComponent()) for _, m in received
    ]


def test_each_repeat_of_a_refused_item_is_refused() -> None:
    bench = Bench(accepts=False)
    for confirmation in range(3):
        bench.take(10.0 + 0.5 * confirmation, broadcast(confirmation=confirmation))
    assert bench.results() == [DENIED] * 3


@pytest.mark.parametrize("target", [(1, 1), (1, 154), (2, US), (2, 0), (7, 1)])
@pytest.mark.parametrize("sender", [STATION, AUTOPILOT, (1, 100)])
def test_commands_for_others_get_no_answer(target: tuple[int, int], sender: tuple[int, int]) -> None:
    bench = Bench()
    for number in (ACTUATOR, USER_1, USER_4, 400):
        bench.take(10.0, command(number, (0.0,), sender=sender, target=target))
    assert bench.triggers == []
    assert bench.answers == []


@pytest.mark.parametrize("target", [(1, 0), (0, 0), (0, US)])
@pytest.mark.parametrize(
    ("number", "param1", "intent"),
    [
        (USER_2, 30.0, None),
        (USER_3, 10.0, None),
        (USER_4, 0.0, VentVine()),
        (USER_4, 1.0, None),
        (USER_4, 2.0, DisarmPneumatics()),
        (USER_4, 3.0, None),
        (USER_5, 1.0, None),
        *((number, 0.0, None) for number in (400, 512, 1000, 1001, 2003)),
    ],
)
@pytest.mark.parametrize("sender", [STATION, AUTOPILOT])
def test_of_broadcasts_that_are_no_mission_items_only_those_that_deflate_act(
    target: tuple[int, int], number: int, param1: float, intent: Intent | None, sender: tuple[int, int]
) -> None:
    bench = Bench()
    bench.take(10.0, command(number, (param1,), sender=sender, target=target))
    assert [trigger.intent for trigger in bench.triggers] == ([intent] if intent else [])
    assert bench.results() == ([ACCEPTED] if intent else [])


def test_an_item_that_is_not_from_the_autopilot_is_ignored() -> None:
    bench = Bench()
    bench.take(10.0, command(ACTUATOR, (0.5,), sender=(1, 100), target=(1, 0)))
    bench.take(10.0, command(ACTUATOR, (0.5,), sender=STATION, target=(0, 0)))
    assert bench.triggers == []


def test_a_broadcast_item_of_an_ardupilot_is_ignored() -> None:
    bench = Bench(kind="ardupilot")
    bench.take(10.0, broadcast(GRIPPER, (1.0, 0.0), target=(0, 0)))
    assert bench.triggers == []
    assert bench.answers == []


def test_a_command_of_a_script_on_ardupilot_is_a_mission_item() -> None:
    bench = Bench(kind="ardupilot")
    bench.take(10.0, command(USER_1, (1.0, 40.0), sender=AUTOPILOT))
    (trigger,) = bench.triggers
    assert (trigger.kind, trigger.intent, trigger.by_person) == ("mission_item", BendTo(40.0), False)
    assert bench.results() == [ACCEPTED]


@pytest.mark.parametrize("number", [SET_SERVO, 400, 512, 31009, 31015, 65535])
def test_unknown_commands_are_unsupported(number: int) -> None:
    bench = Bench()
    bench.take(10.0, command(number))
    bench.take(10.5, command(number, confirmation=1))
    assert bench.triggers == []
    assert bench.results() == [UNSUPPORTED, UNSUPPORTED]
    assert {answer.command for answer in bench.answers} == {number}


@pytest.mark.parametrize(
    ("number", "params", "intent"),
    [
        (USER_1, (0.0,), StartProfile("straight")),
        (USER_1, (1.0, -25.0), BendTo(-25.0)),
        (USER_1, (2.0,), StartProfile("reach")),
        (USER_2, (33.0,), BendTo(33.0)),
        (USER_3, (12.0,), SetPressure(12.0)),
        (USER_4, (0.0,), VentVine()),
        (USER_4, (1.0,), Hold()),
        (USER_4, (2.0,), DisarmPneumatics()),
        (USER_4, (3.0,), ArmPneumatics()),
        (USER_5, (1.0,), ClearLatchedFaults()),
        (GRIPPER, (1.0, 0.0), StartProfile("bend-full")),
        (ACTUATOR, (-0.5,), BendTo(-30.0)),
    ],
)
def test_the_intents_of_commands(number: int, params: tuple[float, ...], intent: object) -> None:
    bench = Bench()
    bench.take(10.0, command(number, params))
    (trigger,) = bench.triggers
    assert (trigger.kind, trigger.intent, trigger.by_person) == ("command", intent, True)
    assert trigger.what["from"] == "255/190"
    assert bench.results() == [ACCEPTED]


@pytest.mark.parametrize(
    ("number", "params", "problem"),
    [
        (USER_1, (NAN,), "no rule"),
        (USER_1, (1.0, NAN), "not a number"),
        (USER_1, (7.0,), "no rule"),
        (USER_2, (NAN,), "not a number"),
        (USER_2, (math.inf,), "not a number"),
        (USER_3, (NAN,), "not a number"),
        (USER_3, (-math.inf,), "not a number"),
        (USER_4, (NAN,), "param1 must be"),
        (USER_4, (4.0,), "0 (vent), 1 (hold), 2 (disarm), 3 (arm)"),
        (USER_4, (1.5,), "param1 must be"),
        (USER_5, (NAN,), "param1 must be"),
        (USER_5, (0.0,), "param1 must be"),
        (USER_5, (2.0,), "param1 must be one of 1 (clear faults)"),
        (ACTUATOR, (NAN,), "not a number"),
        (GRIPPER, (1.0, NAN), "no rule"),
    ],
)
def test_invalid_params_are_denied_with_a_reason(
    number: int, params: tuple[float, ...], problem: str
) -> None:
    bench = Bench()
    for confirmation in range(2):
        bench.take(10.0 + confirmation, command(number, params, confirmation))
    (trigger,) = bench.triggers
    assert trigger.intent is None
    assert problem in trigger.problem
    assert bench.results() == [DENIED, DENIED]


def test_only_a_command_of_a_ground_station_is_by_a_person() -> None:
    bench = Bench()
    for sender in ((1, 195), AUTOPILOT, STATION):
        bench.take(10.0, command(USER_4, (3.0,), sender=sender))
    assert [trigger.by_person for trigger in bench.triggers] == [False, False, True]


@pytest.mark.parametrize("param", [4, 5, 6])
def test_rules_see_all_seven_params(param: int) -> None:
    rules = config.parse(
        f"[[items]]\ncommand = 'actuator'\nmatch = {{ param{param + 1} = 5 }}\nbend = 'param1'\n"
        "[profiles.straight]\nsegments = [{ kind = 'step', to_kPa = 0 }]\n[switch]\npositions = ['', '']\n",
        "test",
    )
    numbers = [12.0, *(6 * [0.0])]
    commands = CommandReceiver(Rules(rules), US)
    (other,) = commands.handle(1.0, command(ACTUATOR, numbers), 1, PERSON, MissionWatch(MissionCache()))
    numbers[param] = 5.0
    (trigger,) = commands.handle(2.0, command(ACTUATOR, numbers), 1, PERSON, MissionWatch(MissionCache()))
    assert isinstance(other, Trigger) and isinstance(trigger, Trigger)
    assert (other.intent, trigger.intent) == (None, BendTo(12.0))
    integers = (ACTUATOR, 0, 0, *numbers[:4], *(int(number) for number in numbers[4:6]), numbers[6])
    message = sent(mavlink.MAVLink_command_int_message(1, US, 0, *integers), (254, 190))
    (whole,) = commands.handle(3.0, message, 1, PERSON, MissionWatch(MissionCache()))
    assert isinstance(whole, Trigger) and whole.intent == BendTo(12.0)


def test_command_int_has_the_same_effect() -> None:
    bench = Bench()
    numbers = (USER_2, 0, 0, 15.0, 0.0, 0.0, 0.0, 0, 0, 0.0)
    bench.take(10.0, sent(mavlink.MAVLink_command_int_message(1, US, 0, *numbers), STATION))
    bench.take(11.0, sent(mavlink.MAVLink_command_int_message(1, 154, 0, *numbers), STATION))
    assert [trigger.intent for trigger in bench.triggers] == [BendTo(15.0)]
    assert bench.results() == [ACCEPTED]


def test_a_broadcast_item_has_its_number_in_the_mission() -> None:
    items = [MissionItem(seq, ACTUATOR, (0.1 * seq, 0, 0, 0, 0, 0, 0)) for seq in range(5)]
    bench = Bench(items)
    bench.take(10.0, broadcast(params=(0.3,)))
    assert bench.triggers[0].what["seq"] == 3


def test_the_memory_for_repeats_is_bounded() -> None:
    bench = Bench()
    for i in range(5000):
        bench.take(0.01 * i, command(USER_2, (float(i),)))
    assert len(bench.triggers) == 5000
    assert all(b.t > a.t for a, b in pairwise(bench.triggers))
    assert len(bench.commands._repeats._commands) <= MAX_COMMANDS


def test_every_repeat_of_a_vent_vents_but_clears_no_faults() -> None:
    """The sender of a repeat may not have seen the faults since the first message."""
    bench = Bench()
    for confirmation in range(2):
        bench.take(10.0 + confirmation, command(USER_4, (0.0,), confirmation))
    assert [trigger.intent for trigger in bench.triggers] == [VentVine(), VentVine()]
    assert [trigger.by_person for trigger in bench.triggers] == [True, False]


def test_a_repeat_of_an_older_item_is_only_acknowledged() -> None:
    bench = Bench()
    bench.watch.forget(9.9)
    bench.take(10.0, broadcast(confirmation=1))
    assert bench.triggers == []
    assert bench.results() == [ACCEPTED]


@pytest.mark.parametrize(
    ("sender", "params", "problem"),
    [
        ((1, 195), (20.0,), "1/195 is not a ground station"),
        ((1, 195), (NAN,), "the angle is not a number"),
        ((1, 195), (0.0,), ""),
        (STATION, (20.0,), ""),
        (AUTOPILOT, (20.0,), ""),
    ],
)
def test_who_may_bend(sender: tuple[int, int], params: tuple[float, ...], problem: str) -> None:
    bench = Bench()
    bench.take(10.0, command(USER_2, params, sender=sender))
    assert [trigger.problem for trigger in bench.triggers] == [problem]
