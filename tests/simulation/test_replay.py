"""Replays of recorded ArduCopter and PX4 flights: each stimulus in their logs gives its decision."""

from __future__ import annotations

import functools
import json
import math
import re
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pytest
from command_line import run
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config
from flying_vines.core.events import Action, Decision, ToFirmware, ToVehicle
from flying_vines.simulation.replay import as_json, replay
from flying_vines.vehicle.mavlink.codec import MavlinkCodec
from flying_vines.vehicle.mavlink.tlog import TlogReader, recorded_times
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.notice import Notice

RECORDINGS = Path(__file__).parents[1] / "data" / "recordings"
FRAMES = sorted(path.stem for path in RECORDINGS.glob("*.tlog"))
SETTLING_S = 0.45
"""RC_CHANNELS at 10 Hz: up to 0.1 s of delay, the debounce time, and two more samples."""


@functools.cache
def replayed(name: str, seconds: float = math.inf) -> list[Action]:
    return fresh_replay(name, seconds=seconds)


def fresh_replay(name: str, mission: Sequence[MissionItem] = (), seconds: float = math.inf) -> list[Action]:
    """The actions for the first `seconds` of a recording."""
    reader = TlogReader(RECORDINGS / f"{name}.tlog")
    frames = list(reader.frames())
    taken = (frame for frame in frames if frame[0] < frames[0][0] + seconds)
    actions = list(replay(taken, config.default(), mission))
    assert reader.skipped_bytes == 0
    return actions


def decisions(actions: list[Action], trigger: str | None = None) -> list[Decision]:
    return [a for a in actions if isinstance(a, Decision) and trigger in (None, a.trigger)]


def assert_moves(found: list[Decision], wanted: list[tuple[float, int]], offset_s: float) -> None:
    """Each stimulus gives exactly one decision, in order and in time."""
    assert [d.what["position"] for d in found] == [position for _, position in wanted]
    for decision, (at_s, _) in zip(found, wanted, strict=True):
        assert 0.0 < decision.t - (at_s + offset_s) < SETTLING_S


def test_each_move_of_the_switch_counts_once_and_a_failsafe_never() -> None:
    actions = replayed("rc_switch")
    first_frame_after_start_s = 0.09
    wanted = [
        (10.016, 1), (14.016, 2), (18.017, 1), (21.017, 0), (24.017, 2), (28.017, 0), (31.018, 2),
        (34.018, 0), (34.518, 2), (35.018, 0), (35.518, 1), (36.019, 2),
        (55.036, 1), (58.036, 2), (70.048, 0),
    ]  # fmt: skip
    found = decisions(actions, "switch")
    assert_moves(found, wanted, first_frame_after_start_s)
    assert all(d.safety == "accepted" for d in found)
    losses = decisions(actions, "failsafe")
    assert [d.what for d in losses] == [{"loss": "rc"}, {"loss": "rc"}]
    assert [round(d.t) for d in losses] == [40, 62]
    assert {d.setpoint_kPa for d in losses} == {0.0}
    assert len(decisions(actions)) == len(wanted) + len(losses)


def test_a_move_while_rc_is_lost_is_only_reported() -> None:
    notices_s = [a.t for a in replayed("rc_switch") if isinstance(a, Notice) and "move it again" in a.text]
    assert len(notices_s) == 1
    assert 49.0 < notices_s[0] < 52.0


CONFIRMED_S = (1.6, 1.85)
"""Delay of a bend on PX4: the RC status must stay good for 1.6 s. Then the next messages decide."""


def bends(actions: list[Action]) -> list[tuple[float, str | None]]:
    return [(d.t, d.intent) for d in decisions(actions, "switch") if d.intent and d.intent != "straight"]


def vents(actions: list[Action]) -> list[float]:
    return [d.t for d in decisions(actions, "failsafe") if d.what == {"loss": "rc"}]


@pytest.mark.parametrize(
    ("name", "seconds", "bent_s", "losses_s"),
    [
        ("px4_sbus_failsafe", 60.0, [29.36], [32.25, 50.40]),
        pytest.param(
            *("px4_sbus_failsafe", math.inf, [29.36, 76.89], [32.25, 50.40, 69.21, 79.8, 97.9, 116.8]),
            marks=pytest.mark.long,
        ),
        pytest.param(
            *("px4_crsf_loss", math.inf, [28.58, 63.08], [31.5, 49.6, 66.1, 84.2]), marks=pytest.mark.long
        ),
    ],
)
def test_on_px4_only_held_positions_bend_and_every_loss_vents(
    name: str, seconds: float, bent_s: list[float], losses_s: list[float]
) -> None:
    actions = replayed(name, seconds)
    for (t, intent), moved_s in zip(bends(actions), bent_s, strict=True):
        assert CONFIRMED_S[0] < t - moved_s < CONFIRMED_S[1]
        assert intent == "bend-full"
    for t, lost_s in zip(vents(actions), losses_s, strict=True):
        assert 0.0 < t - lost_s < 1.5
    texts = [a.text for a in actions if isinstance(a, Notice)]
    assert sum("move it again" in text for text in texts) >= len(losses_s) - 1


@pytest.mark.long
def test_with_a_receiver_that_holds_bends_are_immediate() -> None:
    base = config.default()
    holds = msgspec.structs.replace(
        base, switch=msgspec.structs.replace(base.switch, receiver_failsafe="hold")
    )
    frames = TlogReader(RECORDINGS / "px4_crsf_loss.tlog").frames()
    moved_s = [26.45, 28.58, 47.53, 56.88, 61.01, 63.08, 82.12, 91.41]
    for (t, _), at_s in zip(bends(list(replay(frames, holds))), moved_s, strict=True):
        assert 0.0 < t - at_s < 0.25


def test_an_ardupilot_that_hides_losses_bends_nothing() -> None:
    actions = replayed("ardupilot_hidden_rc_loss")
    assert bends(actions) == []
    refused = [d for d in decisions(actions, "switch") if d.safety == "refused"]
    assert [round(d.t, 1) for d in refused] == [48.4, 74.9]
    assert {d.reason for d in refused} == {"FS_THR_ENABLE 0 hides a lost transmitter"}


@pytest.mark.long
def test_the_end_of_an_override_bends_nothing() -> None:
    actions = replayed("ardupilot_override_and_late_texts")
    assert [round(t, 1) for t, _ in bends(actions)] == [49.1]
    notices_s = [a.t for a in actions if isinstance(a, Notice) and "was overruled" in a.text]
    assert [round(t, 1) for t in notices_s] == [59.5]


def test_reboots_on_the_ground_bend_nothing() -> None:
    actions = replayed("reboot")
    found = decisions(actions, "switch")
    assert_moves(found, [(12.047, 2), (45.097, 0)], 0.0)
    assert (found[0].safety, found[0].reason) == ("refused", "not armed")
    assert found[1].intent == "straight"
    reboots = [d.t for d in decisions(actions, "link")]
    assert len(reboots) == 2
    assert 20.0 < reboots[0] < 24.0
    assert 50.0 < reboots[1] < 54.0
    assert all(d.setpoint_kPa == 0.0 for d in decisions(actions))


EXECUTED = re.compile(r" PAYLOAD \S+ item (\d+) \S+\((\d+)\).* at (\d+\.\d+)")


@pytest.mark.parametrize(
    "name", ["ardupilot_vine_mission", pytest.param("px4_vine_mission", marks=pytest.mark.long)]
)
def test_each_item_counts_once_when_it_runs(name: str) -> None:
    timeline = (RECORDINGS / f"{name}.timeline.txt").read_text()
    truth = [
        (float(m[3]), int(m[1]), int(m[2])) for line in timeline.splitlines() if (m := EXECUTED.search(line))
    ]
    assert len(truth) == 4
    actions = replayed(name)
    found = decisions(actions, "mission_item")
    assert [(d.what["seq"], d.what["command"]) for d in found] == [
        (seq, command) for _, seq, command in truth
    ]
    for decision, (at_s, _, _) in zip(found, truth, strict=True):
        assert abs(decision.t - at_s) < 0.005
        assert decision.safety == "accepted"
    assert decisions(actions) == found


def test_script_messages_give_their_angles_and_profiles() -> None:
    found = decisions(replayed("ardupilot_vine_mission"), "mission_item")
    assert [d.intent for d in found] == ["bend 40°", "bend-full", "reach", "straight"]
    assert found[0].setpoint_kPa == pytest.approx(2.0 + 18.7 * 40 / 60, abs=0.01)


@pytest.mark.long
def test_px4_switch_on_the_ground_and_repeated_commands() -> None:
    actions = replayed("px4_mission")
    moves = decisions(actions, "switch")
    assert_moves(moves, [(3.001, 1), (6.001, 2)], 0.0)
    assert {d.reason for d in moves} == {"not armed"}
    items = decisions(actions, "mission_item")
    assert [(d.what["command"], round(d.t, 1)) for d in items] == [(187, 40.0), (42600, 47.5), (211, 77.7)]
    assert {d.safety for d in items} == {"accepted"}


@pytest.mark.long
def test_items_with_unknown_params_are_refused() -> None:
    found = decisions(replayed("mission_do_items"), "mission_item")
    assert [d.what["seq"] for d in found] == [2, 6, 7, 37, 40, 42, 44]
    assert {d.safety for d in found} == {"refused"}
    assert {d.reason for d in found} == {"params not confirmed"}


@pytest.mark.long
def test_a_given_mission_has_the_params() -> None:
    given = {2: (217, (1, 25.0)), 6: (211, (1, 0)), 37: (217, (0, 0)), 40: (217, (9, 0))}
    mission = [MissionItem(seq, *_item(given.get(seq, (16, (0, 0))))) for seq in range(47)]
    found = {d.what["seq"]: d for d in decisions(fresh_replay("mission_do_items", mission), "mission_item")}
    assert found[2].intent == "bend 25°"
    assert found[2].safety == "accepted"
    assert found[6].intent == "bend-full"
    assert found[40].safety == "refused"
    assert "no rule for script_message (9" in found[40].reason


def _item(
    given: tuple[int, tuple[float, float]],
) -> tuple[int, tuple[float, float, float, float, float, float, float]]:
    command, (one, two) = given
    return command, (one, two, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.long
def test_the_same_recording_gives_the_same_actions() -> None:
    def as_text(actions: list[Action]) -> list[str]:
        return [str(a.message) if isinstance(a, ToVehicle | ToFirmware) else str(a) for a in actions]

    assert as_text(fresh_replay("px4_vine_mission")) == as_text(replayed("px4_vine_mission"))


def test_pace_waits_for_the_recorded_time() -> None:
    frames = [(1000.0 + 0.5 * i, b"") for i in range(5)]
    waited: list[float] = []
    list(replay(frames, config.default(), pace=1e3, sleep=waited.append))
    assert len(waited) <= 4
    slept: list[float] = []
    list(replay(frames, config.default(), pace=0.5, sleep=slept.append))
    assert slept[-1] == pytest.approx(4.0, abs=1.0)


REAL = list(TlogReader(RECORDINGS / "rc_switch.tlog").frames())
BEGAN_S, STEPS_AT_S = REAL[0][0], REAL[0][0] + 22.5
HOUR_S = 3600.0


def stepped(step_s: float) -> Callable[[int, float], float]:
    return lambda index, unix_s: unix_s + (step_s if unix_s > STEPS_AT_S else 0.0)


WRONG_CLOCKS: dict[str, tuple[Callable[[int, float], float], str]] = {
    "right": (lambda index, unix_s: unix_s, ""),
    "an hour forward": (stepped(HOUR_S), "steps by +3,600 s at 22.4 s"),
    "an hour back": (stepped(-HOUR_S), "steps by -3,600 s at 22.4 s"),
    "three seconds forward": (stepped(3.0), "steps by +3.0 s at 22.4 s"),
    "two seconds back": (stepped(-2.0), "steps by -2.0 s at 22.4 s"),
    "a leap of three days": (stepped(72 * HOUR_S), "steps by +259,200 s"),
    "1970": (lambda index, unix_s: unix_s - BEGAN_S + 12.0, ""),
    "1970 until the network tells the time": (
        lambda index, unix_s: unix_s - BEGAN_S + 12.0 if unix_s < STEPS_AT_S else unix_s,
        "steps by +1,795,211,465 s",
    ),
    "no clock": (lambda index, unix_s: 0.0, "stands still for"),
    "no clock until the network tells the time": (
        lambda index, unix_s: 0.0 if unix_s < STEPS_AT_S else unix_s,
        "stands still for",
    ),
    "one record far ahead": (
        lambda index, unix_s: unix_s + 999.0 * (index % 1000 == 557),
        "steps by +999 s",
    ),
    "one record far behind": (lambda index, unix_s: unix_s - 50.0 * (index == 200), "steps by -50 s"),
    "often": (lambda index, unix_s: unix_s + HOUR_S * (index // 100 % 3), "times more"),
}


@pytest.mark.parametrize("name", WRONG_CLOCKS)
def test_the_vehicles_clock_counts_where_the_recorded_times_are_impossible(name: str) -> None:
    times, says = WRONG_CLOCKS[name]
    said: list[str] = []
    found = recorded_times([(times(i, unix_s), frame) for i, (unix_s, frame) in enumerate(REAL)], said.append)
    assert found == sorted(found)
    for t, (unix_s, _) in zip(found, REAL, strict=True):
        assert t == pytest.approx(unix_s - BEGAN_S, abs=0.3)
    assert says in " ".join(said)
    assert bool(says) == bool(said)


@pytest.mark.parametrize("name", FRAMES)
def test_stalls_reboots_and_losses_of_real_links_are_no_steps(name: str) -> None:
    frames = list(TlogReader(RECORDINGS / f"{name}.tlog").frames())
    assert recorded_times(frames, pytest.fail) == [unix_s - frames[0][0] for unix_s, _ in frames]


def test_a_gap_of_days_between_two_flights_is_left_out() -> None:
    later = [(unix_s + 48 * HOUR_S, frame) for unix_s, frame in REAL]
    said: list[str] = []
    found = recorded_times([*REAL, *later], said.append)
    assert found[-1] == pytest.approx(2 * (REAL[-1][0] - BEGAN_S) + 60.0, abs=1.0)
    assert len(said) == 1
    assert said[0].startswith("nothing is recorded for 48.0 h after 88.3 s")


def test_a_clock_that_steps_costs_no_move_of_the_switch(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    times, _ = WRONG_CLOCKS["an hour back"]
    path = write_tlog(tmp_path / "x.TLOG", [(times(0, unix_s), frame) for unix_s, frame in REAL[:1200]])
    status, out, err = run(capsys, "replay", path, "--json")
    assert status == 0
    found = [(d["what"]["position"], d["t"]) for d in json.loads(out)]
    right = [(d.what["position"], d.t) for d in decisions(replayed("rc_switch"), "switch")]
    assert found == [(position, pytest.approx(t, abs=0.1)) for position, t in right[: len(found)]]
    assert len(found) >= 6
    assert err.count("\n") == 1
    assert "the file's clock steps by -3,600 s at 22.4 s" in err


def write_tlog(path: Path, records: Sequence[tuple[float, bytes]]) -> Path:
    path.write_bytes(b"".join(struct.pack(">Q", round(unix_s * 1e6)) + frame for unix_s, frame in records))
    return path


def of_system(frame: bytes, system: int) -> bytes:
    """The frame as if another vehicle had sent it."""
    message = MavlinkCodec(0, 0).decode(frame)[0]
    sender = mavlink.MAVLink(None, srcSystem=system, srcComponent=message.get_srcComponent())
    sender.seq = message.get_seq()
    return bytes(message.pack(sender))


@pytest.mark.parametrize(
    ("arguments", "status", "says"),
    [
        ((), 2, "has several autopilots, 1, 7: choose one, for example --system 1"),
        (("--system", "1"), 0, "this is 1; --system N shows another one"),
        (("--system", "3"), 2, "--system is 3, but the recording has autopilot 1, 7: give --system 1"),
    ],
)
def test_two_vehicles_in_one_recording_are_named(
    arguments: tuple[str, ...], status: int, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    both = [(t, frame) for t, own in REAL[:500] for frame in (own, of_system(own, 7))]
    path = write_tlog(tmp_path / "two.tlog", both)
    found, _, err = run(capsys, "replay", path, *arguments)
    assert (found, err.count("\n")) == (status, 1)
    assert says in err


def test_the_json_of_a_decision() -> None:
    found = [as_json(d) for d in decisions(replayed("rc_switch"))]
    first: dict[str, Any] = found[0]
    assert set(first) == {"t", "trigger", "what", "intent", "safety", "reason", "setpoint_kPa"}
    assert first["trigger"] == "switch"
    assert first["what"] == {"channel": 9, "position": 1, "from": 0}


@pytest.mark.long
def test_items_that_arrive_late_bend_nothing() -> None:
    """Item 2 ran 7.5 s late at 79.1 s, and 4.5 s late at 96.1 s."""
    actions = replayed("ardupilot_override_and_late_texts", 100.0)
    found = decisions(actions, "mission_item")
    assert [(d.what["seq"], d.intent, d.safety) for d in found] == [
        (2, "bend 40°", "refused"),
        (4, "straight", "accepted"),
        (2, "bend 40°", "refused"),
    ]
    assert [d.what["late_s"] for d in found] == pytest.approx([7.5, 3.5, 4.9], abs=0.2)
    assert [d.reason for d in found if d.safety == "refused"] == ["came 7.5 s late", "came 5.0 s late"]
    texts = [a.text for a in actions if isinstance(a, Notice) and "came" in a.text]
    assert texts == [
        "Vine: refused item 2, bend 40°: came 7.5 s late",
        "Vine: refused item 2, bend 40°: came 5.0 s late",
    ]


@pytest.mark.long
def test_the_later_mission_is_in_time_and_has_its_own_angles() -> None:
    actions = replayed("ardupilot_override_and_late_texts")
    found = [d for d in decisions(actions, "mission_item") if d.t > 100.0]
    assert [d.intent for d in found][2:6] == ["bend 13°", "bend 16°", "bend 19°", "bend 22°"]
    assert all(d.safety == "accepted" and "late_s" not in d.what for d in found)
